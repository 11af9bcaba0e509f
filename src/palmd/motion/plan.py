"""From a plan as written to a trajectory: every segment placed in time and checked against the limits.

A plan begins at the target of its first segment when that is a `move` (the way there is the executor's
approach, no shorter than the move's duration); any other plan begins where the palms stand. A `rate` segment
comes to rest exactly at its `until` angle. Repeats go from the pose where one round ended through the first
segment again. An exploration is decided while it runs and ends when it is told to, so that it comes last and once.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

from palmd.config.fields import Strict
from palmd.config.guards import pad_force_limits
from palmd.config.plans import MAX_DURATION_S, AnyPlanSpec, ExploreSpec, HoldSpec, JointValues
from palmd.config.two_palms import (
    SEGMENT_KINDS,
    Config,
    DitherSpec,
    LimitsConfig,
    MoveSpec,
    PalmAngles,
    PlanSpec,
    RateSpec,
    SegmentSpec,
    SineSpec,
)
from palmd.events import PalmMotion
from palmd.motion.exploration import Exploration
from palmd.motion.kinematics import PoseError
from palmd.motion.limits import MotionLimits, QuantityLimit, problems, ranges
from palmd.motion.segments import (
    PEAK_RATE,
    Angles,
    ConstantRate,
    Hold,
    MotionSegment,
    Move,
    Sine,
    growing_s,
)
from palmd.system.arcs import joints_of
from palmd.system.mechanism import JOINTS, PALMS

HOME: Angles = (
    math.radians(45.0),
    math.radians(90.0),
)  # a V about the vertical: assumed when no pose is known
HOME_RADIUS_M = 0.02
BLEND_SHARE = 0.5  # of the acceleration limit, for speeding up to a rate and slowing down from it
APPROACH_SHARE = 0.25  # of the limits, for the way to a plan's beginning: nobody asked for it to be quick
DITHER_SHARE = 0.8  # of the limits, at most
DITHER_GROW = 1.0  # s
MAX_DRIFTING_ROUNDS = 100
SETTLING_ROUNDS = 3  # a plan whose rounds come to repeat themselves does so within these
_SAME_POSE = 1e-12
_SMALL = 1e-9

Loc = tuple[str | int, ...]


class PlanError(ValueError):
    """A plan that must not move; `problems` says what is wrong and at which part of the plan, all at once."""

    def __init__(self, problems: Sequence[tuple[Loc, str]]) -> None:
        super().__init__("\n".join(f"{'.'.join(map(str, loc))}: {text}" for loc, text in problems))
        self.problems = tuple(problems)


@dataclass(frozen=True, slots=True)
class PlanPlace:
    """Where in a plan a time is: the segment's number (from 0) and kind, and the whole's progress, 0 to 1.

    A plan that runs forever shows the progress of its present round, one that explores the share it has touched.
    """

    segment: int
    label: str
    progress: float


@dataclass(frozen=True, slots=True)
class Round:
    """One pass through a plan: its segments, and when each begins (s, from the round's beginning)."""

    segments: tuple[MotionSegment, ...]
    begins: tuple[float, ...]
    duration: float

    @classmethod
    def of(cls, segments: Sequence[MotionSegment]) -> Round:
        """Segments one after the other."""
        ends = list(accumulate(segment.duration for segment in segments))
        return cls(tuple(segments), (0.0, *ends[:-1]), ends[-1])

    def index(self, t: float) -> int:
        """The number of the segment that time t falls into."""
        return max(bisect_right(self.begins, t) - 1, 0)

    def at(self, t: float) -> PalmMotion:
        """The motion t (s) after the round's beginning."""
        index = self.index(t)
        return self.segments[index].at(t - self.begins[index])


@dataclass(frozen=True, slots=True)
class Trajectory:
    """A checked plan as a function of its own time tau (s), from rest to rest; `duration` may be inf.

    start: the pose where it begins (rad). lead_in: the time (s) that the way to it takes at least. rounds:
    one pass after the other; the last one repeats while the plan lasts.
    """

    name: str
    start: Angles
    lead_in: float
    duration: float
    labels: tuple[str, ...]
    rounds: tuple[Round, ...]
    dither: Sine | None

    def at(self, tau: float) -> PalmMotion:
        """The motion at plan time tau, clamped to the plan. Safe in the loop."""
        tau = min(max(tau, 0.0), self.duration)
        current, t = self._locate(tau)
        motion = current.at(t)
        if self.dither is None:
            return motion
        extra = self.dither.at(tau)
        return PalmMotion(
            _sum(motion.angles, extra.angles),
            _sum(motion.rates, extra.rates),
            _sum(motion.accelerations, extra.accelerations),
        )

    def place(self, tau: float) -> PlanPlace:
        """Which segment plan time tau belongs to, and how far the plan is. Safe in the loop."""
        tau = min(max(tau, 0.0), self.duration)
        current, t = self._locate(tau)
        whole, done = (current.duration, t) if math.isinf(self.duration) else (self.duration, tau)
        index = current.index(t)
        segment = current.segments[index]
        if isinstance(segment, Exploration):
            whole, done = 1.0, segment.coverage
        return PlanPlace(index, self.labels[index], done / whole if whole > 0.0 else 1.0)

    def exploration(self, tau: float) -> tuple[Exploration, float] | None:
        """The exploration that plan time tau belongs to, and the time since it began (s). Safe in the loop."""
        current, t = self._locate(min(max(tau, 0.0), self.duration))
        index = current.index(t)
        segment = current.segments[index]
        return (segment, t - current.begins[index]) if isinstance(segment, Exploration) else None

    def _locate(self, tau: float) -> tuple[Round, float]:
        """The round that plan time tau falls into, and the time since that round began."""
        before = 0.0
        for current in self.rounds[:-1]:
            if tau - before < current.duration:
                return current, tau - before
            before += current.duration
        last = self.rounds[-1]
        if last.duration <= 0.0:
            return last, 0.0
        if math.isinf(last.duration):
            return last, tau - before
        passes = (tau - before) // last.duration
        if not math.isinf(self.duration):  # at the very end: the end of the last pass, not the start of another
            passes = min(passes, round((self.duration - before) / last.duration) - 1)
        return last, tau - before - passes * last.duration


@dataclass(frozen=True, slots=True)
class PlanForm:
    """What a system's plans are: how they are written, what limits them, and what becomes of them."""

    spec: type[AnyPlanSpec]
    section: type[Strict]
    """The configuration's `limits`."""
    configured: Callable[[Any], MotionLimits]
    """The limits of a configuration."""
    over: Callable[[Any, float], MotionLimits]
    """The limits of such a section, over pads of a length (mm)."""
    compiled: Callable[[Any, Any, Angles | None], Trajectory]
    """The trajectory of a plan within limits, for a rig that stands there (None: unknown); raises PlanError."""


def compile_plan(spec: PlanSpec, limits: MotionLimits, start: Angles | None = None) -> Trajectory:
    """The plan as a trajectory within the limits; raises PlanError with everything that stands against it.

    start: the palm angles (rad) from which it would begin, HOME within the limits where unknown; it matters
    only when the plan does not begin by moving both angles.
    """
    return _Compiler(spec, limits).trajectory(start if start is not None else home(limits))


def approach(start: Angles, end: Angles, limits: MotionLimits, least: float, share: float = APPROACH_SHARE) -> Move:
    """A move that takes `least` (s) or more, by that share of the limits; raises PoseError if its way leaves them."""
    if start == end:
        return Move(start, end, least)
    move, extremes = _way(start, end, limits)
    gentle = [share * bound.high for bound in limits.bounds]
    return Move(start, end, max(least, move.duration * _slowing(limits.bounds, extremes, gentle)))


def check_way(start: Angles, end: Angles, limits: MotionLimits) -> None:
    """Raises PoseError if the straight way from `start` to `end` (rad) leaves the limits; takes about a millisecond."""
    _way(start, end, limits)


def home(limits: MotionLimits) -> Angles:
    """HOME, on curved palms where a middling object lies as there, or the angles nearest to it within the limits."""
    curvatures = limits.curvatures
    wanted = joints_of(HOME_RADIUS_M, HOME, curvatures) if any(curvatures) else HOME
    return tuple(min(max(angle, low), high) for angle, (low, high) in zip(wanted, limits.angles, strict=True))


def _sum(one: Angles, other: Angles) -> Angles:
    return tuple(a + b for a, b in zip(one, other, strict=True))


class _SegmentError(ValueError):
    """A segment that makes no motion; `end` is where the plan may go on to look for further errors."""

    def __init__(self, text: str, end: Angles) -> None:
        super().__init__(text)
        self.end = end


class _Compiler:
    """Builds one plan round by round, collecting what is wrong with it."""

    def __init__(self, spec: PlanSpec, limits: MotionLimits) -> None:
        self.spec = spec
        self.limits = limits
        self.problems: dict[tuple[Loc, str], str] = {}  # by place and kind: each is told once
        self._known: dict[MotionSegment, list[tuple[float, float]]] = {}  # the extremes of segments that come again
        self.dither_peaks = self._dither_peaks(spec.dither)

    def trajectory(self, origin: Angles) -> Trajectory:
        self._check_explorations()
        first = self.spec.segments[0]
        lead_in = first.duration_s if isinstance(first, MoveSpec) else 0.0
        start = _target(first.move, origin) if isinstance(first, MoveSpec) else origin
        count = math.inf if self.spec.repeat == "forever" else self.spec.repeat
        rounds: list[Round] = []
        pose, settled = start, False
        while len(rounds) < count and not settled:
            begin = pose
            segments, pose = self._round(begin, first=not rounds)
            rounds.append(Round.of(segments))
            drift = max(abs(now - then) for now, then in zip(pose, begin, strict=True))
            settled = drift < _SAME_POSE and (lead_in == 0.0 or len(rounds) > 1)
            if not settled and len(rounds) >= self._most_rounds(count):
                if count > MAX_DRIFTING_ROUNDS:
                    self._drifts(drift, len(rounds), count)
                break
        if self.problems:
            by_place = sorted(self.problems.items(), key=lambda problem: problem[0][0])
            raise PlanError([(loc, text) for (loc, _), text in by_place])
        passes = count - len(rounds) + 1 if settled else 1
        duration = sum(done.duration for done in rounds[:-1]) + passes * rounds[-1].duration
        return Trajectory(
            name=self.spec.name,
            start=start,
            lead_in=lead_in,
            duration=duration,
            labels=tuple(map(_label, self.spec.segments)),
            rounds=tuple(rounds),
            dither=_dither(self.spec.dither, duration),
        )

    def _round(self, pose: Angles, *, first: bool) -> tuple[list[MotionSegment], Angles]:
        """One pass from `pose`; in the first, a move at its beginning is left to the approach."""
        segments: list[MotionSegment] = []
        for index, spec in enumerate(self.spec.segments):
            beginning = first and index == 0
            try:
                if beginning and isinstance(spec, MoveSpec):
                    segment: MotionSegment = Hold(pose, 0.0)
                else:
                    segment, pose = self._segment(spec, pose)
            except _SegmentError as error:
                self.problems.setdefault((("segments", index), "impossible"), str(error))
                segment, pose = Hold(pose, 0.0), error.end
            else:
                self._check(index, segment, first=beginning)
            segments.append(segment)
        return segments, pose

    def _segment(self, spec: SegmentSpec, pose: Angles) -> tuple[MotionSegment, Angles]:
        """One segment from `pose`, and where it ends."""
        if isinstance(spec, MoveSpec):
            end = _target(spec.move, pose)
            return Move(pose, end, spec.duration_s), end
        if isinstance(spec, RateSpec):
            return self._constant_rate(spec, pose)
        if isinstance(spec, HoldSpec):
            return Hold(pose, spec.hold_s), pose
        if isinstance(spec, SineSpec):
            return _sine(spec, pose), pose
        return Exploration(pose, spec.explore), pose

    def _constant_rate(self, spec: RateSpec, pose: Angles) -> tuple[ConstantRate, Angles]:
        rate = _radians(spec.rate)
        axis = next(i for i, angle in enumerate(spec.until.each()) if angle is not None)
        name = JOINTS[axis]
        until = _target(spec.until, pose)[axis]
        way, speed = until - pose[axis], rate[axis]
        end = (*pose[:axis], until, *pose[axis + 1 :])
        here = f"it starts at {math.degrees(pose[axis]):.6g}°"
        if way * speed <= 0.0:
            turning = f"turns at {math.degrees(speed):g}°/s"
            raise _SegmentError(f"{name} {turning} and never reaches {math.degrees(until):g}°: {here}", end)
        budget = BLEND_SHARE * (self.limits.acceleration - self.dither_peaks[2])
        ramp = PEAK_RATE * max(map(abs, rate)) / budget
        if abs(way) < abs(speed) * ramp:
            raise _SegmentError(
                f"no room to speed up to {math.degrees(abs(speed)):g}°/s and slow down again: that takes"
                f" {math.degrees(abs(speed) * ramp):.3g}° of {name} at half the acceleration limit, and"
                f" from {math.degrees(pose[axis]):.6g}° to {math.degrees(until):g}° there are"
                f" {math.degrees(abs(way)):.3g}°",
                end,
            )
        duration = way / speed + ramp
        if duration > MAX_DURATION_S:
            raise _SegmentError(f"takes {duration:.3g} s, more than {MAX_DURATION_S:g} s", end)
        cruise = duration - ramp
        gone = [angle + each * cruise for angle, each in zip(pose, rate, strict=True)]
        end = (*gone[:axis], until, *gone[axis + 1 :])
        return ConstantRate(pose, rate, ramp, duration), end

    def _check(self, index: int, segment: MotionSegment, *, first: bool) -> None:
        """Note what in a segment leaves the limits, with the dither on top.

        A pose limit that is left already where the segment starts is the fault of the one before.
        """
        loc: Loc = ("segments", index)
        bounds = self.limits.bounds
        try:
            if segment not in self._known:
                self._known[segment] = _extremes(segment, self.limits)
            extremes = self._known[segment]
            beginning = ranges([self.limits.values(segment.at(0.0))])
        except PoseError as error:
            self.problems.setdefault((loc, "pose"), str(error))
            return
        dither = [self.dither_peaks[bound.order] * bound.gain for bound in bounds]
        inherited = [] if first else [bound for bound, _ in problems(bounds, _widened(beginning, dither))]
        for bound, text in problems(bounds, _widened(extremes, dither)):
            if bound.order == 0 and bound in inherited:
                continue
            if bound.order > 0 and isinstance(segment, Move):
                usable = [each.high - more for each, more in zip(bounds, dither, strict=True)]
                shortest = segment.duration * _slowing(bounds, extremes, usable)
                text = f"{text}; duration_s must be {math.ceil(shortest * 100.0) / 100.0:g} or more"
            self.problems.setdefault((loc, bound.what), text)

    def _check_explorations(self) -> None:
        places = [index for index, spec in enumerate(self.spec.segments) if isinstance(spec, ExploreSpec)]
        for index in places:
            if index != len(self.spec.segments) - 1:
                text = "where an exploration ends is not known beforehand: it must be the last segment"
                self.problems[(("segments", index), "not last")] = text
        if places and self.spec.repeat != 1:
            self.problems[(("repeat",), "exploration")] = "a plan that explores runs once: leave repeat out"
        if places and self.spec.dither is not None:
            text = "a plan that explores has no dither: its moves leave no room for one"
            self.problems[(("dither",), "exploration")] = text

    def _most_rounds(self, count: float) -> int:
        """How many rounds that differ are built; a plan refused anyway needs few to show its faults."""
        return SETTLING_ROUNDS if self.problems or math.isinf(count) else MAX_DRIFTING_ROUNDS

    def _drifts(self, drift: float, rounds: int, count: float) -> None:
        wish = "forever" if math.isinf(count) else f"{count:g} times"
        self.problems[(("repeat",), "drift")] = (
            f"a plan cannot repeat {wish} when every round ends elsewhere than it began (round {rounds} by"
            f" {math.degrees(drift):.3g}°); let it begin with a move of both angles"
        )

    def _dither_peaks(self, spec: DitherSpec | None) -> tuple[float, float, float]:
        """The most that the dither adds to an angle, its rate and its acceleration (rad, s)."""
        dither = _dither(spec, math.inf)
        if dither is None:
            return (0.0, 0.0, 0.0)
        swings = [dither.at(t) for t in dither.sample_times()]
        peaks = (
            max(abs(swing.angles[0]) for swing in swings),  # of all joints alike
            max(abs(swing.rates[0]) for swing in swings),
            max(abs(swing.accelerations[0]) for swing in swings),
        )
        fits = True
        for bound in self.limits.bounds:
            used = peaks[bound.order] * bound.gain
            if bound.order > 0 and used > DITHER_SHARE * bound.high:
                fits = False
                self.problems[(("dither",), bound.what)] = (
                    f"takes {used / max(bound.high, _SMALL):.0%} of the limit of {bound.what};"
                    f" more than {DITHER_SHARE:.0%} leaves no room to move"
                )
        return peaks if fits else (0.0, 0.0, 0.0)


def _target(angles: PalmAngles, pose: Angles) -> Angles:
    """The named angles (rad), with the pose's for those left out."""
    wanted = zip(angles.each(), pose, strict=True)
    return tuple(here if degrees is None else math.radians(degrees) for degrees, here in wanted)


def _radians(values: JointValues) -> Angles:
    """Of each joint; zero where left out."""
    return tuple(math.radians(degrees or 0.0) for degrees in values.each())


def _label(spec: SegmentSpec) -> str:
    return next(kind for kind in SEGMENT_KINDS if hasattr(spec, kind))


def _sine(spec: SineSpec, pose: Angles) -> Sine:
    return Sine(
        centre=pose,
        amplitude=_radians(spec.sine),
        angular_frequency=tuple(math.tau * each for each in spec.frequency_hz),
        grow=growing_s(spec.frequency_hz, spec.duration_s),
        duration=spec.duration_s,
    )


def _dither(spec: DitherSpec | None, duration: float) -> Sine | None:
    """The dither over a whole plan; None when none is asked for, or the plan is too short for it."""
    if spec is None or duration < 2.0 * DITHER_GROW:
        return None
    amplitude, w = math.radians(spec.amplitude_deg), math.tau * spec.frequency_hz
    joints = len(JOINTS)
    return Sine((0.0,) * joints, (amplitude,) * joints, (w,) * joints, DITHER_GROW, duration)


def _way(start: Angles, end: Angles, limits: MotionLimits) -> tuple[Move, list[tuple[float, float]]]:
    """The move in a second and its extremes; raises PoseError where no duration keeps it within the limits."""
    move = Move(start, end, 1.0)
    extremes = _extremes(move, limits)
    blocked = [text for bound, text in problems(limits.bounds, extremes) if bound.order == 0]
    if blocked:
        raise PoseError("; ".join(blocked))
    return move, extremes


def _extremes(segment: MotionSegment, limits: MotionLimits) -> list[tuple[float, float]]:
    """Lowest and highest of each bounded quantity; raises PoseError at a singular pose."""
    return ranges(limits.values(segment.at(t)) for t in segment.sample_times())


def _widened(extremes: Sequence[tuple[float, float]], more: Sequence[float]) -> list[tuple[float, float]]:
    return [(low - each, high + each) for (low, high), each in zip(extremes, more, strict=True)]


def _slowing(
    bounds: Sequence[QuantityLimit], extremes: Sequence[tuple[float, float]], usable: Sequence[float]
) -> float:
    """The factor on a move's duration that brings its rates and accelerations down to what is usable of them.

    The path stays the same, so rates go with 1/T and accelerations with 1/T².
    """
    factor = 0.0
    for bound, (low, high), most in zip(bounds, extremes, usable, strict=True):
        if bound.order > 0:
            factor = max(factor, (max(-low, high) / max(most, _SMALL)) ** (1.0 / bound.order))
    return factor


def _configured(config: Config) -> MotionLimits:
    pads = dict(zip(PALMS, config.pads.each(), strict=True))
    shortest_mm = min(pad.length_mm for pad in pads.values())
    return MotionLimits.from_config(
        config.limits,
        pad_length=shortest_mm * 1e-3,
        curvatures=config.rig.curvatures_per_m,
        pad_forces=pad_force_limits(config.limits.force_n, pads),
    )


PLANS = PlanForm(
    PlanSpec,
    LimitsConfig,
    _configured,
    lambda section, length_mm: MotionLimits.from_config(section, pad_length=length_mm * 1e-3),
    compile_plan,
)
"""Of two palms."""
