"""Run the smoother of a body between three palms in a separate process: see `daemon.smoothing`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, fields
from typing import Any

import numpy as np

from palmd.daemon.smoothing import BatchingProcess, rig_from_json, work
from palmd.events import Event
from palmd.system.three_palms import BodyAnswer, ThreePalmsRig
from palmd.three_palms_messages import answer_from_flat

PERIOD_S = 0.2  # polling interval for the end of an update
SWITCH_S = 5e-4  # thread switch interval: receiving events must not wait for an update
_NAMES = tuple(each.name for each in fields(BodyAnswer))


class BodySmootherProcess(BatchingProcess[BodyAnswer]):
    """The loop's side of the smoother's process; safe in the loop."""

    def __init__(self, rig: ThreePalmsRig) -> None:
        """Start the process; raises OSError if that fails."""
        super().__init__(__name__, asdict(rig), _answer_of)

    def submit(self, t: float, events: Sequence[Event]) -> None:
        """Send the tick's events."""
        self._hand_over(t, events)


def serve(address: str, rig: str) -> None:
    """Main function of the process, never returns; `rig`: the rig's fields as JSON. Updates run in a thread."""
    from palmd.observer.three_palms.incremental import IncrementalBodySmoother  # SciPy, in this process alone

    sys.setswitchinterval(SWITCH_S)
    smoother = IncrementalBodySmoother(rig_from_json(rig, ThreePalmsRig))
    pool = ThreadPoolExecutor(1)
    update: Future[BodyAnswer | None] | None = None

    def answer() -> list[Any] | None:
        nonlocal update
        answered = None
        if update is not None and not update.done():
            return None
        if update is not None:
            answered = update.result()
        update = pool.submit(smoother.answer)
        return None if answered is None else [_flat(getattr(answered, name)) for name in _NAMES]

    work(address, smoother.add, answer, lambda: PERIOD_S)


def _flat(value: Any) -> Any:
    return value.tobytes() if isinstance(value, np.ndarray) else value


def _answer_of(*values: Any) -> BodyAnswer:
    return answer_from_flat(
        **{
            name: np.frombuffer(value) if isinstance(value, bytes) else value
            for name, value in zip(_NAMES, values, strict=True)
        }
    )
