"""An emulated rig, the daemon and the live page together, in closed loop on an object that palmd knows nothing about.

The palms explore until the outline is complete, and then stand. Progress goes to standard error, and in the end one
line that compares the estimate with the rig's truth to standard output. Without --seconds it runs until Ctrl-C.
"""

from __future__ import annotations

import argparse
import json
import math
import socket
import sys
import tempfile
import time
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
import zmq

from palmd.bus.client import COMMAND, PUBLISH, Client, Subscriber
from palmd.cli.browser import open_page
from palmd.config import BusConfig, Config
from palmd.console.errors import BAD_INPUT, RIG_FAILED, CliError
from palmd.console.shipped import shipped
from palmd.harness.comparison import Comparison
from palmd.harness.panel import Panel
from palmd.harness.processes import Child, StopRequest
from palmd.rig.shapes import KINDS
from palmd.yamlfile import ConfigError, load_config

RIG_START_S = 30.0
DAEMON_START_S = 240.0  # compiling the observers on a slow machine
MOTION_START_S = 30.0
BUILDING_AFTER_S = 3.0
ANSWER_S = 5.0
LOOK_S = 0.1
PROGRESS_S = 1.0
START_ATTEMPTS = 3
RECORDER_START_S = 10.0
RECORDED_S = 300.0  # to pack the recording of many hours
RUNS = Path("runs")
PORTS = range(9872, 10872)  # below those that the system hands out itself
PAGE_PORTS = range(8787, 8887)
PAGE_START_S = 15.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument("--seconds", type=_duration, default=math.inf, metavar="N", help="how long to run")
    parser.add_argument("--no-browser", action="store_true", help="serve the live page, but open no browser")
    parser.add_argument("--seed", type=int, help="which object and noise; default: a random one, printed")
    parser.add_argument("--kind", choices=KINDS, default="rig", help="what sort of object (default: %(default)s)")
    parser.add_argument("--no-record", action="store_true", help=f"keep no recording; else it goes to {RUNS}/ here")
    parser.add_argument("--config", type=Path, default=shipped("demo.yaml"), help="rig and plan; default: as shipped")


def run(arguments: argparse.Namespace) -> int:
    """Runs to the end asked for and leaves nothing behind; 3 when no estimate ever settled.

    Raises CliError when the rig or the daemon fail.
    """
    try:
        config = load_config(arguments.config)
    except ConfigError as error:
        raise CliError(BAD_INPUT, str(error)) from None
    seed = [] if arguments.seed is None else ["--seed", str(arguments.seed)]
    with StopRequest() as stop, tempfile.TemporaryDirectory(prefix="palmd-demo-") as name, ExitStack() as stack:
        folder = Path(name)
        rig = _start_rig([str(arguments.config), "--kind", arguments.kind, *seed], folder, stop, stack)
        runs = None if arguments.no_record else RUNS.absolute()
        daemon = rig and _start_daemon(config, rig, runs, folder, stop, stack)
        if not (rig and daemon):
            return 0  # the end was asked for before anything began
        comparison = Comparison(rig.told["seed"])
        page = _serve_page(daemon.bus, rig.told["truth"], folder, stop, stack)
        _introduce(rig.told["seed"], daemon.bus, page)
        if page and not arguments.no_browser:
            open_page(page)
        _operate(rig, daemon, comparison, stop, arguments.seconds)
        _bring_to_rest(daemon)
        _finish_recording(daemon)
    print(comparison.summary())
    return 0 if comparison.settled else RIG_FAILED


@dataclass(frozen=True, slots=True)
class _Rig:
    """The rig's process, and its JSON line."""

    child: Child
    told: dict[str, Any]


@dataclass(frozen=True, slots=True)
class _Daemon:
    """The daemon's process and the ways to talk with it; the subscriber hears the rig's truth too."""

    child: Child
    recorder: Child | None
    bus: BusConfig
    subscriber: Subscriber
    client: Client

    def listen(self, comparison: Comparison, panel: Panel, seconds: float) -> None:
        """Let both take what comes within so many seconds."""
        for message in self.subscriber.until(time.monotonic() + seconds):
            comparison.take(message)
            if message.topic == "palm/state":
                panel.see(message.fields)


