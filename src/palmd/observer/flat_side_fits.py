"""Fits of a record by outlines with flat sides: prior of a side, tests of a fit, and the fits."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from palmd.events import FloatArray
from palmd.model import sharp
from palmd.model.sharp import CONSTANTS, LENGTHS, NORMALS, SIDES, WIDTH
from palmd.model.smoothing import C
from palmd.observer.factor import Prior
from palmd.observer.mode_initialisation import (
    explained_spans,
    initial_guess,
    initial_normal,
    narrowed,
    on_nodes,
    trimmed_spans,
)
from palmd.observer.mode_segments import ModeSegment, combined_corner
from palmd.observer.normal_equations import LOOSENED, Guess, ProcessNoise
from palmd.observer.record import Record, total_duration
from palmd.observer.search import HIGH_PRIOR_COST, MOST_PRIOR_COST
from palmd.observer.smoother import Fit, Posterior, Smoother

NOISE = ProcessNoise(1e-10, 1e-5, gate=4.0)
SIDE_M, SIDE_SD_M = 15e-3, 8e-3  # length of a side before it is touched
NEW_SIDE_SD_RAD = 0.05  # 1σ of a new side's normal
Stage = tuple[float, float, float]
"""Width w of a side (rad), 1σ of ln w, and the gate beyond which a defect is an impact."""
FIXED = 1e-3  # 1σ of ln w where the width is held
FINE: tuple[Stage, ...] = ((0.001, 1.0, NOISE.gate),)
Way = tuple[tuple[float, float], ...]  # widths of a side (rad), and factors on the process noise
# ways to fit contact-mode segments
WAYS: tuple[Way, ...] = (((5e-4, 1.0), (2.5e-4, 1.0)), ((5e-4, 1e3), (5e-4, 10.0), (2.5e-4, 1.0)))
SHAPE_SD = 2.0  # relative to that of a smooth outline
LN_GYRATION, LN_GYRATION_SD = math.log(0.67), 0.12  # of a triangle 0.61, of a square 0.64, of a disc 0.71
MOST_CUT = 0.2  # share of the segments that may be left out as unexplained
PRICE = 12.0  # twice the log-likelihood that a further side must gain
ITERATIONS, LAST_ITERATIONS = 25, 60
MOST_SCATTER, MOST_OUTLIERS = 1.25, 0.10  # of the readings, during the search
MOST_OUTLIER_RUN = 20  # readings in a row that are missed; more cannot be rocking after a jump
# largest rise of the deviance while the window grows: per reading, and constant
MOST_PER_READING, MOST_RISE = 1.25, 60.0
SCATTER = 0.455  # median of x², x standard normal
LEAST_S = 5.0  # of explained readings for a result; shorter ones may be of a single contact mode


@dataclass(frozen=True, slots=True)
class FlatSide:
    """Prior of a side: its normal (rad, in the object's frame)."""

    normal: float


@dataclass(frozen=True, slots=True)
class Candidate:
    """A fit of a record by an outline with these sides."""

    sides: tuple[FlatSide, ...]
    prior: Prior
    record: Record
    fit: Fit
    scatter: float

    @property
    def deviance(self) -> float:
        """Twice the negative log-likelihood, up to a constant, plus the price of its sides."""
        return self.fit.cost + PRICE * len(self.sides)

    @property
    def lasts(self) -> float:
        """Duration of its record (s)."""
        return total_duration(self.record.spans)

    @property
    def explains(self) -> bool:
        """Whether the readings are explained to their noise, except for a while when a contact jumps."""
        fit = self.fit
        n = len(self.record.contact_value)
        return (
            math.isfinite(fit.cost)
            and self.scatter < MOST_SCATTER + 4.0 / math.sqrt(n)
            and fit.outliers < MOST_OUTLIERS
            and fit.process_cost < 0.5 * n
            and fit.prior_cost < MOST_PRIOR_COST
            and fit.outlier_run < MOST_OUTLIER_RUN
        )

    def goes_on(self, before: Candidate) -> bool:
        """Whether it explains the readings since `before`, the best fit on a shorter window, and still the others."""
        more = self.record.readings - before.record.readings
        return self.explains and self.deviance < before.deviance + MOST_PER_READING * more + MOST_RISE

    @property
    def settled(self) -> tuple[FlatSide, ...]:
        """Its sides, at the normals that the readings determine."""
        return tuple(FlatSide(float(self.fit.guess.p[NORMALS + j])) for j in range(len(self.sides)))

    def residuals(self) -> FloatArray:
        """Normalised residuals of the contact readings."""
        return smoother_of(self.sides, self.record, self.prior).residuals(self.fit.guess)

    @property
    def doubtful(self) -> bool:
        """Whether it may be a wrong minimum: the readings are explained less well than by most right ones."""
        few = math.sqrt(2.0 / len(self.record.contact_value))
        return not self.explains or self.fit.chi2 > 1.0 + few or self.fit.prior_cost > HIGH_PRIOR_COST


class FlatSideSmoother(Smoother):
    """Smoother of an outline with flat sides."""

    def sane(self, guess: Guess) -> bool:
        """As `Smoother.sane`, and no side is longer than 0.1 m."""
        p = guess.p
        return (
            super().sane(guess)
            and bool(abs(p[C.LN_RHO] - math.log(p[C.SHAPE]) + 0.4) < 1.0)
            and bool((p[LENGTHS:WIDTH] > -1e-3).all() and (p[LENGTHS:WIDTH] < 0.1).all())
        )


class FlatSideFits:
    """Fits of parts of one record; `work` counts iterations times nodes."""

    def __init__(self, record: Record, prior: Prior):
        """prior: of a smooth outline and its motion."""
        self.record, self._base = record, prior
        self.work = 0

    def fitted(
        self,
        record: Record,
        sides: tuple[FlatSide, ...],
        guess: Guess,
        stages: Sequence[Stage] = FINE,
        iterations: int = ITERATIONS,
        noise: ProcessNoise = NOISE,
    ) -> Candidate:
        """Fit from the guess, stage by stage, with at most so many iterations in each."""
        for width, width_sd, gate in stages:
            prior = self.prior(sides, width, width_sd)
            p = guess.p.copy()
            if width_sd == FIXED:
                p[WIDTH] = math.log(width)
            smoother = smoother_of(sides, record, prior)
            fit = smoother.fit(Guess(guess.x, p), replace(noise, gate=gate), iterations)
            guess = fit.guess
            self.work += fit.iterations * len(record.t)
        residual = smoother.residuals(guess)
        return Candidate(sides, prior, record, fit, float(np.median(residual**2)) / SCATTER)

    def loosened(self, record: Record, sides: tuple[FlatSide, ...], guess: Guess) -> Candidate:
        """As `fitted`, with higher process noise at first and with the sides' width held meanwhile."""
        for times in LOOSENED:
            guess = self.fitted(record, sides, guess, (held(guess),), noise=NOISE.noisier(times)).fit.guess
        return self.fitted(record, sides, guess, FINE, LAST_ITERATIONS)

    def along(self, way: Way, segments: Sequence[ModeSegment]) -> Candidate:
        """Fit of segments on one side with one corner on the other palm, with ever narrower sides."""
        record, palm = self.record.within(trimmed_spans(segments)), segments[0].palm
        sides = (FlatSide(initial_normal(record, palm)),)
        p = self.start(sides)
        p[WIDTH] = math.log(way[0][0])
        guess = initial_guess(record, palm, combined_corner(segments), p, self.prior(sides))
        for width, times in way:
            guess = narrowed(guess, record, palm, width)
            guess = self.fitted(record, sides, guess, ((width, FIXED, math.inf),), noise=NOISE.noisier(times)).fit.guess
        return self.fitted(record, sides, guess)

    def on_one_side(self, segments: Sequence[ModeSegment]) -> tuple[Candidate, ...]:
        """As `along`, for all `WAYS`, best first; without what the best fit does not explain, if that is little."""
        found = best_first(self.along(way, segments) for way in WAYS)
        spans = self.explained_spans(found[0])
        least = LEAST_S if found[0].lasts > LEAST_S else 0.0
        if total_duration(spans) > max(least, (1.0 - MOST_CUT) * found[0].lasts):
            found = best_first(self.restricted(each, spans) for each in found)
        return found

    def restricted(self, found: Candidate, spans: list[tuple[float, float]]) -> Candidate:
        """The fit restricted to these spans (s)."""
        record = self.record.within(spans)
        if len(record.t) == len(found.record.t):
            return found
        guess = on_nodes(found.fit.guess, found.record.t, record.t)
        turn = float(guess.p[NORMALS] - found.fit.guess.p[NORMALS])
        return self.fitted(record, tuple(FlatSide(side.normal + turn) for side in found.sides), guess)

    @staticmethod
    def explained_spans(found: Candidate) -> list[tuple[float, float]]:
        """The spans (s) of its record that `found` explains throughout."""
        return explained_spans(found.record, found.residuals())

    def start(self, sides: tuple[FlatSide, ...]) -> FloatArray:
        """The most likely constants before the first reading."""
        p = self.prior(sides).mean.copy()
        dither = math.exp(p[C.SATURATION])
        p[C.LN_RHO] += math.log(p[C.SHAPE])
        p[C.DRAG], p[C.SATURATION] = p[C.DRAG] / dither, dither**-2.0
        return p

    def posterior(self, candidate: Candidate) -> Posterior:
        """Posterior with the width free, even if it was held; raises LinAlgError where the fit is no minimum."""
        ((width, width_sd, _),) = FINE
        prior = self.prior(candidate.sides, width, width_sd)
        return smoother_of(candidate.sides, candidate.record, prior).posterior(candidate.fit)

    def prior(self, sides: tuple[FlatSide, ...], width: float = FINE[0][0], width_sd: float = FIXED) -> Prior:
        """Prior of an outline with these sides, each passed within `width` (rad); `width_sd`: 1σ of its logarithm."""
        smooth = self._base
        mean, sd = np.zeros(CONSTANTS), np.zeros(CONSTANTS)
        mean[:NORMALS], sd[:NORMALS] = smooth.mean, smooth.sd
        mean[C.LN_RHO], sd[C.LN_RHO] = LN_GYRATION, LN_GYRATION_SD
        sd[C.SHAPE : NORMALS] *= SHAPE_SD
        mean[NORMALS:LENGTHS], sd[NORMALS:LENGTHS] = np.arange(SIDES), 0.01
        sd[LENGTHS:WIDTH] = 1e-8
        for j, side in enumerate(sides):
            mean[NORMALS + j], sd[NORMALS + j] = side.normal, NEW_SIDE_SD_RAD
            mean[LENGTHS + j], sd[LENGTHS + j] = SIDE_M, SIDE_SD_M
        mean[WIDTH], sd[WIDTH] = math.log(width), width_sd
        return Prior(mean, sd, smooth.omega0_sd)


def held(guess: Guess) -> Stage:
    """Stage with the sides' width held as in the guess."""
    return math.exp(guess.p[WIDTH]), FIXED, NOISE.gate


def smoother_of(sides: Sequence[FlatSide], record: Record, prior: Prior) -> FlatSideSmoother:
    """Smoother with the kernels for this number of sides."""
    return FlatSideSmoother(sharp.library_for(len(sides)), record, prior)


def best_first(candidates: Iterable[Candidate]) -> tuple[Candidate, ...]:
    """The candidates by deviance, the likeliest first."""
    return tuple(sorted(candidates, key=lambda each: each.deviance))
