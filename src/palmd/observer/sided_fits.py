"""Fits of a record by outlines with flat sides: what is believed of a side, how a fit is judged, and the fits."""

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
from palmd.observer.normal_equations import LOOSENED, Guess, ProcessNoise
from palmd.observer.record import Record, lasting
from palmd.observer.ridden import begun, calm, kept, narrowed, normal_at_first, trimmed
from palmd.observer.rides import Ride, corner_of
from palmd.observer.search import MOST_STRAIN, UNLIKELY
from palmd.observer.smoother import Fit, Posterior, Smoother

NOISE = ProcessNoise(1e-10, 1e-5, gate=4.0)
SIDE_M, SIDE_SD_M = 15e-3, 8e-3  # length of a side before it is felt
BORN_SD_RAD = 0.05
Stage = tuple[
    float, float, float
]  # the width w of a side (rad), ln w's one-sigma, and from where on a defect is a blow
FIXED = 1e-3
FINE: tuple[Stage, ...] = ((0.001, 1.0, NOISE.gate),)
Way = tuple[tuple[float, float], ...]  # widths of a side (rad), and by how much the motion is noisier
WAYS: tuple[Way, ...] = (((5e-4, 1.0), (2.5e-4, 1.0)), ((5e-4, 1e3), (5e-4, 10.0), (2.5e-4, 1.0)))  # to what rides
SHAPE_SD = 2.0  # times that of a smooth lump
LN_GYRATION, LN_GYRATION_SD = math.log(0.67), 0.12  # of a triangle 0.61, of a square 0.64, of a disc 0.71
MOST_CUT = 0.2  # of the rides, that may be left out as nothing explains it
PRICE = 12.0  # of a side more: twice the log-likelihood that it must gain
ITERATIONS, LAST_ITERATIONS = 25, 60
MOST_SCATTER, MOST_OUTLIERS = 1.25, 0.10  # of the readings, while looking
MOST_ASTRAY = 20  # readings in a row that are missed: more is no rocking after a jump
MOST_PER_READING, SURPRISE = 1.25, 60.0  # that the deviance may rise by while the window grows
SCATTER = 0.455  # median of x², x standard normal
LEAST_S = 5.0  # of readings that are explained, before anything is told; until then the object may have ridden


@dataclass(frozen=True, slots=True)
class FlatSide:
    """What is believed of a side before the readings speak: its normal (rad, in the object's frame)."""

    normal: float


@dataclass(frozen=True, slots=True)
class Candidate:
    """A fit of a record by an outline with so many sides."""

    sides: tuple[FlatSide, ...]
    prior: Prior
    record: Record
    fit: Fit
    scatter: float

    @property
    def deviance(self) -> float:
        """Twice the negative log-likelihood up to a constant, with the price of its sides."""
        return self.fit.cost + PRICE * len(self.sides)

    @property
    def lasts(self) -> float:
        """How long its record is (s)."""
        return lasting(self.record.spans)

    @property
    def explains(self) -> bool:
        """Whether the readings are explained to their noise but for some while a contact jumps."""
        fit = self.fit
        n = len(self.record.contact_value)
        return (
            math.isfinite(fit.cost)
            and self.scatter < MOST_SCATTER + 4.0 / math.sqrt(n)
            and fit.outliers < MOST_OUTLIERS
            and fit.slack < 0.5 * n
            and fit.strain < MOST_STRAIN
            and fit.astray < MOST_ASTRAY
        )

    def goes_on(self, before: Candidate) -> bool:
        """Whether it explains what has come since `before`, the best on a shorter window, and all the rest as well."""
        more = self.record.readings - before.record.readings
        return self.explains and self.deviance < before.deviance + MOST_PER_READING * more + SURPRISE

    @property
    def settled(self) -> tuple[FlatSide, ...]:
        """Its sides where the readings have them."""
        return tuple(FlatSide(float(self.fit.guess.p[NORMALS + j])) for j in range(len(self.sides)))

    def residuals(self) -> FloatArray:
        """Of the contact readings, in one-sigmas."""
        return smoother_of(self.sides, self.record, self.prior).residuals(self.fit.guess)

    @property
    def doubtful(self) -> bool:
        """Whether it may be a lesser minimum: the readings are explained less well than by most that are right."""
        few = math.sqrt(2.0 / len(self.record.contact_value))
        return not self.explains or self.fit.chi2 > 1.0 + few or self.fit.strain > UNLIKELY


class SidedSmoother(Smoother):
    """The smoother of an outline with sides."""

    def sane(self, guess: Guess) -> bool:
        """As `Smoother.sane`, and no side is longer than 0.1 m."""
        p = guess.p
        return (
            super().sane(guess)
            and bool(abs(p[C.LN_RHO] - math.log(p[C.SHAPE]) + 0.4) < 1.0)
            and bool((p[LENGTHS:WIDTH] > -1e-3).all() and (p[LENGTHS:WIDTH] < 0.1).all())
        )


