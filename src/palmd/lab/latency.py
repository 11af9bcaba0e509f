"""How late the control loop's ticks begin on this machine: idle, and while it has other things to do.

A daemon moves an emulated rig; beside it, in the same seconds, a bare timer tells what this machine can do at best:
cyclictest where it is installed (Debian: rt-tests), else one in Python. Times are in milliseconds.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from palmd.bus.client import Client, Subscriber
from palmd.cli.demo import as_yaml, free_addresses
from palmd.config import BusConfig
from palmd.console.arguments import seconds
from palmd.console.errors import RIG_FAILED, CliError
from palmd.console.shipped import shipped
from palmd.harness.panel import Panel
from palmd.harness.processes import Child, StopRequest
from palmd.lab import load
from palmd.lab.lateness_summary import Case, TickLateness, table
from palmd.lab.wakeups import Meter
from palmd.yamlfile import load_config

SEED = 3
START_S = 240.0  # compiling the observers on a slow machine
PAGE_START_S = 15.0
SETTLING_S = 1.5  # a load takes hold, and palm/loop speaks once of it
LOOK_S = 0.1
DISK = Path("/var/tmp")  # unlike /tmp never in memory


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument("--seconds", type=seconds, default=10.0, metavar="N", help="for each case (default: 10)")


def run(arguments: argparse.Namespace) -> int:
    """Ctrl-C ends it with what is measured until then; raises CliError when rig or daemon do not start."""
    cases: list[Case] = []
    by: set[str] = set()
    with StopRequest() as stop, tempfile.TemporaryDirectory(prefix="palmd-latency-") as name, ExitStack() as stack:
        bench = _start(Path(name), stop, stack)
        bench.listen_until(lambda: bench.moves or stop.made, START_S)
        if "no-realtime" in bench.seen["palm/state"].get("faults", ()):
            _tell("no real-time priority or locked memory: these are the figures of an ordinary process")
        for what, busy in CASES.items():
            if stop.made:
                break
            _tell(f"{what}, {arguments.seconds:g} s…")
            with busy(bench):
                bench.listen_until(lambda: stop.made, SETTLING_S)
                case, measured_by = _measured(what, bench, arguments.seconds, stop)
            if not stop.made:
                cases.append(case)
                by.add(measured_by)
    if cases:
        print(table(cases, " / ".join(sorted(by))))
    return 0


@dataclass(slots=True)
class _Bench:
    """A daemon on an emulated rig, kept moving while we listen."""

    folder: Path
    config: Path
    bus: BusConfig
    truth: str
    period_s: float
    daemon: Child
    subscriber: Subscriber
    client: Client
    panel: Panel = field(default_factory=Panel)
    seen: dict[str, dict[str, Any]] = field(default_factory=lambda: {"palm/state": {}, "palm/motion": {}})

    @property
    def moves(self) -> bool:
        """Whether the palms follow a plan."""
        return bool(self.seen["palm/motion"].get("segment", -1) >= 0)

    def listen_until(
        self, done: Callable[[], bool], patience_s: float, hear: Callable[[dict[str, Any]], None] | None = None
    ) -> None:
        """Listen so long at most; `hear` is given each palm/loop. Raises CliError when the daemon has ended."""
        t_end = time.monotonic() + patience_s
        while not done() and (t := time.monotonic()) < t_end:
            for message in self.subscriber.until(min(t + LOOK_S, t_end)):
                self.seen[message.topic] = message.fields
                if message.topic == "palm/state":
                    self.panel.see(message.fields)
                elif message.topic == "palm/loop" and hear is not None:
                    hear(message.fields)
            if self.daemon.status is not None:
                raise CliError(RIG_FAILED, self.daemon.said() or "the daemon ended")
            command = self.panel.decide(self.seen["palm/state"], self.seen["palm/motion"], time.monotonic())
            if command is not None:
                self.client.ask(command)


def _start(folder: Path, stop: StopRequest, stack: ExitStack) -> _Bench:
    rig = _child(["rig", str(shipped("demo.yaml")), "--seed", str(SEED)], folder, stack)
    told = json.loads(rig.started(START_S, lambda: stop.made))
    config = load_config(shipped("demo.yaml")).model_copy(update={"plan": shipped("plans/lively.yaml")})
    bus = free_addresses(config.bus)
    path = folder / "palmd.yaml"
    path.write_text(as_yaml(config, bus, told, folder / "runs"), encoding="utf-8")
    daemon = _child(["run", str(path), "--no-record"], folder, stack)
    subscriber = stack.enter_context(Subscriber(bus.publish, topics=("palm/state", "palm/motion", "palm/loop")))
    client = stack.enter_context(Client(bus.command, START_S))
    return _Bench(folder, path, bus, told["truth"], 1.0 / config.loop.rate_hz, daemon, subscriber, client)


def _measured(what: str, bench: _Bench, seconds: float, stop: StopRequest) -> tuple[Case, str]:
    lateness = TickLateness()
    meter = Meter(seconds, bench.period_s, bench.folder)
    try:
        bench.listen_until(lambda: stop.made, seconds, lateness.take)
        wakeups = None if stop.made else meter.result()
    finally:
        meter.close()
    measured = ((), "timer") if wakeups is None else (wakeups.lateness_ms, wakeups.by)
    return Case(what, lateness.values_ms, lateness.skipped, measured[0]), measured[1]


# ------------------------------------------------------------------------------------------------------- cases


@contextmanager
def _idle(_bench: _Bench) -> Iterator[None]:
    yield


@contextmanager
def _processors(_bench: _Bench) -> Iterator[None]:
    with ExitStack() as stack:
        for _ in range(multiprocessing.cpu_count()):
            stack.enter_context(_beside(load.processor))
        yield


@contextmanager
def _disk(_bench: _Bench) -> Iterator[None]:
    with _beside(load.disk, str(DISK)):
        yield


@contextmanager
def _network(_bench: _Bench) -> Iterator[None]:
    with _beside(load.network):
        yield


@contextmanager
def _companions(bench: _Bench) -> Iterator[None]:
    with ExitStack() as stack:
        _child(["record", str(bench.config), "--truth", bench.truth], bench.folder, stack)
        where = ["--address", bench.bus.publish, "--command", bench.bus.command, "--truth", bench.truth]
        page = _child(["view", "--no-browser", "--port", "0", *where], bench.folder, stack)
        with StopRequest() as stop:
            address = page.started(PAGE_START_S, lambda: stop.made)
        stack.enter_context(_beside(load.browser, address))
        yield


CASES = {
    "idle": _idle,
    "every core busy": _processors,
    "disk busy": _disk,
    "network busy": _network,
    "recorder and page": _companions,
}
"""What the machine is busy with, and how it is made so."""


@contextmanager
def _beside(work: Callable[..., None], *arguments: str) -> Iterator[None]:
    process = multiprocessing.get_context("spawn").Process(target=work, args=arguments, daemon=True)
    process.start()
    try:
        yield
    finally:
        process.kill()
        process.join()


def _child(arguments: list[str], folder: Path, stack: ExitStack) -> Child:
    child = Child(arguments, folder)
    stack.callback(child.stop)
    return child


def _tell(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
