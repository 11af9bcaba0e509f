"""What lies on a side on one palm, a corner on the other: where both palms feel it, by geometry and balance. Pure.

It turns with the palm that it lies on, so its motion is that of the palms. In that palm's frame (x from the hinge
outwards, y towards the object; mirrored for palm 2) the corner's centre is at x_c = (Y cos φ2 + ρ)/sin φ2 and Y, and
the centre of mass at x_c + a and H. The other palm reads (Y + ρ cos φ2)/sin φ2. Newton's law gives the force on either
palm, with friction μ σ(u) as everywhere, and the torques about the centre of mass where on its side the object stands:
that the ridden palm reads, and it tells a and H. Nothing is integrated. Not for use inside the loop.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.model.friction import averaged_direction, mean_direction, sign_shares
from palmd.observer.record import Record
from palmd.observer.rides import Ride, unexplained
from palmd.system.mechanism import JOINTS, OPENING, PALMS
from palmd.system.vibration import VibrationLaw

SEAT, SHARED = 4, 3
"""How many numbers: Y, ρ, a, H (m); and ln of the radius of gyration (m), μ, ln of the dither's speed (m/s)."""
STEPS = (*(1e-6,) * SEAT, *(1e-4,) * SHARED)  # for slopes
WINDOW_SIGMAS, MOST = 4.0, 10.0  # of χ² in a window, beyond which it rocks; a residual's share of it
LEAST_READINGS = 16  # of either pad

Marks = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Carried:
    """A frame that turns with a palm, at n times: all that the balance needs of the palms' motion.

    pull: gravity less the hinge's acceleration, along the palm and out of it (n, 2; m/s²). spin, turn: the frame's rate
    and acceleration (n; rad/s, rad/s²), from x to y. opening: φ2, its rate and acceleration (n, 3).
    """

    pull: FloatArray
    spin: FloatArray
    turn: FloatArray
    opening: FloatArray

    @classmethod
    def by(cls, palm: int, palms: FloatArray, rig: FloatArray) -> Carried:
        """By `palm` (0, 1) of palms (n, 6), both as a `Record` has them."""
        motion = palms.reshape(len(palms), 3, len(JOINTS))
        first, rate, turn = motion[:, :, 0].T
        phi, spin, spun = motion[:, :, : palm + 1].sum(axis=2).T
        gravity, arm = rig[:2]
        x = -arm * (turn * np.sin(first) + rate**2 * np.cos(first))
        y = -gravity + arm * (turn * np.cos(first) - rate**2 * np.sin(first))
        side = (1.0, -1.0)[palm]
        pull = np.stack([x * np.cos(phi) + y * np.sin(phi), side * (y * np.cos(phi) - x * np.sin(phi))], axis=1)
        return cls(pull, side * spin, side * spun, motion[:, :, OPENING])


@dataclass(frozen=True, slots=True)
class Balance:
    """Where the other palm and the ridden one feel it, s (n; m), and how hard they press, per unit mass (n; m/s²)."""

    other: FloatArray
    ridden: FloatArray
    other_force: FloatArray
    ridden_force: FloatArray


def balance(seat: FloatArray, shared: FloatArray, carried: Carried, law: VibrationLaw = "sign_pairs") -> Balance:
    """Of what lies as `seat` says (`SEAT` numbers) and rubs and turns as `shared` says (`SHARED`).

    Means over the palms' vibrations, which are taken to be independent.
    """
    high, radius, away, height = seat
    gyration2, mu, dither = np.exp(2.0 * shared[0]), shared[1], np.exp(shared[2])
    phi, rate, turn = carried.opening.T
    sin, cos = np.sin(phi), np.cos(phi)
    other = (high + radius * cos) / sin
    centre = (high * cos + radius) / sin
    slips = -other / sin * rate  # along the ridden palm, as its centre of mass and its corner do
    x = centre + away
    along = -other / sin * turn + (radius / sin + 2.0 * other * cos / sin**2) * rate**2
    along = along - carried.turn * height - carried.spin**2 * x - carried.pull[:, 0]
    out = carried.turn * x + 2.0 * carried.spin * slips - carried.spin**2 * height - carried.pull[:, 1]
    lever = centre - radius * sin - x, high + radius * cos - height
    means = np.zeros((3, len(phi)))
    for share, direction, other_direction in _directions(slips, slips * cos, dither, law):
        rubs, other_rubs = mu * direction, mu * other_direction
        push = np.stack([sin - other_rubs * cos, -cos - other_rubs * sin])  # of the other palm, by its normal force
        other_force = (along + rubs * out) / (push[0] + rubs * push[1])
        ridden_force = out - push[1] * other_force
        torque = (lever[0] * push[1] - lever[1] * push[0]) * other_force - height * rubs * ridden_force
        means += share * np.stack([other_force, ridden_force, torque])
    other_force, ridden_force, torque = means
    ridden = x + (gyration2 * carried.turn - torque) / ridden_force
    return Balance(other, ridden, other_force, ridden_force)


