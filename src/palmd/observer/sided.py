"""The search for an outline with flat sides and corners behind a segment of readings, blind.

What lies on a flat side rides on its palm: ψ follows that palm's angle, while the contact wanders along the side as the
balance of torques asks. That gives two starts, one a palm, besides those of the bank of filters. The window then grows
over the segment. Where no motion of the present outline explains what comes next, rivals are born that have one more
side, at the normal by which either palm feels the object there; the readings choose among them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from palmd.events import FloatArray
from palmd.model import sharp
from palmd.model.sharp import CONSTANTS, LENGTHS, NORMALS, SIDES, WIDTH
from palmd.model.smoothing import NODE, C
from palmd.observer.factor import Prior
from palmd.observer.normal_equations import Guess, ProcessNoise
from palmd.observer.outline import normal_angles
from palmd.observer.record import Record
from palmd.observer.search import ASTRAY_READINGS, Search
from palmd.observer.smoother import Fit, Smoother
from palmd.system.mechanism import normal_directions

NOISE = ProcessNoise(1e-10, 1e-5, gate=4.0)  # a blow of two sigmas is a contact that jumps
FIRST_S, GROWTH, LEAST_GROWTH_S = 1.0, 1.6, 0.2
SIDE_M, SIDE_SD_M = 15e-3, 8e-3  # length of a side before it is felt
BORN_SD_RAD = 0.05
COARSE, FINE = (0.03, 0.01), 0.004  # rad: in what angle a side is passed, while looking for it and in the end
SHAPE_SD = 2.0  # times that of a smooth lump
LN_GYRATION, LN_GYRATION_SD = math.log(0.67), 0.12  # of a triangle 0.61, of a square 0.64, of a disc 0.71
PRICE = 12.0  # of a side more: twice the log-likelihood that it must gain
ITERATIONS = 30
MOST_OUTLIERS = 0.10  # of readings, while contacts jump
SCATTER = 0.455  # median of x², x standard normal
RIVALS = 3


@dataclass(frozen=True, slots=True)
class Side:
    """What is believed of a side before the readings speak: its normal (rad, in the object's frame)."""

    normal: float


@dataclass(frozen=True, slots=True)
class Candidate:
    """A fit of a record by an outline with so many sides."""

    sides: tuple[Side, ...]
    prior: Prior
    record: Record
    fit: Fit
    scatter: float

    @property
    def deviance(self) -> float:
        """Twice the negative log-likelihood up to a constant, with the price of its sides."""
        return self.fit.cost + PRICE * len(self.sides)

    @property
    def explains(self) -> bool:
        """Whether the readings are explained to their noise but for some while a contact jumps."""
        fit = self.fit
        n = len(self.record.contact_value)
        return (
            math.isfinite(fit.cost)
            and self.scatter < 1.12 + 4.0 / math.sqrt(n)
            and fit.outliers < MOST_OUTLIERS
            and fit.slack < 0.5 * n
        )


class SidedSmoother(Smoother):
    """The smoother of an outline with sides."""

    def _sane(self, guess: Guess) -> bool:
        p = guess.p
        return (
            super()._sane(guess)
            and bool(abs(p[C.LN_RHO] - math.log(p[C.SHAPE]) + 0.4) < 1.0)
            and bool((p[LENGTHS:WIDTH] > -1e-3).all() and (p[LENGTHS:WIDTH] < 0.1).all())
        )


class SidedSearch:
    """One segment, as `search` has laid it out."""

    def __init__(self, search: Search):
        self._search = search
        self._library = sharp.library()
        self.trace: list[str] = []

    def found(self, seed: int, log=None) -> Candidate | None:
        whole = self._search.record
        first = whole.until(whole.t[0] + FIRST_S)
        candidates = [self._fitted(first, sides, guess, coarse=True) for sides, guess in self._starts(first)]
        best = self._kept(candidates)
        failures = 0
        while True:
            if log:
                for c in best:
                    log(c)
            now = best[0].record.t[-1]
            if best[0].record.t[-1] >= whole.t[-1] - 1e-9:
                return best[0]
            best = self._kept(self._grown(best, whole))
            failures = 0 if best[0].explains else failures + 1
            if failures > 3:
                return None

    def _kept(self, candidates: Sequence[Candidate]) -> list[Candidate]:
        ordered = sorted(candidates, key=lambda each: each.deviance)
        kept: list[Candidate] = []
        for each in ordered:
            if len(kept) < RIVALS and (not kept or each.deviance < kept[0].deviance + 60) and not any(_same(each, other) for other in kept):
                kept.append(each)
        return kept

    def _starts(self, record: Record) -> Iterator[tuple[tuple[Side, ...], Guess]]:
        phi = record.palms[:, :2]
        rate = record.palms[:, 2:4]
        first = normal_directions(tuple(phi[0]), 0.0)
        for palm in (0, 1):
            angle, spin = phi[:, : palm + 1].sum(axis=1), rate[:, : palm + 1].sum(axis=1)
            sides = (Side(float(first[palm])),)
            yield sides, Guess(np.stack([angle - angle[0], spin], axis=1), self._start(sides))
        yield (), Guess(np.zeros((len(record.t), NODE)), self._start(()))

    def _start(self, sides: tuple[Side, ...]) -> FloatArray:
        """The constants most likely before anything is felt."""
        p = self._prior(sides).mean.copy()
        dither = math.exp(p[C.SATURATION])
        p[C.LN_RHO] += math.log(p[C.SHAPE])
        p[C.DRAG], p[C.SATURATION] = p[C.DRAG] / dither, dither**-2.0
        return p

    def _grown(self, rivals: Sequence[Candidate], whole: Record) -> list[Candidate]:
        begin, now = whole.t[0], rivals[0].record.t[-1]
        until = begin + max(GROWTH * (now - begin), now - begin + LEAST_GROWTH_S)
        while True:
            longer = whole.until(until)
            grown = [self._fitted(longer, each.sides, each.fit.guess, normals=each) for each in rivals]
            if min(grown, key=lambda each: each.deviance).explains:
                return grown
            if until - now <= 1.01 * LEAST_GROWTH_S or longer.t[-1] - now < LEAST_GROWTH_S * 1.01:
                break
            until = now + max((until - now) / 2, LEAST_GROWTH_S)
        return [*grown, *(self._fitted(longer, sides, guess, coarse=True) for each in grown[:1] for sides, guess in self._births(each, now))]

    def _births(self, candidate: Candidate, now: float) -> Iterator[tuple[tuple[Side, ...], Guess]]:
        if len(candidate.sides) == SIDES:
            return
        record, guess = candidate.record, candidate.fit.guess
        at = normal_angles(record.palms, guess.x[:, 0])
        for k in (int(np.searchsorted(record.t, now)), len(record.t) - 1):
            for palm in (0, 1):
                normal = float(at[k, palm])
                if any(abs(math.remainder(normal - float(guess.p[NORMALS + j]), math.tau)) < 0.1 for j in range(len(candidate.sides))):
                    continue
                sides = (*self._settled(candidate), Side(normal))
                p = guess.p.copy()
                p[NORMALS + len(candidate.sides)], p[LENGTHS + len(candidate.sides)] = normal, SIDE_M / 3
                yield sides, Guess(guess.x, p)

    @staticmethod
    def _settled(candidate: Candidate) -> tuple[Side, ...]:
        return tuple(Side(float(candidate.fit.guess.p[NORMALS + j])) for j in range(len(candidate.sides)))

    def _fitted(self, record: Record, sides: tuple[Side, ...], guess: Guess, coarse: bool = False, normals=None) -> Candidate:
        prior = self._prior(sides)
        for width in (*(COARSE if coarse else ()), FINE):
            prior = self._prior(sides, width)
            p = guess.p.copy()
            p[WIDTH] = math.log(width)
            smoother = SidedSmoother(self._library, record, prior)
            fit = smoother.fit(Guess(guess.x, p), NOISE, ITERATIONS)
            guess = fit.guess
        residual = smoother.residuals(guess)
        return Candidate(sides, prior, record, fit, float(np.median(residual**2)) / SCATTER)

    def _prior(self, sides: tuple[Side, ...], width: float = FINE) -> Prior:
        base = self._search.prior
        mean, sd = np.zeros(CONSTANTS), np.zeros(CONSTANTS)
        mean[:NORMALS], sd[:NORMALS] = base.mean, base.sd
        mean[C.LN_RHO], sd[C.LN_RHO] = LN_GYRATION, LN_GYRATION_SD
        sd[C.SHAPE : NORMALS] *= SHAPE_SD
        mean[NORMALS:LENGTHS], sd[NORMALS:LENGTHS] = np.arange(SIDES), 0.01
        sd[LENGTHS:WIDTH] = 1e-8
        for j, side in enumerate(sides):
            mean[NORMALS + j], sd[NORMALS + j] = side.normal, BORN_SD_RAD
            mean[LENGTHS + j], sd[LENGTHS + j] = SIDE_M, SIDE_SD_M
        mean[WIDTH], sd[WIDTH] = math.log(width), 1e-3
        return Prior(mean, sd, base.omega0_sd)


def _same(one: Candidate, other: Candidate) -> bool:
    if len(one.fit.guess.x) != len(other.fit.guess.x) or len(one.sides) != len(other.sides):
        return False
    return float(np.abs(one.fit.guess.x[:, 0] - other.fit.guess.x[:, 0]).max()) < 0.02
