"""Gravity in the plane of the palms, from a ball or a cylinder that rolls down one palm after the other. Pure.

A roller of radius R and radius of gyration ρ on a plane that rises at the angle φ away from the hinge (φ1 of palm 1,
φ12 of palm 2) rolls towards the hinge with

    κ·s̈ = −g·(sin(φ + δ) − μ·|cos(φ + δ)|),   κ = 1 + ρ²/R²                                                 (1)

where κ is 7/5 for a ball and 3/2 for a full cylinder, μ is the rolling resistance, which acts against the motion, and
δ is the angle by which the palms stand further than the daemon believes: the error of the arm's yaw. Palm 1 slopes
down to the hinge for small φ1 and palm 2 for φ12 near 180°, where sin(φ + δ) falls with δ: so δ is told from g. The
resistance matters the less the steeper the palm is, and so is told from g by several slopes.

Each roll is fitted by s(t) = s0 + v·t + a·t²/2 (2), whatever push it began with, and (1) to all the a by Gauss–Newton.
What does not fit is left out and counted in both.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np

from palmd.events import Event, FloatArray, PadLift, PadSample, PalmSample
from palmd.system.mechanism import PALMS, directions

RollerKind = Literal["ball", "cylinder"]
INERTIA: Mapping[RollerKind, float] = MappingProxyType({"ball": 7.0 / 5.0, "cylinder": 3.0 / 2.0})
"""κ of (1)."""

LEAST_READINGS = 8
LEAST_PER_PALM = 4
LEAST_TRAVEL = 0.012
"""m: less on one pad alone is no roll."""
LEAST_SLOPES = math.radians(5.0)
"""How far apart the slopes on one of the palms must be, for the resistance to be told."""

_REVERSAL = 1e-3  # m: so far back uphill, and it is another roll
_AT_TOP, _AT_BOTTOM = 6e-4, 1.5e-3  # m: so near to them it may lie in the hand, or on both palms
_PARTED = 3e-4  # m: a roll counts from here on below its rest, where the hand has surely let go
_SILENCE = 0.06  # s: a touch has ended
_GROSS = 3.5  # of one sigma: no reading of this roll
_ROUGH = 5e-4  # m: what (2) may leave of a roll; a hand that leads the roller leaves more
_STRANGE = 4.0  # of one sigma: no roll like the others
_ROUNDS = 20

TOO_SHORT, ROUGH, STRANGE = "too short", "not smooth", "unlike the others"
"""Why a roll was left out."""


class TooFewRollsError(ValueError):
    """The rolls do not suffice; the text says what is missing and what to do."""


@dataclass(frozen=True, slots=True)
class Roll:
    """The readings of one roll: the pad, its palm's angle phi (rad: φ1 or φ12), times (s) and distances (m).

    They begin before it was let go, where it lay at `rest` (m).
    """

    pad: int
    phi: float
    rest: float
    t: FloatArray
    s: FloatArray


@dataclass(frozen=True, slots=True)
class Acceleration:
    """What (2) makes of a roll: the acceleration (m/s²) with its one sigma; rms is what it leaves (m)."""

    pad: int
    phi: float
    a: float
    a_sd: float
    rms: float
    readings: int
    left_out: int


@dataclass(frozen=True, slots=True)
class GravityFit:
    """g (m/s²), δ (rad) and μ with their one sigma; scatter is the rolls' own over what their readings promise.

    `used` are the rolls that count, `strange` how many were unlike the others.
    """

    g: float
    delta: float
    resistance: float
    g_sd: float
    delta_sd: float
    resistance_sd: float
    scatter: float
    used: tuple[Acceleration, ...]
    strange: int

    def acceleration(self, phi: float, kind: RollerKind) -> float:
        """What (1) says for a palm at phi (rad), m/s²."""
        return float(_model(np.array([phi]), INERTIA[kind], np.array([self.g, self.delta, self.resistance]))[0])


def find_rolls(events: Sequence[Event]) -> tuple[list[Roll], int]:
    """The rolls towards the hinge among the readings of palms that stand still, and how many were too short.

    A roll is what one pad reports while the other one is silent, going down without coming back. Its ends are left
    out: at the top a hand lets go, at the bottom the roller meets the other palm. Without a PalmSample there is none.
    """
    angles = [directions(event.angles) for event in events if isinstance(event, PalmSample)]
    if not angles:
        return [], 0
    phi = np.mean(np.array(angles), axis=0)
    rolls: list[Roll] = []
    short = 0
    for pad in PALMS:
        other = np.array([each.t_sample for each in events if isinstance(each, PadSample) and each.pad != pad])
        for t, s in _touches(events, pad):
            for begin, top, end in _descents(s):
                first = top + int(np.flatnonzero(s[top:end] > s[top] - _AT_TOP)[-1]) + 1
                bottom = first + int(np.argmax(s[first:end] < s[end - 1] + _AT_BOTTOM))
                last = min(bottom, first + int(np.searchsorted(t[first:end], _next(other, float(t[first])))))
                if last - first < LEAST_READINGS or s[first] - s[last - 1] < LEAST_TRAVEL:
                    short += 1
                    continue
                rest = float(np.median(s[begin:first][s[begin:first] > s[top] - _AT_TOP]))
                rolls.append(Roll(1 if pad == 1 else 2, float(phi[pad - 1]), rest, t[begin:last], s[begin:last]))
    return sorted(rolls, key=lambda roll: float(roll.t[0])), short


def accelerate(roll: Roll, noise: float) -> Acceleration | None:
    """The least squares of (2), without readings that are grossly off; None for a roll that is not smooth.

    noise: one sigma of a position (m), rounding included; less is never believed of the readings.
    """
    t = roll.t - float(roll.t[-1])
    basis = np.stack([np.ones_like(t), t, 0.5 * t * t], axis=1)
    # the first reading below was chosen for being low, which would bias the curve: it is left out as well
    rolling = np.arange(len(t)) > np.flatnonzero(roll.s > roll.rest - _PARTED)[-1] + 1
    kept = rolling
    for _ in range(_ROUNDS):
        if kept.sum() < LEAST_READINGS:
            return None
        found = np.linalg.lstsq(basis[kept], roll.s[kept], rcond=None)[0]
        left = roll.s - basis @ found
        spread = max(1.4826 * float(np.median(np.abs(left[kept]))), noise)
        again = rolling & (np.abs(left) < _GROSS * spread)
        if (again == kept).all():
            break
        kept = again
    count, left_out = int(kept.sum()), int((rolling & ~kept).sum())
    rms = math.sqrt(float(left[kept] @ left[kept]) / (count - 3))
    if rms > _ROUGH or left_out > count or found[2] >= 0.0:
        return None
    variance = np.linalg.inv(basis[kept].T @ basis[kept])[2, 2]
    a_sd = max(rms, noise) * math.sqrt(float(variance))
    return Acceleration(roll.pad, roll.phi, float(found[2]), a_sd, rms, count, left_out)


def fit_gravity(rolls: Sequence[Acceleration], kind: RollerKind) -> GravityFit:
    """The weighted least squares of (1) over all rolls that are like the others.

    Raises TooFewRollsError unless both palms have rolls enough, on slopes that are far enough apart.
    """
    _refuse_too_few(rolls)
    phi, a, sd = (np.array([getattr(roll, name) for roll in rolls]) for name in ("phi", "a", "a_sd"))
    kept = np.ones(len(rolls), dtype=bool)
    x = np.array([9.81, 0.0, 0.0])
    for _ in range(_ROUNDS):
        x = _solved(phi[kept], a[kept], sd[kept], INERTIA[kind], x)
        left = (a - _model(phi, INERTIA[kind], x)) / sd
        spread = max(1.4826 * float(np.median(np.abs(left[kept]))), 1.0)
        again = np.abs(left) < _STRANGE * spread
        if (again == kept).all():
            break
        kept = again
    used = tuple(roll for roll, keep in zip(rolls, kept, strict=True) if keep)
    _refuse_too_few(used)
    scatter = math.sqrt(float(left[kept] @ left[kept]) / (len(used) - 3))
    weighted = _jacobian(phi[kept], INERTIA[kind], x) / sd[kept, None]
    sds = np.sqrt(np.diag(np.linalg.inv(weighted.T @ weighted))) * max(scatter, 1.0)
    (g, delta, resistance), (g_sd, delta_sd, resistance_sd) = map(float, x), map(float, sds)
    return GravityFit(
        g, delta, resistance, g_sd, delta_sd, resistance_sd, scatter, used, strange=len(rolls) - len(used)
    )


def slope(pad: int, phi: float) -> float:
    """How steeply a palm falls towards the hinge (rad), as the daemon believes."""
    return phi if pad == 1 else math.pi - phi


def causes(too_short: int, rough: int, strange: int) -> Counter[str]:
    """How many rolls were left out, by cause; causes without any are not named."""
    return +Counter({TOO_SHORT: too_short, ROUGH: rough, STRANGE: strange})


def _refuse_too_few(rolls: Sequence[Acceleration]) -> None:
    spread = 0.0
    for pad in PALMS:
        slopes = [slope(pad, roll.phi) for roll in rolls if roll.pad == pad]
        if len(slopes) < LEAST_PER_PALM:
            raise TooFewRollsError(
                f"{len(slopes)} of at least {LEAST_PER_PALM} good rolls on palm {pad}: lay the roller at its upper"
                " end, let go without a push, and let it come to the hinge"
            )
        spread = max(spread, max(slopes) - min(slopes))
    if spread < LEAST_SLOPES:
        raise TooFewRollsError(
            f"on each palm all slopes are within {math.degrees(spread):.1f}°, which does not tell resistance from"
            " gravity: widen the limits of the palms' angles"
        )


def _touches(events: Sequence[Event], pad: int) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Times and distances of each touch of a pad; it ends with a PadLift or silence."""
    touch: list[tuple[float, float]] = []
    for event in events:
        if not isinstance(event, PadSample | PadLift) or event.pad != pad:
            continue
        if touch and (isinstance(event, PadLift) or event.t_sample - touch[-1][0] > _SILENCE):
            yield _arrays(touch)
            touch = []
        if isinstance(event, PadSample):
            touch.append((event.t_sample, event.s))
    if touch:
        yield _arrays(touch)