def _directions(
    slip: FloatArray, other: FloatArray, dither: float, law: VibrationLaw
) -> Iterator[tuple[FloatArray | float, FloatArray | float, FloatArray | float]]:
    """(share of the time, direction of slip on the ridden palm, on the other) for slips (n; m/s); dither is πV/2."""
    if law == "averaged":
        yield 1.0, averaged_direction(slip, dither, np), averaged_direction(other, dither, np)
        return
    sigma = [mean_direction(math.pi / 2 * u / dither, np) for u in (slip, other)]
    for share, (one, two) in zip(sign_shares(sigma, 0.0, xp=np), itertools.product((1.0, -1.0), repeat=2), strict=True):
        yield share, one, two


@dataclass(frozen=True, slots=True)
class RideReadings:
    """The readings of both pads in one ride, for as long as the object lies still; s and one-sigma in m.

    on_ridden: which of them are the ridden palm's. law: of friction.
    """

    ride: Ride
    t: FloatArray
    s: FloatArray
    sd: FloatArray
    on_ridden: Marks
    carried: Carried
    law: VibrationLaw = "sign_pairs"

    @classmethod
    def of(cls, record: Record, ride: Ride, trim: float, law: VibrationLaw = "sign_pairs") -> RideReadings:
        """Of `record`, but for so long (s) at either end."""
        t = record.contact_t
        mine = (t > ride.start + trim) & (t < ride.end - trim)
        carried = Carried.by(ride.palm, record.contact_palms[mine], record.rig)
        on_ridden = record.contact_pad[mine] == PALMS[ride.palm]
        return cls(
            ride, t[mine], record.contact_value[mine], np.sqrt(record.contact_variance[mine]), on_ridden, carried, law
        )

    def residuals(self, seat: FloatArray, shared: FloatArray) -> FloatArray:
        """Of all readings (n), in one-sigmas."""
        there = balance(seat, shared, self.carried, self.law)
        return (np.where(self.on_ridden, there.ridden, there.other) - self.s) / self.sd

    def slopes(self, seat: FloatArray, shared: FloatArray) -> FloatArray:
        """The same by seat and shared numbers: (n, SEAT + SHARED)."""
        both, columns = np.concatenate([seat, shared]), []
        for i, step in enumerate(STEPS):
            after, before = both.copy(), both.copy()
            after[i] += step
            before[i] -= step
            ahead, behind = (self.residuals(each[:SEAT], each[SEAT:]) for each in (after, before))
            columns.append((ahead - behind) / (2.0 * step))
        return np.stack(columns, axis=1)

    @property
    def openings(self) -> tuple[float, float]:
        """The least φ2 and the largest (rad)."""
        phi = self.carried.opening[:, 0]
        return float(phi.min()), float(phi.max())

    def still(self, seat: FloatArray, shared: FloatArray) -> Marks:
        """Which of the readings are explained, and none about them is not: elsewhere the object rocks or tips."""
        residuals, kept = self.residuals(seat, shared), np.ones(len(self.t), dtype=np.bool_)
        for mine in (self.on_ridden, ~self.on_ridden):
            squares = np.minimum(residuals[mine] ** 2, MOST**2)
            for start, end in unexplained(self.t[mine], squares, WINDOW_SIGMAS):
                kept &= (self.t < start) | (self.t > end)
        return kept

    @property
    def enough(self) -> bool:
        """Whether there are readings enough of both pads."""
        on_ridden = int(self.on_ridden.sum())
        return min(on_ridden, len(self.t) - on_ridden) >= LEAST_READINGS

    def only(self, kept: Marks) -> RideReadings:
        """The same of some of its readings."""
        carried = Carried(*(getattr(self.carried, name)[kept] for name in ("pull", "spin", "turn", "opening")))
        at = {name: getattr(self, name)[kept] for name in ("t", "s", "sd", "on_ridden")}
        return replace(self, carried=carried, **at)
