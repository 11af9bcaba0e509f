"""Checks of the configured ports and of the pads' devices: present, permitted, free, and a device that answers."""

from __future__ import annotations

import contextlib
import grp
import os
import stat
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from palmd.config.any_config import AnyConfig
from palmd.config.arms import ServosConfig
from palmd.config.pads import AnyPads, PadConfig
from palmd.config.two_palms import Config
from palmd.daemon.realtime import user
from palmd.devices.pad import inspect_pad
from palmd.doctor.finding import Finding
from palmd.yamlfile import Document

PROC = Path("/proc")
USB_SERIAL = Path("/sys/bus/usb-serial/devices")
PSEUDO_TERMINALS = range(136, 144)  # their major device numbers
LISTEN_S = 0.6
LATENCY_MS = 1


def pad_findings(name: str, pad: PadConfig, status: dict[str, Any] | None, path: Path) -> Iterator[Finding]:
    """Yield the findings about a pad's port and the pad."""
    port = port_finding(name, pad.port)
    yield port
    if port.verdict != "ok":
        return
    yield latency(name, pad.port)
    yield from device_findings(name, pad, path)
    if status is not None:
        prefix = name.replace(" ", "")
        faults = [fault for fault in status.get("faults", ()) if fault.startswith(prefix)]
        yield _by_daemon(f"{name} talks", faults, "the daemon receives its reports")
    else:
        yield pad_talks(name, pad, path)


def arm_findings(config: Config, status: dict[str, Any] | None) -> Iterator[Finding]:
    """Yield the findings about the arm's port and its controller."""
    port = port_finding("arm", config.arm.port)
    yield port
    if port.verdict != "ok":
        return
    yield latency("arm", config.arm.port)
    if status is not None:
        faults = [fault for fault in status.get("faults", ()) if fault.startswith("arm")]
        yield _by_daemon("arm answers", faults, f"the daemon receives its answers, state {status.get('arm_state')}")
    elif isinstance(config.arm, ServosConfig):
        from palmd.doctor import servos

        yield from servos.findings(config.arm)
    else:
        from palmd.doctor import arm

        yield arm.answers(config.arm)


def _by_daemon(what: str, faults: Sequence[str], well: str) -> Finding:
    if faults:
        return Finding(what, "missing", f"the daemon reports {', '.join(faults)}", "palmd ctl status")
    return Finding(what, "ok", well)


def port_finding(name: str, path: str) -> Finding:
    """Check whether a port exists, may be opened, and is not used by another program than palmd."""
    what = f"{name} port"
    try:
        mode = Path(path).stat()
    except OSError:
        names = "find it with ls -l /dev/serial/by-id, then name it in /etc/udev/rules.d/71-palmd-names.rules"
        return Finding(what, "missing", f"no port {path}", names)
    if not (stat.S_ISCHR(mode.st_mode) or stat.S_ISSOCK(mode.st_mode)):
        return Finding(what, "missing", f"{path} is not a serial port", f"ls -l {path}")
    if not os.access(path, os.R_OK | os.W_OK):
        group = _group(mode.st_gid)
        return Finding(
            what, "missing", f"no permission to open {path}", f"sudo usermod -aG {group} {user()}, then log in again"
        )
    users = [holder for holder in holders(path) if holder[0] != os.getpid()]
    strangers = [f"{command} ({process})" for process, command in users if command != "palmd"]
    if strangers:
        return Finding(what, "missing", f"{path} is held by {', '.join(strangers)}", f"sudo fuser -v {path}")
    return Finding(what, "ok", path + (" (in use by palmd)" if users else ""))


def _group(number: int) -> str:
    try:
        return grp.getgrgid(number).gr_name
    except KeyError:
        return str(number)


def holders(path: str) -> list[tuple[int, str]]:
    """Return id and name of each process that has this port open, as far as permissions allow.

    The name of a palmd process is `palmd`, whatever interpreter runs it. Empty if the port does not exist.
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
        except OSError:  # ended in the meantime, or of another user
            continue
    return found


def same_port(one: os.stat_result, other: os.stat_result) -> bool:
    """Whether two device files of one name are the same port: containers number their pseudo-terminals separately."""
    if os.major(other.st_rdev) in PSEUDO_TERMINALS and one.st_dev != other.st_dev:
        return False
    return one.st_rdev == other.st_rdev


def _command(folder: Path) -> str:
    words = (folder / "cmdline").read_bytes().decode(errors="replace").split("\0")
    names = [Path(word).name for word in words[:5]]
    return "palmd" if "palmd" in names else names[0]


def latency(name: str, path: str) -> Finding:
    """Check a USB adapter's latency timer; other ports have none."""
    device = Path(os.path.realpath(path)).name
    timer = USB_SERIAL / device / "latency_timer"
    try:
        milliseconds = int(timer.read_text(encoding="ascii"))
    except (OSError, ValueError):
        return Finding(f"{name} latency", "ok", f"{device} has no latency timer")
    if milliseconds > LATENCY_MS:
        fix = f"sudo palmd install, or: echo {LATENCY_MS} | sudo tee {timer}"
        return Finding(f"{name} latency", "missing", f"{device} delays received bytes by up to {milliseconds} ms", fix)
    return Finding(f"{name} latency", "ok", f"{device}: {milliseconds} ms")


def pad_talks(name: str, pad: PadConfig, path: Path) -> Finding:
    """Check whether reports arrive; most pads report only while they are touched."""
    from palmd.devices.padlistener import PadListener
    from palmd.devices.port import PortUnavailableError, PortWaiter

    what = f"{name} talks"
    try:
        listener = PadListener(1 if name.endswith("1") else 2, pad)
    except PortUnavailableError as error:
        return Finding(what, "missing", str(error))
    t = time.monotonic()
    reports, t_end, driver = 0, t + LISTEN_S, listener.driver
    with listener, contextlib.suppress(PortUnavailableError):
        waiter = PortWaiter([listener.port])
        while t < t_end or driver.starting:
            waiter.wait(min(t + 0.02, t_end))
            reports += len(listener.read())
            t = time.monotonic()
    if reports:
        return Finding(what, "ok", f"{reports} reports in {LISTEN_S:g} s")
    if driver.diagnosis is not None:
        return Finding(what, "missing", driver.diagnosis, f"check the pad's section in {path}")
    return Finding(what, "unknown", "no reports, as is normal for an untouched pad", f"palmd doctor --touch {path}")


def device_findings(name: str, pad: PadConfig, path: Path) -> Iterator[Finding]:
    """Yield each remark of a pad's driver as a finding."""
    for remark in inspect_pad(pad).remarks:
        fix = remark.fix or ("" if remark.verdict == "ok" else f"edit {path}")
        yield Finding(f"{name} {remark.what}", remark.verdict, remark.text, fix)


def device_errors(document: Document, config: AnyConfig) -> list[str]:
    """Return contradictions between a configuration and its devices, as `file:line:col: text`.

    A device that is missing, or that this user may not open, is no error.
    """
    pads = getattr(config, "pads", None)
    if not isinstance(pads, AnyPads):
        return []
    errors = []
    for palm in type(pads).model_fields:
        for remark in inspect_pad(getattr(pads, palm)).remarks:
            if remark.verdict != "ok":
                place = document.place(("pads", palm, remark.key))
                errors.append(document.line(place, f"pads.{palm}.{remark.key}: {remark.text}"))
    return errors
