"""Fit of `model.friction.STICKING`: mean direction of a contact that its own friction makes stick at its reversals.

For a drive D (in units of the vibration's speed) and a mean direction σ the mean slip is exact: of a contact that never
sticks in closed form, of others after a period. The polynomial is fitted to the inverse, together with
`rippled_directions`, which decides where a contact sticks. Prints the present and the fitted coefficients, and the
errors of both.

Usage: python -m tools.fit_sticking
"""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
from scipy.optimize import least_squares

from palmd.events import FloatArray
from palmd.model import friction

STEPS, PERIODS = 20_000, 6  # per period; sticking forgets the start within one
DRIVES = np.r_[0.1:0.5:0.1, 0.5:5.3:0.25]
DIRECTIONS = np.r_[0.005, 0.025:0.97:0.025]  # beyond, the smooth kink of the mean direction is off by up to 0.09


def mean_slips(direction: FloatArray, drive: FloatArray) -> FloatArray:
    """Mean slips (in units of the vibration's speed) with these mean directions and drives."""
    forwards, backwards = drive * (1 - direction) / math.tau, drive * (1 + direction) / math.tau
    slip, total, stuck = np.zeros_like(direction), np.zeros_like(direction), np.zeros(direction.shape, dtype=bool)
    dt = math.tau / STEPS
    for k in range(PERIODS * STEPS):
        vibration = -math.sin((k + 0.5) * dt)
        ahead, behind = vibration - forwards, vibration + backwards
        forward, backward = (slip > 0) | ((slip == 0) & (ahead > 0)), (slip < 0) | ((slip == 0) & (behind < 0))
        then = slip + dt * np.where(forward, ahead, np.where(backward, behind, 0.0))
        then[(slip != 0) & (slip * then <= 0)] = 0.0
        if k >= (PERIODS - 1) * STEPS:
            total += (slip + then) / 2
            stuck |= ~(forward | backward)
        slip = then
    share = np.cos(math.pi / 2 * direction)
    tip = drive / 4 * (1 - direction**2) / share  # of the ripple, relative to where a contact reverses without it
    free = np.sin(math.pi / 2 * direction) * np.sqrt(np.maximum(1 - tip**2, 0.0))
    return np.where(stuck, total / STEPS, free)


def law(slip: FloatArray, drive: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Mean directions of the model for these coefficients."""
    friction.STICKING = tuple(map(tuple, coefficients.reshape(np.shape(friction.STICKING)).tolist()))  # type: ignore
    u, d, none = ca.SX.sym("u"), ca.SX.sym("d"), ca.SX(0)
    (direction, _), _ = friction.rippled_directions(
        [u, none], ca.SX(1), lambda _: [[-d, none], [none, none]], none, steps=3
    )
    return np.asarray(ca.Function("law", [u, d], [direction])(slip[None], drive[None]))[0]


def main() -> None:
    """Print the fit, from the present coefficients on."""
    direction, drive = (each.ravel() for each in np.meshgrid(DIRECTIONS, DRIVES))
    slip = mean_slips(direction, drive)
    used = (slip > 0) & (slip < 1)
    direction, drive, slip = direction[used], drive[used], slip[used]
    present = np.ravel(friction.STICKING)
    fit = least_squares(lambda c: law(slip, drive, c) - direction, present)
    for name, coefficients in (("present", present), ("fitted", fit.x)):
        print(f"{name}: {coefficients.reshape(np.shape(friction.STICKING)).round(4).tolist()}")
        errors = law(slip, drive, coefficients) - direction
        for low, high in ((0.0, 0.3), (0.3, 1.3), (1.3, 2.6), (2.6, 4.0), (4.0, friction.MOST_DRIVE)):
            part = errors[(drive >= low) & (drive < high)]
            print(f"  D {low:g} to {high:g}: {np.sqrt(np.mean(part**2)):.4f} RMS, {np.abs(part).max():.4f} at most")


if __name__ == "__main__":
    main()
