"""How rides on different sides lie to one another: by the corners that they share. Pure.

A ride tells how high the centre of mass is over a side, and where a corner is; another tells of another side and
another corner, in a frame of its own. Both are one outline where the corner of either ends the side of the other
(the object tipped from one palm to the other), where both touch with the same corner (it tipped on its palm), or where
both lie on the same side (the other palm came to another corner). Each asks for one turn between the frames and is
contradicted by all others; whether the object has turned so is told by the readings in between (`bridged`).
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from palmd.events import FloatArray
from palmd.model import sharp
from palmd.model.sharp import NORMALS, WIDTH
from palmd.observer.factor import Prior
from palmd.observer.followed import FOLLOW_WIDTH, followed
from palmd.observer.normal_equations import Guess, Residuals
from palmd.observer.outline import directions, normal_angles, touched_within
from palmd.observer.record import Record
from palmd.observer.ridden import STEP_RAD, outline_through

NEAR_M = 1.5e-4  # of heights over a side that are to be the same
NEAR_RHO_M = 5e-4  # of the radii of a corner that is to be the same
SAME_SIDE_RAD = 0.05
SEEN = (2.0, 98.0), 25  # percentiles of the normals by which a corner was felt, and how many are looked at
ABOUT = np.array([-8.0, -4.0, 0.0, 4.0, 8.0])  # widths of a side, about its normal
ROAMS = 2.0  # of ψ (rad), how far about where the object leaves a side
ARRIVES_RAD = 0.05  # of ψ, where it lies again
RIDES_RAD = 0.02
MISSED_M, MOST_MISSED = 1.2e-3, 0.1  # of readings in between, and their share
MEAN_OF = 5  # nodes
H_SD_M, SLOPE_SD_M = 2e-5, 1e-4  # by which the outline of two parts may not be that of each, at first


@dataclass(frozen=True, slots=True)
class Footing:
    """A side and the corner opposite, as a ride tells them: normal (rad), height (m); centre and radius (m)."""

    palm: int
    normal: float
    high: float
    corner: complex
    radius: float

    def turned(self, turn: float) -> Footing:
        """The same in a frame in which all normals are greater by `turn` (rad)."""
        return replace(self, normal=self.normal + turn, corner=self.corner * cmath.exp(1j * turn))

    def over(self, normal: float) -> float:
        """How high the centre of mass is over a side of this `normal` (rad) that the corner ends."""
        return float((self.corner * cmath.exp(-1j * normal)).real) + self.radius

    def ends(self, high: float) -> list[float]:
        """Normals (rad) of the sides, the centre of mass so `high` over them (m), that the corner ends."""
        share = (high - self.radius) / abs(self.corner)
        if abs(share) > 1.0:
            return []
        away, at = math.acos(share), cmath.phase(self.corner)
        return [at - away, at + away]


def footing(record: Record, guess: Guess, palm: int) -> Footing:
    """Of what has ridden on one side on `palm` (0, 1) all the time."""
    p = guess.p
    low, high = np.percentile(normal_angles(record.palms, guess.x[:, 0])[:, 1 - palm], SEEN[0])
    felt = np.linspace(low, high, SEEN[1])
    rows = np.stack([np.cos(felt), np.sin(felt), np.ones_like(felt)], axis=1)
    x, y, radius = np.linalg.lstsq(rows, sharp.support(felt, p), rcond=None)[0].tolist()
    normal = float(p[NORMALS])
    return Footing(palm, normal, float(sharp.support(p[NORMALS : NORMALS + 1], p)[0]), complex(x, y), radius)


def turns(one: Footing, other: Footing) -> list[float]:
    """By how much (rad) the normals of `other` may be turned to be in the frame of `one`."""
    asked = [
        _middle(end - other.normal, one.normal - back)
        for end in one.ends(other.high)
        for back in other.ends(one.high)
        if abs(math.remainder(end - other.normal - one.normal + back, math.tau)) < SAME_SIDE_RAD
    ]
    if abs(abs(one.corner) - abs(other.corner)) < NEAR_M and abs(one.radius - other.radius) < NEAR_RHO_M:
        asked.append(cmath.phase(one.corner / other.corner))
    if abs(one.high - other.high) < NEAR_M:
        asked.append(one.normal - other.normal)
    return [turn for turn in asked if _convex(one, other, turn)]


def felt_by(record: Record, guess: Guess, sides: int) -> tuple[FloatArray, FloatArray]:
    """The normals (rad) by which the object was felt, and those about its sides; and the constants."""
    p = guess.p
    about = (p[NORMALS : NORMALS + sides, None] + math.exp(p[WIDTH]) * ABOUT).ravel()
    return np.concatenate([directions()[touched_within(record, guess.x[:, 0])], about]), p


def _middle(one: float, other: float) -> float:
    return one + 0.5 * math.remainder(other - one, math.tau)


def _convex(one: Footing, other: Footing, turn: float) -> bool:
    """Whether neither corner is beyond the side of the other."""
    return one.over(other.normal + turn) < other.high + NEAR_M and other.over(one.normal - turn) < one.high + NEAR_M


def outlines_together(
    p: FloatArray, parts: Sequence[tuple[FloatArray, FloatArray]], prior: Prior, sides: int
) -> FloatArray:
    """The constants `p`, their outline being each of `parts` on its normals, as far as it can.

    parts: normals (rad) and constants, in one frame. Sides are where p has them, and as wide.
    """
    h, slope = list[FloatArray](), list[FloatArray]()
    for normals, own in parts:
        own = own.copy()
        own[WIDTH] = p[WIDTH]
        here, after, before = (sharp.support(normals + by, own) for by in (0.0, STEP_RAD, -STEP_RAD))
        h.append(here)
        slope.append((after - before) / (2 * STEP_RAD))
    normals = np.concatenate([each for each, _ in parts])
    sd = np.full(len(normals), H_SD_M), np.full(len(normals), SLOPE_SD_M)
    return outline_through(p, normals, (np.concatenate(h), np.concatenate(slope)), sd, prior, sides)


def bridged(gap: Record, p: FloatArray, before: FloatArray, after: FloatArray) -> FloatArray | None:
    """ψ (rad) at the nodes of `gap` by its readings, if these lead from one ride to the next; else None.

    before, after: ψ there, had the object ridden on, or before already.
    """
    psi = followed(p, gap, 0, float(before[0]), ROAMS)
    after = after + math.tau * round((psi[-1] - after[-1]) / math.tau)
    if abs(psi[-1] - after[-1]) > ARRIVES_RAD:
        return None
    wide = p.copy()
    wide[WIDTH] = max(p[WIDTH], math.log(FOLLOW_WIDTH))
    spin = np.gradient(psi, gap.t)
    missed = Residuals(sharp.library_for(sharp.SIDES), gap).contacts(Guess(np.stack([psi, spin], axis=1), wide))
    if np.mean(np.abs(missed) * np.sqrt(gap.contact_variance) > MISSED_M) > MOST_MISSED:
        return None
    psi = np.convolve(np.pad(psi, MEAN_OF // 2, mode="edge"), np.full(MEAN_OF, 1.0 / MEAN_OF), "valid")
    rides = np.abs(psi - before) < RIDES_RAD
    leaves = len(psi) if rides.all() else int(np.argmin(rides))
    rides = np.abs(psi - after)[::-1] < RIDES_RAD
    lies = 0 if rides.all() else len(psi) - int(np.argmin(rides))
    psi[lies:] = after[lies:]
    psi[:leaves] = before[:leaves]
    return psi


def ridden_at(record: Record, guess: Guess, node: int, sides: int) -> int:
    """The palm (0, 1) that feels the object by the normal next to that of a side."""
    normals = normal_angles(record.palms[node : node + 1], guess.x[node : node + 1, 0])[0]
    away = normals[:, None] - guess.p[NORMALS : NORMALS + sides]
    return int(np.argmin(np.abs(away - math.tau * np.round(away / math.tau)).min(axis=1)))
