"""The smoother of a body between three palms in a process of its own beside the loop: see `daemon.smoothing`."""

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
from palmd.three_palms_messages import shaped

PERIOD_S = 0.2  # of looking whether it has thought
SWITCH_S = 5e-4  # between its threads: what comes must not wait for what is thought
_NAMES = tuple(each.name for each in fields(BodyAnswer))


class BodySmootherProcess(BatchingProcess[BodyAnswer]):
    """Of a body between three palms; safe inside the loop."""

    def __init__(self, rig: ThreePalmsRig) -> None:
        """Start the process; raises OSError when it cannot be."""
        super().__init__(__name__, asdict(rig), _answer_of)

    def submit(self, t: float, events: Sequence[Event]) -> None:
        """Hand the tick's events over."""
        self._hand_over(t, events)


def serve(address: str, rig: str) -> None:
    """The process's work, for ever; `rig` is the rig's fields as JSON. A thread thinks while events go on to come."""
    from palmd.observer.three_palms.incremental import IncrementalBodySmoother  # SciPy, in this process alone

    sys.setswitchinterval(SWITCH_S)
    smoother = IncrementalBodySmoother(rig_from_json(rig, ThreePalmsRig))
    pool = ThreadPoolExecutor(1)
    thought: Future[BodyAnswer | None] | None = None

    def answer() -> list[Any] | None:
        nonlocal thought
        found = None
        if thought is not None and not thought.done():
            return None
        if thought is not None:
            found = thought.result()
        thought = pool.submit(smoother.answer)
        return None if found is None else [_flat(getattr(found, name)) for name in _NAMES]

    work(address, smoother.add, answer, lambda: PERIOD_S)


def _flat(value: Any) -> Any:
    return value.tobytes() if isinstance(value, np.ndarray) else value


def _answer_of(*told: Any) -> BodyAnswer:
    return shaped(
        **{
            name: np.frombuffer(value) if isinstance(value, bytes) else value
            for name, value in zip(_NAMES, told, strict=True)
        }
    )
