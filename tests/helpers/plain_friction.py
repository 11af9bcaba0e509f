"""Independent friction law of vibrating palms (docs/theory/vibration.md) in NumPy, to test the compiled models.

Columns, real or complex, are independent bodies.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from palmd.model.friction import (
    KINK,
    LEAST_RIPPLE,
    MOST_DRIVE,
    RELAXED,
    STICKING,
    STICKING_AT_REST,
    STICKING_DRIVE,
)

Array = npt.NDArray[Any]  # real or complex

SIGN_PAIRS = ((1, 1), (1, -1), (-1, 1), (-1, -1))


def by_sign(spin: Mapping[tuple[int, int], Array], p: Array) -> Array:
    """Change of α0 when the slip sign of contact 1, and of contact 2, goes from −1 to 1.

    p: share of the time in which the other contact's sign is positive, for each other contact.
    """
    changes = []
    for contact in range(2):
        other = {sign: p[1 - contact] if sign > 0 else 1 - p[1 - contact] for sign in (1, -1)}
        changes.append(sum(signs[contact] * other[signs[1 - contact]] * of for signs, of in spin.items()))
    return np.array(changes)


def rippled_directions(
    slip: Array, speed: Array, drive_of: Callable[[Array], Array], kappa: float | Array, steps: int = 1
) -> tuple[Array, Array]:
    """Mean direction of each slip, and the lag of contact 1 behind contact 2 in periods, caused by the body's ripple.

    drive_of: from the shares of positive signs, [i, j] the change of slip i (m/s) in a period driven by the sign of
    contact j.
    """
    together, apart = np.abs(kappa), 1 - np.abs(kappa)
    half = np.where(np.asarray(kappa) > 0, 0.0, 0.5)
    mean, late = mean_direction(slip / speed), np.zeros_like(slip)
    for step in range(steps):
        p = (1 + mean) / 2
        drive = drive_of(together / 2 + apart * p)
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
            middle, size = slip[i] + (swings[0] + swings[1]) / 2, own_drive(drive[i, i], speed)
            stuck = sum(sticking_direction((middle + side * stray) / speed, size) for side in (1, -1)) / 2
            found[i] = either(np.asarray((tips[0] + tips[1]) / 2), np.asarray(stuck), middle, size)
            lags[i] = (tips[0] - tips[1]) / 8
        part = RELAXED if step else 1.0
        mean, late = mean + part * (found - mean), late + part * (lags - late)
    return mean, late[0] - late[1]


def own_drive(drive: Array, speed: Array) -> Array:
    """Drive of a slip by its own sign, positive where friction resists, in units of the vibration's speed."""
    size = -drive / speed
    return np.where(size.real > 0.0, np.where(size.real < MOST_DRIVE, size, MOST_DRIVE), 0.0)


def sticking_direction(x: Array, drive: Array) -> Array:
    """Mean direction of a contact that sticks at each reversal: a polynomial fit."""
    x = np.where(x.real > 1.0, 1.0, np.where(x.real < -1.0, -1.0, x))
    size = np.where(x.real < 0.0, -x, x)
    powers = [((drive - 3.5) / 2) ** j for j in range(len(STICKING[0]))]
    bend = sum(c * z * size**i for i, row in enumerate(STICKING) for c, z in zip(row, powers, strict=True))
    return np.asarray(x + x * (1 - size) * bend)


def either(free: Array, stuck: Array, slip: Array, drive: Array) -> Array:
    """The direction without sticking or with it: the larger one in slow drives, the latter in fast ones."""
    side = np.where(slip.real > 0.0, 1.0, -1.0) * (slip.real != 0.0)
    more = side * positive(side * (stuck - free))
    always = always_stuck(drive)
    noticed = 1 / (1 + (STICKING_DRIVE / np.where(drive.real > 1e-3, drive, 1e-3)) ** 4)
    return np.asarray(free + noticed * (more * (1 - always) + always * (stuck - free)))


def always_stuck(drive: Array) -> Array:
    """Whether a contact sticks at its reversals even in slow slip, 0 to 1."""
    return np.asarray(1 / (1 + (STICKING_AT_REST / np.where(drive.real > 1e-3, drive, 1e-3)) ** 24))


def softened_direction(slip: Array, speed: Array, drive: Array) -> Array:
    """Mean direction of each slip without iterations: steeper than without a ripple, or that of one that sticks."""
    found = []
    for i, u in enumerate(slip):
        own = own_drive(drive[i, i], speed)
        free = mean_direction(u / speed * np.sqrt(1 + (own**2 + (drive[i, 1 - i] / speed) ** 2 / 3) / 16))
        found.append(free + always_stuck(own) * (sticking_direction(u / speed, own) - free))
    return np.array(found)


def _swung(x: Array, share: Array) -> Array:
    """Integral of (sign − mean) over periods, for a sign that is positive for a share of the period about x = 0."""
    x = x - np.floor(x.real + 0.5)
    side = np.where(x.real < 0, -1, 1)
    inside = np.abs(x.real) < share.real / 2
    return np.asarray(np.where(inside, 2 * (1 - share) * x, share * (side - 2 * x)))


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
