"""Quick checks, a minute at most: linters, types, unit tests of the folders that changed, a sample of the corpus.

A change in `src/palmd/X/…` or `tests/unit/X/…` runs `tests/unit/X`. Changes are those since main, uncommitted ones
included.
"""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parent.parent
BIN = str(Path(sys.executable).parent)


FAST = "not rig and not bench and not vm and not nightly"
"""Markers of the tests that the inner loop runs."""


def changed() -> list[Path]:
    """Files that differ from main or are new, relative to the root."""
    base = _git("merge-base", "HEAD", "main") or "HEAD"
    names = [
        *_git("diff", "--name-only", base).splitlines(),
        *_git("ls-files", "--others", "--exclude-standard").splitlines(),
    ]
    return [Path(name) for name in names]


def test_targets(files: list[Path]) -> list[str]:
    """Test folders and files of the changed files."""
    targets = set()
    for file in files:
        if file.parts[:2] == ("src", "palmd") and len(file.parts) > 3:
            folder = Path("tests/unit", file.parts[2])
            targets |= {str(folder)} if (ROOT / folder).is_dir() else set()
        elif file.parts[:2] == ("src", "palmd"):
            module = Path("tests/unit", f"test_{file.stem}.py")
            targets |= {str(module)} if (ROOT / module).exists() else set()
        elif (
            file.parts[0] == "tests"
            and file.name.startswith("test_")
            and file.suffix == ".py"
            and (ROOT / file).exists()
        ):
            targets.add(str(file))
    return sorted(target for target in targets if not any(Path(other) in Path(target).parents for other in targets))


def main() -> int:
    """Run all checks; returns 0 if everything passed."""
    t_start, failed = time.monotonic(), []
    steps: list[tuple[str, list[str]]] = [
        ("style", [f"{BIN}/ruff", "check", "--quiet", "."]),
        ("format", [f"{BIN}/ruff", "format", "--check", "--quiet", "."]),
        ("types", [f"{BIN}/mypy"]),
        ("imports", [f"{BIN}/lint-imports"]),
    ]
    targets = test_targets(changed())
    if targets:
        steps.append(("unit tests", [sys.executable, "-m", "pytest", "-q", "-n", "2", "-m", FAST, *targets]))
    steps.append(("corpus", [sys.executable, "tests/corpus/corpus.py", "check", "--sample"]))
    for name, command in steps:
        started = time.monotonic()
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        print(f"{name}: {'good' if done.returncode == 0 else 'FAILED'}, {time.monotonic() - started:.0f} s", flush=True)
        if done.returncode:
            failed.append(name)
            print(done.stdout + done.stderr)
    print(f"{time.monotonic() - t_start:.0f} s, failed: {', '.join(failed) or 'nothing'}")
    return int(bool(failed))


def _git(*arguments: str) -> str:
    return subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False).stdout.strip()


if __name__ == "__main__":
    sys.exit(main())
