"""Compile a plan into a trajectory: place every segment in time and check it against the limits.

A plan that begins with a `move` starts at that move's target (the way there is the executor's approach, no shorter
than the move's duration); any other plan starts where the palms stand. A `rate` segment comes to rest exactly at its
`until` angle. Each repetition starts at the pose where the previous round ended and includes the first segment. The
moves and the end of an exploration are decided while it runs, so it must be the last segment and cannot repeat.
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
    PlanSpec,
    RateSpec,
    SegmentSpec,
    SineSpec,
)
from palmd.events import PalmMotion
from palmd.motion.exploration import Exploration
from palmd.motion.kinematics import PoseError
from palmd.motion.limits import MotionLimits, QuantityLimit, clipped, problems, ranges
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

# a V symmetric about the vertical: assumed when no pose is known
HOME: Angles = (math.radians(45.0), math.radians(90.0))
HOME_RADIUS_M = 0.02
BLEND_SHARE = 0.5  # of the acceleration limit, for the ramps of a `rate` segment
APPROACH_SHARE = 0.25  # of the limits, for the way to a plan's start, which need not be fast
DITHER_SHARE = 0.8  # largest share of the limits that the dither may use
DITHER_GROW = 1.0  # s, growth and decay of the dither
MAX_DRIFTING_ROUNDS = 100
SETTLING_ROUNDS = 3  # rounds within which a plan becomes periodic, if it ever does; enough for an invalid one, too
_SAME_POSE = 1e-12
_SMALL = 1e-9

Loc = tuple[str | int, ...]


class PlanError(ValueError):
    """An invalid plan; `problems`: all errors, each with its location in the plan."""

    def __init__(self, problems: Sequence[tuple[Loc, str]]) -> None:
        super().__init__("\n".join(f"{'.'.join(map(str, loc))}: {text}" for loc, text in problems))
        self.problems = tuple(problems)


@dataclass(frozen=True, slots=True)
class PlanPlace:
    """A position in a plan: number (from 0) and kind of the segment, progress of the plan from 0 to 1.

    For a plan that runs forever it is the progress of the present round, for an exploration the coverage.
    """

    segment: int
    label: str
    progress: float


@dataclass(frozen=True, slots=True)
class Round:
    """One pass through a plan: its segments, and the start time of each (s, from the start of the round)."""

    segments: tuple[MotionSegment, ...]
    begins: tuple[float, ...]
    duration: float

    @classmethod
    def of(cls, segments: Sequence[MotionSegment]) -> Round:
        """Chain segments."""
        ends = list(accumulate(segment.duration for segment in segments))
        return cls(tuple(segments), (0.0, *ends[:-1]), ends[-1])

    def index(self, t: float) -> int:
        """Return the number of the segment at time t (s)."""
        return max(bisect_right(self.begins, t) - 1, 0)

    def at(self, t: float) -> PalmMotion:
        """Return the motion t (s) after the start of the round."""
        index = self.index(t)
        return self.segments[index].at(t - self.begins[index])


@dataclass(frozen=True, slots=True)
class Trajectory:
    """A checked plan as a function of plan time tau (s), from rest to rest; `duration` may be inf.

    start: initial pose (rad). lead_in: shortest time (s) for the way to it. rounds: passes in order; the last one
    repeats until the plan ends.
    """

    name: str
    start: Angles
    lead_in: float
    duration: float
    labels: tuple[str, ...]
    rounds: tuple[Round, ...]
    dither: Sine | None

    def at(self, tau: float) -> PalmMotion:
        """Return the motion at plan time tau, clamped to the plan. Safe in the loop."""
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
        """Return the segment and the progress at plan time tau. Safe in the loop."""
        tau = min(max(tau, 0.0), self.duration)
        current, t = self._locate(tau)
        whole, done = (current.duration, t) if math.isinf(self.duration) else (self.duration, tau)
        index = current.index(t)
        segment = current.segments[index]
        if isinstance(segment, Exploration):
            whole, done = 1.0, segment.coverage
        return PlanPlace(index, self.labels[index], done / whole if whole > 0.0 else 1.0)

    def exploration(self, tau: float) -> tuple[Exploration, float] | None:
        """Return the exploration at plan time tau and the time since its start (s); None if none. Safe in the loop."""
        current, t = self._locate(min(max(tau, 0.0), self.duration))
        index = current.index(t)
        segment = current.segments[index]
        return (segment, t - current.begins[index]) if isinstance(segment, Exploration) else None

    def _locate(self, tau: float) -> tuple[Round, float]:
        """Return the round at plan time tau and the time since its start."""
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
        if not math.isinf(self.duration):  # the end of the plan is the end of the last pass, not the start of another
            passes = min(passes, round((self.duration - before) / last.duration) - 1)
        return last, tau - before - passes * last.duration


@dataclass(frozen=True, slots=True)
class PlanForm:
    """How a system's plans are parsed, limited and compiled."""

    spec: type[AnyPlanSpec]
    """Schema of a plan file."""
    section: type[Strict]
    """Schema of the configuration's section `limits`."""
    configured: Callable[[Any], MotionLimits]
    """Configuration → limits."""
    over: Callable[[Any, float], MotionLimits]
    """Section `limits`, length of the pads (mm) → limits."""
    compiled: Callable[[Any, Any, Angles | None], Trajectory]
    """Plan, limits, pose of the rig (None: unknown) → trajectory; raises PlanError."""


