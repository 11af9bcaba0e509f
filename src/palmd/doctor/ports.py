"""The serial ports that a configuration names: there, ours to open, free, and something behind them that answers."""

from __future__ import annotations

import grp
import os
import stat
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from palmd.config.arms import ServosConfig
from palmd.config.pads import PadConfig
from palmd.config.two_palms import Config
from palmd.daemon.realtime import user
from palmd.doctor.finding import Finding
from palmd.doctor.pad_devices import device_findings

PROC = Path("/proc")
USB_SERIAL = Path("/sys/bus/usb-serial/devices")
PSEUDO_TERMINALS = range(136, 144)  # their major device numbers
LISTEN_S = 0.6
LATENCY_MS = 1


def pad_findings(name: str, pad: PadConfig, status: dict[str, Any] | None, path: Path) -> Iterator[Finding]:
    """A pad's port, and whether a pad is behind it."""
    port = port_finding(name, pad.port)
    yield port
    if port.verdict != "ok":
        return
    yield latency(name, pad.port)
    yield from device_findings(name, pad, path)
    if status is not None:
        prefix = name.replace(" ", "")
        faults = [fault for fault in status.get("faults", ()) if fault.startswith(prefix)]
        yield _by_daemon(f"{name} talks", faults, "the daemon hears it")
    else:
        yield pad_talks(name, pad, path)


def arm_findings(config: Config, status: dict[str, Any] | None, path: Path) -> Iterator[Finding]:
    """The arm's port, and whether its controller answers and is ready."""
    port = port_finding("arm", config.arm.port)
    yield port
    if port.verdict != "ok":
        return
    yield latency("arm", config.arm.port)
    if status is not None:
        faults = [fault for fault in status.get("faults", ()) if fault.startswith("arm")]
        yield _by_daemon("arm answers", faults, f"the daemon hears it, state {status.get('arm_state')}")
    elif isinstance(config.arm, ServosConfig):
        from palmd.doctor import servos

        yield from servos.findings(config.arm)
    else:
        yield arm_answers(config.arm.port, config.arm.baud, path)


def _by_daemon(what: str, faults: Sequence[str], well: str) -> Finding:
    if faults:
        return Finding(what, "missing", f"the daemon says {', '.join(faults)}", "palmd ctl status")
    return Finding(what, "ok", well)


def port_finding(name: str, path: str) -> Finding:
    """Whether a port is there, may be opened, and is not somebody else's; a palmd may have it."""
    what = f"{name} port"
    try:
        mode = Path(path).stat()
    except OSError:
        names = "ls -l /dev/serial/by-id, then name it in /etc/udev/rules.d/71-palmd-names.rules"
        return Finding(what, "missing", f"no port {path}", names)
    if not (stat.S_ISCHR(mode.st_mode) or stat.S_ISSOCK(mode.st_mode)):
        return Finding(what, "missing", f"{path} is not a serial port", f"ls -l {path}")
    if not os.access(path, os.R_OK | os.W_OK):
        group = _group(mode.st_gid)
        return Finding(what, "missing", f"no right to open {path}", f"sudo usermod -aG {group} {user()}, log in again")
    users = [holder for holder in holders(path) if holder[0] != os.getpid()]
    strangers = [f"{command} ({process})" for process, command in users if command != "palmd"]
    if strangers:
        return Finding(what, "missing", f"{path} is held by {', '.join(strangers)}", f"sudo fuser -v {path}")
    return Finding(what, "ok", path + (" (palmd has it)" if users else ""))


def _group(number: int) -> str:
    try:
        return grp.getgrgid(number).gr_name
    except KeyError:
        return str(number)


def holders(path: str) -> list[tuple[int, str]]:
    """Process number and name of everybody who has this port open, as far as we may look.

    A process of palmd is called so whatever interpreter runs it. Nobody has a port that is not there.
    """
    real = os.path.realpath(path)
    try:
        asked = Path(real).stat()
    except OSError:
        return []
    found = []
    for folder in PROC.glob("[0-9]*"):
        try:
            links = (folder / "fd").iterdir()
            if any(str(link.readlink()) == real and same_port(link.stat(), asked) for link in links):
                found.append((int(folder.name), _command(folder)))
        except OSError:  # gone in the meantime, or somebody else's
            continue
    return found


def same_port(one: os.stat_result, other: os.stat_result) -> bool:
    """Whether two device files of one name are one port: a container counts its pseudo-terminals for itself."""
    if os.major(other.st_rdev) in PSEUDO_TERMINALS and one.st_dev != other.st_dev:
        return False
    return one.st_rdev == other.st_rdev


def _command(folder: Path) -> str:
    words = (folder / "cmdline").read_bytes().decode(errors="replace").split("\0")
    names = [Path(word).name for word in words[:5]]
    return "palmd" if "palmd" in names else names[0]


def latency(name: str, path: str) -> Finding:
    """A USB adapter's latency timer; other ports have none."""
    device = Path(os.path.realpath(path)).name
    timer = USB_SERIAL / device / "latency_timer"
    try:
        milliseconds = int(timer.read_text(encoding="ascii"))
    except (OSError, ValueError):
        return Finding(f"{name} latency", "ok", f"{device} has no latency timer")
    if milliseconds > LATENCY_MS:
        fix = f"sudo palmd install, or: echo {LATENCY_MS} | sudo tee {timer}"
        return Finding(f"{name} latency", "missing", f"{device} holds bytes back for {milliseconds} ms", fix)
    return Finding(f"{name} latency", "ok", f"{device}: {milliseconds} ms")


def pad_talks(name: str, pad: PadConfig, path: Path) -> Finding:
    """Whether reports come, which takes a touch."""
    from palmd.devices.pad import make_pad
    from palmd.devices.port import PortWaiter

    what = f"{name} talks"
    driver = make_pad(1 if name.endswith("1") else 2, pad)
    port = driver.port()
    t = time.monotonic()
    if not port.poll_open(t):
        return Finding(what, "missing", str(port.error))
    driver.opened(t)
    waiter = PortWaiter([port])
    reports, t_end = 0, t + LISTEN_S
    while port.is_open and (t < t_end or driver.starting):
        waiter.wait(min(t + 0.02, t_end))
        data = port.read()
        t = time.monotonic()
        reports += len(driver.reports(data, t))
        driver.tend(port, t)
    port.close()
    if reports:
        return Finding(what, "ok", f"{reports} reports in {LISTEN_S:g} s")
    if driver.diagnosis is not None:
        return Finding(what, "missing", driver.diagnosis, f"check the pad's section in {path}")
    return Finding(what, "cannot tell", "silent, as a pad is that nothing touches", f"palmd doctor --touch {path}")


def arm_answers(port: str, baud: int, path: Path) -> Finding:
    """Hello and a report; neither moves anything."""
    from palmd.devices.armconformance import CHECKS, REPORT, examine
    from palmd.devices.armconformance_port import ArmLine, ArmLineError
    from palmd.devices.armconformance_talk import Talk

    what = "arm answers"
    talk = Talk(baud)
    try:
        with ArmLine(port, baud) as line:
            results = [line.play(examine(check, talk)) for check in (CHECKS[0], REPORT)]
    except ArmLineError as error:
        return Finding(what, "missing", str(error))
    if talk.home is None:
        fix = f"start the program on the controller (tools/adept/README.md), check arm.baud in {path}"
        return Finding(what, "missing", f"no answer at {baud} baud", fix)
    if results[1].outcome != "passed":
        return Finding(what, "missing", results[1].seen)
    return Finding(what, "ok", f"{results[1].seen}")
