"""Compiles the observers into the cache, so that the first run need not; without a compiler it says so."""

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
    """The command's arguments."""
    parser.add_argument(
        "config",
        type=Path,
        nargs="?",
        metavar="CONFIG",
        help="what a run with this configuration needs, and no more (default: what any rig with flat palms needs)",
    )
    parser.add_argument(
        "--all",
        action="store_true",
        help="what other systems need too: curved palms, flat sides, a pivoting grasp, three palms in space",
    )


def run(arguments: argparse.Namespace) -> int:
    """Makes each set of kernels once; takes seconds for what is not in the cache yet."""
    compiled.forget_failures()
    if arguments.config is not None and not arguments.all:
        parts = needed_by(any_configured(arguments.config))
    else:
        systems = LIVE if arguments.all else (TWO_PALMS,)
        usual = [each for name in systems for each in load_part(LIVE[name].kernels)(None)]
        parts = [*(_other_forms() if arguments.all else ()), *usual, *_beside()]  # those that last go first
    for what, backend, seconds in side_by_side(parts):
        print(f"{what}: {_BACKENDS[backend]}, {seconds:.1f} s", flush=True)
    return 0


def needed_by(config: AnyConfig) -> list[Part]:
    """What the processes of a run with this configuration load."""
    parts: list[Part] = load_part(LIVE[config.system].kernels)(config)
    return parts


def made_ready(config: AnyConfig, tell: Callable[[str], None]) -> None:
    """Make what a run needs before its processes start, each of which would else compile; tell if it lasts."""
    for _ in side_by_side(needed_by(config), lambda: tell("compiling what these palms need, once; it takes a minute")):
        pass


def side_by_side(parts: Iterable[Part], lasts: Callable[[], None] | None = None) -> Iterator[tuple[str, str, float]]:
    """Make parts, as many at once as there are processors: what each is, how it runs, and seconds, as it is done.

    `lasts` is called, once, when none has been for a while. Each part is made in a forked process, as CasADi is not
    safe among threads; what several of them warn of is said once. Raises what making one raised, CliError when its
    process was killed; the others end first.
    """
    waiting, running, said = deque(parts), dict[Connection, tuple[str, float]](), set[str]()
    while waiting or running:
        while waiting and len(running) < len(os.sched_getaffinity(0)):
            what, make = waiting.popleft()
            running[_begun(make)] = what, time.monotonic()
        done = wait(running, _PATIENCE_S if lasts else None)
        if lasts and not done:
            lasts()
            lasts = None
        for connection in [each for each in running if each in done]:
            what, begun = running.pop(connection)
            try:
                made, warnings, fault = connection.recv()
            except EOFError:
                advice = "for want of memory most often: make fewer at once with `taskset -c 0 palmd doctor build`"
                made, warnings, fault = CliError(RIG_FAILED, f"{what}: what compiled it was killed, {advice}"), [], None
            for warning in warnings:
                reason = fault or warning.partition(": ")[2] or warning
                if reason not in said:
                    said.add(reason)
                    log.warning("%s", warning)
            if fault is not None:
                os.environ[compiler.FAULT] = fault
            if isinstance(made, Exception):
                raise made
            yield what, made, time.monotonic() - begun


def _begun(make: Callable[[], str]) -> Connection:
    """A process that makes a part: from there comes how it runs, or what was raised."""
    forked = multiprocessing.get_context("fork")
    ours, theirs = forked.Pipe(duplex=False)
    forked.Process(target=_make, args=(make, theirs)).start()  # ends by itself, and tidily, on Ctrl-C
    theirs.close()
    return ours


class _Warnings(logging.Handler):
    """Keeps what is logged: whoever started this process says it, once for all that it starts."""

    def __init__(self) -> None:
        super().__init__()
        self.texts: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.texts.append(record.getMessage())


def _make(make: Callable[[], str], told: Connection) -> None:
    warnings = _Warnings()
    compiled.log.addHandler(warnings)
    compiled.log.propagate = False
    try:
        made: str | Exception = make()
    except Exception as error:
        made = error
    except KeyboardInterrupt:
        return  # the parent has been interrupted too, and says so
    with suppress(BrokenPipeError):  # whoever asked is gone
        told.send((made, warnings.texts, os.environ.get(compiler.FAULT)))


def _beside() -> list[Part]:
    from palmd.record import jsontext
    from palmd.rig import compiled_plant

    return [("emulated rig", compiled_plant.backend), ("numbers as text", jsontext.backend)]


def _other_forms() -> list[Part]:
    from palmd.model import sharp

    return [
        ("flat sides", lambda: sharp.library().backend),
        ("a flat side", lambda: sharp.library_for(1).backend),
        *(part for part in of_palms(curved=True) if part[0] != "smoother's equations"),  # flat ones have made them
    ]
