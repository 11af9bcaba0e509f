"""An exploration of the emulated tabletop rig (vibrating palms, calibrated) in which a wrong motion was followed."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
from stored_log import DATA, stored_log

from palmd.events import FloatArray, Improvement
from palmd.model import shape, shape_map
from palmd.observer.coverage import NORMAL_BINS
from palmd.observer.outline import gauge_free_sd
from palmd.observer.simulated_smoother import Simulated
from palmd.observer.smoothing import Session
from palmd.record.eventlog import EventLog
from palmd.score import score_outline

THETA: FloatArray = (np.arange(NORMAL_BINS) + 0.5) * (2 * np.pi / NORMAL_BINS)
NAME, SEED = "tabletop-exploration", 7807
LATENCY_S, TICK_S = 0.4, 0.01


def answers(log: EventLog) -> list[Improvement]:
    """The answers of the smoother beside the loop, which are there some time after they were asked for."""
    smoother, events, found = Simulated(log.rig, SEED, LATENCY_S), list(log.events), list[Improvement]()
    start, end = events[0].t_sample, events[-1].t_sample
    for t in np.arange(start, end, TICK_S):
        now = [event for event in events[:40] if event.t_sample <= t]
        del events[: len(now)]
        smoother.submit(t, Session(1, start), now)
        answer = smoother.collect(t)
        if isinstance(answer, Improvement):
            found.append(answer)
    return found


def in_sigmas(answer: Improvement, truth: FloatArray) -> float:
    """RMS error of the touched outline over the RMS of its 1σ."""
    outline = slice(shape_map.Z.SHAPE, len(answer.x))
    coefficients, spread = answer.x[outline], answer.spread[outline]
    covariance = answer.P[outline, outline] + spread @ spread.T
    order = (len(coefficients) - 1) // 2
    touched = THETA[answer.touched]
    score = score_outline(THETA, shape.basis(THETA, order) @ coefficients, answer.touched, truth)
    return score.e_h / math.sqrt(float(np.mean(gauge_free_sd(touched, touched, coefficients, covariance) ** 2)))


def test_a_wrong_turn_of_the_motion_is_not_followed(tmp_path: Path) -> None:
    """At 4.9 s the extended motion takes a wrong turn; that of filters that have read all readings does not."""
    log, truth = stored_log(NAME, tmp_path), np.array(json.loads((DATA / f"{NAME}.truth.json").read_text())["h_m"])
    found = answers(log)
    assert found[-1].established
    assert max(in_sigmas(answer, truth) for answer in found if answer.established) < 3.0
