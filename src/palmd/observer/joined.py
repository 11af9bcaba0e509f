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
from palmd.observer.outline import normal_angles, wrapped
from palmd.observer.record import Record
from palmd.observer.ridden import outline_through
from palmd.observer.rides import Ride

NEAR_M = 2e-4  # of heights over a side that are to be the same
NEAR_RHO_M = 5e-4  # of the radii of a corner that is to be the same
SAME_SIDE_RAD = 0.05
STAYS_S = 0.1  # from one corner of the other palm to the next: to tip takes longer
APART_M = 2e-3  # of these corners, at least
SEEN = (2.0, 98.0), 25  # percentiles of the normals by which a corner was felt, and how many are looked at
REACH = 8.0  # widths from the middle of a side to its end
FINE_RAD = 1e-5  # of a normal, for slopes
SEAT_RAD, SEAT, SEATS = 0.04, 6.0, 401  # about a side's normal, where contacts are looked for, closer in the middle
FOOT_SD_M = 2e-3
ROAMS = 2.0  # of ψ (rad), how far about where the object leaves a side
ARRIVES_RAD, NEARLY_RAD = 0.05, 0.15  # of ψ, where it lies again; where it does not contradict that
RIDES_RAD = 0.02
MISSED_M, MOST_MISSED = 1.2e-3, 0.1  # of readings in between, and their share besides those
JUMPS_S = 0.1  # in which a contact jumps, or both, as a side is passed
MEAN_OF = 5  # nodes
H_SD_M, SLOPE_SD_M = 2e-5, 1e-4  # by which the outline of two parts may not be that of each, at first


@dataclass(frozen=True, slots=True)
class Footing:
    """A side and the corner opposite, as rides on a palm (0, 1) tell them.

    normal (rad) of the side, how high the centre of mass is over it and how far along it, and against θ, from where the
    object stood (m); the corner's centre and radius (m), and from which normal to which it was felt (rad). rides: which
    tell so, none where it follows from others.
    """

    palm: int
    normal: float
    high: float
    foot: float
    corner: complex
    radius: float
    felt: tuple[float, float]
    rides: tuple[Ride, ...] = ()

    def turned(self, turn: float) -> Footing:
        """The same in a frame in which all normals are greater by `turn` (rad)."""
        low, high = self.felt
        felt = (low + turn, high + turn)
        return replace(self, normal=self.normal + turn, corner=self.corner * cmath.exp(1j * turn), felt=felt)

    def reaches(self, side: Footing) -> bool:
        """Whether the corner ends the side of `side`."""
        return abs(self.over(side.normal) - side.high) < NEAR_M

    def stays(self, other: Footing) -> bool:
        """Whether the object lay on as the other palm came from one corner to the other, as it does between sides."""
        apart = (
            max(one.start, another.start) - min(one.end, another.end) for one in self.rides for another in other.rides
        )
        return self.palm == other.palm and any(each < STAYS_S for each in apart)

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


def footing(record: Record, guess: Guess, palm: int, rides: Sequence[Ride] = ()) -> Footing:
    """Of what has ridden on one side on `palm` (0, 1) all the time."""
    p, normals = guess.p, normal_angles(record.palms, guess.x[:, 0])
    low, high = np.percentile(normals[:, 1 - palm], SEEN[0]).tolist()
    foot = float(np.median(slope_of(normals[:, palm], p)))
    return _read(p, Footing(palm, float(p[NORMALS]), 0.0, foot, 0j, 0.0, (low, high), tuple(rides)))


def told_by(p: FloatArray, sides: int, before: Footing) -> Footing:
    """The same as an outline of so many `sides` has it, `before` in its frame."""
    away = wrapped(p[NORMALS : NORMALS + sides] - before.normal)
    return _read(p, replace(before, normal=before.normal + float(away[np.argmin(np.abs(away))])))


def _read(p: FloatArray, of: Footing) -> Footing:
    """How high the side is, and the corner, by h on the normals by which it was felt."""
    felt = np.linspace(*of.felt, SEEN[1])
    rows = np.stack([np.cos(felt), np.sin(felt), np.ones_like(felt)], axis=1)
    x, y, radius = np.linalg.lstsq(rows, sharp.support(felt, p), rcond=None)[0].tolist()
    over = float(sharp.support(np.array([of.normal]), p)[0])
    return replace(of, high=over, corner=complex(x, y), radius=radius)


def side_between(one: Footing, other: Footing) -> tuple[Footing, Footing]:
    """The side from the corner of `one` to that of `other`, both in one frame, and either as the corner that ends it.

    Its normal is that by which both corners reach as far out, next to where they were felt.
    """
    apart = other.corner - one.corner
    away = math.acos(max(-1.0, min(1.0, (one.radius - other.radius) / abs(apart))))
    near = [(theirs + math.remainder(mine - theirs, math.tau), theirs) for mine in one.felt for theirs in other.felt]
    mine, theirs = min(near, key=lambda both: abs(both[0] - both[1]))
    middle = (mine + theirs) / 2
    normals = (middle + math.remainder(cmath.phase(apart) + way - middle, math.tau) for way in (-away, away))
    normal = min(normals, key=lambda each: abs(each - middle))
    foot = sum((each.corner * cmath.exp(-1j * normal)).imag for each in (one, other)) / 2
    high = (one.over(normal) + other.over(normal)) / 2
    ends = (Footing(1 - one.palm, normal, high, foot, each.corner, each.radius, each.felt) for each in (one, other))
    first, last = ends
    return first, last


