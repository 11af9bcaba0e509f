"""Interface of a bank of filters, independent of their state vector, and code common to all kinds of filters."""

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

LONGEST_STEP_S = 0.0061  # longest integration step; one pad's readings come every 10 ms
CURVATURE_NORMALS = 72  # normals on which convexity is checked
SMALLEST_RADIUS_M = 1e-3  # lower bound of a filter's mean radius where its logarithm is taken
GUESSED_ACCELERATION_SD = 2.0  # rad/s², 1σ for palms and object while the palms' motion is guessed


@dataclass(frozen=True, slots=True)
class Overconfidence:
    """Overconfidence of a young filter: its true errors are 1 + excess · exp(−age/decay_s) times its own 1σ.

    A covariance does not include the error of linearising about a blind guess. Measured over simulated runs of the kind
    `nominal`, as the root mean square of error over 1σ, of both radii, by age.
    """

    excess: float
    decay_s: float

    def factor(self, age: float) -> float:
        """The factor by which to multiply standard deviations at `age` (s)."""
        return 1.0 + self.excess * math.exp(-age / self.decay_s)


NOT_OVERCONFIDENT = Overconfidence(0.0, 1.0)
"""For filters that start from a well linearised estimate."""


class Filters(Protocol):
    """A bank with its process and measurement models; safe inside the loop except construction, which may compile C."""

    name: str
    order: int  # harmonics of its outlines
    fuses_palms: bool  # whether reports of the palms are readings; else the palms' motion is an input
    supports_rollout: bool  # whether `model.rollout` can predict motions from its state
    spread: FloatArray | None  # 1σ steps of the rig's constants and their effect on an established smoother's state
    provisional_spread: FloatArray | None  # the same for the bank's states, from an improvement not yet established
    overconfidence: Overconfidence
    curvature: FloatArray  # rows that map the state to v (m) on `CURVATURE_NORMALS` normals

    @property
    def bank(self) -> Bank:
        """The bank."""

    def tracker(self, angle_noise: float) -> TrackedPalms:
        """A new tracker of the palms for these filters; `angle_noise`: 1σ of a measured angle (rad)."""

    def start(self, start: BlindStart, palms: TrackedPalms, t: float) -> None:
        """Set every filter to its sample of the prior, at time `t`."""

    def start_known(self, x: FloatArray, P: FloatArray, psi: FloatArray, palms: TrackedPalms, t: float) -> None:
        """Set the first filters, one for each of `psi` (rad), to a state of `model.shape_map` at this orientation.

        State `x` and covariance `P` are the same for all; a bank of shape maps also accepts one for each.
        """

    def constants(self, start: BlindStart) -> Belief:
        """The prior of the object's constants at the start, for `Bank.fade`."""

    def propagate(self, t: float, until: float, palms: TrackedPalms, repeated: float) -> None:
        """Propagate the bank from `t` to `until` (s) and age its scores by as much, divided by `repeated`."""

    def fuse_pad(self, sample: PadSample, variance: float, palms: TrackedPalms, repeated: float) -> None:
        """Fuse one contact reading; `repeated` readings share one error."""

    def fuse_palms(self, sample: PalmSample, angle_variance: float) -> None:
        """Fuse one report of the palms; only where `fuses_palms`."""

    def inflate(self, gap: float) -> None:
        """Increase the covariance of the moving states after `gap` seconds in which the palms' motion was guessed."""

    def named(self, member: int, t: float, dt: float, palms: TrackedPalms) -> tuple[list[float], list[float]]:
        """Values of `NAMED` and their variances for one filter, propagated from `t` to `t + dt`."""

    def all_named(self, t: float, palms: TrackedPalms) -> FloatArray:
        """Values of `NAMED` of every filter at `t`, (size, len(NAMED)); overwritten by the next call."""

    def outline(self, member: int) -> tuple[FloatArray, FloatArray]:
        """Fourier coefficients of the support function (m) and their covariance for one filter."""

    def as_shape_map(self, member: int) -> FloatArray:
        """The state of one filter in the coordinates of `model.shape_map`, with `HARMONICS` harmonics."""

    def belief(self, member: int) -> tuple[FloatArray, FloatArray]:
        """Mean and covariance (for the constants only) in these coordinates, with all of the filter's harmonics."""


def curvature_rows(order: int = shape.HARMONICS) -> FloatArray:
    """Rows that map the coefficients of h to v = h + h″ on `CURVATURE_NORMALS` normals."""
    rows = shape.basis(np.linspace(0.0, 2 * np.pi, CURVATURE_NORMALS, endpoint=False), order)
    v: FloatArray = rows * (1.0 - shape.harmonic_of_coefficient(order) ** 2)
    return v


def pad_update(pad: int) -> str:
    """The kernel that fuses a reading of pad 1 or 2."""
    return f"update_s{pad}"
