"""Independent friction law of vibrating palms (docs/theory/vibration.md) in NumPy, to test the compiled models.

Columns, real or complex, are independent bodies.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from palmd.model.friction import KINK, LEAST_DIRECTION, LEAST_DRIVE, LEAST_RIPPLE, RELAXED

Array = npt.NDArray[Any]  # real or complex

SIGN_PAIRS = ((1, 1), (1, -1), (-1, 1), (-1, -1))


def by_sign(spin: Mapping[tuple[int, int], Array]) -> Array:
    """Change of α0 when the slip sign of contact 1, and of contact 2, goes from −1 to 1."""
    return np.array([sum(signs[contact] * of for signs, of in spin.items()) for contact in range(2)])


def rippled_directions(
    slip: Array, speed: Array, drive: Array, kappa: float | Array, steps: int = 1
) -> tuple[Array, Array]:
    """Mean direction of each slip, and the lag of contact 1 behind contact 2 in periods, caused by the body's ripple.

    drive[i, j]: change of slip i (m/s) in a period driven by the sign of contact j.
    """
    together, apart = np.abs(kappa), 1 - np.abs(kappa)
    half = np.where(np.asarray(kappa) > 0, 0.0, 0.5)
    mean, late = mean_direction(slip / speed), np.zeros_like(slip)
    for step in range(steps):
        p = (1 + mean) / 2
        found, lags = np.empty_like(mean), np.empty_like(mean)
        for i, j in ((0, 1), (1, 0)):
            own, other = drive[i, i] * p[i] * (1 - p[i]), drive[i, j] * p[j] * (1 - p[j])
            stray = apart * np.where(other.real < 0, -other, other) / math.sqrt(3)
            spread = apart * np.sqrt(own**2 + other**2 / 3 + LEAST_RIPPLE**2)
            tips, swings = [], []
            for side in (1, -1):
                swing = together * drive[i, j] * _swung(half + late[i] - late[j] + side * p[i] / 2, p[j])
                w = swing + side * (together * own - spread)
                w = np.where(w.real > speed.real, speed, np.where(w.real < -speed.real, -speed, w))
                tips.append(mean_direction((slip[i] + w) / speed))
                swings.append(swing)
            least = LEAST_DRIVE * speed
            own_drive = np.where(-drive[i, i].real > least.real, -drive[i, i], least)
            middle = (tips[0] + tips[1]) / 2
            ahead = _beyond(speed - slip[i] - swings[1], stray, own_drive)
            behind = _beyond(speed + slip[i] + swings[0], stray, own_drive)
            drives = np.where(-drive[i, i].real > LEAST_RIPPLE, -drive[i, i], LEAST_RIPPLE)
            sticking = 1 / (1 + (least / drives) ** 4)
            found[i] = middle + sticking * (positive(ahead - positive(middle)) - positive(behind - positive(-middle)))
            lags[i] = (tips[0] - tips[1]) / 8
        part = RELAXED if step else 1.0
        mean, late = mean + part * (found - mean), late + part * (lags - late)
    return mean, late[0] - late[1]


def softened_direction(slip: Array, speed: Array, drive: Array) -> Array:
    """Mean direction of each slip for a vibration reduced by the amount that the ripple steepens it."""
    swing = [np.sqrt(drive[i, i] ** 2 + drive[i, 1 - i] ** 2 / 3) / 4 for i in range(2)]
    return mean_direction(np.array([u * np.sqrt(speed**2 + a**2) / speed**2 for u, a in zip(slip, swing, strict=True)]))


def _swung(x: Array, share: Array) -> Array:
    """Integral of (sign − mean) over periods, for a sign that is positive for a share of the period about x = 0."""
    x = x - np.floor(x.real + 0.5)
    side = np.where(x.real < 0, -1, 1)
    inside = np.abs(x.real) < share.real / 2
    return np.asarray(np.where(inside, 2 * (1 - share) * x, share * (side - 2 * x)))


def _beyond(room: Array, stray: Array, drive: Array) -> Array:
    """Smallest mean direction of a contact whose ripple is limited to this room, ± stray."""
    squares = (1 - 4 * positive(each) / drive for each in (room + stray, room - stray))
    one, two = (np.sqrt(np.where(each.real > LEAST_DIRECTION**2, each, LEAST_DIRECTION**2)) for each in squares)
    return np.asarray((one + two) / 2 - 2 * LEAST_DIRECTION)


def mean_direction(x: Array) -> Array:
    """Mean sign of x + cos τ over a period, its kinks at |x| = 1 smoothed over `KINK`."""
    cosh = (np.sqrt((x + 1) ** 2 + KINK**2) + np.sqrt((x - 1) ** 2 + KINK**2)) / 2
    return np.asarray(2 / math.pi * np.arctan(x / KINK * np.sqrt(cosh**2 - 1) / cosh))


def sign_shares(mean: Array, kappa: float | Array, lag: Array) -> Iterator[tuple[tuple[int, int], Array]]:
    """Pairs of slip signs with their shares of time: independent slips, and with weight |κ| two arcs of one period."""
    p1, p2 = (1 + mean) / 2
    late = 2 * np.where(lag.real < 0, -lag, lag)
    lesser = 2 * np.where(p1.real < p2.real, p1, p2)

    def overlap(x: Array) -> Array:
        left = p1 + p2 - x
        return positive(np.where(left.real < lesser.real, left, lesser)) / 2

    in_antiphase, in_phase = overlap(late) + overlap(2 - late), overlap(1 - late) + overlap(1 + late)
    arcs = np.where(np.asarray(kappa) > 0, in_antiphase, in_phase)
    both = (1 - np.abs(kappa)) * p1 * p2 + np.abs(kappa) * arcs
    yield from zip(SIGN_PAIRS, (both, p1 - both, p2 - both, 1 - p1 - p2 + both), strict=True)


def positive(value: Array) -> Array:
    """The values, clipped below at 0."""
    return np.where(value.real > 0.0, value, 0.0)
