"""Measures the lateness of the control loop's ticks on this machine, idle and under several kinds of load.

A daemon moves an emulated rig; at the same time a bare timer measures the lower bound of this machine: cyclictest if
it is installed (Debian: rt-tests), else a timer in Python. Times are in milliseconds.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from palmd.console.arguments import seconds
from palmd.console.notes import say
from palmd.console.shipped import shipped
from palmd.doctor import load
from palmd.doctor.lateness import Case, TickLateness, branches, lines, table
from palmd.doctor.wakeups import Meter
from palmd.harness.operator import Operator
from palmd.harness.processes import StopRequest
from palmd.harness.stack import START_S, Stack, not_started
from palmd.rig.imperfections import perfect
from palmd.yamlfile import load_config

SEED = 3
SETTLING_S = 1.5  # until the load is effective and palm/loop has been published once
LOOK_S = 0.1
DISK = Path("/var/tmp")  # never in memory, as /tmp may be


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "--seconds", type=seconds, default=10.0, metavar="N", help="duration of each case in s (default: 10)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Ctrl-C ends it with the cases measured so far. CliError if rig or daemon do not start."""
    cases: list[Case] = []
    by: set[str] = set()
    config = perfect(load_config(shipped("demo.yaml"))).model_copy(update={"plan": shipped("plans/lively.yaml")})
    with StopRequest() as stop, tempfile.TemporaryDirectory(prefix="palmd-latency-") as name, ExitStack() as leaving:
        stack = leaving.enter_context(Stack(Path(name), config, give_up=lambda: stop.made))
        if not (stack.start_rig("--seed", str(SEED)) and stack.start(record=False)):
            return 0
        bench = _Bench(Path(name), stack, 1.0 / config.loop.rate_hz)
        bench.listen_until(lambda: bench.operator.moves or stop.made, START_S)
        if "no-realtime" in bench.operator.state.get("faults", ()):
            say("no real-time priority or locked memory: the results are those of an ordinary process")
        for what, busy in CASES.items():
            if stop.made:
                break
            say(f"{what}, {arguments.seconds:g} s…")
            with busy(bench):
                bench.listen_until(lambda: stop.made, SETTLING_S)
                case, measured_by = _measured(what, bench, arguments.seconds, stop)
            if not stop.made:
                cases.append(case)
                by.add(measured_by)
    if cases:
        print(table(cases, " / ".join(sorted(by))))
        print("\n".join(["", *lines(tuple(branches(cases)))]))
    return 0


@dataclass(slots=True)
class _Bench:
    """A daemon on an emulated rig, kept moving while listening."""

    folder: Path
    stack: Stack
    period_s: float
    operator: Operator = field(default_factory=Operator)

    def listen_until(
        self, done: Callable[[], bool], patience_s: float, hear: Callable[[dict[str, Any]], None] | None = None
    ) -> None:
        """Listen for at most `patience_s`; `hear` receives each palm/loop. Raises CliError if the daemon has ended."""
        t_end = time.monotonic() + patience_s
        while not done() and (t := time.monotonic()) < t_end:
            for message in self.stack.subscriber.until(min(t + LOOK_S, t_end)):
                self.operator.take(message.topic, message.fields)
                if message.topic == "palm/loop" and hear is not None:
                    hear(message.fields)
            self.stack.check_alive("daemon")
            command = self.operator.decide(time.monotonic())
            if command is not None:
                self.stack.client.ask(command)


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
def _beside(work: Callable[..., None], *arguments: str, count: int = 1) -> Iterator[None]:
    """Context in which `count` processes do this work."""
    start = multiprocessing.get_context("spawn").Process
    with ExitStack() as leaving:
        for _ in range(count):
            process = start(target=work, args=(os.getpid(), *arguments), daemon=True)
            process.start()
            leaving.callback(process.join)
            leaving.callback(process.kill)
        yield


@contextmanager
def _companions(bench: _Bench) -> Iterator[None]:
    stack = bench.stack
    stack.start_recorder()
    if not stack.start_page():
        raise not_started(stack.children["page"])
    with _beside(load.browser, stack.page):
        yield


CASES: dict[str, Callable[[_Bench], AbstractContextManager[None]]] = {
    "idle": lambda _: nullcontext(),
    "every core busy": lambda _: _beside(load.processor, count=multiprocessing.cpu_count()),
    "disk busy": lambda _: _beside(load.disk, str(DISK)),
    "network busy": lambda _: _beside(load.network),
    "recorder and page": _companions,
}
"""Names of the loads and the context managers that create them."""