class SidedFits:
    """Fits of parts of one record; `work` counts the iterations times nodes that they took."""

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
        """Iterated from the guess, stage by stage, so many times at most in each."""
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
        """As `fitted`, of a motion that is noisier at first, and sides that are as wide as they are."""
        for times in LOOSENED:
            guess = self.fitted(record, sides, guess, (held(guess),), noise=NOISE.noisier(times)).fit.guess
        return self.fitted(record, sides, guess, FINE, LAST_ITERATIONS)

    def along(self, way: Way, rides: Sequence[Ride]) -> Candidate:
        """What explains rides on one side with one corner opposite, on ever narrower sides."""
        record, palm = self.record.within(trimmed(rides)), rides[0].palm
        sides = (FlatSide(normal_at_first(record, palm)),)
        p = self.start(sides)
        p[WIDTH] = math.log(way[0][0])
        guess = begun(record, palm, corner_of(rides), p, self.prior(sides))
        for width, times in way:
            guess = narrowed(guess, record, palm, width)
            guess = self.fitted(record, sides, guess, ((width, FIXED, math.inf),), noise=NOISE.noisier(times)).fit.guess
        return self.fitted(record, sides, guess)

    def on_one_side(self, rides: Sequence[Ride]) -> tuple[Candidate, ...]:
        """The same in all `WAYS`, best first, without what the best does not explain if that is little."""
        found = best_first(self.along(way, rides) for way in WAYS)
        spans = self.calm(found[0])
        least = LEAST_S if found[0].lasts > LEAST_S else 0.0
        if lasting(spans) > max(least, (1.0 - MOST_CUT) * found[0].lasts):
            found = best_first(self.cut(each, spans) for each in found)
        return found

    def cut(self, found: Candidate, spans: list[tuple[float, float]]) -> Candidate:
        """The same, of these parts (s) alone."""
        record = self.record.within(spans)
        if len(record.t) == len(found.record.t):
            return found
        guess = kept(found.fit.guess, found.record.t, record.t)
        turn = float(guess.p[NORMALS] - found.fit.guess.p[NORMALS])
        return self.fitted(record, tuple(FlatSide(side.normal + turn) for side in found.sides), guess)

    @staticmethod
    def calm(found: Candidate) -> list[tuple[float, float]]:
        """The parts (s) of its record that `found` explains all along."""
        return calm(found.record, found.residuals())

    def start(self, sides: tuple[FlatSide, ...]) -> FloatArray:
        """The constants most likely before anything is felt."""
        p = self.prior(sides).mean.copy()
        dither = math.exp(p[C.SATURATION])
        p[C.LN_RHO] += math.log(p[C.SHAPE])
        p[C.DRAG], p[C.SATURATION] = p[C.DRAG] / dither, dither**-2.0
        return p

    def posterior(self, candidate: Candidate) -> Posterior:
        """How sure it is of itself, the width open though it was held; raises LinAlgError where it is no minimum."""
        ((width, width_sd, _),) = FINE
        prior = self.prior(candidate.sides, width, width_sd)
        return smoother_of(candidate.sides, candidate.record, prior).posterior(candidate.fit)

    def prior(self, sides: tuple[FlatSide, ...], width: float = FINE[0][0], width_sd: float = FIXED) -> Prior:
        """Of an outline with these sides, each passed within `width` (rad), whose logarithm is known to `width_sd`."""
        base = self._base
        mean, sd = np.zeros(CONSTANTS), np.zeros(CONSTANTS)
        mean[:NORMALS], sd[:NORMALS] = base.mean, base.sd
        mean[C.LN_RHO], sd[C.LN_RHO] = LN_GYRATION, LN_GYRATION_SD
        sd[C.SHAPE : NORMALS] *= SHAPE_SD
        mean[NORMALS:LENGTHS], sd[NORMALS:LENGTHS] = np.arange(SIDES), 0.01
        sd[LENGTHS:WIDTH] = 1e-8
        for j, side in enumerate(sides):
            mean[NORMALS + j], sd[NORMALS + j] = side.normal, BORN_SD_RAD
            mean[LENGTHS + j], sd[LENGTHS + j] = SIDE_M, SIDE_SD_M
        mean[WIDTH], sd[WIDTH] = math.log(width), width_sd
        return Prior(mean, sd, base.omega0_sd)


def held(guess: Guess) -> Stage:
    """The sides' width kept as the guess has it."""
    return math.exp(guess.p[WIDTH]), FIXED, NOISE.gate


def smoother_of(sides: Sequence[FlatSide], record: Record, prior: Prior) -> SidedSmoother:
    """With the kernels of so many sides."""
    return SidedSmoother(sharp.library_for(len(sides)), record, prior)


def best_first(candidates: Iterable[Candidate]) -> tuple[Candidate, ...]:
    """The likeliest first, each side at its price."""
    return tuple(sorted(candidates, key=lambda each: each.deviance))