def compile_plan(spec: PlanSpec, limits: MotionLimits, start: Angles | None = None) -> Trajectory:
    """Compile a plan within the limits; raises PlanError with all errors.

    start: present palm angles (rad); None: HOME, clipped to the limits. It only matters if the plan does not begin
    with a move of both angles.
    """
    return _Compiler(spec, limits).trajectory(start if start is not None else home(limits))


def approach(start: Angles, end: Angles, limits: MotionLimits, least: float, share: float = APPROACH_SHARE) -> Move:
    """Return a move of `least` (s) or more within `share` of the limits; raises PoseError if its way leaves them."""
    if start == end:
        return Move(start, end, least)
    move, extremes = _way(start, end, limits)
    gentle = [share * bound.high for bound in limits.bounds]
    return Move(start, end, max(least, move.duration * _slowing(limits.bounds, extremes, gentle)))


def check_way(start: Angles, end: Angles, limits: MotionLimits) -> None:
    """Raise PoseError if the straight way from `start` to `end` (rad) leaves the limits; takes about a millisecond."""
    _way(start, end, limits)


def home(limits: MotionLimits) -> Angles:
    """Return HOME clipped to the limits; for curved palms, the angles at which a 20 mm radius touches as at HOME."""
    curvatures = limits.curvatures
    wanted = joints_of(HOME_RADIUS_M, HOME, curvatures) if any(curvatures) else HOME
    return clipped(wanted, limits.angles)


def _sum(one: Angles, other: Angles) -> Angles:
    return tuple(a + b for a, b in zip(one, other, strict=True))


class _SegmentError(ValueError):
    """An impossible segment; `end`: pose from which the check of the following segments continues."""

    def __init__(self, text: str, end: Angles) -> None:
        super().__init__(text)
        self.end = end


