"""Limits of the palms' motion: angles, rates, accelerations, the arm's workspace, contacts on the pads.

A limit is a `QuantityLimit` on one quantity of a motion and words its own violation, so that plan checks, the last
guard before a set-point and messages to the operator use the same numbers.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import ClassVar

from palmd.config.two_palms import LimitsConfig
from palmd.events import Joints, PalmMotion
from palmd.motion.kinematics import RigGeometry
from palmd.system.arcs import FLAT, opening_at
from palmd.system.mechanism import JOINTS, OPENING, PALMS, directions
from palmd.systems import TWO_PALMS

PHI12_MAX = math.radians(172.0)  # two contacts need φ12 < 180°; φ12 must stay below this
SMALL_RADIUS = 0.010  # m, radius of the smallest object that must touch within the pads
PAD_MARGIN = 0.002  # m
HELD_SHARE = 0.3  # of a concave palm's pad, from the hinge: the objects it is made for touch it farther out
_DEGREES = math.degrees(1.0)
_ROUNDING = 1e-9
_STOP_SHARE = 0.9  # of the arm's acceleration that a stop uses; set-points are discrete in time
_BELOW = 3e-9  # turns "must stay below" into an inclusive bound


@dataclass(frozen=True, slots=True)
class QuantityLimit:
    """The limits of one quantity (SI) and the words for messages about it.

    order: 0 for a pose, 1 for a rate, 2 for an acceleration. gain: largest change of the quantity when both palm
    angles (or their rates, or accelerations) change by one. unit, scale: of messages.
    """

    what: str
    unit: str
    scale: float
    low: float
    high: float
    order: int = 0
    gain: float = 1.0
    low_words: str = "the limit is"
    high_words: str = "the limit is"

    def problem(self, lowest: float, highest: float) -> str | None:
        """Return the violation by a quantity that ranges from `lowest` to `highest`, as text; None if within limits."""
        if self.order > 0:  # symmetric limit: only the magnitude matters
            lowest, highest = self.low, max(-lowest, highest)
        if not highest <= self.high + _ROUNDING:
            return self._words("reaches", highest, self.high_words, self.high)
        if not lowest >= self.low - _ROUNDING:
            return self._words("falls to", lowest, self.low_words, self.low)
        return None

    def _words(self, verb: str, value: float, limit_words: str, limit: float) -> str:
        value, limit = value * self.scale, limit * self.scale
        return f"{self.what} {verb} {value:.6g}{self.unit}, {limit_words} {limit:.6g}{self.unit}"


@dataclass(frozen=True, slots=True)
class Workspace:
    """Workspace, speed and acceleration of the arm, as reported in its handshake (m, m/s, m/s², arm coordinates)."""

    geometry: RigGeometry
    x_min: float
    x_max: float
    y_min: float
    y_max: float
    speed: float
    acceleration: float

    def bounds(self) -> tuple[QuantityLimit, ...]:
        """Return the limits of the quantities of `values`, in the same order."""
        gain = sum(turning * length for turning, length in enumerate(self.geometry.palm_lengths, 1))
        return (
            QuantityLimit("the arm's x", " mm", 1e3, self.x_min, self.x_max, 0, gain),
            QuantityLimit("the arm's y", " mm", 1e3, self.y_min, self.y_max, 0, gain),
            QuantityLimit("the arm's speed", " mm/s", 1e3, 0.0, self.speed, 1, gain),
            QuantityLimit("the arm's acceleration", " mm/s²", 1e3, 0.0, self.acceleration, 2, gain),
        )

    def values(self, motion: PalmMotion) -> tuple[float, ...]:
        """Return position, speed and acceleration of the arm; raises PoseError at a singular pose."""
        x, y, _ = self.geometry.arm_pose(motion.angles)
        return (x, y, *self.geometry.tip_speed_acceleration(motion))

    def hardest_slowing(self, planned: PalmMotion, speed: float) -> float:
        """`MotionLimits.hardest_slowing` by the tip's acceleration only; 0 if its limit leaves no room."""

        def squared(slowing: float) -> float:
            each = zip(planned.rates, planned.accelerations, strict=True)
            rates = tuple(omega * speed for omega in planned.rates)
            slowed = tuple(alpha * speed**2 - omega * slowing for omega, alpha in each)
            return self.geometry.tip_speed_acceleration(PalmMotion(planned.angles, rates, slowed))[1] ** 2

        at_zero, below, above = squared(0.0), squared(-1.0), squared(1.0)
        a, b, c = (
            0.5 * (above + below) - at_zero,
            0.5 * (above - below),
            at_zero - (_STOP_SHARE * self.acceleration) ** 2,
        )
        if a <= 0.0:
            return math.inf  # the tip does not move with the path
        discriminant = b * b - 4.0 * a * c
        return max((-b + math.sqrt(discriminant)) / (2.0 * a), 0.0) if discriminant > 0.0 else 0.0


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """All limits of the palms' motion (rad, rad/s, rad/s², m); rate and acceleration hold for each angle.

    angles: range of each joint. pad_length: distance from the hinge up to which a pad senses contacts. pad_forces:
    largest force on each pad (N); empty: no limit. workspace: None until the arm has reported it. stop_deceleration: of
    each angle when the motion is held; None: as much as the arm allows.
    """

    system: ClassVar[str] = TWO_PALMS
    """The system they belong to (`palmd.systems`)."""

    angles: tuple[tuple[float, float], ...]
    rate: float
    acceleration: float
    pad_length: float
    workspace: Workspace | None = None
    curvatures: tuple[float, ...] = FLAT
    stop_deceleration: float | None = None
    pad_forces: tuple[float, ...] = ()
    bounds: tuple[QuantityLimit, ...] = field(init=False)

    def __post_init__(self) -> None:
        bounds = [QuantityLimit(joint, "°", _DEGREES, *ends) for joint, ends in zip(JOINTS, self.angles, strict=True)]
        bounds[0] = self._first_bound()
        bounds[OPENING] = self._opening_bound()
        bounds.append(
            QuantityLimit(
                f"phi12 = {' + '.join(JOINTS)}",
                "°",
                _DEGREES,
                0.0,
                self.top - _BELOW,
                gain=2.0,
                high_words="it must stay below",
            )
        )
        for order, kind, unit, most in (
            (1, "rate", "°/s", self.rate),
            (2, "acceleration", "°/s²", self.acceleration),
        ):
            bounds += [QuantityLimit(f"the {kind} of {joint}", unit, _DEGREES, -most, most, order) for joint in JOINTS]
        if self.workspace is not None:
            bounds += self.workspace.bounds()
        object.__setattr__(self, "bounds", tuple(bounds))

    @classmethod
    def from_config(
        cls,
        limits: LimitsConfig,
        *,
        pad_length: float,
        workspace: Workspace | None = None,
        curvatures: tuple[float, ...] = FLAT,
        pad_forces: tuple[float, ...] = (),
    ) -> MotionLimits:
        """Return the configured limits in SI; pad_length in m, the palms' `curvatures` in 1/m, `pad_forces` in N."""
        stop = limits.stop_deceleration_deg_s2
        return cls(
            angles=tuple((math.radians(low), math.radians(high)) for low, high in limits.angles_deg),
            rate=math.radians(limits.rate_deg_s),
            acceleration=math.radians(limits.acceleration_deg_s2),
            pad_length=pad_length,
            workspace=workspace,
            curvatures=curvatures,
            stop_deceleration=None if stop is None else math.radians(stop),
            pad_forces=pad_forces,
        )

    @property
    def top(self) -> float:
        """Upper bound of φ12 (rad): palm 2's tangent stays below 172° wherever it may be touched."""
        return PHI12_MAX + self._turned(self.curvatures[-1])

    def _turned(self, kappa: float) -> float:
        """Return the smallest upward turn (rad) of a palm's tangent where it may be touched.

        It is at the end of a dome (convex palm), where the tangent has turned down, and at `HELD_SHARE` of the pad of a
        cradle (concave palm). A caller that knows the contacts must check their tangents itself.
        """
        return kappa * self.pad_length * (HELD_SHARE if kappa > 0.0 else 1.0)

    @property
    def unknown(self) -> Joints:
        """A pose of NaN."""
        return (math.nan,) * len(self.angles)

    @property
    def joint_bounds(self) -> tuple[QuantityLimit, ...]:
        """The joints' bounds among `bounds`, in the order of the joints."""
        return self.bounds[: len(self.angles)]

    def _first_bound(self) -> QuantityLimit:
        """Return the bound of φ1: palm 1's tangent stays above the horizontal wherever it may be touched."""
        level = -self._turned(self.curvatures[0])
        low, high = self.angles[0]
        if level <= low:
            return QuantityLimit(JOINTS[0], "°", _DEGREES, low, high)
        shape = "is a dome, whose end points" if level > 0.0 else "points"
        words = f"palm {PALMS[0]} {shape} downwards below"
        return QuantityLimit(JOINTS[0], "°", _DEGREES, level, high, low_words=words)

    def _opening_bound(self) -> QuantityLimit:
        """Return the bound of the opening: a circle of radius r touches at r/tan(φ2/2), which must be on the pads."""
        pads_end = opening_at(SMALL_RADIUS, max(self.pad_length - PAD_MARGIN, PAD_MARGIN), self.curvatures)
        joint, (low, high) = JOINTS[OPENING], self.angles[OPENING]
        if pads_end <= low:
            return QuantityLimit(joint, "°", _DEGREES, low, high)
        words = f"even an object of {SMALL_RADIUS * 1e3:g} mm radius leaves the pads below"
        return QuantityLimit(joint, "°", _DEGREES, pads_end, high, low_words=words)

    def values(self, motion: PalmMotion) -> tuple[float, ...]:
        """Return the quantities bounded by `bounds`, in that order; raises PoseError at a singular pose."""
        arm = self.workspace.values(motion) if self.workspace else ()
        return (*motion.angles, directions(motion.angles)[-1], *motion.rates, *motion.accelerations, *arm)

    def violations(self, angles: Joints) -> list[str]:
        """Return the limits violated by standing at these joint angles (rad), as texts.

        Raises PoseError at a singular pose when a workspace is known. Safe in the loop.
        """
        return [text for _, text in problems(self.bounds, ranges([self.values(PalmMotion.at_rest(angles))]))]

    def hardest_slowing(self, planned: PalmMotion, speed: float) -> float:
        """Return how fast (1/s) the path speed u may fall when the palms are stopped, at u = `speed` (1: as planned).

        With the plan's ω and α the palms then have the accelerations α·u² − ω·s. s is the largest value for which these
        respect the stop deceleration and the arm's tip its acceleration limit, whose square is quadratic in s. Safe in
        the loop.
        """
        arm = self.workspace
        most = self.stop_deceleration if self.stop_deceleration is not None or arm is not None else self.acceleration
        slowing = math.inf
        if most is not None:
            for omega, alpha in zip(planned.rates, planned.accelerations, strict=True):
                if omega != 0.0:
                    slowing = min(slowing, (most + math.copysign(alpha * speed**2, alpha * omega)) / abs(omega))
        if arm is not None:
            slowing = min(slowing, arm.hardest_slowing(planned, speed))
        return max(slowing, 0.0)

    def clamp_step(self, previous: PalmMotion, wanted: PalmMotion, dt: float) -> PalmMotion:
        """Clamp `wanted` to the angle limits and to a step of rate·dt: the last guard before a set-point.

        previous: the last set-point; dt: time (s) that the step may take. A step that is too long is shortened in its
        direction; for non-finite angles the palms stand still. From outside the limits the palms return at the rate
        limit. Safe in the loop.
        """
        if not all(map(math.isfinite, wanted.angles)):
            return PalmMotion.at_rest(previous.angles)
        inside = self._inside(wanted.angles)
        steps = [angle - before for angle, before in zip(inside, previous.angles, strict=True)]
        longest = max(map(abs, steps))
        room = self.rate * dt
        if inside == wanted.angles and longest <= room:
            return wanted
        share = 1.0 if longest <= room else room / longest
        clamped = PalmMotion.at_rest(tuple(b + share * step for b, step in zip(previous.angles, steps, strict=True)))
        return clamped._replace(rates=tuple(share * step / dt for step in steps)) if dt > 0.0 else clamped

    def _inside(self, angles: Joints) -> Joints:
        """Return the nearest joint angles (rad) within the ranges."""
        inside = clipped(angles, self.angles)
        opening = min(inside[OPENING], self.top - _BELOW - sum(inside[:OPENING]))
        return (*inside[:OPENING], opening, *inside[OPENING + 1 :])


def clipped(angles: Joints, ends: Iterable[tuple[float, float]]) -> Joints:
    """Return the joint angles clipped to a range each."""
    return tuple(min(max(angle, low), high) for angle, (low, high) in zip(angles, ends, strict=True))


def ranges(values: Iterable[tuple[float, ...]]) -> list[tuple[float, float]]:
    """Return the lowest and the highest value of each quantity over the samples."""
    return [(min(column), max(column)) for column in zip(*values, strict=True)]


def problems(
    bounds: Iterable[QuantityLimit], extremes: Iterable[tuple[float, float]]
) -> list[tuple[QuantityLimit, str]]:
    """Return the bounds that the quantities' extremes violate, with the violation as text."""
    found = ((bound, bound.problem(*pair)) for bound, pair in zip(bounds, extremes, strict=True))
    return [(bound, text) for bound, text in found if text is not None]