def slope_of(normals: FloatArray, p: FloatArray) -> FloatArray:
    """h′ (m) on `normals` (rad), by differences that are small beside the width of a side."""
    slope: FloatArray = (sharp.support(normals + FINE_RAD, p) - sharp.support(normals - FINE_RAD, p)) / (2 * FINE_RAD)
    return slope


def turns(one: Footing, other: Footing) -> list[float]:
    """By how much (rad) the normals of `other` may be turned to be in the frame of `one`."""
    ways = ((end - other.normal, one.normal - back) for end in one.ends(other.high) for back in other.ends(one.high))
    middles = (way + 0.5 * math.remainder(back - way, math.tau) for way, back in ways)
    asked = [turn for turn in middles if _cross(one, other.turned(turn))]
    if abs(abs(one.corner) - abs(other.corner)) < NEAR_M and abs(one.radius - other.radius) < NEAR_RHO_M:
        asked.append(cmath.phase(one.corner / other.corner))
    if abs(one.high - other.high) < NEAR_M:
        asked.append(one.normal - other.normal)
    return [turn for turn in asked if _convex(one, other, turn)]


def _cross(one: Footing, other: Footing) -> bool:
    """Whether the corner of either ends the side of the other."""
    return one.reaches(other) and other.reaches(one)


def _convex(one: Footing, other: Footing, turn: float) -> bool:
    """Whether neither corner is beyond the side of the other."""
    return one.over(other.normal + turn) < other.high + NEAR_M and other.over(one.normal - turn) < one.high + NEAR_M


def sketched(p: FloatArray, footings: Sequence[Footing], prior: Prior, sides: int) -> FloatArray:
    """The constants `p` with an outline of these sides and corners; a corner reaches to the sides that it ends.

    Sides are where p has them, and as wide.
    """
    reach = REACH * math.exp(p[WIDTH])
    normals = [np.array([each.normal]) for each in footings]
    wanted = [np.array([complex(each.high, each.foot)]) for each in footings]
    sd = [np.array([[H_SD_M], [FOOT_SD_M]])] * len(footings)
    for each in footings:
        arcs = [each.felt, *(_arc(each, side.normal, reach) for side in footings if each.reaches(side))]
        for arc in arcs:
            along = np.linspace(*arc, SEEN[1])
            normals.append(along)
            wanted.append(each.corner * np.exp(-1j * along) + each.radius)
            sd.append(np.tile([[H_SD_M], [SLOPE_SD_M]], SEEN[1]))
    values, (h_sd, slope_sd) = np.concatenate(wanted), np.concatenate(sd, axis=1)
    return outline_through(p, np.concatenate(normals), (values.real, values.imag), (h_sd, slope_sd), prior, sides)


def _arc(corner: Footing, normal: float, reach: float) -> tuple[float, float]:
    """From the end of a side of this normal (rad) to where the corner was felt."""
    ends = [normal + math.remainder(end - normal, math.tau) for end in corner.felt]
    nearer = min(ends, key=lambda end: abs(end - normal))
    return normal + math.copysign(reach, nearer - normal), nearer


def seated(record: Record, x: FloatArray, own: FloatArray, p: FloatArray, sides: Sequence[float]) -> FloatArray:
    """Nodes with the contacts where they are on outline `own`, on those sides of outline `p` that have these normals.

    Normals in rad, of both.
    """
    moved = x.copy()
    normals = normal_angles(record.palms, x[:, 0])
    for normal in sides:
        near = normal + np.sinh(SEAT * np.linspace(-1.0, 1.0, SEATS)) * (SEAT_RAD / math.sinh(SEAT))
        slopes = np.maximum.accumulate(slope_of(near, p))
        for theta in normals.T:
            away = wrapped(theta - normal)
            on = np.abs(away) < SEAT_RAD / 2
            moved[on, 0] -= np.interp(slope_of(theta[on], own), slopes, near) - normal - away[on]
    shift = moved[:, 0] - x[:, 0]
    for nodes in np.split(np.arange(len(x)), record.torn + 1):
        moved[nodes, 1] += np.gradient(shift[nodes], record.t[nodes])
    return moved


def led(gap: Record, p: FloatArray, before: FloatArray, after: FloatArray, near: float) -> FloatArray | None:
    """ψ (rad) at the nodes of `gap` by its readings, if these lead next to where it lies after, by `near`; else None.

    before, after: ψ there, had the object ridden on, or before already.
    """
    psi = followed(p, gap, 0, float(before[0]), ROAMS)
    if abs(math.remainder(float(psi[-1] - after[-1]), math.tau)) > near:
        return None
    wide = p.copy()
    wide[WIDTH] = max(p[WIDTH], math.log(FOLLOW_WIDTH))
    spin = np.gradient(psi, gap.t)
    missed = Residuals(sharp.library_for(sharp.SIDES), gap).contacts(Guess(np.stack([psi, spin], axis=1), wide))
    most = MOST_MISSED + JUMPS_S / float(gap.t[-1] - gap.t[0])
    if np.mean(np.abs(missed) * np.sqrt(gap.contact_variance) > MISSED_M) > most:
        return None
    return psi


def bridged(gap: Record, p: FloatArray, before: FloatArray, after: FloatArray) -> FloatArray | None:
    """ψ (rad) at the nodes of `gap` by its readings, if these lead from one ride to the next; else None.

    before, after: ψ there, had the object ridden on, or before already.
    """
    psi = led(gap, p, before, after, ARRIVES_RAD)
    if psi is None:
        return None
    after = after + math.tau * round((psi[-1] - after[-1]) / math.tau)
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
    away = wrapped(normals[:, None] - guess.p[NORMALS : NORMALS + sides])
    return int(np.argmin(np.abs(away).min(axis=1)))