# -------------------------------------------------------------------------------------------------- starting


def _start_rig(arguments: list[str], folder: Path, stop: StopRequest, stack: ExitStack) -> _Rig | None:
    """None when the end was asked for meanwhile; raises CliError when there is no rig."""
    child = Child(["rig", *arguments], folder)
    stack.callback(child.stop)
    line = child.first_line(RIG_START_S, lambda: stop.made)
    if stop.made:
        return None
    if line is None:
        raise _not_started(child)
    return _Rig(child, json.loads(line))


def _start_daemon(
    config: Config, rig: _Rig, runs: Path | None, folder: Path, stop: StopRequest, stack: ExitStack
) -> _Daemon | None:
    """With its recorder, unless `runs` is None. None when the end was asked for meanwhile.

    Raises CliError when there is no daemon.
    """
    for _ in range(START_ATTEMPTS):  # another demo may take the addresses while this daemon starts
        bus = free_addresses(config.bus)
        path = folder / "palmd.yaml"
        path.write_text(as_yaml(config, bus, rig.told, runs), encoding="utf-8")
        recorder = None if runs is None else _start_recorder(path, rig, folder, stop, stack)
        child = Child(["run", str(path), "--no-record"], folder)
        stack.callback(child.stop)
        subscriber = stack.enter_context(Subscriber(bus.publish, rig.told["truth"], topics=("palm/", "rig/")))
        if _is_heard(child, subscriber, stop):
            return _Daemon(child, recorder, bus, subscriber, stack.enter_context(Client(bus.command, ANSWER_S)))
        if recorder is not None:
            recorder.stop()
        if stop.made:
            return None
        if "is in use" not in child.said():
            break
    raise _not_started(child)


def _start_recorder(config: Path, rig: _Rig, folder: Path, stop: StopRequest, stack: ExitStack) -> Child:
    """It listens before the daemon begins to speak, unless it does not start at all, which ends nothing."""
    recorder = Child(["record", str(config), "--truth", rig.told["truth"]], folder)
    stack.callback(recorder.stop)
    recorder.first_line(RECORDER_START_S, lambda: stop.made)
    return recorder


def _serve_page(bus: BusConfig, truth: str, folder: Path, stop: StopRequest, stack: ExitStack) -> str | None:
    """The live page's address; None when there is none, which ends nothing."""
    where = ["--address", bus.publish, "--command", bus.command, "--truth", truth]
    for _ in range(START_ATTEMPTS):  # another demo may take the port in between
        child = Child(["view", "--no-browser", *where, "--port", str(_free_page_port())], folder)
        stack.callback(child.stop)
        page = child.first_line(PAGE_START_S, lambda: stop.made)
        if page is not None or stop.made:
            return page
    _tell(f"no live page: {child.said() or 'it did not start'}")
    return None


def _free_page_port() -> int:
    """The first of the page's ports that nobody has, else any."""
    for port in PAGE_PORTS:
        with socket.socket() as probe, suppress(OSError):
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as the page's server has it
            probe.bind(("127.0.0.1", port))
            return port
    return 0


def _is_heard(daemon: Child, subscriber: Subscriber, stop: StopRequest) -> bool:
    t_begin = time.monotonic()
    told = False
    while daemon.status is None and not stop.made and time.monotonic() < t_begin + DAEMON_START_S:
        for message in subscriber.until(time.monotonic() + LOOK_S):
            if message.topic.startswith("palm/"):
                return True
        if not told and time.monotonic() > t_begin + BUILDING_AFTER_S:
            told = True
            _tell("building the observers once, some 20 s…")
    return False


def _not_started(child: Child) -> CliError:
    """Its own words, and its status where the input was wrong."""
    status = BAD_INPUT if child.status == BAD_INPUT else RIG_FAILED
    return CliError(status, child.said() or f"palmd {child.name} did not start")


# -------------------------------------------------------------------------------------------------- operating


