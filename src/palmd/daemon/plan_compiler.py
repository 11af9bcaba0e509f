"""Compiles plans in a process of ordinary priority beside the loop, with limits on time and size.

The loop submits a picklable call and finds the plan ready some ticks later. It never waits, and takes at most a few
milliseconds to unpack a plan of the largest size.
"""

from __future__ import annotations

import importlib
import pickle  # between a process and its own child, on a socket in a private folder
import signal
import time
from collections.abc import Callable
from concurrent.futures import Executor, Future
from types import FrameType
from typing import Any, ParamSpec, TypeVar

from palmd.daemon.worker import WorkerProcess, worker_socket

MAX_CPU_S = 10.0
"""Largest processor time for compiling a plan."""

TIMEOUT_S = 40.0
"""For an answer, on a busy machine and including a start of the process; then the process is restarted."""

MAX_PLAN_BYTES = 100_000
"""Largest size of a compiled plan, which the loop unpacks in 3 ms."""

HIGH_WATER = 2
NICENESS = 1

P = ParamSpec("P")
T = TypeVar("T")


class CompilationError(Exception):
    """A plan that could not be compiled, with the reason."""


class _PolledFuture(Future[T]):
    """A future that checks for its result whenever `done` is called."""

    def __init__(self, look: Callable[[], None]) -> None:
        super().__init__()
        self._look = look

    def done(self) -> bool:
        """Whether there is a result or an exception."""
        self._look()
        return super().done()


class PlanCompiler(Executor):
    """The loop's side: an executor for picklable calls that return a plan. Safe inside the loop.

    One plan at a time: a call submitted before is abandoned.
    """

    def __init__(self) -> None:
        """Start the process as a fork of this one, before it has other threads; raises OSError if that fails."""
        self._process = WorkerProcess("planner", __name__, high_water=HIGH_WATER, forked=True)
        self._count = 0
        self._message = b""
        self._sent_to = 0  # number of the process start that has the message
        self._future: Future[Any] | None = None
        self._t_end = 0.0

    def submit(self, work: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Submit a call that returns a plan; abandons the one submitted before."""
        t = time.monotonic()
        if self._future is not None:
            self._process.restart(t)  # that plan is not needed any more
        future: Future[T] = _PolledFuture(self._look)
        self._count += 1
        self._message = pickle.dumps((self._count, work, args, kwargs))
        self._future, self._sent_to, self._t_end = future, 0, t + TIMEOUT_S
        return future

    def tend(self, t: float) -> None:
        """Restart the process at `t` (s) if it does not run."""
        self._process.tend(t)

    def close(self) -> None:
        """Stop the process."""
        self._process.close()

    def _look(self) -> None:
        """Send the message if the present process does not have it, and receive its answer."""
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
            future.set_exception(CompilationError(f"the plan was not compiled within {TIMEOUT_S:g} s"))


def serve(address: str) -> None:
    """Main function of the process, endless: compile the plans it receives."""
    importlib.import_module("palmd.daemon.planner")  # loaded before the first plan arrives
    signal.signal(signal.SIGPROF, _raise_timeout)
    with worker_socket(address, NICENESS) as socket:
        while True:
            socket.send(pickle.dumps(compiled(socket.recv())))


def compiled(message: bytes) -> tuple[int, bytes, str]:
    """(number of the message, the packed plan, why there is none)."""
    number, work, args, kwargs = pickle.loads(message)
    signal.setitimer(signal.ITIMER_PROF, MAX_CPU_S)
    try:
        packed = pickle.dumps(work(*args, **kwargs))
    except Exception as error:  # a plan from outside can fail in any way; the reason is sent to the loop
        return number, b"", str(error) or type(error).__name__
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    if len(packed) > MAX_PLAN_BYTES:
        size = f"{len(packed) / 1e3:.0f} kB once compiled, more than {MAX_PLAN_BYTES / 1e3:.0f} kB"
        return number, b"", f"the plan is too large: {size}; use fewer segments, or let each round end at its start"
    return number, packed, ""


def _raise_timeout(_signal: int, _frame: FrameType | None) -> None:
    raise CompilationError(
        f"compiling the plan takes more than {MAX_CPU_S:g} s of processor time: shorten or divide it"
    )
