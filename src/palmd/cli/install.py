"""Installs palmd's services: units, account, udev rules, and a first configuration in /etc/palmd.

The files contain the paths of the palmd that runs this command. Configuration and port names of the machine are never
overwritten. Nothing is enabled or started. With --root the files are installed into another tree, such as an image.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import palmd
from palmd.console.errors import BAD_INPUT, RIG_FAILED, CliError
from palmd.console.shipped import shipped, shipped_service

UNITS = ("palmd.service", "palmd-record.service", "palmd-view.service", "palmd-rig.service")
LOCAL = Path("usr/local/lib")
SETTINGS = Path("etc/palmd")
CACHE = "/var/cache/palmd"
RUNS = "/var/lib/palmd"
# folders that are hidden from services except for listed paths; checkouts may be in them
HIDDEN = (Path("/home"), Path("/root"), Path("/run/user"), Path("/tmp"), Path("/var/tmp"))
EMPTIED = Path("/tmp")  # usually at each boot

_SHIPPED_COMMAND = "/opt/palmd/bin/palmd"
_SHIPPED_HOME = "ProtectHome=yes\n"
_SHIPPED_BUS = 'bus: {publish: "tcp://127.0.0.1:9872", command: "tcp://127.0.0.1:9873"}\n'
_LOCAL_BUS = """\
# Local sockets: the members of the group palmd may listen and give commands, other users of this machine may not.
bus: {publish: "ipc:///run/palmd/publish", command: "ipc:///run/palmd/command", group: palmd}
"""
_SHIPPED_RUNS = "record: {directory: runs}        # relative to this file's folder\n"


@dataclass(frozen=True, slots=True)
class Item:
    """A file to install, relative to the root; an `own` file belongs to the machine and is kept if it exists."""

    target: Path
    text: str
    own: bool = False


@dataclass(frozen=True, slots=True)
class Step:
    """A command to run after the files; one that is not `vital` is repeated by the next boot."""

    words: list[str]
    vital: bool = True


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("--root", type=Path, default=Path("/"), help="the tree to install into (default: this machine)")
    parser.add_argument("--dry-run", action="store_true", help="only print what would be done")


def run(arguments: argparse.Namespace) -> int:
    """Install; CliError if files cannot be written or a vital command fails."""
    root: Path = arguments.root
    command = Path(sys.prefix) / "bin/palmd"
    if not command.exists():
        raise CliError(BAD_INPUT, f"{command} does not exist: install palmd with pip before its services")
    items = [*_services(command), *_settings()]
    follow = _following(command) if root == Path("/") else ()
    for item in items:
        _put(item, root, arguments.dry_run)
    for step in follow:
        _follow(step, arguments.dry_run)
    for part in passing_parts(_parts()):
        print(f"note     {part} may be deleted by the next boot, and the services with it: install into /opt/palmd")
    print(f"next: describe the rig in {root / SETTINGS / 'palmd.yaml'} and the port names in", end=" ")
    print(f"{root / _NAMES}, then: systemctl enable --now palmd palmd-record palmd-view")
    print("only members of the group palmd may command the rig: usermod -aG palmd USER, then log in again")
    return 0


_NAMES = Path("etc/udev/rules.d/71-palmd-names.rules")


def adapted(unit: str, command: Path, hidden: Sequence[Path]) -> str:
    """Adapt a shipped unit to a palmd at `command`; of hidden folders it sees only the `hidden` paths."""
    unit = unit.replace(_SHIPPED_COMMAND, str(command))
    if not hidden:
        return unit
    return unit.replace(_SHIPPED_HOME, f"ProtectHome=tmpfs\nBindReadOnlyPaths={' '.join(map(str, hidden))}\n")


def hidden_parts(parts: Sequence[Path]) -> list[Path]:
    """Return an installation's folders that are in home or temporary folders, without nested ones. Pure."""
    inside = {part for part in parts if any(part.is_relative_to(home) for home in HIDDEN)}
    return sorted(part for part in inside if not any(part != other and part.is_relative_to(other) for other in inside))


def passing_parts(parts: Sequence[Path]) -> list[Path]:
    """Return an installation's folders that a boot may delete. Pure."""
    return [part for part in hidden_parts(parts) if part.is_relative_to(EMPTIED)]


def _parts() -> list[Path]:
    return [Path(sys.prefix), Path(sys.base_prefix), Path(palmd.__file__).resolve().parent.parent]


def _services(command: Path) -> Iterator[Item]:
    hidden = hidden_parts(_parts())
    for name in UNITS:
        yield Item(LOCAL / "systemd/system" / name, adapted(_read(shipped_service(name)), command, hidden))
    for name in ("sysusers.d/palmd.conf", "modules-load.d/palmd.conf"):
        yield Item(LOCAL / name, _read(shipped_service(name)))
    latency = "70-palmd-latency.rules"
    yield Item(LOCAL / "udev/rules.d" / latency, _read(shipped_service(f"udev/{latency}")))
    yield Item(_NAMES, _read(shipped_service(f"udev/{_NAMES.name}")), own=True)


def _settings() -> Iterator[Item]:
    text = _read(shipped("palmd.yaml"))
    text = text.replace(_SHIPPED_RUNS, f"record: {{directory: {RUNS}}}\n").replace(_SHIPPED_BUS, _LOCAL_BUS)
    yield Item(SETTINGS / "palmd.yaml", text, own=True)
    for plan in sorted(shipped("plans").glob("*.yaml")):
        yield Item(SETTINGS / "plans" / plan.name, _read(plan), own=True)


def _following(command: Path) -> Iterator[Step]:
    """Yield the commands that create the account, reload systemd and udev, and compile the observers."""
    yield Step(["systemd-sysusers", f"/{LOCAL}/sysusers.d/palmd.conf"])
    if Path("/run/systemd/system").exists():
        yield Step(["systemctl", "daemon-reload"])
        # a service that starts before its ports' drivers are loaded may not open ports plugged in later
        yield Step(["systemctl", "restart", "systemd-modules-load"], vital=False)
    if Path("/run/udev/control").exists():
        yield Step(["udevadm", "control", "--reload"])
    yield Step(["env", f"CACHE_DIRECTORY={CACHE}", str(command), "doctor", "build"])


def _put(item: Item, root: Path, dry_run: bool) -> None:
    path = root / item.target
    if item.own and path.exists():
        print(f"kept     {path}")
        return
    if dry_run:
        print(f"to write {path}")
        return
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(item.text, encoding="utf-8")
        path.chmod(0o644)
    except PermissionError:
        raise CliError(BAD_INPUT, f"{path} may not be written: sudo {sys.prefix}/bin/palmd install") from None
    except OSError as error:
        raise CliError(BAD_INPUT, f"{path} cannot be written: {error.strerror}") from None
    print(f"written  {path}")


def _follow(step: Step, dry_run: bool) -> None:
    words = step.words
    print(f"{'to run' if dry_run else 'running':8} {' '.join(words)}", flush=True)
    if dry_run:
        return
    try:
        status = subprocess.run(words, check=False).returncode
    except FileNotFoundError:
        raise CliError(RIG_FAILED, f"{words[0]} not found: palmd's services need systemd and udev") from None
    if status == 0:
        return
    if step.vital:
        raise CliError(RIG_FAILED, f"{' '.join(words)} failed with status {status}; the files are in place")
    print(f"note     this failed with status {status}; the next boot repeats it")


def _read(path: Path) -> str:
    return path.read_text(encoding="utf-8")
