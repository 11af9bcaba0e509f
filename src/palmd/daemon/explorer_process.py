"""The explorer in a process beside the loop. It answers the newest question only."""

from __future__ import annotations

import logging
import pickle  # between a process and its own child, on a socket in a private folder

from palmd.daemon.exploration_requests import ExplorationAnswer, ExplorationDecider, Question
from palmd.daemon.worker import WorkerProcess, release_memory, worker_socket
from palmd.systems import load_part

log = logging.getLogger(__name__)

DECIDER = "palmd.daemon.exploration_requests:Decider"
HIGH_WATER = 10  # questions in transit: one second
NICENESS = 2  # the palms wait for its decisions: priority below the loop, above the smoother


class ExplorerProcess:
    """The loop's side, a `DecisionSource`; the process starts, in 3 ms, when a plan first needs it."""

    def __init__(self, rig: object, decider: str = DECIDER) -> None:
        """`decider` names the class that answers questions in the process, constructed from the `rig` description."""
        self._rig, self._decider = rig, decider
        self._process: WorkerProcess | None = None
        self._failed = False

    @property
    def starts(self) -> int:
        """How often the process was started."""
        return 0 if self._process is None else self._process.starts

    def prepare(self) -> None:
        """Start the process if that has not been done."""
        if self._process is not None or self._failed:
            return
        try:
            self._process = WorkerProcess("explorer", __name__, self._decider, high_water=HIGH_WATER)
        except OSError as error:
            self._failed = True
            log.warning("the explorer process cannot be started: %s", error)

    def ask(self, question: Question) -> None:
        """Pass on a question; it is dropped if the process cannot take it."""
        if self._process is not None:
            self._process.send(pickle.dumps((self._rig, question)))

    def collect(self, t: float) -> ExplorationAnswer | None:
        """The newest answer that has arrived."""
        del t  # an answer can be used as soon as it arrives
        newest: ExplorationAnswer | None = None
        if self._process is not None:
            for message in self._process.received():
                newest = pickle.loads(message)
        return newest

    def tend(self, t: float) -> None:
        """Restart the process at `t` (s) if it does not run; see `WorkerProcess.tend`."""
        if self._process is not None:
            self._process.tend(t)

    def close(self) -> None:
        """Stop the process."""
        if self._process is not None:
            self._process.close()


def serve(address: str, decider_name: str) -> None:
    """Main function of the process, endless: answer questions, skipping those that newer ones have superseded."""
    decider: ExplorationDecider | None = None
    with worker_socket(address, NICENESS) as socket:
        while True:
            message = socket.recv()
            if socket.poll(0):
                continue
            rig, question = pickle.loads(message)
            decider = decider or load_part(decider_name)(rig)
            socket.send(pickle.dumps(decider.answer(question)))
            release_memory()
