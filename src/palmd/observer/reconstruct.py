"""A whole record, seen from its end: the object's outline and motion from a blind start, or an honest refusal.

A bank of filters reads the first seconds and says where a solution may lie; the smoother goes there, and its window
then grows over the record, with rivals kept as long as they explain the readings nearly as well. What comes out is
called converged only when the iteration has settled, the readings are explained to their noise, and no rival is left.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from palmd.events import Event, FloatArray, RigDescription
from palmd.model import shape, smoothing
from palmd.model.smoothing import ORDER, C
from palmd.observer.first_guess import blind_starts, prior_of
from palmd.observer.marginal import marginalised
from palmd.observer.outline import directions, normal_angles, outline_of
from palmd.observer.palm_path import smoothed_path
from palmd.observer.record import LEAST_FORCE_N, Record, lay_out
from palmd.observer.smoother import Fit, Guess, ProcessNoise, Smoother
from palmd.observer.stretch import Stretch, longest_stretch

SEARCH_SPACING_S, SPACING_S = 0.01, 0.005  # of the nodes: while looking for the answer, and in the end
LEAST_S = 0.5
FIRST_LOOK_S = 0.3  # readings that tell the object's size
SHARP_M = 1.5e-4  # RMS of the outline's one-sigma where touched, above which there is no outline to speak of
NOISE = ProcessNoise(1e-8, 1e-5)
# Each attempt: seconds that the bank reads, and how many of its filters the smoother starts from.
ATTEMPTS = ((2.0, 3), (3.5, 6), (1.2, 8))
GROWTH, LEAST_GROWTH_S = 1.6, 0.1
ASTRAY_SIGMAS, ASTRAY_READINGS = 8.0, 5  # a prediction that misses so many readings in a row by so much is lost
RIVAL = 25.0  # twice the difference in log-likelihood up to which a rival is carried along
DOUBT = 9.0  # and up to which it makes the answer ambiguous
DIFFERENT_M = 1e-4  # RMS of the outlines' difference from which two fits are rivals rather than the same
CHI2_SIGMAS, CHI2_SLACK = 5.0, 0.05
MOST_OUTLIERS = 0.2


@dataclass(frozen=True, slots=True)
class Reconstruction:
    """What a record tells; SI units, NaN or None where there is no value.

    theta, h, h_sd, touched: 360 normals (rad), support function and its one-sigma (m), whether a palm touched there.
    t, psi, omega0, r1, r2: the trajectory at the nodes. `chi2` is per contact reading. `reason` says why not, when
    not `converged`.
    """

    converged: bool
    chi2: float
    theta: FloatArray
    h: FloatArray | None
    h_sd: FloatArray | None
    touched: npt.NDArray[np.bool_] | None
    rho: float
    rho_sd: float
    mu: float
    mu_sd: float
    mass: float
    mass_sd: float
    t: FloatArray
    psi: FloatArray
    omega0: FloatArray
    r1: FloatArray
    r2: FloatArray
    reason: str
    seconds: float


def reconstruct(events: Sequence[Event], rig: RigDescription, seed: int = 0) -> Reconstruction:
    """Smooth the longest stretch of `events` in which both palms feel the object; deterministic for a given seed.

    Takes about a second for ten seconds of readings. Never raises for what the readings say: a record that tells too
    little, or contradicts the model, comes back with `converged` False and the reason.
    """
    begun = time.perf_counter()
    stretch = longest_stretch(events)
    if stretch is None or stretch.end - stretch.start < LEAST_S:
        return _nothing("there is no half second in which both pads and the arm report", begun)
    task = _Task(stretch, rig)
    best: _Answer | None = None
    for seconds, starts in ATTEMPTS:
        answer = task.attempt(seconds, starts, seed)
        if answer is not None and (best is None or answer.fit.cost < best.fit.cost):
            best = answer
        if best is not None and not best.reason:
            break
    return _nothing("no start could be found", begun) if best is None else task.result(best, begun)


@dataclass(frozen=True, slots=True)
class _Answer:
    fit: Fit
    record: Record
    reason: str


class _Task:
    """One record: its layout, its prior, and what the attempts on it share."""

    def __init__(self, stretch: Stretch, rig: RigDescription):
        self._rig = rig
        self._events = stretch.events()
        self._stretch = stretch
        self._path = path = smoothed_path(stretch.palms, rig.palm_angle_noise)
        self._record = lay_out(stretch.pads, path, rig, stretch.start, stretch.end, SEARCH_SPACING_S)
        first = [sample for sample in stretch.pads if sample.t_sample < stretch.start + FIRST_LOOK_S]
        phi2 = path.at(np.array([sample.t_sample for sample in first]))[:, 1]
        self._prior = prior_of(first, np.tan(phi2 / 2))
        self._library = smoothing.library()

    def attempt(self, seconds: float, count: int, seed: int) -> _Answer | None:
        """Start from the `count` likeliest of a bank that has read the first `seconds`, and grow the window."""
        record = self._record.until(self._record.t[0] + seconds)
        starts = blind_starts(self._events, self._rig, seconds, seed)[:count]
        rivals = self._fits(record, [start.guess(record.t) for start in starts])
        while rivals and len(record.t) < len(self._record.t):
            if not _explained(rivals[0], record):
                return None
            record = self._grown(record, rivals[0])
            rivals = self._fits(record, [fit.guess for fit in rivals])
        return self._judged(rivals) if rivals else None

    def _grown(self, record: Record, fit: Fit) -> Record:
        """A longer window, as far as the fit foretells the readings to come: beyond that it would be led astray."""
        begin, now = record.t[0], record.t[-1]
        longer = self._record.until(begin + GROWTH * (now - begin))
        smoother = Smoother(self._library, longer, self._prior)
        miss = np.abs(smoother.residuals(smoother.completed(fit.guess)))
        gone = np.convolve(miss > ASTRAY_SIGMAS, np.ones(ASTRAY_READINGS), "valid") == ASTRAY_READINGS
        if not gone.any():
            return longer
        step = longer.contact_step[int(np.argmax(gone))]
        return self._record.until(max(longer.t[step], now + LEAST_GROWTH_S))

    def _fits(self, record: Record, guesses: Sequence[Guess]) -> list[Fit]:
        """The distinct minima that the guesses lead to, best first, without those that are out of the race."""
        smoother = Smoother(self._library, record, self._prior)
        fits = sorted((smoother.fit(guess, NOISE) for guess in guesses), key=lambda fit: fit.cost)
        distinct: list[Fit] = []
        for fit in fits:
            near = fit.cost < fits[0].cost + RIVAL
            if near and all(_difference(fit, other) > DIFFERENT_M for other in distinct):
                distinct.append(fit)
        return distinct

    def _judged(self, rivals: list[Fit]) -> _Answer:
        fit, record = self._refined(rivals[0])
        readings, forces = len(record.contact_value), len(record.force_value)
        if not fit.settled:
            reason = "the iteration has not settled"
        elif not _consistent(fit.chi2, readings):
            reason = f"the readings are not explained to their noise: chi2 {fit.chi2:.2f}"
        elif forces and not _consistent(fit.force_chi2, forces):
            reason = f"the forces are not explained to their noise: chi2 {fit.force_chi2:.2f}"
        elif fit.outliers > MOST_OUTLIERS:
            reason = f"{fit.outliers:.0%} of the readings are outliers"
        elif len(rivals) > 1 and rivals[1].cost < rivals[0].cost + DOUBT:
            reason = "another outline explains the readings as well"
        else:
            reason = ""
        return _Answer(fit, record, reason)

    def _refined(self, fit: Fit) -> tuple[Fit, Record]:
        """The fit again on finer nodes, each force's noise taken from the model's force instead of its neighbours'."""
        stretch = self._stretch
        record = lay_out(stretch.pads, self._path, self._rig, stretch.start, stretch.end, SPACING_S)
        guess = fit.guess.on(self._record.t, record.t)
        level = np.maximum(Smoother(self._library, record, self._prior).forces(guess), LEAST_FORCE_N)
        variance = (self._rig.force_scale_std * level) ** 2 + self._rig.force_resolution**2 / 12
        record = replace(record, force_variance=variance)
        return Smoother(self._library, record, self._prior).fit(guess, fit.noise), record

    def result(self, answer: _Answer, begun: float) -> Reconstruction:
        """The answer in full, with its error bars."""
        fit, record = answer.fit, answer.record
        try:
            answered = marginalised(self._library, record, self._prior, fit)
        except np.linalg.LinAlgError:
            return _nothing(answer.reason or "the fit is not a minimum", begun, fit.chi2)
        x, p, covariance = answered.mean.x, answered.mean.p, answered.covariance
        normals = normal_angles(record.palms, x[:, 0])
        outline = outline_of(
            p[C.SHAPE :], covariance[C.SHAPE : smoothing.CONSTANTS, C.SHAPE : smoothing.CONSTANTS], normals
        )
        reason = answer.reason
        if not reason and float(np.sqrt(np.mean(outline.h_sd[outline.touched] ** 2))) > SHARP_M:
            reason = "the readings tell too little of the outline"
        sd = np.sqrt(np.diagonal(covariance))
        rho, mass = math.exp(p[C.LN_RHO]), math.exp(p[C.LN_MASS])
        weighed = len(record.force_value) > 0
        radii = [shape.basis(normals[:, i], ORDER) @ p[C.SHAPE :] for i in range(2)]
        return Reconstruction(
            converged=not reason, chi2=fit.chi2,
            theta=outline.theta, h=outline.h, h_sd=outline.h_sd, touched=outline.touched,
            rho=rho, rho_sd=rho * float(sd[C.LN_RHO]), mu=float(p[C.MU]), mu_sd=float(sd[C.MU]),
            mass=mass if weighed else math.nan, mass_sd=mass * float(sd[C.LN_MASS]) if weighed else math.nan,
            t=record.t, psi=x[:, 0], omega0=x[:, 1], r1=radii[0], r2=radii[1],
            reason=reason, seconds=time.perf_counter() - begun,
        )  # fmt: skip


def _consistent(chi2: float, readings: int) -> bool:
    return chi2 < 1.0 + CHI2_SLACK + CHI2_SIGMAS * math.sqrt(2.0 / readings)


def _explained(fit: Fit, record: Record) -> bool:
    forces = len(record.force_value)
    return _consistent(fit.chi2, len(record.contact_value)) and (not forces or _consistent(fit.force_chi2, forces))


def _difference(one: Fit, other: Fit) -> float:
    """RMS difference of two outlines (m), by Parseval."""
    miss = one.guess.p[C.SHAPE :] - other.guess.p[C.SHAPE :]
    return math.sqrt(float(miss[0] ** 2 + (miss[1:] ** 2).sum() / 2))


def _nothing(reason: str, begun: float, chi2: float = math.nan) -> Reconstruction:
    none: FloatArray = np.zeros(0)
    nan = math.nan
    return Reconstruction(
        False, chi2, directions(), None, None, None, nan, nan, nan, nan, nan, nan,
        none, none, none, none, none, reason, time.perf_counter() - begun,
    )  # fmt: skip
