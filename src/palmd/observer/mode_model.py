"""Measurement model of an object that lies with a side on one palm and touches the other palm with a corner. Pure.

It turns with the palm that it lies on, the supporting palm, so its motion is that of the palms. In that palm's frame (x
from the hinge outwards, y towards the object; mirrored for palm 2) the corner's centre is at x_c = (Y cos φ2 + ρ)/sin
φ2 and Y, and the centre of mass at x_c + a and H. The other palm reads (Y + ρ cos φ2)/sin φ2. Newton's law gives the
force on either palm, with friction μ σ(u) as everywhere. The torques about the centre of mass give where on its side
the object stands: that is what the supporting palm reads, and it determines a and H. Nothing is integrated. Not for use
inside the loop.
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
from palmd.observer.mode_segments import ModeSegment, rejected_windows
from palmd.observer.record import Record
from palmd.system.mechanism import JOINTS, OPENING, PALMS
from palmd.system.vibration import VibrationLaw

MODE_PARAMETERS, SHARED = 4, 3
"""How many mode parameters: Y, ρ, a, H (m); shared numbers: ln radius of gyration (m), μ, ln dither speed (m/s)."""
STEPS = (*(1e-6,) * MODE_PARAMETERS, *(1e-4,) * SHARED)  # for difference quotients
# of χ² in a window, beyond which the object rocks; largest normalised residual that is added to it
WINDOW_SIGMAS, MOST = 4.0, 10.0
LEAST_READINGS = 16  # of each pad

Marks = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class SupportFrame:
    """Motion of a frame that turns with the supporting palm, at n times: all that the balance of forces needs.

    pull: gravity less the hinge's acceleration, along the palm and out of it (n, 2; m/s²). spin, turn: the frame's rate
    and acceleration (n; rad/s, rad/s²), from x to y. opening: φ2, its rate and acceleration (n, 3).
    """

    pull: FloatArray
    spin: FloatArray
    turn: FloatArray
    opening: FloatArray

    @classmethod
    def by(cls, palm: int, palms: FloatArray, rig: FloatArray) -> SupportFrame:
        """The frame of `palm` (0, 1); palms (n, 6) and rig as in a `Record`."""
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
    """Predicted contacts on the other and the supporting palm (n; m), and forces on them per unit mass (n; m/s²)."""

    other: FloatArray
    support: FloatArray
    other_force: FloatArray
    support_force: FloatArray


def balance(mode: FloatArray, shared: FloatArray, carried: SupportFrame, law: VibrationLaw = "sign_pairs") -> Balance:
    """Predict contacts and forces for mode parameters `mode` and shared numbers `shared`.

    Means over the palms' vibrations, which are taken to be independent.
    """
    height_c, radius, offset, height_m = mode
    gyration2, mu, dither = np.exp(2.0 * shared[0]), shared[1], np.exp(shared[2])
    phi, rate, turn = carried.opening.T
    sin, cos = np.sin(phi), np.cos(phi)
    other = (height_c + radius * cos) / sin
    centre = (height_c * cos + radius) / sin
    slip = -other / sin * rate  # speed of centre of mass and corner along the supporting palm
    x = centre + offset
    tangential = -other / sin * turn + (radius / sin + 2.0 * other * cos / sin**2) * rate**2
    tangential = tangential - carried.turn * height_m - carried.spin**2 * x - carried.pull[:, 0]
    normal = carried.turn * x + 2.0 * carried.spin * slip - carried.spin**2 * height_m - carried.pull[:, 1]
    lever = centre - radius * sin - x, height_c + radius * cos - height_m
    means = np.zeros((3, len(phi)))
    for share, direction, other_direction in _directions(slip, slip * cos, dither, law):
        friction, other_friction = mu * direction, mu * other_direction
        # of the other palm, per unit normal force
        push = np.stack([sin - other_friction * cos, -cos - other_friction * sin])
        other_force = (tangential + friction * normal) / (push[0] + friction * push[1])
        support_force = normal - push[1] * other_force
        torque = (lever[0] * push[1] - lever[1] * push[0]) * other_force - height_m * friction * support_force
        means += share * np.stack([other_force, support_force, torque])
    other_force, support_force, torque = means
    support = x + (gyration2 * carried.turn - torque) / support_force
    return Balance(other, support, other_force, support_force)


def _directions(
    slip: FloatArray, other: FloatArray, dither: float, law: VibrationLaw
) -> Iterator[tuple[FloatArray | float, FloatArray | float, FloatArray | float]]:
    """(share of time, slip's direction on the supporting palm, on the other) for slips (n; m/s); dither is πV/2."""
    if law == "averaged":
        yield 1.0, averaged_direction(slip, dither, np), averaged_direction(other, dither, np)
        return
    sigma = [mean_direction(math.pi / 2 * u / dither, np) for u in (slip, other)]
    for share, (one, two) in zip(sign_shares(sigma, 0.0, xp=np), itertools.product((1.0, -1.0), repeat=2), strict=True):
        yield share, one, two


@dataclass(frozen=True, slots=True)
class SegmentReadings:
    """The readings of both pads in one segment; s and its 1σ in m.

    on_support: which readings are of the supporting palm. law: of friction.
    """

    segment: ModeSegment
    t: FloatArray
    s: FloatArray
    sd: FloatArray
    on_support: Marks
    frame: SupportFrame
    law: VibrationLaw = "sign_pairs"

    @classmethod
    def of(cls, record: Record, segment: ModeSegment, trim: float, law: VibrationLaw = "sign_pairs") -> SegmentReadings:
        """The readings of `record` in `segment`, without `trim` (s) at either end."""
        t = record.contact_t
        during = (t > segment.start + trim) & (t < segment.end - trim)
        frame = SupportFrame.by(segment.palm, record.contact_palms[during], record.rig)
        on_support = record.contact_pad[during] == PALMS[segment.palm]
        return cls(
            segment,
            t[during],
            record.contact_value[during],
            np.sqrt(record.contact_variance[during]),
            on_support,
            frame,
            law,
        )

    def residuals(self, mode: FloatArray, shared: FloatArray) -> FloatArray:
        """Residuals of all readings (n), normalised by their 1σ."""
        predicted = balance(mode, shared, self.frame, self.law)
        return (np.where(self.on_support, predicted.support, predicted.other) - self.s) / self.sd

    def slopes(self, mode: FloatArray, shared: FloatArray) -> FloatArray:
        """Derivatives of the residuals by mode parameters and shared numbers: (n, MODE_PARAMETERS + SHARED)."""
        both, columns = np.concatenate([mode, shared]), []
        for i, step in enumerate(STEPS):
            after, before = both.copy(), both.copy()
            after[i] += step
            before[i] -= step
            ahead, behind = (self.residuals(each[:MODE_PARAMETERS], each[MODE_PARAMETERS:]) for each in (after, before))
            columns.append((ahead - behind) / (2.0 * step))
        return np.stack(columns, axis=1)

    @property
    def openings(self) -> tuple[float, float]:
        """Least and largest φ2 (rad)."""
        phi = self.frame.opening[:, 0]
        return float(phi.min()), float(phi.max())

    def still(self, mode: FloatArray, shared: FloatArray) -> Marks:
        """Readings that are explained, as are all within a window about them; elsewhere the object rocks or tips."""
        residuals, kept = self.residuals(mode, shared), np.ones(len(self.t), dtype=np.bool_)
        for of_palm in (self.on_support, ~self.on_support):
            squares = np.minimum(residuals[of_palm] ** 2, MOST**2)
            for start, end in rejected_windows(self.t[of_palm], squares, WINDOW_SIGMAS):
                kept &= (self.t < start) | (self.t > end)
        return kept

    @property
    def enough(self) -> bool:
        """Whether both pads have enough readings."""
        on_support = int(self.on_support.sum())
        return min(on_support, len(self.t) - on_support) >= LEAST_READINGS

    def only(self, kept: Marks) -> SegmentReadings:
        """The same with these readings only."""
        frame = SupportFrame(*(getattr(self.frame, name)[kept] for name in ("pull", "spin", "turn", "opening")))
        arrays = {name: getattr(self, name)[kept] for name in ("t", "s", "sd", "on_support")}
        return replace(self, frame=frame, **arrays)
