"""Libraries of similar outlines, and runs with one of the bodies on the palms, for tests of recognition."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from similar_outlines import as_stored, similar_bodies

from palmd.outlinefile import Outline
from palmd.record.eventlog import EventLog
from palmd.rig.shapes import Body
from palmd.score import score_outline
from tools.studies.simulated import simulated

THETA = np.arange(360) * (2 * np.pi / 360)


@dataclass(frozen=True)
class Run:
    log: EventLog
    t: np.ndarray
    truth: dict
    psi: np.ndarray  # in the stored outline's own frame


@cache
def library(kind: str, seed: int, count: int) -> tuple[tuple[Body, ...], tuple[Outline, ...]]:
    random = np.random.default_rng([seed, 1])
    bodies = tuple(similar_bodies(kind, count, random))
    return bodies, tuple(as_stored(body, f"body {i}", random) for i, body in enumerate(bodies))


@cache
def run_with(body: Body, kind: str, seed: int, seconds: float) -> Run:
    log, truth = simulated(kind, seed, seconds, body)
    everywhere = np.ones(len(THETA), dtype=bool)
    turn = score_outline(THETA, body.support.sample(THETA), everywhere, np.array(truth["h_m"])).rotation
    return Run(log, np.array(truth["t"]), truth, np.array(truth["psi_rad"]) + turn)


def angle(difference: np.ndarray) -> np.ndarray:
    return np.angle(np.exp(1j * np.asarray(difference)))
