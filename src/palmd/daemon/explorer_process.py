"""The explorer in a process of its own beside the loop. It answers the newest question it finds."""

from __future__ import annotations

import logging
import pickle  # between a process and its own child, on a socket in a folder of their own

from palmd.daemon.exploration_requests import Decides, ExplorationAnswer, Question
from palmd.daemon.worker import WorkerProcess, give_back_memory, meet
from palmd.systems import load_part

log = logging.getLogger(__name__)

DECIDER = "palmd.daemon.exploration_requests:Decider"
HIGH_WATER = 10  # questions on their way: a second
NICENESS = 2  # the palms stand while it thinks: before the smoother, after the loop


class ExplorerProcess:
    """The loop's end, a `daemon.exploration_requests.Source`; a plan that first needs it starts it, in 3 ms."""

    def __init__(self, rig: object, decider: str = DECIDER) -> None:
        """`decider`: who answers questions there, a class made of the `rig` as its observers know it."""
        self._rig, self._decider = rig, decider
        self._process: WorkerProcess | None = None
        self._failed = False

    @property
    def starts(self) -> int:
        """How often the process has been started."""
        return 0 if self._process is None else self._process.starts

    def prepare(self) -> None:
        """Start the process, unless that has been done."""
        if self._process is not None or self._failed:
            return
        try:
            self._process = WorkerProcess("explorer", __name__, self._decider, high_water=HIGH_WATER)
        except OSError as error:
            self._failed = True
            log.warning("no explorer beside the loop: %s", error)

    def ask(self, question: Question) -> None:
        """Pass a question on; it is dropped when the process does not take it."""
        if self._process is not None:
            self._process.send(pickle.dumps((self._rig, question)))

    def collect(self, t: float) -> ExplorationAnswer | None:
        """The newest answer that has come."""
        del t  # it is ready when it is here
        newest: ExplorationAnswer | None = None
        if self._process is not None:
            for message in self._process.received():
                newest = pickle.loads(message)
        return newest

    def tend(self, t: float) -> None:
        """Start the process again at `t` (s) if it does not run; see `WorkerProcess.tend`."""
        if self._process is not None:
            self._process.tend(t)

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.close()


def serve(address: str, who: str) -> None:
    """The process's work, for ever: answer, and leave out questions that newer ones have overtaken."""
    decider: Decides | None = None
    with meet(address, NICENESS) as socket:
        while True:
            message = socket.recv()
            if socket.poll(0):
                continue
            rig, question = pickle.loads(message)
            decider = decider or load_part(who)(rig)
            socket.send(pickle.dumps(decider.answer(question)))
            give_back_memory()
