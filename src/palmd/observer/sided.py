"""The search for an outline with flat sides and corners behind a segment of readings, blind.

What lies on a flat side rides on its palm, and where it does is read off the readings (`observer.rides`): all rides on
one side, with one corner on the other palm, tell of one outline together, whatever came between them.

Else the search begins at the beginning: ψ follows that palm's angle, while the contact wanders along the side as the
balance of torques asks. That gives two starts, one a palm, besides those of the bank of filters. The window then grows
over the segment. Where no motion of the present outline explains what comes next, rivals are born that have one more
side, at the normal by which either palm feels the object there; the readings choose among them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from palmd.events import FloatArray
from palmd.model import sharp
from palmd.model.sharp import CONSTANTS, LENGTHS, NORMALS, SIDES, WIDTH
from palmd.model.smoothing import NODE, C
from palmd.observer.factor import Prior
from palmd.observer.first_guess import blind_starts
from palmd.observer.normal_equations import Guess, ProcessNoise
from palmd.observer.outline import normal_angles
from palmd.observer.record import Record, lasting, lay_out
from palmd.observer.ridden import begun, calm, kept, narrowed, normal_at_first, trimmed, turning
from palmd.observer.rides import Ride, rides_of, same
from palmd.observer.search import MOST_STRAIN, UNLIKELY, Search, astray
from palmd.observer.smoother import Fit, Posterior, Smoother
from palmd.system.mechanism import JOINTS, OPENING, normal_directions

NOISE = ProcessNoise(1e-10, 1e-5, gate=4.0)
SPACING_S = 0.005  # of the nodes, while looking
BANK_S, BANK_STARTS = 1.0, 3  # seconds that the bank of filters reads, and how many of it are started from
FIRST_S, GROWTH, LEAST_GROWTH_S = 0.4, 1.6, 0.1
SIDE_M, SIDE_SD_M = 15e-3, 8e-3  # length of a side before it is felt
BORN_SD_RAD = 0.05
Stage = tuple[
    float, float, float
]  # the width w of a side (rad), ln w's one-sigma, and from where on a defect is a blow
FIXED = 1e-3
CALM: tuple[Stage, ...] = ((0.012, FIXED, math.inf), (0.004, FIXED, math.inf), (0.0015, FIXED, math.inf))
COARSE: tuple[Stage, ...] = ((0.012, FIXED, math.inf), (0.004, FIXED, math.inf), (0.0015, FIXED, NOISE.gate))
FINE: tuple[Stage, ...] = ((0.001, 1.0, NOISE.gate),)
Way = tuple[tuple[float, float], ...]  # widths of a side (rad), and by how much the motion is noisier
WAYS: tuple[Way, ...] = (((5e-4, 1.0), (2.5e-4, 1.0)), ((5e-4, 1e3), (5e-4, 10.0), (2.5e-4, 1.0)))  # to what rides
LAST_S = 0.0025  # spacing of the nodes (s) in the end
SHAPE_SD = 2.0  # times that of a smooth lump
LN_GYRATION, LN_GYRATION_SD = math.log(0.67), 0.12  # of a triangle 0.61, of a square 0.64, of a disc 0.71
MOST_CUT = 0.2  # of the rides, that may be left out as nothing explains it
HOPELESS = 5.0  # cost for each reading of a ride, on a wide side, that narrower ones will not bring down
PRICE = 12.0  # of a side more: twice the log-likelihood that it must gain
ITERATIONS, LAST_ITERATIONS = 25, 60
MOST_SCATTER, MOST_OUTLIERS = 1.25, 0.10  # of the readings, while looking
MOST_ASTRAY = 20  # readings in a row that are missed: more is no rocking after a jump
MOST_PER_READING, SURPRISE = 1.25, 60.0  # that the deviance may rise by while the window grows
SCATTER = 0.455  # median of x², x standard normal
RIVALS = 3
OTHER_KIND = 150.0  # of twice the log-likelihood, that an outline with another number of sides may lack
LEAST_S = 5.0  # of readings that are explained, before anything is told; until then the object may have ridden
BIRTHS_S = 2.0  # from its beginning, within which a search looks for more sides
PAUSE_S = 0.6  # from where nothing explains the readings to the next search's beginning
WORK = 1e6  # of a segment: iterations times nodes, as bounds the time taken; some 20 µs each


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


class SidedSearch:
    """One segment, as `search` has laid it out."""

    def __init__(self, search: Search, seed: int = 0):
        self._search, self._seed = search, seed
        segment = search.segment
        self.record = lay_out(segment.pads, search.path, search.rig, segment.start, segment.end, SPACING_S)
        self._work = 0

    def ridden(self) -> Iterator[tuple[Candidate, ...]]:
        """What explains the rides on one side, with one corner on the other palm, wherever they last long enough.

        Best first: the same minimum twice, or another.
        """
        for rides in same(rides_of(self.record)):
            if lasting(trimmed(rides)) > LEAST_S and any(ride.rolls for ride in rides):
                found = _in_order(self._along(way, rides) for way in WAYS)
                spans = self._calm(found[0])
                if lasting(spans) > max(LEAST_S, (1.0 - MOST_CUT) * found[0].lasts):
                    found = _in_order(self._cut(each, spans) for each in found)
                yield found

    def _along(self, way: Way, rides: Sequence[Ride]) -> Candidate:
        record, palm = self.record.within(trimmed(rides)), rides[0].palm
        sides = (FlatSide(normal_at_first(record, palm)),)
        p = self._start(sides)
        p[WIDTH] = math.log(way[0][0])
        guess = begun(record, rides[0], p)
        for width, noisier in way:
            noise = ProcessNoise(noisier * NOISE.psi, noisier * NOISE.omega0)
            guess = narrowed(guess, record, palm, width)
            guess = self._fitted(record, sides, guess, ((width, FIXED, math.inf),), noise=noise).fit.guess
        return self._fitted(record, sides, guess)

    @staticmethod
    def _calm(found: Candidate) -> list[tuple[float, float]]:
        """The parts (s) of its record that `found` explains all along."""
        return calm(found.record, _smoother(found.sides, found.record, found.prior).residuals(found.fit.guess))

    def _cut(self, found: Candidate, spans: list[tuple[float, float]]) -> Candidate:
        """The same, of these parts (s) alone."""
        record = self.record.within(spans)
        if len(record.t) == len(found.record.t):
            return found
        guess = kept(found.fit.guess, found.record.t, record.t)
        turn = float(guess.p[NORMALS] - found.fit.guess.p[NORMALS])
        return self._fitted(record, tuple(FlatSide(side.normal + turn) for side in found.sides), guess)

    def stretches(self, log: Callable[[Candidate], None] | None = None) -> list[tuple[Candidate, ...]]:
        """The parts of the segment that are explained, longest first: outlines and motions of each, best first.

        Where nothing follows the object from one side to another, a new search begins, as long as `WORK` lasts and what
        is left may be longer than what was found.
        """
        whole, found = self.record, list[tuple[Candidate, ...]]()
        begin, longest = 0, LEAST_S
        while begin < len(whole.dt) and whole.t[-1] - whole.t[begin] > longest and self._work < WORK:
            explained = self._explained(whole.between(begin, len(whole.dt)), log)
            lasted = explained[0].lasts if explained else FIRST_S
            if lasted > longest:
                found.insert(0, explained)
                longest = lasted
            begin += round((lasted + PAUSE_S) / SPACING_S)
        return found

    def _explained(self, whole: Record, log: Callable[[Candidate], None] | None) -> tuple[Candidate, ...]:
        """What explains the readings from the beginning as far as anything does, best first; none if nothing does."""
        first = whole.until(whole.t[0] + FIRST_S)
        candidates = [self._fitted(first, sides, guess, CALM) for sides, guess in self._starts(first)]
        best = self._kept(candidates)
        if not best[0].explains:
            best = self._kept([*candidates, *self._with_births(candidates, first.t[0])])
        explained: list[Candidate] = []
        while True:
            if log:
                for c in best:
                    log(c)
            if not best[0].explains:
                return tuple(explained)
            explained = [each for each in best if each.explains]
            if best[0].record.t[-1] >= whole.t[-1] - 1e-9 or self._work > WORK:
                return tuple(explained)
            grown = self._grown(best, whole)
            if not grown:
                return tuple(explained)
            best = self._kept(grown)

    def _kept(self, candidates: Sequence[Candidate], margin: float = 40.0) -> list[Candidate]:
        """The likeliest, and the likeliest of each number of sides as long as it explains the readings itself."""
        ordered = sorted(candidates, key=lambda each: each.deviance)
        kept: list[Candidate] = []
        for each in ordered:
            near = not kept or each.deviance < kept[0].deviance + margin
            other_kind = each.explains and all(len(each.sides) != len(other.sides) for other in kept)
            if (
                (len(kept) < RIVALS and near) or (other_kind and each.deviance < kept[0].deviance + OTHER_KIND)
            ) and not any(_same(each, other) for other in kept):
                kept.append(each)
        return kept

    def _starts(self, record: Record) -> Iterator[tuple[tuple[FlatSide, ...], Guess]]:
        yield from self._rides(record)
        still = self._start(())
        yield (), Guess(np.zeros((len(record.t), NODE)), still)
        search, begin = self._search, float(record.t[0])
        events = [event for event in search.segment.events() if event.t_sample >= begin]
        for start in blind_starts(events, search.rig, begin, BANK_S, self._seed, BANK_STARTS):
            guess = start.guess(record.t)
            p = still.copy()
            p[:NORMALS] = guess.p
            yield (), Guess(guess.x, p)

    def _rides(self, record: Record) -> Iterator[tuple[tuple[FlatSide, ...], Guess]]:
        """The object lies on one side on a palm, and turns with it."""
        for palm in (0, 1):
            sides = (FlatSide(normal_at_first(record, palm)),)
            yield sides, Guess(turning(record, palm), self._start(sides))

    def _start(self, sides: tuple[FlatSide, ...]) -> FloatArray:
        """The constants most likely before anything is felt."""
        p = self._prior(sides).mean.copy()
        dither = math.exp(p[C.SATURATION])
        p[C.LN_RHO] += math.log(p[C.SHAPE])
        p[C.DRAG], p[C.SATURATION] = p[C.DRAG] / dither, dither**-2.0
        return p

    def _grown(self, rivals: Sequence[Candidate], whole: Record) -> list[Candidate]:
        """The rivals on a longer window, as far as one of them goes on explaining it; none where none does."""
        begin, now = whole.t[0], rivals[0].record.t[-1]
        far, near = float(self._longer(rivals, whole).t[-1]), self._foretold(rivals, whole)
        for until in dict.fromkeys((far, near) if now - begin < BIRTHS_S else (near, far)):
            longer = whole.until(until)
            grown = [self._fitted(longer, each.sides, each.fit.guess) for each in rivals]
            if not _best(grown).goes_on(rivals[0]):
                led = [self._by_readings(longer, each.fit.guess) for each in rivals]
                grown += [self._fitted(longer, each.sides, guess) for each, guess in zip(rivals, led, strict=True)]
            if _best(grown).doubtful and until - begin < LEAST_S:
                grown += [self._ridden(longer, sides, guess) for sides, guess in self._rides(longer)]
            if _best(grown).goes_on(rivals[0]):
                return grown
        if now - begin < BIRTHS_S:
            grown += self._with_births(self._kept(grown, 4000.0), now)
        return grown if _best(grown).goes_on(rivals[0]) else []

    @staticmethod
    def _longer(rivals: Sequence[Candidate], whole: Record) -> Record:
        begin, now = float(whole.t[0]), float(rivals[0].record.t[-1])
        return whole.until(begin + max(GROWTH * (now - begin), now - begin + LEAST_GROWTH_S))

    def _foretold(self, rivals: Sequence[Candidate], whole: Record) -> float:
        """Until when (s) the window may grow: what no rival foretells any more leads astray."""
        now, longer = float(rivals[0].record.t[-1]), self._longer(rivals, whole)
        furthest = now + LEAST_GROWTH_S
        for each in rivals:
            smoother = _smoother(each.sides, longer, each.prior)
            gone = astray(smoother.residuals(smoother.completed(each.fit.guess)))
            furthest = max(
                furthest, longer.t[longer.contact_step[int(np.argmax(gone))]] if gone.any() else longer.t[-1]
            )
        return max(float(furthest), now + LEAST_GROWTH_S)

    def _with_births(self, candidates: Sequence[Candidate], now: float) -> Iterator[Candidate]:
        for each in candidates:
            for sides, guess in self._births(each, now):
                nodes = int(np.searchsorted(each.record.t, now)) + 1
                if 1 < nodes < len(guess.x):
                    led = self._by_readings(each.record, Guess(guess.x[:nodes], guess.p))
                    yield self._fitted(each.record, sides, led, COARSE)
                yield self._fitted(each.record, sides, guess, COARSE)

    def _births(self, candidate: Candidate, now: float) -> Iterator[tuple[tuple[FlatSide, ...], Guess]]:
        if len(candidate.sides) == SIDES:
            return
        record, guess = candidate.record, candidate.fit.guess
        at = normal_angles(record.palms, guess.x[:, 0])
        taken = [float(normal) for normal in guess.p[NORMALS : NORMALS + len(candidate.sides)]]
        for k in (int(np.searchsorted(record.t, now)), len(record.t) - 1):
            for palm in (0, 1):
                normal = float(at[k, palm])
                if any(abs(math.remainder(normal - other, math.tau)) < 0.1 for other in taken):
                    continue
                taken.append(normal)
                sides = (*self._settled(candidate), FlatSide(normal))
                p = guess.p.copy()
                p[NORMALS + len(candidate.sides)], p[LENGTHS + len(candidate.sides)] = normal, SIDE_M
                yield sides, Guess(guess.x, p)

    def refined(self, candidate: Candidate) -> Iterator[Candidate]:
        """The same iterated to the end: on finer nodes, and as it is where they lead astray.

        On finer ones the width is held: on a side that narrows steps become blows, which explain what they like.
        """
        search, start, end = self._search, candidate.record.t[0], candidate.record.t[-1]
        finer = lay_out(search.segment.pads, search.path, search.rig, start, end, LAST_S)
        record = finer.within(candidate.record.spans)
        guess = candidate.fit.guess
        held: Stage = (math.exp(guess.p[WIDTH]), FIXED, NOISE.gate)
        there = guess.on(candidate.record.t, record.t)
        yield self._fitted(record, candidate.sides, there, (held,), LAST_ITERATIONS)
        yield self._fitted(candidate.record, candidate.sides, guess, FINE, LAST_ITERATIONS)

    def posterior(self, candidate: Candidate) -> Posterior:
        """How sure it is of itself, the width open though it was held; raises LinAlgError where it is no minimum."""
        ((width, width_sd, _),) = FINE
        prior = self._prior(candidate.sides, width, width_sd)
        return _smoother(candidate.sides, candidate.record, prior).posterior(candidate.fit)

    def _by_readings(self, record: Record, guess: Guess) -> Guess:
        """The guess carried on to the record's end by the readings alone, the outline taken as it is."""
        known = len(guess.x)
        if known >= len(record.t):
            return guess
        psi = followed(guess.p, record, known - 1, float(guess.x[-1, 0]))
        x = np.empty((len(record.t), NODE))
        x[:known] = guess.x
        x[known:, 0] = psi[1:]
        x[known:, 1] = np.gradient(psi, record.t[known - 1 :])[1:]
        return Guess(x, guess.p)

    @staticmethod
    def _settled(candidate: Candidate) -> tuple[FlatSide, ...]:
        return tuple(FlatSide(float(candidate.fit.guess.p[NORMALS + j])) for j in range(len(candidate.sides)))

    def _fitted(
        self,
        record: Record,
        sides: tuple[FlatSide, ...],
        guess: Guess,
        stages: Sequence[Stage] = FINE,
        iterations: int = ITERATIONS,
        noise: ProcessNoise = NOISE,
    ) -> Candidate:
        for width, width_sd, gate in stages:
            prior = self._prior(sides, width, width_sd)
            p = guess.p.copy()
            if width_sd == FIXED:
                p[WIDTH] = math.log(width)
            smoother = _smoother(sides, record, prior)
            fit = smoother.fit(Guess(guess.x, p), replace(noise, gate=gate), iterations)
            guess = fit.guess
            self._work += fit.iterations * len(record.t)
        residual = smoother.residuals(guess)
        return Candidate(sides, prior, record, fit, float(np.median(residual**2)) / SCATTER)

    def _ridden(self, record: Record, sides: tuple[FlatSide, ...], guess: Guess) -> Candidate:
        """As `_fitted`, on ever narrower sides; given up where on a wide one already nothing is explained."""
        wide = self._fitted(record, sides, guess, CALM[:1])
        if wide.fit.cost > HOPELESS * record.readings:
            return wide
        return self._fitted(record, sides, wide.fit.guess, CALM[1:])

    def _prior(self, sides: tuple[FlatSide, ...], width: float = FINE[0][0], width_sd: float = FIXED) -> Prior:
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
        mean[WIDTH], sd[WIDTH] = math.log(width), width_sd
        return Prior(mean, sd, base.omega0_sd)