class _Compiler:
    """Builds one plan round by round and collects its errors."""

    def __init__(self, spec: PlanSpec, limits: MotionLimits) -> None:
        self.spec = spec
        self.limits = limits
        self.problems: dict[tuple[Loc, str], str] = {}  # (location, kind) → text: each is reported once
        self._known: dict[MotionSegment, list[tuple[float, float]]] = {}  # extremes of segments, for repetitions
        self.dither_peaks = self._dither_peaks(spec.dither)

    def trajectory(self, origin: Angles) -> Trajectory:
        self._check_explorations()
        first = self.spec.segments[0]
        lead_in = first.duration_s if isinstance(first, MoveSpec) else 0.0
        start = target(first.move, origin) if isinstance(first, MoveSpec) else origin
        count = math.inf if self.spec.repeat == "forever" else self.spec.repeat
        rounds: list[Round] = []
        pose, settled = start, False
        while len(rounds) < count and not settled:
            begin = pose
            segments, pose = self._round(begin, first=not rounds)
            rounds.append(Round.of(segments))
            drift = max(abs(now - then) for now, then in zip(pose, begin, strict=True))
            settled = drift < _SAME_POSE and (lead_in == 0.0 or len(rounds) > 1)
            most = SETTLING_ROUNDS if self.problems or math.isinf(count) else MAX_DRIFTING_ROUNDS
            if not settled and len(rounds) >= most:
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
        """Build one pass from `pose`; in the first pass the executor's approach replaces an initial move."""
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
        """Build one segment from `pose`; return it and its end."""
        if isinstance(spec, MoveSpec):
            end = target(spec.move, pose)
            return Move(pose, end, spec.duration_s), end
        if isinstance(spec, RateSpec):
            return self._constant_rate(spec, pose)
        if isinstance(spec, HoldSpec):
            return Hold(pose, spec.hold_s), pose
        if isinstance(spec, SineSpec):
            return _sine(spec, pose), pose
        return Exploration(pose, spec.explore), pose

    def _constant_rate(self, spec: RateSpec, pose: Angles) -> tuple[ConstantRate, Angles]:
        rate = radians(spec.rate)
        axis = next(i for i, angle in enumerate(spec.until.each()) if angle is not None)
        name = JOINTS[axis]
        until = target(spec.until, pose)[axis]
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
        """Record where a segment, with the dither added, violates the limits.

        A pose limit that is violated at the start of the segment was already reported for the previous one.
        """
        loc: Loc = ("segments", index)
        bounds = self.limits.bounds
        try:
            if segment not in self._known:
                self._known[segment] = extremes_of(segment, self.limits)
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
        indices = [index for index, spec in enumerate(self.spec.segments) if isinstance(spec, ExploreSpec)]
        for index in indices:
            if index != len(self.spec.segments) - 1:
                text = "the end of an exploration is not known in advance: it must be the last segment"
                self.problems[(("segments", index), "not last")] = text
        if indices and self.spec.repeat != 1:
            self.problems[(("repeat",), "exploration")] = "a plan that explores runs once: leave repeat out"
        if indices and self.spec.dither is not None:
            text = "a plan that explores cannot have a dither: its moves leave no room for one"
            self.problems[(("dither",), "exploration")] = text

    def _drifts(self, drift: float, rounds: int, count: float) -> None:
        times = "forever" if math.isinf(count) else f"{count:g} times"
        self.problems[(("repeat",), "drift")] = (
            f"a plan cannot repeat {times} when every round ends elsewhere than it began (round {rounds} by"
            f" {math.degrees(drift):.3g}°); let it begin with a move of both angles"
        )

    def _dither_peaks(self, spec: DitherSpec | None) -> tuple[float, float, float]:
        """Return the largest angle, rate and acceleration that the dither adds (rad, s); zeros if it is too large."""
        dither = _dither(spec, math.inf)
        if dither is None:
            return (0.0, 0.0, 0.0)
        swings = [dither.at(t) for t in dither.sample_times()]
        peaks = (
            max(abs(swing.angles[0]) for swing in swings),  # all joints have the same dither
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


def target(wanted: JointValues, pose: Angles, si: Callable[[float], float] = math.radians) -> Angles:
    """Return the target: the wanted joint values, converted by `si`, and the pose's for those left out."""
    each = zip(wanted.each(), pose, strict=True)
    return tuple(here if value is None else si(value) for value, here in each)


def radians(values: JointValues) -> Angles:
    """Convert each joint's value from degrees; zero where left out."""
    return tuple(math.radians(degrees or 0.0) for degrees in values.each())


def _label(spec: SegmentSpec) -> str:
    return next(kind for kind in SEGMENT_KINDS if hasattr(spec, kind))


def _sine(spec: SineSpec, pose: Angles) -> Sine:
    return Sine(
        centre=pose,
        amplitude=radians(spec.sine),
        angular_frequency=tuple(math.tau * each for each in spec.frequency_hz),
        grow=growing_s(spec.frequency_hz, spec.duration_s),
        duration=spec.duration_s,
    )


def _dither(spec: DitherSpec | None, duration: float) -> Sine | None:
    """Return the dither over a whole plan; None if none is specified or the plan is too short for it."""
    if spec is None or duration < 2.0 * DITHER_GROW:
        return None
    amplitude, w = math.radians(spec.amplitude_deg), math.tau * spec.frequency_hz
    joints = len(JOINTS)
    return Sine((0.0,) * joints, (amplitude,) * joints, (w,) * joints, DITHER_GROW, duration)


def _way(start: Angles, end: Angles, limits: MotionLimits) -> tuple[Move, list[tuple[float, float]]]:
    """Return the move with a duration of 1 s, and its extremes; raises PoseError if its path violates the limits."""
    move = Move(start, end, 1.0)
    extremes = extremes_of(move, limits)
    blocked = [text for bound, text in problems(limits.bounds, extremes) if bound.order == 0]
    if blocked:
        raise PoseError("; ".join(blocked))
    return move, extremes


def extremes_of(segment: MotionSegment, limits: MotionLimits) -> list[tuple[float, float]]:
    """Return lowest and highest value of each bounded quantity; raises PoseError at a singular pose."""
    return ranges(limits.values(segment.at(t)) for t in segment.sample_times())


def _widened(extremes: Sequence[tuple[float, float]], more: Sequence[float]) -> list[tuple[float, float]]:
    return [(low - each, high + each) for (low, high), each in zip(extremes, more, strict=True)]


def _slowing(
    bounds: Sequence[QuantityLimit], extremes: Sequence[tuple[float, float]], usable: Sequence[float]
) -> float:
    """Return the factor on a move's duration that brings its rates and accelerations down to the `usable` ones.

    The path stays the same, so rates scale with 1/T and accelerations with 1/T².
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
"""Plans of the system of two palms."""
