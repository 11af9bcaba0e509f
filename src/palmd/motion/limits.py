"""What the palms may do: angles, rates, accelerations, the arm's workspace, contacts on the pads.

A limit is a `QuantityLimit` on one quantity of a motion and says in words when it is left, so that the check of a
plan, the last guard before a set-point and the message to the operator speak of the same numbers.
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

PHI12_MAX = math.radians(172.0)  # two contacts need φ12 < 180°; here it must stay below this
SMALL_RADIUS = 0.010  # an object no smaller than this shall find pad under it
PAD_MARGIN = 0.002
HELD_SHARE = (
    0.3  # of a cradle's pad, from the hinge: what it is made for touches it farther out, unless it is open wide
)
_DEGREES = math.degrees(1.0)
_ROUNDING = 1e-9
_STOP_SHARE = 0.9  # of the arm's acceleration that a stop uses: set-points come in steps
_BELOW = 3e-9  # "must stay below" as a bound that may be reached


@dataclass(frozen=True, slots=True)
class QuantityLimit:
    """The limits of one quantity (SI) and how to speak of it.

    order: 0 for a pose, 1 for a rate, 2 for an acceleration. gain: the most that the quantity changes when
    both palm angles (or their rates, or accelerations) change by one.
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
        """What is wrong when the quantity ranges from `lowest` to `highest`; None if nothing is."""
        if self.order > 0:  # same limit both ways: only the size matters
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
    """Where and how fast the arm can go, as it says in its hello (m, m/s, m/s², arm coordinates)."""

    geometry: RigGeometry
    x_min: float
    x_max: float
    y_min: float
    y_max: float
    speed: float
    acceleration: float

    def bounds(self) -> tuple[QuantityLimit, ...]:
        """Of the values that `values` gives, in the same order."""
        gain = sum(turning * length for turning, length in enumerate(self.geometry.palm_lengths, 1))
        return (
            QuantityLimit("the arm's x", " mm", 1e3, self.x_min, self.x_max, 0, gain),
            QuantityLimit("the arm's y", " mm", 1e3, self.y_min, self.y_max, 0, gain),
            QuantityLimit("the arm's speed", " mm/s", 1e3, 0.0, self.speed, 1, gain),
            QuantityLimit("the arm's acceleration", " mm/s²", 1e3, 0.0, self.acceleration, 2, gain),
        )

    def values(self, motion: PalmMotion) -> tuple[float, ...]:
        """Position, speed and acceleration of the arm; raises PoseError at a singular pose."""
        x, y, _ = self.geometry.arm_pose(motion.angles)
        return (x, y, *self.geometry.tip_speed_acceleration(motion))

    def hardest_slowing(self, planned: PalmMotion, speed: float) -> float:
        """As that of `MotionLimits`, by the tip's acceleration alone; 0 where that has no room at all."""

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

    angles: the lowest and the highest of each joint.
    pad_length: how far along a palm, from the hinge, a contact is felt. pad_forces: what may press on each pad (N);
    empty: anything. workspace: None while no arm has said what it can do. stop_deceleration: of each angle when the
    motion is held; None: as much as the arm allows.
    """

    system: ClassVar[str] = TWO_PALMS
    """Whose they are, by the table of `palmd.systems`."""

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
        """The configured limits in SI; pad_length in m, the palms' `curvatures` in 1/m, `pad_forces` in N."""
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
        """φ12 stays below it (rad): 172° where palm 2 may be touched, by its tangent."""
        return PHI12_MAX + self._turned(self.curvatures[-1])

    def _turned(self, kappa: float) -> float:
        """By how much (rad) a palm's tangent has turned up where it may be touched, at the least.

        That is at the end of a dome, where it has turned down. On a cradle it is at `HELD_SHARE` of the pad: who knows
        where the object touches must keep to its tangent there.
        """
        return kappa * self.pad_length * (HELD_SHARE if kappa > 0.0 else 1.0)

    @property
    def unknown(self) -> Joints:
        """No pose."""
        return (math.nan,) * len(self.angles)

    @property
    def joint_bounds(self) -> tuple[QuantityLimit, ...]:
        """Of `bounds` those of the joints, in their order."""
        return self.bounds[: len(self.angles)]

    def _first_bound(self) -> QuantityLimit:
        """φ1's, `top` mirrored: above the horizontal where palm 1 may be touched, by its tangent."""
        level = -self._turned(self.curvatures[0])
        low, high = self.angles[0]
        if level <= low:
            return QuantityLimit(JOINTS[0], "°", _DEGREES, low, high)
        told = "is a dome, whose end points" if level > 0.0 else "points"
        words = f"palm {PALMS[0]} {told} downwards below"
        return QuantityLimit(JOINTS[0], "°", _DEGREES, level, high, low_words=words)

    def _opening_bound(self) -> QuantityLimit:
        """The opening's bound: a circle of radius r touches both palms at r/tan(φ2/2), which must be on the pads."""
        pads_end = opening_at(SMALL_RADIUS, max(self.pad_length - PAD_MARGIN, PAD_MARGIN), self.curvatures)
        joint, (low, high) = JOINTS[OPENING], self.angles[OPENING]
        if pads_end <= low:
            return QuantityLimit(joint, "°", _DEGREES, low, high)
        words = f"even an object of {SMALL_RADIUS * 1e3:g} mm radius leaves the pads below"
        return QuantityLimit(joint, "°", _DEGREES, pads_end, high, low_words=words)

    def values(self, motion: PalmMotion) -> tuple[float, ...]:
        """The quantities bounded by `bounds`, in that order; raises PoseError at a singular pose."""
        arm = self.workspace.values(motion) if self.workspace else ()
        return (*motion.angles, directions(motion.angles)[-1], *motion.rates, *motion.accelerations, *arm)

    def violations(self, angles: Joints) -> list[str]:
        """What is wrong with standing at these joint angles (rad), in words; empty when nothing is.

        Raises PoseError at a singular pose when a workspace is known. Safe in the loop.
        """
        return [text for _, text in problems(self.bounds, ranges([self.values(PalmMotion.at_rest(angles))]))]

    def hardest_slowing(self, planned: PalmMotion, speed: float) -> float:
        """How fast (1/s²·s) a path's speed may fall to bring the palms to a stand, from `speed`, 1 being as planned.

        With the plan's ω and α the palms then have the accelerations α·u² − ω·s. s is the largest for which these keep
        to the stops' deceleration and the arm's tip to its own acceleration, whose square is quadratic in s. Safe in
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
        """The last guard before a set-point: `wanted`, inside the angle limits and one step of rate·dt.

        previous: the set-point sent last; dt: time (s) that the step may take. Both angles of a step that is
        too long shrink alike, so that the direction stays; non-finite wishes are answered by standing still.
        From outside the limits the way back is taken at the rate limit. Safe in the loop.
        """
        if not all(map(math.isfinite, wanted.angles)):
            return PalmMotion.at_rest(previous.angles)
        inside = [min(max(angle, low), high) for angle, (low, high) in zip(wanted.angles, self.angles, strict=True)]
        inside[OPENING] = min(inside[OPENING], self.top - _BELOW - sum(inside[:OPENING]))
        steps = [angle - before for angle, before in zip(inside, previous.angles, strict=True)]
        longest = max(map(abs, steps))
        room = self.rate * dt
        if tuple(inside) == wanted.angles and longest <= room:
            return wanted
        share = 1.0 if longest <= room else room / longest
        clamped = PalmMotion.at_rest(tuple(b + share * step for b, step in zip(previous.angles, steps, strict=True)))
        return clamped._replace(rates=tuple(share * step / dt for step in steps)) if dt > 0.0 else clamped


def ranges(values: Iterable[tuple[float, ...]]) -> list[tuple[float, float]]:
    """Lowest and highest of each quantity over samples of them."""
    return [(min(column), max(column)) for column in zip(*values, strict=True)]


def problems(
    bounds: Iterable[QuantityLimit], extremes: Iterable[tuple[float, float]]
) -> list[tuple[QuantityLimit, str]]:
    """Which bounds the quantities' extremes leave, in words."""
    found = ((bound, bound.problem(*pair)) for bound, pair in zip(bounds, extremes, strict=True))
    return [(bound, text) for bound, text in found if text is not None]