def _arrays(touch: Sequence[tuple[float, float]]) -> tuple[FloatArray, FloatArray]:
    t, s = np.array(touch, dtype=np.float64).T
    return t, s


def _descents(s: FloatArray) -> Iterator[tuple[int, int, int]]:
    """Ways from a highest point to a lowest, without going up by `_REVERSAL`; falls of more only.

    Of each its beginning, which is the way up to the highest point, that point, and its end.
    """
    begin = high = low = 0
    for i in range(len(s)):
        if s[i] < s[low]:
            low = i
        elif s[i] > s[low] + _REVERSAL or (s[i] >= s[high] and s[high] - s[low] < _REVERSAL):
            if s[high] - s[low] > _REVERSAL:
                yield begin, high, low + 1
                begin = low + 1
            high = low = i
    if len(s) and s[high] - s[low] > _REVERSAL:
        yield begin, high, low + 1


def _next(times: FloatArray, t: float) -> float:
    later = times[times >= t]
    return float(later[0]) if len(later) else math.inf


def _model(phi: FloatArray, inertia: float, x: FloatArray) -> FloatArray:
    """Accelerations by (1) for x = (g, δ, μ)."""
    g, delta, mu = x
    return np.asarray(-g / inertia * (np.sin(phi + delta) - mu * np.abs(np.cos(phi + delta))))


def _jacobian(phi: FloatArray, inertia: float, x: FloatArray) -> FloatArray:
    g, delta, mu = x
    s, c = np.sin(phi + delta), np.cos(phi + delta)
    along = np.sign(c)
    return np.stack([-(s - mu * np.abs(c)), -g * (c + mu * along * s), g * np.abs(c)], axis=1) / inertia


def _solved(phi: FloatArray, a: FloatArray, sd: FloatArray, inertia: float, x: FloatArray) -> FloatArray:
    for _ in range(_ROUNDS):
        left = (a - _model(phi, inertia, x)) / sd
        step = np.linalg.lstsq(_jacobian(phi, inertia, x) / sd[:, None], left, rcond=None)[0]
        x = x + step
        if float(np.abs(step).max()) < 1e-12:
            break
    return x
