"""Compiles plans in a process of ordinary priority beside the loop, within bounds on time and size.

The loop hands over a description of the work and finds the plan ready some ticks later. It never waits, and takes at
most a few milliseconds to unpack a plan of the largest size.
"""

from __future__ import annotations

import importlib
import pickle  # between a process and its own child, on a socket in a folder of their own
import signal
import time
from collections.abc import Callable
from concurrent.futures import Executor, Future
from types import FrameType
from typing import Any, ParamSpec, TypeVar

from palmd.daemon.worker import WorkerProcess, meet

LONGEST_S = 10.0
"""The most processor time that the compilation of a plan may take."""

PATIENCE_S = 40.0
"""For an answer, on a busy machine and with a start of the process; then the process is started again."""

LARGEST_BYTES = 100_000
"""Of a compiled plan on its way to the loop, which unpacks it in 3 ms."""

HIGH_WATER = 2
NICENESS = 1

P = ParamSpec("P")
T = TypeVar("T")


class CompilationError(Exception):
    """A plan that cannot be had; says why."""


class _Awaited(Future[T]):
    """A plan that is looked for whenever somebody asks whether it is there."""

    def __init__(self, look: Callable[[], None]) -> None:
        super().__init__()
        self._look = look

    def done(self) -> bool:
        """Whether it is there, or is known not to come."""
        self._look()
        return super().done()


class PlanCompiler(Executor):
    """The loop's end; what is submitted is a picklable call that gives a plan. Safe inside the loop.

    One plan at a time: whatever was submitted before is given up.
    """

    def __init__(self) -> None:
        """Start the process, as a copy of this one, before it has other threads; raises OSError when it cannot be."""
        self._process = WorkerProcess("planner", __name__, high_water=HIGH_WATER, copied=True)
        self._count = 0
        self._message = b""
        self._sent_to = 0  # the start of the process that has the message
        self._future: Future[Any] | None = None
        self._t_end = 0.0

    def submit(self, work: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Have the plan compiled."""
        t = time.monotonic()
        if self._future is not None:
            self._process.restart(t)  # nobody waits for that plan any more
        future: Future[T] = _Awaited(self._look)
        self._count += 1
        self._message = pickle.dumps((self._count, work, args, kwargs))
        self._future, self._sent_to, self._t_end = future, 0, t + PATIENCE_S
        return future

    def tend(self, t: float) -> None:
        """Start the process again at `t` (s) if it does not run."""
        self._process.tend(t)

    def close(self) -> None:
        """End the process."""
        self._process.close()

    def _look(self) -> None:
        """Pass on what the process has not got yet, and take its answer."""
        future = self._future
        if future is None:
            return
        if self._sent_to != self._process.starts and self._process.send(self._message):
            self._sent_to = self._process.starts
        for message in self._process.received():
            number, packed, error = pickle.loads(message)
            if number == self._count:
                self._future = None
                if error:
                    future.set_exception(CompilationError(error))
                else:
                    future.set_result(pickle.loads(packed))
                return
        if time.monotonic() > self._t_end:
            self._future = None
            self._process.restart(time.monotonic())
            future.set_exception(CompilationError(f"the plan was not compiled within {PATIENCE_S:g} s"))


def serve(address: str) -> None:
    """The process's work, for ever: compile what comes."""
    importlib.import_module("palmd.daemon.planner")  # before the first plan comes
    signal.signal(signal.SIGPROF, _give_up)
    with meet(address, NICENESS) as socket:
        while True:
            socket.send(pickle.dumps(compiled(socket.recv())))


def compiled(message: bytes) -> tuple[int, bytes, str]:
    """The number of a message, the plan that its call gives, packed, and why there is none."""
    number, work, args, kwargs = pickle.loads(message)
    signal.setitimer(signal.ITIMER_PROF, LONGEST_S)
    try:
        packed = pickle.dumps(work(*args, **kwargs))
    except Exception as error:  # a plan from outside may be wrong in any way; the loop hears how
        return number, b"", str(error) or type(error).__name__
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    if len(packed) > LARGEST_BYTES:
        size = f"{len(packed) / 1e3:.0f} kB once compiled, more than {LARGEST_BYTES / 1e3:.0f} kB"
        return number, b"", f"the plan is too large: {size}; leave out segments, or let each round end where it began"
    return number, packed, ""


def _give_up(_signal: int, _frame: FrameType | None) -> None:
    raise CompilationError(
        f"the plan takes more than {LONGEST_S:g} s of processor time to compile: make it shorter or divide it"
    )