def _smoother(sides: Sequence[FlatSide], record: Record, prior: Prior) -> SidedSmoother:
    return SidedSmoother(sharp.library_for(len(sides)), record, prior)


def _in_order(candidates: Iterable[Candidate]) -> tuple[Candidate, ...]:
    return tuple(sorted(candidates, key=lambda each: each.deviance))


def _best(candidates: Sequence[Candidate]) -> Candidate:
    return min(candidates, key=lambda each: each.deviance)


def _same(one: Candidate, other: Candidate) -> bool:
    if len(one.fit.guess.x) != len(other.fit.guess.x) or len(one.sides) != len(other.sides):
        return False
    return float(np.abs(one.fit.guess.x[:, 0] - other.fit.guess.x[:, 0]).max()) < 0.02


GRID_RAD, REACH, ROAMS = 2.5e-3, 40, 0.9  # of ψ: steps, most of them in one interval, and how far about the start (rad)
INTERVAL_NODES = 3
FOLLOW_SD_M, FOLLOW_GATE, FOLLOW_TURN_RAD = 6e-4, 25.0, 0.02
FOLLOW_WIDTH = 0.008  # of sides (rad), a few of the grid's steps
TABLE = 7200


def followed(p: FloatArray, record: Record, start: int, psi0: float) -> FloatArray:
    """ψ (rad) at the nodes from `start` on, where it is psi0, by the readings and the outline p alone.

    Dynamic programming over a grid: each interval's readings are missed least, turns are dear. No dynamics.
    """
    t = record.t[start:]
    bins = np.arange(0, len(t), INTERVAL_NODES)
    count = 2 * round(ROAMS / GRID_RAD) + 1
    grid = np.linspace(psi0 - ROAMS, psi0 + ROAMS, count)
    angles = np.linspace(0.0, math.tau, TABLE, endpoint=False)
    wide = p.copy()
    wide[WIDTH] = max(p[WIDTH], math.log(FOLLOW_WIDTH))
    h = sharp.support(angles, wide)
    d = -(np.roll(h, -1) - np.roll(h, 1)) * (TABLE / math.tau / 2)

    def at(table: FloatArray, theta: FloatArray) -> FloatArray:
        position = theta * (TABLE / math.tau)
        low = np.floor(position)
        part = position - low
        i = low.astype(np.intp) % TABLE
        return table[i] * (1 - part) + table[(i + 1) % TABLE] * part

    mine = record.contact_step >= start
    which = (record.contact_step[mine] - start) // INTERVAL_NODES
    joints = [record.contact_palms[mine, joint][:, None] for joint in range(len(JOINTS))]
    normals = normal_directions(joints, grid[None, :])
    one, two = (at(h, theta) for theta in normals)
    before, after = (at(d, theta) for theta in normals)
    first, cos, sin = (record.contact_pad[mine] < 1.5)[:, None], np.cos(joints[OPENING]), np.sin(joints[OPENING])
    s = np.where(first, one * cos + two, two * cos + one) / sin + np.where(first, -before, after)
    miss = (record.contact_value[mine][:, None] - s) ** 2 / FOLLOW_SD_M**2
    miss = np.where(miss > FOLLOW_GATE, FOLLOW_GATE * (1 + np.log(np.maximum(miss, FOLLOW_GATE) / FOLLOW_GATE)), miss)
    cost = np.zeros((len(bins), len(grid)))
    np.add.at(cost, np.minimum(which, len(bins) - 1), miss)
    turn = (np.arange(-REACH, REACH + 1) * GRID_RAD / FOLLOW_TURN_RAD) ** 2
    best = np.where(np.abs(grid - psi0) < GRID_RAD / 2, 0.0, 1e9)
    back = np.zeros((len(bins), len(grid)), dtype=np.intp)
    index = np.arange(len(grid))
    for b in range(1, len(bins)):
        padded = np.pad(best, REACH, constant_values=1e12)
        options = np.lib.stride_tricks.sliding_window_view(padded, 2 * REACH + 1) + turn
        choice = options.argmin(axis=1)
        back[b] = np.clip(index + choice - REACH, 0, len(grid) - 1)
        best = options[index, choice] + cost[b]
    path = np.zeros(len(bins), dtype=np.intp)
    path[-1] = int(best.argmin())
    for b in range(len(bins) - 1, 0, -1):
        path[b - 1] = back[b, path[b]]
    middle = np.minimum(bins + INTERVAL_NODES / 2, len(t) - 1)
    middle[0] = 0
    psi: FloatArray = np.interp(np.arange(len(t)), middle, grid[path])
    return psi
