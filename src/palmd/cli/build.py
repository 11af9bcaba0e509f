"""Compiles the observers into the cache before the first run; reports if there is no compiler."""

from __future__ import annotations

import argparse
import logging
import multiprocessing
import os
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from pathlib import Path

from palmd.config.any_config import AnyConfig
from palmd.console.configured import any_configured
from palmd.console.errors import RIG_FAILED, CliError
from palmd.model import compiled, compiler
from palmd.observer.kernels import Part, of_palms
from palmd.systems import LIVE, TWO_PALMS, load_part

log = logging.getLogger(__name__)

_PATIENCE_S = 2.0

_BACKENDS = {
    "c": "compiled C",
    "vm": "CasADi's virtual machine, no compiled C",
    "numpy": "NumPy, nothing to compile",
    "python": "Python, no compiled C",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add = parser.add_argument
    add(
        "config", type=Path, nargs="?", metavar="CONFIG",
        help="compile only what a run with this configuration needs (default: what any rig with flat palms needs)",
    )  # fmt: skip
    add(
        "--all", action="store_true",
        help="also compile what other systems need: curved palms, flat sides, a pivoting grasp, three palms in space",
    )  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Compile each set of kernels once; takes seconds for each that is not in the cache yet."""
    compiled.forget_failures()
    if arguments.config is not None and not arguments.all:
        parts = needed_by(any_configured(arguments.config))
    else:
        from palmd.rig import vibrating_plant

        systems = LIVE if arguments.all else (TWO_PALMS,)
        usual = [each for name in systems for each in load_part(LIVE[name].kernels)(None)]
        others = _other_forms() if arguments.all else []
        parts = [*others, *usual, ("emulated rig", vibrating_plant.backend)]  # longest first
    for what, backend, seconds in compile_parallel(parts):
        print(f"{what}: {_BACKENDS[backend]}, {seconds:.1f} s", flush=True)
    return 0


def needed_by(config: AnyConfig) -> list[Part]:
    """Return the parts that the processes of a run with this configuration load."""
    parts: list[Part] = load_part(LIVE[config.system].kernels)(config)
    return parts


def prepare_kernels(config: AnyConfig, report: Callable[[str], None]) -> None:
    """Compile what a run needs before its processes start, which would else compile it each; report long waits."""
    for _ in compile_parallel(needed_by(config), lambda: report("compiling the observers, once; this takes a minute")):
        pass


def compile_parallel(
    parts: Iterable[Part], on_wait: Callable[[], None] | None = None
) -> Iterator[tuple[str, str, float]]:
    """Compile parts in parallel, one per processor; yield name, backend and duration (s) of each as it is finished.

    `on_wait` is called once if none is finished for a while. Each part is compiled in a forked process, since CasADi is
    not thread-safe; warnings common to several are logged once. Raises the exception of a part, CliError if its process
    was killed; the others finish first.
    """
    waiting, running, logged = deque(parts), dict[Connection, tuple[str, float]](), set[str]()
    while waiting or running:
        while waiting and len(running) < len(os.sched_getaffinity(0)):
            what, make = waiting.popleft()
            running[_start(make)] = what, time.monotonic()
        done = wait(running, _PATIENCE_S if on_wait else None)
        if on_wait and not done:
            on_wait()
            on_wait = None
        for connection in [each for each in running if each in done]:
            what, t_start = running.pop(connection)
            try:
                made, warnings, fault = connection.recv()
            except EOFError:
                advice = "most often for lack of memory: compile fewer at once with `taskset -c 0 palmd doctor build`"
                made, warnings, fault = CliError(RIG_FAILED, f"{what}: its compiler was killed, {advice}"), [], None
            for warning in warnings:
                reason = fault or warning.partition(": ")[2] or warning
                if reason not in logged:
                    logged.add(reason)
                    log.warning("%s", warning)
            if fault is not None:
                os.environ[compiler.FAULT] = fault
            if isinstance(made, Exception):
                raise made
            yield what, made, time.monotonic() - t_start


def _start(make: Callable[[], str]) -> Connection:
    """Start a process that compiles a part; the connection receives its backend or its exception."""
    forked = multiprocessing.get_context("fork")
    ours, theirs = forked.Pipe(duplex=False)
    forked.Process(target=_make, args=(make, theirs)).start()  # ends cleanly on Ctrl-C
    theirs.close()
    return ours


class _Warnings(logging.Handler):
    """Collects log messages, which the parent process logs once for all its children."""

    def __init__(self) -> None:
        super().__init__()
        self.texts: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.texts.append(record.getMessage())


def _make(make: Callable[[], str], result: Connection) -> None:
    warnings = _Warnings()
    compiled.log.addHandler(warnings)
    compiled.log.propagate = False
    try:
        made: str | Exception = make()
    except Exception as error:
        made = error
    except KeyboardInterrupt:
        return  # the parent is interrupted too, and reports it
    with suppress(BrokenPipeError):  # the parent has ended
        result.send((made, warnings.texts, os.environ.get(compiler.FAULT)))


def _other_forms() -> list[Part]:
    from palmd.model import sharp

    return [
        ("flat sides", lambda: sharp.library().backend),
        ("a flat side", lambda: sharp.library_for(1).backend),
        *(part for part in of_palms(curved=True) if part[0] != "smoother's equations"),  # compiled with the flat ones
    ]
