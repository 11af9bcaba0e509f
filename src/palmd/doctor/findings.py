"""What palmd needs of this machine and this rig, one finding a line, in the order in which to mend it."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from palmd.config import Config
from palmd.console.errors import BAD_INPUT, CliError
from palmd.doctor import machine, ports
from palmd.doctor.finding import Finding
from palmd.system.mechanism import PALMS
from palmd.yamlfile import ConfigError, load_config


def examine_all(path: Path) -> int:
    """Prints every finding as it is made; 0 if all are ok, else 1."""
    verdicts = []
    for finding in findings(path):
        print(finding.line(), flush=True)
        verdicts.append(finding.verdict)
    counts = ", ".join(
        f"{verdicts.count(each)} {each}" for each in ("ok", "missing", "cannot tell") if each in verdicts
    )
    print(counts)
    return 0 if set(verdicts) == {"ok"} else BAD_INPUT


def findings(path: Path) -> Iterator[Finding]:
    """Everything, in order; what rests on a bad configuration is left out."""
    yield machine.python(sys.version_info[:3])
    yield machine.packages()
    yield machine.compiler()
    yield machine.observers()
    try:
        config = load_config(path)
    except ConfigError as error:
        yield Finding("configuration", "missing", str(error).splitlines()[0], f"palmd check {path}")
        return
    yield Finding("configuration", "ok", str(path))
    yield plan(config, path)
    status = daemon(config)
    yield bus(config, status)
    for name, pad in ((f"pad {palm}", config.pads.of(palm)) for palm in PALMS):
        yield from ports.pad_findings(name, pad, status, path)
    yield from ports.arm_findings(config, status, path)
    yield machine.real_time()
    yield machine.locked_memory()
    yield machine.runs(config.record.directory)
    yield machine.units()


def plan(config: Config, path: Path) -> Finding:
    """The motion plan that the configuration names."""
    from palmd.motion.check import load_trajectory, motion_limits

    if config.plan is None:
        return Finding("plan", "ok", "none named")
    try:
        load_trajectory(config.plan, motion_limits(config))
    except ConfigError as error:
        return Finding("plan", "missing", str(error).splitlines()[0], f"palmd check {path}")
    return Finding("plan", "ok", str(config.plan))


def daemon(config: Config) -> dict[str, Any] | None:
    """What a running daemon says of itself, None if none answers."""
    from palmd.bus.command_client import CommandClient

    with CommandClient(config.bus.command, timeout_s=0.5) as client, contextlib.suppress(CliError):
        reply = client.ask("status")
        result: dict[str, Any] | None = reply.get("result")
        return result if reply["ok"] else {}
    return None


def bus(config: Config, status: dict[str, Any] | None) -> Finding:
    """Both addresses are free, or a daemon has them."""
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
                return Finding("bus", "missing", f"{address} cannot be had ({error.strerror})", look)
    return Finding("bus", "ok", f"{config.bus.publish} and {config.bus.command} are free")
