"""The segments of a motion plan: each starts and ends at rest, with smooth rates and accelerations.

Every segment gives its pose and both time derivatives in closed form as functions of the time since its start, so that
observers can use the plan's rates and accelerations. All blends are the quintic S(u) = 10u³ − 15u⁴ + 6u⁵, whose first
two derivatives vanish at both ends: the minimum-jerk path (Flash & Hogan 1985).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

from palmd.events import Joints, PalmMotion

PEAK_RATE = 15.0 / 8.0  # largest S′
PEAK_ACCELERATION = 10.0 / math.sqrt(3.0)  # largest |S″|
SWING_GROW_MAX = 10.0  # s, longest growth of a swing
_SAMPLES = 64  # per blend or period, when a segment is checked
_SWING_SAMPLES = 6000  # largest number for a long sine, enough to include its extremes

Angles = Joints


class MotionSegment(Protocol):
    """One segment of motion, from rest to rest."""

    @property
    def duration(self) -> float:
        """Duration (s)."""

    def at(self, t: float) -> PalmMotion:
        """Return the motion t (s) after the start, 0 ≤ t ≤ duration. Safe in the loop."""

    def sample_times(self) -> Iterator[float]:
        """Return times that are dense enough to include every extreme of the motion."""


def blend(u: float) -> tuple[float, float, float]:
    """Return S(u), S′(u), S″(u); S is 0 for u ≤ 0 and 1 for u ≥ 1."""
    if u <= 0.0:
        return 0.0, 0.0, 0.0
    if u >= 1.0:
        return 1.0, 0.0, 0.0
    v = 1.0 - u
    return (
        u * u * u * (10.0 + u * (6.0 * u - 15.0)),
        30.0 * u * u * v * v,
        60.0 * u * v * (v - u),
    )


def _along(start: Angles, direction: Sequence[float], way: float, speed: float, change: float) -> PalmMotion:
    """Return the motion at distance `way` from `start` along `direction`, with this speed and rate of change of it."""
    return PalmMotion(
        tuple(angle + each * way for angle, each in zip(start, direction, strict=True)),
        tuple(each * speed for each in direction),
        tuple(each * change for each in direction),
    )


def _spread(begin: float, end: float, count: int) -> Iterator[float]:
    return (begin + (end - begin) * i / count for i in range(count + 1))


@dataclass(frozen=True, slots=True)
class Hold:
    """Standing still."""

    pose: Angles
    duration: float

    def at(self, t: float) -> PalmMotion:  # noqa: ARG002
        """The pose, at rest."""
        return PalmMotion.at_rest(self.pose)

    def sample_times(self) -> Iterator[float]:
        """Return one time, which is enough."""
        return iter((0.0,))


@dataclass(frozen=True, slots=True)
class Move:
    """A minimum-jerk move, straight in the palm angles."""

    start: Angles
    end: Angles
    duration: float

    def at(self, t: float) -> PalmMotion:
        """φ = start + (end − start)·S(t/T)."""
        if t >= self.duration:
            return PalmMotion.at_rest(self.end)
        s, s_dot, s_ddot = blend(t / self.duration)
        s_dot /= self.duration
        s_ddot /= self.duration * self.duration
        return _along(
            self.start, [end - start for start, end in zip(self.start, self.end, strict=True)], s, s_dot, s_ddot
        )

    def sample_times(self) -> Iterator[float]:
        """Return denser times than other segments: the shortest duration within the limits is computed from them."""
        return _spread(0.0, self.duration, 4 * _SAMPLES)


@dataclass(frozen=True, slots=True)
class ConstantRate:
    """Constant rates between ramps from rest and to rest of `ramp` seconds each."""

    start: Angles
    rate: Angles
    ramp: float
    duration: float

    def at(self, t: float) -> PalmMotion:
        """φ = start + rate·g(t), where g′ rises as S(t/ramp) to 1 and falls likewise at the end."""
        left = self.duration - t
        if t < self.ramp:
            u = t / self.ramp
            speed, slope, _ = blend(u)
            way = self.ramp * _blend_integral(u)
            slope /= self.ramp
        elif left < self.ramp:
            u = max(left / self.ramp, 0.0)
            speed, slope, _ = blend(u)
            way = self.duration - self.ramp - self.ramp * _blend_integral(u)
            slope /= -self.ramp
        else:
            speed, slope, way = 1.0, 0.0, t - 0.5 * self.ramp
        return _along(self.start, self.rate, way, speed, slope)

    def sample_times(self) -> Iterator[float]:
        """Return times of both ramps and of the part between."""
        yield from _spread(0.0, self.ramp, _SAMPLES)
        yield from _spread(self.ramp, self.duration - self.ramp, _SAMPLES)
        yield from _spread(self.duration - self.ramp, self.duration, _SAMPLES)


@dataclass(frozen=True, slots=True)
class Sine:
    """An oscillation about `centre` that grows and decays in `grow` seconds each; an endless one only grows."""

    centre: Angles
    amplitude: Angles
    angular_frequency: Angles
    grow: float
    duration: float

    def at(self, t: float) -> PalmMotion:
        """φ_i = centre_i + e(t)·amplitude_i·sin(w_i t), the envelope e rising as S(t/grow) and falling at the end."""
        envelope, slope, curve = blend(t / self.grow)
        if envelope == 1.0:
            envelope, slope, curve = blend((self.duration - t) / self.grow)
            slope = -slope
        slope /= self.grow
        curve /= self.grow * self.grow
        angles, rates, accelerations = [], [], []
        for centre, a, w in zip(self.centre, self.amplitude, self.angular_frequency, strict=True):
            sin, cos = math.sin(w * t), math.cos(w * t)
            angles.append(centre + a * envelope * sin)
            rates.append(a * (slope * sin + envelope * w * cos))
            accelerations.append(a * ((curve - envelope * w * w) * sin + 2.0 * slope * w * cos))
        return PalmMotion(tuple(angles), tuple(rates), tuple(accelerations))

    def sample_times(self) -> Iterator[float]:
        """Return times of growth, of the oscillation until it repeats itself, and of decay."""
        step = min(math.tau / max(self.angular_frequency), 2.0 * self.grow) / _SAMPLES
        growing = math.ceil(self.grow / step)
        yield from _spread(0.0, self.grow, growing)
        if math.isinf(self.duration):
            yield from (self.grow + i * step for i in range(2 * _SAMPLES))
            return
        swinging = min(math.ceil((self.duration - 2.0 * self.grow) / step), _SWING_SAMPLES)
        yield from (self.grow + i * step for i in range(swinging))
        yield from _spread(self.duration - self.grow, self.duration, growing)


def growing_s(frequencies_hz: Sequence[float], duration_s: float) -> float:
    """Return the time (s) in which an oscillation grows, and decays."""
    return min(1.0 / min(frequencies_hz), 0.5 * duration_s, SWING_GROW_MAX)


def _blend_integral(u: float) -> float:
    """∫S from 0 to u, for 0 ≤ u ≤ 1; 1/2 at u = 1."""
    return u**4 * (2.5 - 3.0 * u + u * u)
