"""No numerical failure ends a reconstruction or a smoother: corrupt but valid readings are rejected with a reason."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from simulated import simulated

from palmd.events import Event, Improvement, PadSample, PalmSample, Unexplained
from palmd.observer import incremental, reconstruct
from palmd.observer.incremental import IncrementalSmoother
from palmd.observer.smoothing import Session

SECONDS = 3.0


def _pads(change: Callable[[PadSample, int], PadSample]) -> tuple[Event, ...]:
    events = simulated("nominal", 3, SECONDS).events
    return tuple(change(e, i) if isinstance(e, PadSample) else e for i, e in enumerate(events))


CORRUPT = {
    "constant": lambda e, _: replace(e, s=0.02),
    "no force": lambda e, _: replace(e, force=0.0),
    "one time": lambda e, _: replace(e, t_sample=round(e.t_sample, 1)),
    "huge": lambda e, i: replace(e, s=1e6 if i % 7 == 0 else e.s, force=1e12),
    "tiny": lambda e, _: replace(e, s=1e-12, force=1e-300),
}


def _answers(events: tuple[Event, ...]) -> list[Improvement | Unexplained | None]:
    smoother = IncrementalSmoother(simulated("nominal", 3, SECONDS).rig)
    begun = min(e.t_sample for e in events if isinstance(e, PadSample))
    answers = []
    for since in np.arange(0.0, SECONDS, 0.5):
        some = [e for e in events if since <= e.t_sample < since + 0.5]
        smoother.add(Session(1, begun), some)
        answers.append(smoother.result())
    return answers


@pytest.mark.nightly
@pytest.mark.parametrize("how", CORRUPT)
def test_corrupt_readings_are_rejected_with_a_reason(how: str) -> None:
    events = _pads(CORRUPT[how])
    assert all(isinstance(e, PadSample | PalmSample) for e in events)
    answers = reconstruct.reconstruct(events, simulated("nominal", 3, SECONDS).rig)
    assert answers.converged or answers.reason
    _answers(events)


def _fails(*_: object, **__: object) -> None:
    raise np.linalg.LinAlgError("Matrix is not positive definite")


def test_a_failed_factorisation_is_reported_as_unexplained(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(incremental.Initialiser, "search", _fails)
    answers = _answers(simulated("nominal", 3, SECONDS).events)
    assert any(isinstance(each, Unexplained) for each in answers)
