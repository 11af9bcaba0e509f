"""Build a release into dist/: wheel, source archive, site, upgrade notes, checksums, and an image if possible.

Everything is made from committed files; uncommitted changes are an error. The wheel has kernels compiled for this
platform, unless `--no-kernels`. The container image is built and saved if podman or docker is available. `--check`
installs the wheel into an empty environment and runs it there without a compiler: version, doctor, and a demo.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
import venv
from collections.abc import Iterable
from pathlib import Path

import palmd
from tools.wheel import build_wheel, portable_kernels

ROOT = Path(__file__).parent.parent
NAME = f"palmd-{palmd.__version__}"
CHECK_S = 60  # time to a valid estimate on a busy machine; the wheel is checked, not the speed
BUILDERS = ("podman", "docker")


def main() -> int:
    """Build a release; returns 1 if something cannot be built or does not run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "dist", metavar="FOLDER")
    parser.add_argument("--no-site", action="store_true", help="without the documentation")
    parser.add_argument(
        "--no-kernels", action="store_true", help="a wheel for any platform, which compiles kernels where it runs"
    )
    parser.add_argument("--check", action="store_true", help=f"run the wheel: doctor, and a demo of {CHECK_S} s")
    arguments = parser.parse_args()
    changed = _output(["git", "status", "--porcelain", "--untracked-files=no"])
    if changed:
        print(f"cannot build a release with uncommitted changes; commit or revert them:\n{changed}", file=sys.stderr)
        return 1
    shutil.rmtree(arguments.output, ignore_errors=True)
    arguments.output.mkdir(parents=True)
    try:
        made = [*packages(arguments.output, kernels=not arguments.no_kernels), upgrade_notes(arguments.output)]
        if not arguments.no_site:
            made.append(site(arguments.output))
        made += image(arguments.output)
        if arguments.check:
            run_wheel(next(path for path in made if path.suffix == ".whl"))
    except subprocess.CalledProcessError as error:
        said = "\n".join(filter(None, (error.stdout, error.stderr)))
        print(f"{' '.join(map(str, error.cmd))}: status {error.returncode}\n{said}".strip(), file=sys.stderr)
        return 1
    made.append(checksums(arguments.output, made))
    for path in made:
        print(f"{path.relative_to(arguments.output.parent)}  {path.stat().st_size / 1e6:.2f} MB")
    return 0


def packages(output: Path, *, kernels: bool) -> list[Path]:
    """Wheel and source archive; the same sources give the same bytes. Compiling kernels takes minutes."""
    os.environ["SOURCE_DATE_EPOCH"] = _output(["git", "log", "-1", "--format=%ct"])
    with tempfile.TemporaryDirectory(prefix="palmd-kernels-") as name:
        wheel = build_wheel(output, portable_kernels(Path(name)) if kernels else None)
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", str(output)],
        cwd=ROOT, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    return [wheel, *output.glob("*.tar.gz")]


def upgrade_notes(output: Path) -> Path:
    """Upgrade notes: what moved since 0.2, from the page of promises, and the newest part of the changelog."""
    _, _, moved = (ROOT / "docs/reference/promises.md").read_text(encoding="utf-8").partition("## What moved")
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    newest = changelog.split("\n## ", 2)[1]
    path = output / f"{NAME}-upgrade.md"
    path.write_text(f"# Upgrade to {palmd.__version__}\n\n## What moved{moved}\n## {newest}", encoding="utf-8")
    return path


def site(output: Path) -> Path:
    """The documentation as one archive that opens from the disk."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(
            [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", folder],
            cwd=ROOT, env=os.environ | {"NO_MKDOCS_2_WARNING": "1"}, check=True,
        )  # fmt: skip
        path = output / f"{NAME}-site.tar.gz"
        with tarfile.open(path, "w:gz") as archive:
            archive.add(folder, f"{NAME}-site")
    return path


def image(output: Path) -> list[Path]:
    """The container image as an archive; nothing, with a message, if no builder is available."""
    for builder in BUILDERS:
        if shutil.which(builder) and not subprocess.run([builder, "info"], capture_output=True, check=False).returncode:
            path = output / f"{NAME}-image.tar"
            subprocess.run([builder, "build", "-q", "-t", f"palmd:{palmd.__version__}", str(ROOT)], check=True)
            subprocess.run([builder, "save", "-o", str(path), f"palmd:{palmd.__version__}"], check=True)
            return [path]
    print(f"no container image: neither {' nor '.join(BUILDERS)} is available", file=sys.stderr)
    return []


def checksums(output: Path, files: Iterable[Path]) -> Path:
    """Write checksums in the format of `sha256sum --check`."""
    path = output / "SHA256SUMS"
    lines = [f"{hashlib.sha256(each.read_bytes()).hexdigest()}  {each.name}\n" for each in files]
    path.write_text("".join(lines), encoding="utf-8")
    return path


def run_wheel(wheel: Path) -> None:
    """Run version, doctor and a demo in an empty environment without a compiler; raises CalledProcessError."""
    with tempfile.TemporaryDirectory(prefix="palmd-release-") as name:
        folder = Path(name)
        venv.create(folder / "venv", with_pip=True)
        pip = [str(folder / "venv/bin/python"), "-m", "pip", "--quiet", "--disable-pip-version-check", "install"]
        subprocess.run([*pip, "--require-hashes", "-r", str(ROOT / "requirements.lock")], check=True)
        subprocess.run([*pip, "--no-deps", str(wheel)], check=True)
        run_without_compiler(folder / "venv/bin/palmd", folder, CHECK_S).check_returncode()


def run_without_compiler(command: Path, folder: Path, seconds: float) -> subprocess.CompletedProcess[str]:
    """Run version, doctor and a demo of so many seconds with an installed palmd; raises CalledProcessError.

    PATH contains only the environment's own programs, and home is `folder`. The demo's status is not checked.
    """
    environment = {"PATH": str(command.parent), "HOME": str(folder)}

    def called(*words: str) -> subprocess.CompletedProcess[str]:
        run = [str(command), *words]
        return subprocess.run(run, cwd=folder, env=environment, check=False, capture_output=True, text=True)

    called("--version").check_returncode()
    doctor = called("doctor")
    findings = [line.split(maxsplit=2)[:2] for line in doctor.stdout.splitlines() if line]
    if "Traceback" in doctor.stderr or ["ok", "observers"] not in findings:
        raise subprocess.CalledProcessError(doctor.returncode, doctor.args, doctor.stdout, doctor.stderr)
    demo = called("demo", "--seconds", str(seconds), "--no-browser", "--seed", "3")
    if "C compiler" in demo.stderr or "not compiled" in demo.stderr:
        raise subprocess.CalledProcessError(demo.returncode, demo.args, demo.stdout, demo.stderr)
    return demo


def _output(arguments: list[str]) -> str:
    return subprocess.run(arguments, cwd=ROOT, check=True, capture_output=True, text=True).stdout.strip()


if __name__ == "__main__":
    sys.exit(main())