def _introduce(seed: int, bus: BusConfig, page: str | None) -> None:
    at = "" if bus.publish == PUBLISH else f" --address {bus.publish}"
    to = "" if bus.command == COMMAND else f" --address {bus.command}"
    _tell(f"an object that palmd does not know (seed {seed}); look at it with:")
    if page:
        _tell(f"  {page}")
    _tell(f"  palmd top{at}")
    _tell(f"  PlotJuggler: ZeroMQ subscriber, MessagePack, {bus.publish}")
    _tell(f"  palmd ctl status{to}")


def _operate(rig: _Rig, daemon: _Daemon, comparison: Comparison, stop: StopRequest, seconds: float) -> None:
    """Does what an operator does, for so many seconds of motion or until the end is asked for."""
    panel = Panel()
    t_begin = time.monotonic()
    t_progress = -math.inf
    while not stop.made:
        daemon.listen(comparison, panel, LOOK_S)
        _check_alive(rig.child, daemon.child)
        t = time.monotonic()
        started = comparison.t_started
        if started is None and t > t_begin + MOTION_START_S:
            raise CliError(RIG_FAILED, f"the palms were not brought to move\n{daemon.child.said()}".strip())
        if started is not None and t > started + seconds:
            return
        command = panel.decide(comparison.state, comparison.motion, t)
        if command is not None and _is_done(daemon.client, command) and command == "start":
            comparison.started(t)
        if started is not None and t >= t_progress + PROGRESS_S:
            t_progress = t
            _tell(comparison.progress(t))


def _is_done(client: Client, command: str) -> bool:
    reply = client.ask(command)
    if not reply["ok"]:
        _tell(f"{command}: {reply.get('error')}")
    elif command == "reset":
        _tell("reset")
    return bool(reply["ok"])


def _check_alive(*children: Child) -> None:
    for child in children:
        if child.status is not None:
            raise CliError(RIG_FAILED, f"{child.name} ended with status {child.status}\n{child.said()}".strip())


def _bring_to_rest(daemon: _Daemon) -> None:
    """A planned stop, then the daemon's end before the rig's; what it estimates meanwhile is not compared."""
    with suppress(CliError):
        daemon.client.ask("stop")
    daemon.child.stop()


def _finish_recording(daemon: _Daemon) -> None:
    """Let the recorder hear the daemon's end and pack what it has; says where that is."""
    recorder = daemon.recorder
    if recorder is None:
        return
    recorder.stop(RECORDED_S)
    paths = recorder.lines()[1:]
    for path in paths:
        _tell(f"recorded in {path}")
    if recorder.status != 0 or not paths:
        _tell(f"not recorded: {recorder.said() or recorder.status}")


# ------------------------------------------------------------------------------------- addresses, configuration


def free_addresses(wanted: BusConfig) -> BusConfig:
    """The wanted addresses where nobody has them, else the next free ports of this machine."""
    publish = _free(wanted.publish, taken="")
    return wanted.model_copy(update={"publish": publish, "command": _free(wanted.command, taken=publish)})


def _free(wanted: str, taken: str) -> str:
    for address in (wanted, *(f"tcp://127.0.0.1:{port}" for port in PORTS)):
        if address != taken and _is_free(address):
            return address
    raise CliError(RIG_FAILED, f"{wanted} is in use, and so are {PORTS[0]} to {PORTS[-1]}")


def _is_free(address: str) -> bool:
    with zmq.Context() as context, context.socket(zmq.PUB) as socket:
        try:
            socket.bind(address)
        except zmq.ZMQError:
            return False
    return True


def as_yaml(config: Config, bus: BusConfig, rig: dict[str, Any], runs: Path | None = None) -> str:
    """The configuration with the rig's ports, the addresses that are free, and the folder of recordings."""
    values = config.model_dump(mode="json") | {"bus": bus.model_dump(mode="json")}
    if runs is not None:
        values["record"]["directory"] = str(runs)
    values["pads"]["palm1"]["port"] = rig["pad1"]
    values["pads"]["palm2"]["port"] = rig["pad2"]
    values["arm"]["port"] = rig["arm"]
    if values["plan"] is None:
        del values["plan"]
    return yaml.safe_dump(values, allow_unicode=True)


def _tell(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _duration(text: str) -> float:
    seconds = float(text)
    if not seconds > 0.0:
        raise argparse.ArgumentTypeError(f"must be more than 0, got {text}")
    return seconds
