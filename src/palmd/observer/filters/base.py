"""What a bank of filters offers whoever feeds it, whatever its state, and what is common to all of them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from palmd.events import FloatArray, PadSample, PalmSample
from palmd.model import shape
from palmd.observer.bank import Bank, Belief
from palmd.observer.palms import TrackedPalms
from palmd.observer.prior import BlindStart

LONGEST_STEP_S = 0.0061  # of one integration step: readings of one pad come every 10 ms
CURVATURE_NORMALS = 72
SMALLEST_RADIUS_M = 1e-3  # below which a filter's mean radius is not taken at its word
GUESSED_ACCELERATION_SD = 2.0  # rad/s², of palms and object while the palms' motion is guessed


@dataclass(frozen=True, slots=True)
class Overconfidence:
    """How overconfident a young filter is: its true errors are 1 + excess · exp(−age/lasts_s) of its own sigmas.

    Linearising about a blind guess costs more than a covariance can know. Measured over simulated runs of the kind
    `nominal`, as the root mean square of error over sigma, of both radii, by age.
    """

    excess: float
    lasts_s: float

    def factor(self, age: float) -> float:
        """What to multiply one-sigmas with at `age` (s)."""
        return 1.0 + self.excess * math.exp(-age / self.lasts_s)


NOT_OVERCONFIDENT = Overconfidence(0.0, 1.0)
"""Of filters that go on from what has been linearised well."""


class Filters(Protocol):
    """A bank and what it takes to feed it; all safe inside the loop but the construction (it may compile C)."""

    name: str
    bank: Bank
    order: int  # harmonics of its outlines
    fuses_palms: bool  # whether reports of the palms are readings; else the palms' motion is an input
    rolls_out: bool  # whether its state is the one that `model.rollout` foretells motions with
    spread: FloatArray | None  # what the rig's constants leave open of a state that a smoother vouches for
    left_open: FloatArray | None  # and of the bank's, by what a smoother has found that is not established yet
    overconfidence: Overconfidence
    curvature: FloatArray  # rows that map the state to v (m) on `CURVATURE_NORMALS` normals

    def tracker(self, angle_noise: float) -> TrackedPalms:
        """What follows the palms for them; `angle_noise` is the one-sigma of a measured angle (rad)."""

    def start(self, start: BlindStart, palms: TrackedPalms, t: float) -> None:
        """Set every filter to its sample of the prior, at time `t`."""

    def start_known(self, x: FloatArray, P: FloatArray, psi: FloatArray, palms: TrackedPalms, t: float) -> None:
        """Set the first filters, one for each of `psi` (rad), to a state of `model.shape_map` turned there.

        `x` and its covariance `P` are one for all; a bank of shape maps also takes one for each.
        """

    def constants(self, start: BlindStart) -> Belief:
        """What was believed of the object's constants at the start, for `Bank.fade`."""

    def carry(self, t: float, until: float, palms: TrackedPalms, repeated: float) -> None:
        """Move the bank from `t` to `until` (s); scores lose weight as readings of one place, one of `repeated`, do."""

    def fuse_pad(self, sample: PadSample, variance: float, palms: TrackedPalms, repeated: float) -> None:
        """Fuse one contact reading, one of `repeated` that share one error."""

    def fuse_palms(self, sample: PalmSample, angle_variance: float) -> None:
        """Fuse one report of the palms; only where `fuses_palms`."""

    def inflate(self, gap: float) -> None:
        """Widen what moves after `gap` seconds through which the palms' motion was not reported but guessed."""

    def named(self, member: int, t: float, dt: float, palms: TrackedPalms) -> tuple[list[float], list[float]]:
        """Values of `NAMED` and their variances for one filter, taken from `t` to `t + dt`."""

    def all_named(self, t: float, palms: TrackedPalms) -> FloatArray:
        """Values of `NAMED` of every filter at `t`, (size, len(NAMED)); overwritten by the next call."""

    def outline(self, member: int) -> tuple[FloatArray, FloatArray]:
        """Fourier coefficients of the support function (m) and their covariance for one filter."""

    def as_shape_map(self, member: int) -> FloatArray:
        """The state of one filter in the coordinates of `model.shape_map`, with `HARMONICS` harmonics."""

    def belief(self, member: int) -> tuple[FloatArray, FloatArray]:
        """Mean and, as far as it concerns the constants, covariance in these coordinates, with all its harmonics."""


class _Predicts(Protocol):
    bank: Bank

    def predict(self, t: float, dt: float, palms: TrackedPalms) -> None:
        """Move the bank from `t` to `t + dt`."""


def carry(filters: _Predicts, t: float, until: float, palms: TrackedPalms, repeated: float) -> None:
    """As `Filters.carry`, in equal steps of at most `LONGEST_STEP_S`; safe inside the loop."""
    gap = until - t
    steps = max(1, math.ceil(gap / LONGEST_STEP_S))
    for _ in range(steps):
        filters.predict(t, gap / steps, palms)
        t += gap / steps
    filters.bank.age_scores(gap / repeated)


def curvature_rows(order: int = shape.HARMONICS) -> FloatArray:
    """Rows that map the coefficients of h to v = h + h″ on normals all around."""
    rows = shape.basis(np.linspace(0.0, 2 * np.pi, CURVATURE_NORMALS, endpoint=False), order)
    v: FloatArray = rows * (1.0 - shape.harmonic_of_coefficient(order) ** 2)
    return v


def pad_update(pad: int) -> str:
    """The kernel that fuses a reading of pad 1 or 2."""
    return f"update_s{pad}"
