"""The rig PC's disk, kernel and installation medium, made from packages; only the first time needs a network.

Everything is in its own folder outside the checkout (`folder()`) and is rebuilt when its sources have changed. Called
as a program it builds what is missing and prints the folder. It needs root, for `mmdebstrap`.
"""

import hashlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

CHECKOUT = Path(__file__).parents[2]
CLOCK = Path(__file__).with_name("clock.c")
SUITE = "bookworm"
INSTALLED_BY_DOCS = ("python3-venv", "gcc", "libc6-dev", "rt-tests")  # required by docs/operate/operations.md
PACKAGES = (
    *("linux-image-rt-amd64", "initramfs-tools", "zstd", "systemd-sysv", "udev", "dbus", "kmod"),
    *("qemu-guest-agent", "psmisc", "procps", "util-linux-extra"),
    *INSTALLED_BY_DOCS,
)
PROGRAMS = {
    "qemu-system-x86_64": "qemu-system-x86",
    "qemu-img": "qemu-utils",
    "mmdebstrap": "mmdebstrap",
    "mke2fs": "e2fsprogs",
}
DISK_BYTES = 8 << 30  # sparse
BOOT_MODULES = ("virtio_pci", "virtio_blk", "ext4", "crc32c_generic")

# mmdebstrap's hooks: $1 is the tree, $debs the packages fetched so far
BEFORE = """
mkdir -p "$1/var/cache/apt/archives" && cp -n "$debs"/*.deb "$1/var/cache/apt/archives/" 2>/dev/null || true
"""
BETWEEN = f"""
mkdir -p "$1/etc/initramfs-tools/conf.d" "$1/usr/share/initramfs-tools/modules.d"
echo MODULES=list >"$1/etc/initramfs-tools/conf.d/palmd-vm"
printf '%s\\n' {" ".join(BOOT_MODULES)} >"$1/usr/share/initramfs-tools/modules.d/palmd-vm"
"""
AFTER = """
cc -O2 -static -o "$1/usr/local/bin/guest-clock" "$clock"
cat >"$1/etc/systemd/system/guest-clock.service" <<UNIT
[Unit]
DefaultDependencies=no
[Service]
ExecStart=/usr/local/bin/guest-clock
[Install]
WantedBy=sysinit.target
UNIT
chroot "$1" systemctl enable guest-clock
chroot "$1" systemctl mask serial-getty@ttyS0.service apt-daily.timer apt-daily-upgrade.timer fstrim.timer
cp -n "$1"/var/cache/apt/archives/*.deb "$debs"/
cp "$1"/boot/vmlinuz-* "$made/vmlinuz" && cp "$1"/boot/initrd.img-* "$made/initrd"
echo rig-pc >"$1/etc/hostname"
echo '/dev/vda / ext4 defaults 0 1' >"$1/etc/fstab"
mkdir -p "$1/var/log/journal"
"""


class ImageError(Exception):
    """Why there is no rig PC here."""


@dataclass(frozen=True, slots=True)
class Image:
    """The files that a machine starts from; `base` and `medium` are read only."""

    base: Path
    kernel: Path
    initrd: Path
    medium: Path
    version: str
    next_version: str

    @property
    def tree(self) -> Path:
        """The folder that `base` was made from."""
        return self.base.with_name("tree")


def folder() -> Path:
    """The folder of all images."""
    caches = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return caches / "palmd" / "vm"


def obstacle() -> str | None:
    """Why none can be built here, None if it can."""
    missing = [package for program, package in PROGRAMS.items() if shutil.which(program) is None]
    if missing:
        return f"missing programs: apt-get install {' '.join(missing)}"
    return "it takes root" if os.geteuid() != 0 else None


def build() -> Image:
    """Builds what is missing; raises ImageError."""
    why_not = obstacle()
    if why_not is not None:
        raise ImageError(why_not)
    kernel_and_disk = _system()
    version, next_version, medium = _medium()
    return Image(
        kernel_and_disk / "base.ext4",
        kernel_and_disk / "vmlinuz",
        kernel_and_disk / "initrd",
        medium,
        version,
        next_version,
    )


