"""Simulated bodies between three palms reconstructed blind, and scored against their truth."""

from __future__ import annotations

import math
import time
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from palmd.events import FloatArray
from palmd.jsonvalues import or_none
from palmd.model import rotation
from palmd.model.spherical import evaluator, order_of
from palmd.observer.three_palms.reconstruct import BodyReconstruction, reconstruct
from palmd.record.systems.three_palms import SYSTEM, laid_out
from palmd.rig.three_palms.simulate import SimulatedBody

NEAR_DEG = 4.0
RIGHT_M = 1.5e-4


@dataclass(frozen=True, slots=True)
class SpaceRow:
    """One run: whether it converged and was right, its errors (m), how they compare with the bands, and the time taken.

    error: RMS of h within `NEAR_DEG` of the contact curves after the best rotation; ratio: mean of (error/sd)² there.
    spin: the most that the body turned at (rad/s). seconds: of processor time.
    """

    kind: str
    seed: int
    body: int
    held: float
    spin: float
    converged: bool
    error: float
    ratio: float
    reason: str
    seconds: float

    @property
    def right(self) -> bool:
        """Whether it is within `RIGHT_M`."""
        return self.error < RIGHT_M

    def line(self) -> dict[str, Any]:
        """As JSON, None for what is not a number."""
        line: dict[str, Any] = or_none(asdict(self))
        return line


def reconstructed(run: SimulatedBody) -> SpaceRow:
    """The run's log reconstructed without its truth, and scored by it."""
    head, *lines = run.lines
    rig = SYSTEM.rig(head["rig"])
    events = tuple(event for line in lines for event in SYSTEM.events(line["t"], line, rig) if event is not None)
    path, readings = laid_out(SYSTEM.log(rig, events, ()))
    if path is None:
        raise ValueError("a simulated run has joints that report")
    begun = time.process_time()
    answer = reconstruct(path, readings, rig)
    seconds = time.process_time() - begun
    error, ratio = errors(answer, run.truth)
    truth = run.truth
    spin = float(np.linalg.norm(truth["omega_rad_s"], axis=1).max())
    said = answer.converged, error, ratio, answer.reason, seconds
    return SpaceRow(truth["kind"], truth["seed"], truth["body"], run.held, spin, *said)


def errors(answer: BodyReconstruction, truth: dict[str, Any]) -> tuple[float, float]:
    """(RMS error of h (m), mean of (error/sd)²) within `NEAR_DEG` of the contact curves, after the best rotation."""
    if answer.coefficients is None or answer.h_sd is None:
        return math.nan, math.nan
    rows = evaluator(order_of(len(answer.coefficients)))
    directions, height = np.array(truth["directions"]), np.array(truth["h_m"])
    lasted = np.array(truth["t"]) <= answer.t[-1]
    felt = np.array(truth["normals_body"])[lasted].reshape(-1, 3)
    near = _nearest(directions, felt) >= math.cos(math.radians(NEAR_DEG))
    begun: FloatArray = np.array(truth["rotation"])[np.searchsorted(truth["t"], answer.t[0] - 1e-9)]
    coefficients, true = answer.coefficients, height[near]

    def normals(turn: FloatArray) -> FloatArray:
        return np.asarray(directions[near] @ (rotation.exp(turn) @ begun).T, np.float64)

    def off_um(turn: FloatArray) -> FloatArray:
        return np.asarray(1e6 * (rows(normals(turn))[0] @ coefficients - true), np.float64)

    # steps that are not damped may lead away where little was touched
    turn = least_squares(off_um, np.zeros(3), method="lm").x
    u, off = normals(turn), 1e-6 * off_um(turn)
    sd = answer.h_sd[(u @ answer.directions.T).argmax(axis=1)]
    return float(np.sqrt(np.mean(off**2))), float(np.mean((off / sd) ** 2))


def _nearest(directions: FloatArray, felt: FloatArray) -> FloatArray:
    """(D,) cosine of the angle from each direction to the nearest contact normal."""
    best = np.full(len(directions), -1.0)
    for part in np.array_split(felt, max(len(felt) // 500, 1)):
        best = np.maximum(best, (directions @ part.T).max(axis=1))
    return best


def report(rows: list[SpaceRow]) -> str:
    """The table, a line for each kind."""
    lines = [f"{'kind':10}{'runs':>5}{'claimed':>9}{'right':>7}{'wrong':>7}{'median µm':>11}{'(e/sd)²':>9}{'cpu s':>7}"]
    for kind in dict.fromkeys(row.kind for row in rows):
        mine = [row for row in rows if row.kind == kind]
        claimed = [row for row in mine if row.converged]
        right = [row for row in claimed if row.right]
        median = 1e6 * float(np.median([row.error for row in claimed])) if claimed else math.nan
        ratio = float(np.mean([row.ratio for row in claimed])) if claimed else math.nan
        cpu = float(np.median([row.seconds for row in mine]))
        lines.append(
            f"{kind:10}{len(mine):5}{len(claimed):9}{len(right):7}{len(claimed) - len(right):7}"
            f"{median:11.1f}{ratio:9.2f}{cpu:7.1f}"
        )
    return "\n".join(lines)
