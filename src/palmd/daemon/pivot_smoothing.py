"""Run the smoother of a pivoting grasp in a separate process: see `daemon.smoothing`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from palmd.daemon.smoothing import BatchingProcess, rig_from_json, work
from palmd.events import Event
from palmd.system.pivot import PivotAnswer, PivotRig


class PivotSmootherProcess(BatchingProcess[PivotAnswer]):
    """The loop's side of the smoother's process; safe in the loop."""

    def __init__(self, rig: PivotRig) -> None:
        """Start the process; raises OSError if that fails."""
        super().__init__(__name__, asdict(rig), _answer_of)

    def submit(self, t: float, events: Sequence[Event]) -> None:
        """Send the tick's events."""
        self._hand_over(t, events)


def serve(address: str, rig: str) -> None:
    """Main function of the process, never returns; `rig`: the rig's fields as JSON."""
    from palmd.observer.pivot.incremental import PERIOD_S, IncrementalPivotSmoother  # SciPy, in this process alone

    smoother = IncrementalPivotSmoother(rig_from_json(rig, PivotRig))

    def answer() -> list[Any] | None:
        a = smoother.answer()
        if a is None:
            return None
        return [a.t, a.accepted, a.reason, a.psi, *(each.tobytes() for each in (a.p, a.covariance, a.h_sd, a.touched))]

    work(address, smoother.add, answer, lambda: PERIOD_S)


def _answer_of(t: float, accepted: bool, reason: str, psi: float, *arrays: bytes) -> PivotAnswer:
    p, covariance, h_sd, touched = map(np.frombuffer, arrays)
    return PivotAnswer(t, accepted, reason, psi, p, covariance.reshape(len(p), len(p)), h_sd, touched)