def with_palmd(image: Image, change: Callable[[Path], None]) -> Path:
    """A disk on which palmd was installed and changed at this machine's speed; its observers are not compiled.

    An emulated processor needs an hour for that; it is also another type, on which code compiled here does not run.
    """
    target = folder() / "installed.ext4"
    with tempfile.TemporaryDirectory(dir=folder()) as temporary:
        tree = Path(temporary) / "tree"
        _run("cp", "-a", "--reflink=auto", image.tree, tree)
        install = " && ".join((
            f"mount -o loop,ro {image.medium} {tree}/mnt",
            f"mount -t proc proc {tree}/proc",
            f"""exec env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root CC=/nonexistent chroot {tree} bash -ec '
                python3 -m venv /opt/palmd
                /opt/palmd/bin/pip install -q --no-index --find-links /mnt palmd=={image.version}
                /opt/palmd/bin/palmd install
                systemctl enable palmd palmd-record'""",
        ))  # fmt: skip
        _run("unshare", "--mount", "bash", "-ec", install)
        change(tree)
        ext4(tree, target, DISK_BYTES, "rigpc")
    return target


def ext4(tree: Path, target: Path, size_bytes: int, label: str) -> None:
    """A file system with the contents of a tree, made without mounting."""
    part = target.with_suffix(".part")
    part.unlink(missing_ok=True)
    _run("mke2fs", "-q", "-t", "ext4", "-L", label, "-d", tree, part, f"{size_bytes >> 10}k")
    part.rename(target)


def _system() -> Path:
    """The folder of kernel, initrd and disk of a machine without palmd."""
    made = folder() / f"{SUITE}-{_digest(repr((PACKAGES, BETWEEN, AFTER, DISK_BYTES, CLOCK.read_text())))}"
    if (made / "base.ext4").exists() and (made / "tree").exists():
        return made
    debs = folder() / "debs"
    for each in (made, debs):
        each.mkdir(parents=True, exist_ok=True)
    tree = made / "tree"
    shutil.rmtree(tree, ignore_errors=True)
    hooks = [f"--{when}-hook={text}" for when, text in
             (("setup", BEFORE), ("essential", BETWEEN), ("customize", AFTER))]  # fmt: skip
    _run(
        *("mmdebstrap", "--quiet", "--variant=minbase", f"--include={','.join(PACKAGES)}", "--skip=download/empty"),
        *("--skip=essential/unlink", "--skip=cleanup/apt/cache", *hooks, SUITE, tree),
        environment={"debs": str(debs), "made": str(made), "clock": str(CLOCK)},
    )
    shutil.rmtree(tree / "var/cache/apt/archives")
    ext4(tree, made / "base.ext4", DISK_BYTES, "rigpc")
    return made


def _medium() -> tuple[str, str, Path]:
    """This checkout's version, the next one, and a file system with both as wheels and their dependencies."""
    wheels = folder() / "wheels" / _digest((CHECKOUT / "requirements.lock").read_text())
    if not wheels.exists():
        part = wheels.with_suffix(".part")
        pip = (sys.executable, "-m", "pip", "--quiet", "download", "--require-hashes", "--only-binary=:all:")
        _run(*pip, "-r", CHECKOUT / "requirements.lock", "-d", part)
        part.rename(wheels)
    with tempfile.TemporaryDirectory(dir=folder()) as temporary:
        content = Path(temporary) / "content"
        shutil.copytree(wheels, content)
        version = _wheel(content, Path(temporary) / "this")
        next_version = _wheel(content, Path(temporary) / "next", _next(version))
        size = sum(each.stat().st_size for each in content.iterdir())
        medium = folder() / "medium.ext4"
        ext4(content, medium, size * 5 // 4 + (32 << 20), "wheels")
    return version, next_version, medium


def _wheel(into: Path, source: Path, version: str | None = None) -> str:
    """Builds a wheel of the checkout, possibly under another version; returns the version."""
    source.mkdir()
    for name in ("README.md", "LICENSE", "pyproject.toml"):
        shutil.copy(CHECKOUT / name, source)
    for name in ("src", "config", "systemd"):
        shutil.copytree(CHECKOUT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    for path, name in ((source / "src/palmd/__init__.py", "__version__"), (source / "pyproject.toml", "version")):
        text = path.read_text()
        found = re.search(rf'(?m)^{name} = "([^"]+)"$', text)
        assert found is not None, f"{path.name} names no version"
        version = version or found[1]
        path.write_text(text.replace(found[0], f'{name} = "{version}"'))
    assert version is not None
    _run(sys.executable, "-m", "pip", "--quiet", "wheel", "--no-deps", "--no-build-isolation", "-w", into, source)
    return version


def _next(version: str) -> str:
    """The next version."""
    *first, last = version.split(".")
    return ".".join((*first, str(int(last) + 1)))


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def _run(*words: object, environment: dict[str, str] | None = None) -> None:
    done = subprocess.run(
        ["nice", *map(str, words)], env=os.environ | (environment or {}), capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise ImageError(f"{words[0]} failed with status {done.returncode}: {done.stderr[-2000:]}")


if __name__ == "__main__":
    try:
        print(build())
    except ImageError as error:
        sys.exit(str(error))
