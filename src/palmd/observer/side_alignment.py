"""Relative orientation of contact-mode segments on different sides, from the corners that they share. Pure.

A segment determines how high the centre of mass is over a side, and where a corner is; another one determines that of
another side and another corner, in a frame of its own. Both belong to one outline where the corner of each ends the
side of the other (the object tipped from one palm to the other), where both touch with the same corner (it tipped on
its palm), or where both lie on the same side (the other palm came to another corner). Each case requires another turn
between the frames. Whether the object has turned so is decided by the readings in between (`bridged`).
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
from palmd.observer.mode_initialisation import outline_through
from palmd.observer.mode_segments import ModeSegment
from palmd.observer.normal_equations import Guess, Residuals
from palmd.observer.orientation_tracking import TRACKED_WIDTH, tracked_orientation
from palmd.observer.outline import normal_angles, wrapped
from palmd.observer.record import Record

NEAR_M = 2e-4  # tolerance of heights over the same side
NEAR_RHO_M = 5e-4  # tolerance of the radii of the same corner
SAME_SIDE_RAD = 0.05
STAYS_S = 0.1  # from one corner on the other palm to the next, while the object stays on its side: tipping takes longer
APART_M = 2e-3  # least distance of these corners
SEEN = (2.0, 98.0), 25  # percentiles of the normals by which a corner was touched; number of normals used between them
REACH = 8.0  # widths, from the middle of a side to its end
FINE_RAD = 1e-5  # of a normal, for difference quotients
# table of contacts about a side's normal: range (rad), concentration in the middle, number of entries
TABLE_RAD, TABLE_CONCENTRATION, TABLE_ENTRIES = 0.04, 6.0, 401
FOOT_SD_M = 2e-3  # 1σ of where along a side the centre of mass is
SEARCH_RANGE_RAD = 2.0  # range of ψ (rad) about where the object leaves a side
# largest error of ψ where the next segment begins: of an accepted bridge; of one that does not contradict it
ARRIVES_RAD, NEARLY_RAD = 0.05, 0.15
ON_SIDE_RAD = 0.02  # deviation of ψ (rad) up to which the object counts as still, or already, on its side
# residual of a missed reading in between; largest share of these, besides those during a jump
MISSED_M, MOST_MISSED = 1.2e-3, 0.1
JUMPS_S = 0.1  # in which one contact or both jump, as a side is passed
MEAN_OF = 5  # nodes of the moving average
H_SD_M, SLOPE_SD_M = 2e-5, 1e-4  # 1σ of h and h′ of the initial outline of two parts, about those of each part


@dataclass(frozen=True, slots=True)
class SideContact:
    """A side and the corner opposite, as segments on a palm (0, 1) determine them.

    normal (rad): of the side. height, foot (m): of the centre of mass over the side, and along it, against θ, from
    where the object stood. corner, radius (m): the corner's centre x + iy, and its radius. touched (rad): range of
    normals by which the corner was touched. segments: that determine it; none where it follows from others.
    """

    palm: int
    normal: float
    height: float
    foot: float
    corner: complex
    radius: float
    touched: tuple[float, float]
    segments: tuple[ModeSegment, ...] = ()

    def turned(self, turn: float) -> SideContact:
        """The same in a frame in which all normals are greater by `turn` (rad)."""
        first, last = self.touched
        touched = (first + turn, last + turn)
        return replace(self, normal=self.normal + turn, corner=self.corner * cmath.exp(1j * turn), touched=touched)

    def ends_side_of(self, side: SideContact) -> bool:
        """Whether the corner ends the side of `side`."""
        return abs(self.height_over(side.normal) - side.height) < NEAR_M

    def stays_with(self, other: SideContact) -> bool:
        """Whether the object stayed on its side while the other palm went from one corner to the other."""
        apart = (
            max(one.start, another.start) - min(one.end, another.end)
            for one in self.segments
            for another in other.segments
        )
        return self.palm == other.palm and any(each < STAYS_S for each in apart)

    def height_over(self, normal: float) -> float:
        """Height of the centre of mass over a side with this `normal` (rad) that the corner ends."""
        return float((self.corner * cmath.exp(-1j * normal)).real) + self.radius

    def normals_of_sides(self, height: float) -> list[float]:
        """Normals (rad) of the sides that the corner ends, with the centre of mass at this height (m) over them."""
        cosine = (height - self.radius) / abs(self.corner)
        if abs(cosine) > 1.0:
            return []
        half_angle, direction = math.acos(cosine), cmath.phase(self.corner)
        return [direction - half_angle, direction + half_angle]


def side_contact(record: Record, guess: Guess, palm: int, segments: Sequence[ModeSegment] = ()) -> SideContact:
    """The side and corner of a record during which the object lay on one side on `palm` (0, 1)."""
    p, normals = guess.p, normal_angles(record.palms, guess.x[:, 0])
    first, last = np.percentile(normals[:, 1 - palm], SEEN[0]).tolist()
    foot = float(np.median(slope_of(normals[:, palm], p)))
    return _with_fitted_corner(
        p, SideContact(palm, float(p[NORMALS]), 0.0, foot, 0j, 0.0, (first, last), tuple(segments))
    )


def updated_contact(p: FloatArray, sides: int, before: SideContact) -> SideContact:
    """The side contact `before` (in the frame of p), updated to the outline p with `sides` sides."""
    away = wrapped(p[NORMALS : NORMALS + sides] - before.normal)
    return _with_fitted_corner(p, replace(before, normal=before.normal + float(away[np.argmin(np.abs(away))])))


def _with_fitted_corner(p: FloatArray, of: SideContact) -> SideContact:
    """The side contact with its height and corner fitted to h on the normals by which it was touched."""
    normals = np.linspace(*of.touched, SEEN[1])
    rows = np.stack([np.cos(normals), np.sin(normals), np.ones_like(normals)], axis=1)
    x, y, radius = np.linalg.lstsq(rows, sharp.support(normals, p), rcond=None)[0].tolist()
    height = float(sharp.support(np.array([of.normal]), p)[0])
    return replace(of, height=height, corner=complex(x, y), radius=radius)


def side_between(one: SideContact, other: SideContact) -> tuple[SideContact, SideContact]:
    """The side from the corner of `one` to that of `other`, both in one frame, with each corner as its end.

    Its normal is the one at which both corners have the same support, next to where they were touched.
    """
    apart = other.corner - one.corner
    half_angle = math.acos(max(-1.0, min(1.0, (one.radius - other.radius) / abs(apart))))
    near = [
        (other_end + math.remainder(own_end - other_end, math.tau), other_end)
        for own_end in one.touched
        for other_end in other.touched
    ]
    own_end, other_end = min(near, key=lambda both: abs(both[0] - both[1]))
    middle = (own_end + other_end) / 2
    normals = (
        middle + math.remainder(cmath.phase(apart) + side - middle, math.tau) for side in (-half_angle, half_angle)
    )
    normal = min(normals, key=lambda each: abs(each - middle))
    foot = sum((each.corner * cmath.exp(-1j * normal)).imag for each in (one, other)) / 2
    height = (one.height_over(normal) + other.height_over(normal)) / 2
    contacts = (
        SideContact(1 - one.palm, normal, height, foot, each.corner, each.radius, each.touched) for each in (one, other)
    )
    first, last = contacts
    return first, last


def slope_of(normals: FloatArray, p: FloatArray) -> FloatArray:
    """h′ (m) on `normals` (rad), by differences that are small compared with the width of a side."""
    slope: FloatArray = (sharp.support(normals + FINE_RAD, p) - sharp.support(normals - FINE_RAD, p)) / (2 * FINE_RAD)
    return slope


def candidate_turns(one: SideContact, other: SideContact) -> list[float]:
    """Candidate turns (rad) of the normals of `other` into the frame of `one`."""
    pairs = (
        (end - other.normal, one.normal - other_turn)
        for end in one.normals_of_sides(other.height)
        for other_turn in other.normals_of_sides(one.height)
    )
    middles = (turn + 0.5 * math.remainder(other_turn - turn, math.tau) for turn, other_turn in pairs)
    candidates = [candidate for candidate in middles if _end_each_others_side(one, other.turned(candidate))]
    if abs(abs(one.corner) - abs(other.corner)) < NEAR_M and abs(one.radius - other.radius) < NEAR_RHO_M:
        candidates.append(cmath.phase(one.corner / other.corner))
    if abs(one.height - other.height) < NEAR_M:
        candidates.append(one.normal - other.normal)
    return [candidate for candidate in candidates if _convex(one, other, candidate)]


def _end_each_others_side(one: SideContact, other: SideContact) -> bool:
    """Whether the corner of each ends the side of the other."""
    return one.ends_side_of(other) and other.ends_side_of(one)


def _convex(one: SideContact, other: SideContact, turn: float) -> bool:
    """Whether neither corner is beyond the side of the other."""
    return (
        one.height_over(other.normal + turn) < other.height + NEAR_M
        and other.height_over(one.normal - turn) < one.height + NEAR_M
    )


def initial_outline(p: FloatArray, contacts: Sequence[SideContact], prior: Prior, sides: int) -> FloatArray:
    """The constants `p` with an outline through these sides and corners; a corner reaches to the sides that it ends.

    Normals and width of the sides are those of p.
    """
    reach = REACH * math.exp(p[WIDTH])
    normals = [np.array([each.normal]) for each in contacts]
    targets = [np.array([complex(each.height, each.foot)]) for each in contacts]
    sds = [np.array([[H_SD_M], [FOOT_SD_M]])] * len(contacts)
    for each in contacts:
        arcs = [each.touched, *(_arc(each, side.normal, reach) for side in contacts if each.ends_side_of(side))]
        for arc in arcs:
            arc_normals = np.linspace(*arc, SEEN[1])
            normals.append(arc_normals)
            targets.append(each.corner * np.exp(-1j * arc_normals) + each.radius)
            sds.append(np.tile([[H_SD_M], [SLOPE_SD_M]], SEEN[1]))
    values, (h_sd, slope_sd) = np.concatenate(targets), np.concatenate(sds, axis=1)
    return outline_through(p, np.concatenate(normals), (values.real, values.imag), (h_sd, slope_sd), prior, sides)


def _arc(corner: SideContact, normal: float, reach: float) -> tuple[float, float]:
    """From the end of a side with this normal (rad) to where the corner was touched."""
    ends = [normal + math.remainder(end - normal, math.tau) for end in corner.touched]
    nearer = min(ends, key=lambda end: abs(end - normal))
    return normal + math.copysign(reach, nearer - normal), nearer


def moved_to_outline(
    record: Record, x: FloatArray, own: FloatArray, p: FloatArray, sides: Sequence[float]
) -> FloatArray:
    """Nodes moved so that contacts stay at the same places on the `sides`, when outline `own` is replaced by `p`.

    sides: normals (rad), in both outlines.
    """
    moved = x.copy()
    normals = normal_angles(record.palms, x[:, 0])
    for normal in sides:
        table = normal + np.sinh(TABLE_CONCENTRATION * np.linspace(-1.0, 1.0, TABLE_ENTRIES)) * (
            TABLE_RAD / math.sinh(TABLE_CONCENTRATION)
        )
        slopes = np.maximum.accumulate(slope_of(table, p))
        for theta in normals.T:
            offset = wrapped(theta - normal)
            on = np.abs(offset) < TABLE_RAD / 2
            moved[on, 0] -= np.interp(slope_of(theta[on], own), slopes, table) - normal - offset[on]
    shift = moved[:, 0] - x[:, 0]
    for nodes in np.split(np.arange(len(x)), record.gap_steps + 1):
        moved[nodes, 1] += np.gradient(shift[nodes], record.t[nodes])
    return moved


def followed_motion(
    gap: Record, p: FloatArray, before: FloatArray, after: FloatArray, near: float
) -> FloatArray | None:
    """ψ (rad) at the nodes of `gap` from its readings, if it ends within `near` of `after`; else None.

    before, after: ψ if the object stayed on its first side, and if it were on the next one already.
    """
    psi = tracked_orientation(p, gap, 0, float(before[0]), SEARCH_RANGE_RAD)
    if abs(math.remainder(float(psi[-1] - after[-1]), math.tau)) > near:
        return None
    widened = p.copy()
    widened[WIDTH] = max(p[WIDTH], math.log(TRACKED_WIDTH))
    spin = np.gradient(psi, gap.t)
    residuals = Residuals(sharp.library_for(sharp.SIDES), gap).residuals(Guess(np.stack([psi, spin], axis=1), widened))
    most_missed = MOST_MISSED + JUMPS_S / float(gap.t[-1] - gap.t[0])
    if np.mean(np.abs(residuals) * np.sqrt(gap.contact_variance) > MISSED_M) > most_missed:
        return None
    return psi


def bridged(gap: Record, p: FloatArray, before: FloatArray, after: FloatArray) -> FloatArray | None:
    """ψ (rad) at the nodes of `gap` from its readings, if it leads from one segment to the next; else None.

    before, after: ψ if the object stayed on its first side, and if it were on the next one already.
    """
    psi = followed_motion(gap, p, before, after, ARRIVES_RAD)
    if psi is None:
        return None
    after = after + math.tau * round((psi[-1] - after[-1]) / math.tau)
    psi = np.convolve(np.pad(psi, MEAN_OF // 2, mode="edge"), np.full(MEAN_OF, 1.0 / MEAN_OF), "valid")
    on_side = np.abs(psi - before) < ON_SIDE_RAD
    leaves = len(psi) if on_side.all() else int(np.argmin(on_side))
    on_side = np.abs(psi - after)[::-1] < ON_SIDE_RAD
    arrives = 0 if on_side.all() else len(psi) - int(np.argmin(on_side))
    psi[arrives:] = after[arrives:]
    psi[:leaves] = before[:leaves]
    return psi


def supporting_palm(record: Record, guess: Guess, node: int, sides: int) -> int:
    """The palm (0, 1) that touches the object by the normal closest to that of a side."""
    normals = normal_angles(record.palms[node : node + 1], guess.x[node : node + 1, 0])[0]
    offset = wrapped(normals[:, None] - guess.p[NORMALS : NORMALS + sides])
    return int(np.argmin(np.abs(offset).min(axis=1)))
