"""Checks of this machine: Python, packages, compiler, permissions, disk space, services."""

from __future__ import annotations

import contextlib
import importlib.metadata
import re
import resource
import shlex
import shutil
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from palmd.console.folders import is_writable_folder, nearest
from palmd.daemon.realtime import PRIORITY, limits_command, user
from palmd.doctor.finding import Finding

PROC = Path("/proc")
UNIT_FOLDERS = tuple(map(Path, (
    "/etc/systemd/system", "/run/systemd/system", "/usr/local/lib/systemd/system", "/usr/lib/systemd/system",
    "/lib/systemd/system",
)))  # fmt: skip
UNITS = ("palmd.service", "palmd-record.service", "palmd-view.service")
SYSTEMD_RUNS = Path("/run/systemd/system")
FREE_MB = 2000
"""Enough for some hours of recording."""

_CAP_IPC_LOCK, _CAP_SYS_NICE = 14, 23


def python(version: Sequence[int]) -> Finding:
    """Check the version of the interpreter."""
    text = ".".join(map(str, version))
    if tuple(version) >= (3, 11):
        return Finding("python", "ok", text)
    return Finding("python", "missing", f"{text} is too old, 3.11 is needed", "sudo apt-get install python3.11-venv")


def packages(distribution: str = "palmd") -> Finding:
    """Check that the package's dependencies are installed, without extras."""
    try:
        needed = importlib.metadata.requires(distribution) or []
    except importlib.metadata.PackageNotFoundError:
        return Finding("packages", "unknown", f"{distribution} runs from its sources", "pip install -e .")
    names = [re.split(r"[^A-Za-z0-9._-]", each)[0] for each in needed if "extra ==" not in each]
    missing = [name for name in names if not _installed(name)]
    if missing:
        return Finding(
            "packages", "missing", ", ".join(missing), f"{sys.executable} -m pip install {' '.join(missing)}"
        )
    return Finding("packages", "ok", f"all {len(names)} are installed")


def _installed(name: str) -> bool:
    try:
        importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return False
    return True


def compiler() -> Finding:
    """Check the C compiler; it is not needed if the wheel contains compiled observers."""
    from palmd.model.compiled import shipped_fits
    from palmd.model.compiler import CompilerError, check_compiler, command

    try:
        found = command()
        if found:
            check_compiler(found, _where_compiled())
            return Finding("compiler", "ok", shlex.join(found))
    except (CompilerError, OSError) as error:
        return Finding("compiler", "missing", str(error), "fix it, or set CC to another compiler")
    if shipped_fits():
        return Finding("compiler", "ok", "none, and none is needed: palmd is installed with compiled observers")
    return Finding("compiler", "missing", "no C compiler", "sudo apt-get install gcc libc6-dev")


def _where_compiled() -> Path:
    """Return the folder of the compiled observers or its nearest parent; the temporary folder if that is not writable.

    `observers` reports why it is not writable.
    """
    from palmd.model.compiled import cache_directory

    with contextlib.suppress(OSError, RuntimeError):
        there = nearest(cache_directory())
        if is_writable_folder(there):
            return there
    return Path(tempfile.gettempdir())


def observers() -> Finding:
    """Check for compiled observers; whether they are of this version is checked when they are loaded."""
    from palmd.model.compiled import SHIPPED, cache_directory, shipped_fits

    own = f"set XDG_CACHE_HOME to a folder of {user()}'s own, then run palmd doctor build"
    try:
        folder = cache_directory()
    except RuntimeError:
        return Finding("observers", "missing", f"{user()} has no home folder to store them in", own)
    try:
        count = sum(each.suffix == ".so" for each in folder.iterdir()) if folder.is_dir() else 0
        makes_more = is_writable_folder(nearest(folder))
    except OSError as error:
        return Finding("observers", "missing", f"{folder}: {error.strerror}", own)
    if count:
        return Finding("observers", "ok", f"{count} compiled in {folder}")
    if shipped_fits():
        return Finding("observers", "ok", f"{len(list(SHIPPED.glob('*.so')))} compiled in {SHIPPED}")
    return Finding("observers", "missing", f"none compiled in {folder}", "palmd doctor build" if makes_more else own)


def real_time() -> Finding:
    """Check whether this user may use the loop's real-time priority; the service always may."""
    allowed, _ = resource.getrlimit(resource.RLIMIT_RTPRIO)
    if allowed >= PRIORITY or allowed == resource.RLIM_INFINITY or _capable(_CAP_SYS_NICE):
        return Finding("real time", "ok", f"priority {PRIORITY} is allowed")
    fix = f"{limits_command(f'rtprio {PRIORITY}')}; or run the service"
    return Finding("real time", "missing", f"no right to priority {PRIORITY}", fix)


def locked_memory() -> Finding:
    """Check whether this user may lock all memory."""
    limit, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if limit == resource.RLIM_INFINITY or _capable(_CAP_IPC_LOCK):
        return Finding("locked memory", "ok", "no limit")
    fix = f"{limits_command('memlock unlimited')}; or run the service"
    return Finding("locked memory", "missing", f"limited to {limit / 1e6:.1f} MB", fix)


def _capable(capability: int) -> bool:
    try:
        status = (PROC / "self/status").read_text(encoding="ascii")
    except OSError:
        return False
    found = re.search(r"^CapEff:\s*([0-9a-f]+)", status, re.MULTILINE)
    return found is not None and bool(int(found[1], 16) >> capability & 1)


def runs(folder: Path) -> Finding:
    """Check the folder of recordings; it is created when needed, so its nearest parent is checked."""
    try:
        there = nearest(folder)
    except OSError as error:
        return Finding("runs", "missing", f"{folder}: {error.strerror}", "edit record.directory in the configuration")
    if not is_writable_folder(there):
        owner = f"sudo install -d -o {user()} {folder}"
        return Finding("runs", "missing", f"{there} cannot be written", owner)
    free_mb = shutil.disk_usage(there).free / 1e6
    if free_mb < FREE_MB:
        return Finding("runs", "missing", f"{there}: {free_mb:.0f} MB free, {FREE_MB} wanted", f"du -sh {folder}/*")
    return Finding("runs", "ok", f"{folder}, {free_mb / 1e3:.0f} GB free")


def units(folders: Sequence[Path] = UNIT_FOLDERS) -> Finding:
    """Check that the services are installed and that systemd runs this machine."""
    missing = [name for name in UNITS if not any((folder / name).exists() for folder in folders)]
    if missing:
        return Finding("services", "missing", f"{', '.join(missing)} not installed", "sudo palmd install")
    if not SYSTEMD_RUNS.is_dir():
        return Finding("services", "unknown", "installed, but systemd does not run this machine")
    return Finding("services", "ok", "installed")
