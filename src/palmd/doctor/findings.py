"""All checks of machine and rig, one finding a line, in the order in which to fix them."""

from __future__ import annotations

import contextlib
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from palmd.config.addresses import from_here
from palmd.config.two_palms import Config
from palmd.console.errors import BAD_INPUT, CliError
from palmd.doctor import lateness, machine, ports
from palmd.doctor.finding import Finding
from palmd.doctor.wakeups import Meter
from palmd.plausibility import implausible
from palmd.system.mechanism import PALMS
from palmd.yamlfile import ConfigError, load_config, read_document

METER_S, METER_PERIOD_S = 1.0, 0.01
RIG_WITHIN_S = 1.5
"""Time (s) within which a daemon publishes `palm/rig`, which it does each second."""


def examine_all(path: Path) -> int:
    """Print each finding as it is made; return 0 if all are ok or open, else 1."""
    verdicts = []
    for finding in findings(path):
        print(finding.line(), flush=True)
        verdicts.append(finding.verdict)
    counts = ", ".join(
        f"{verdicts.count(each)} {each}"
        for each in ("ok", "open", "missing", "mismatch", "unknown")
        if each in verdicts
    )
    print(counts)
    print("\n".join(["", *latency_tree()]))
    return 0 if set(verdicts) <= {"ok", "open"} else BAD_INPUT


def latency_tree() -> list[str]:
    """Measure wake-ups for a second under the current load; return the recommended changes as text lines."""
    with tempfile.TemporaryDirectory(prefix="palmd-doctor-") as name:
        try:
            meter = Meter(METER_S, METER_PERIOD_S, Path(name))
        except OSError:
            return []
        try:
            wakeups = meter.result()
        finally:
            meter.close()
    if wakeups is None:
        return []
    found = [lateness.wakeup_branch(lateness.percentiles(wakeups.lateness_ms)[1])]
    return [
        *lateness.lines(found),
        f"  measured for {METER_S:g} s by {wakeups.by}; run palmd doctor latency for the rest",
    ]


def findings(path: Path) -> Iterator[Finding]:
    """Yield all findings in order; checks that need a valid configuration are skipped without one."""
    yield machine.python(sys.version_info[:3])
    yield machine.packages()
    yield machine.compiler()
    yield machine.observers()
    try:
        config = load_config(path)
        odd = implausible(read_document(path), config)
    except ConfigError as error:
        yield Finding("configuration", "missing", str(error).splitlines()[0], f"palmd check {path}")
        return
    if odd:
        yield Finding("configuration", "mismatch", odd[0], f"palmd check {path}")
    else:
        yield Finding("configuration", "ok", str(path))
    yield plan(config, path)
    status = daemon(config)
    yield bus(config, status)
    yield exposure(config)
    for name, pad in ((f"pad {palm}", config.pads.of(palm)) for palm in PALMS):
        yield from ports.pad_findings(name, pad, status, path)
    yield from ports.arm_findings(config, status)
    if status is not None:
        yield from rig(config)
    yield machine.real_time()
    yield machine.locked_memory()
    yield machine.runs(config.record.directory)
    yield machine.units()


def plan(config: Config, path: Path) -> Finding:
    """Check the motion plan named in the configuration."""
    from palmd.motion.check import load_trajectory, motion_limits

    if config.plan is None:
        return Finding("plan", "ok", "none named")
    try:
        load_trajectory(config.plan, motion_limits(config))
    except ConfigError as error:
        return Finding("plan", "missing", str(error).splitlines()[0], f"palmd check {path}")
    return Finding("plan", "ok", str(config.plan))


def daemon(config: Config) -> dict[str, Any] | None:
    """Return the status of a running daemon, None if none answers."""
    from palmd.bus.command_client import CommandClient

    with CommandClient(config.bus.command, timeout_s=0.5) as client, contextlib.suppress(CliError):
        reply = client.ask("status")
        result: dict[str, Any] | None = reply.get("result")
        return result if reply["ok"] else {}
    return None


def rig(config: Config) -> Iterator[Finding]:
    """Yield the rig constants that the smoother of a running daemon contradicts."""
    from palmd.bus.subscriber import Subscriber
    from palmd.quantities import RIG

    with Subscriber(from_here(config.bus.publish), topics=(RIG.name,)) as subscriber:
        message = next(subscriber.until(time.monotonic() + RIG_WITHIN_S), None)
    if message is None:
        yield Finding("rig's constants", "unknown", f"no message palm/rig from {config.bus.publish}")
        return
    texts = message.fields["contradictions"]
    if not texts:
        yield Finding("rig's constants", "ok", "no reading contradicts them")
    for each in texts:
        yield Finding("rig's constants", "mismatch", *each.split(": ", 1))


def exposure(config: Config) -> Finding:
    """Check who may listen to the daemon and command it."""
    bus = config.bus
    if bus.keys is not None:
        return Finding("bus access", "ok", f"holders of the keys listed in {bus.keys}")
    if all(address.startswith("ipc://") for address in (bus.publish, bus.command)):
        who = f"the members of the group {bus.group}" if bus.group else "the daemon's user only"
        return Finding("bus access", "ok", f"local sockets, for {who}")
    open_ = next(address for address in (bus.command, bus.publish) if address.startswith("tcp://"))
    fix = 'bus: {publish: "ipc:///run/palmd/publish", command: "ipc:///run/palmd/command", group: palmd}'
    text = f"{open_} without keys: every user of this machine can command the arm; fine for a demo. For a rig"
    return Finding("bus access", "open", text, fix)


def bus(config: Config, status: dict[str, Any] | None) -> Finding:
    """Check that both addresses are free or used by a daemon."""
    if status is not None:
        return Finding("bus", "ok", f"a daemon answers at {config.bus.command}, state {status.get('state', 'unknown')}")
    import zmq

    for address in (config.bus.publish, config.bus.command):
        with zmq.Context() as context, context.socket(zmq.PUB) as socket:
            try:
                socket.bind(address)
            except zmq.ZMQError as error:
                port = address.rpartition(":")[2]
                look = f"sudo ss -ltnp 'sport = :{port}'" if address.startswith("tcp") else f"sudo fuser -v {port}"
                return Finding("bus", "missing", f"{address} cannot be bound ({error.strerror})", look)
    return Finding("bus", "ok", f"{config.bus.publish} and {config.bus.command} are free")
