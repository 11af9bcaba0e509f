"""A rival carried on along a record, window by window: what is behind is a belief about its last node and the body.

A window is fitted under that belief alone, so that going on costs by the window and not by the record. What it costs
per number read is how badly the body foretold it, what was never touched allowed for by the belief itself. Now and then
all of it is smoothed as a whole, and the belief is made anew.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from palmd.events import FloatArray
from palmd.model import rotation
from palmd.model.convex_bodies import bending, convex, least_radii
from palmd.model.spherical import Y00, order_of
from palmd.model.three_palms import BODY
from palmd.observer.three_palms import beliefs
from palmd.observer.three_palms.arrow import STATES
from palmd.observer.three_palms.beliefs import Bools, Hypothesis
from palmd.observer.three_palms.body import FINER, ORDER, centres_of, inertia, touching
from palmd.observer.three_palms.driven import BallBelief, ContactCurves, course
from palmd.observer.three_palms.equations import BodyMotion
from palmd.observer.three_palms.record import BodyRecord, lay_out
from palmd.observer.three_palms.search import (
    EXPLAINED,
    HOPELESS,
    SPACING_S,
    START_ORDER,
    ContactBall,
    Rival,
    Task,
    by_chance,
    eased,
    loosely,
    loosened,
    rivals,
    roughened,
)
from palmd.observer.three_palms.smoother import BodyFit, BodyPrior, BodySmoother
from palmd.observer.three_palms.touched_outline import foretelling

WHOLE_STARTS_S = (2.0, 5.0, 8.0, math.inf)
"""Of a record, that are explained as a whole at once; from the first second alone, in many ways, where that fails.

What is calm is told soonest from its beginning; a tumble leads who grows from there astray, but not who explains all.
"""
WAYS = 4
"""Hypotheses that longer starts are tried with; the shortest is tried with all."""
SPINNING_S = 0.7
"""Of a record, that is explained as a whole by each way without friction: who spins fast has come far in 2 s."""
STARTS_S = (1.3, 0.8)
LAP_S = 1.5
"""After how long a time rivals are compared."""
FOUND_S = 9.0
"""Of a record, beyond which no other start is asked for any more where two thirds of it were found twice."""
BEHIND = 40.0  # in cost, of the cheapest, where a rival is given up
STRANGE = 3.0
"""One-sigmas by which the cost of a whole record is too high, from which on finer harmonics are asked for."""
RUBS = 0.02  # coefficient of friction, above which a body moves with the palms
FINE_TRIES = 8  # iterations with these, which explain half of what was left, or they are not what it takes
SAME_COST, SAME_RAD_S = 3.0, 0.02
TOO_FAR = 100.0  # in cost, of the cheapest, where a start is dropped after a few iterations
HOPELESS_WHOLE = 1.7  # cost per number read after these, above which a start of a whole record leads nowhere
DECISIVE, OTHER_RAD_S = 12.0, 0.05
"""By how much less an explanation must cost than another motion's to be believed: odds of 400 to 1."""
SURE = 1.35  # cost per number read at the end that truncation may cost
MOST_COST = 1.12
"""The same, of readings, equations and beliefs together, of a motion that explains a record to its noise."""
MOST_LAMBDA = 0.5
"""Of the inertia's λ: beyond it the inertia stands in for something else."""
CURVATURE_EVERY = 5  # contacts
HOLLOW_CHI2 = 9.0
"""Of the move to the nearest convex body, above which what is known of a body does not allow of one."""
WINDOWS_S = (0.5, 0.2, 0.1)
"""How far it goes on at once; shorter where it is foretold badly."""
TURN_A_WINDOW = 1.0  # rad
FORETOLD = 1.35
"""Cost per number read of a window, above which it is tried again, shorter and from all of it smoothed."""
FORKED, FORKS_S = 1.15, 3.0
"""The same of a window in the first seconds, where what is behind allows of more than one way on."""
FORK_S = 0.4
FORKED_STARTS, FORKS_A_LAP = 2, 1
TRIES = (4, 12)
"""Iterations of the whole that a way is tried with, while it is cheap enough."""
FORKS = (0.0, -1.5, 1.5, -3.0, 3.0)
"""Ways that are tried, in standard deviations of the spin along its least known axis."""
STARTLED, TUMBLES_RAD_S = 3.0, 6.0
"""Cost per number read of a window, above which what has spun so fast lately has to be found again."""
LATELY_S, LOST = 1.0, 6.0
"""A rival is lost where so long a time cost that much per number read."""
AGAIN, AGAIN_EARLY, AGAIN_WHEN_SURPRISED = 1.6, 1.2, 1.15
"""By which factor a record has grown when all of it is smoothed again; early the valley that is left open is bent."""


@dataclass(frozen=True, slots=True)
class Grown:
    """A rival as far as it has come: its motion at all nodes of `record`, what is believed of the last, what it cost.

    whole: the last fit of all until then. windows: of each since the start, its intervals and its cost per number read.
    met: how many starts led to it. confirmed: how many intervals it had when another blind start last came to the same.
    folded: how many numbers were read before the record, and what they cost. refined: how many intervals it had when
    finer harmonics were tried, doubted: when it was last begun from itself. astray: nothing explains all of it.
    """

    prior: BodyPrior
    record: BodyRecord
    motion: BodyMotion
    ahead: BodyPrior
    cost: float
    whole: BodyFit
    windows: tuple[tuple[int, float], ...] = ()
    met: int = 1
    confirmed: int = 0
    folded: tuple[int, float] = (0, 0.0)
    refined: int = 0
    doubted: int = 0
    astray: bool = False

    @property
    def intervals(self) -> int:
        """How far it has come."""
        return len(self.record.middle_palms)

    @property
    def per_number(self) -> float:
        """Cost per number read."""
        return self.cost / self.record.numbers

    def unexplained(self, bent: float = 0.0) -> float:
        """What it cost more than 1 and its one-sigma for each number that was ever read; 0 where all is explained.

        bent: what it cost besides before it was given finer harmonics, which bend to what is wrong.
        """
        numbers, cost = self.folded[0] + self.record.numbers, self.folded[1] + self.cost + bent
        return max(cost / numbers - 1.0 - math.sqrt(2.0 / numbers), 0.0)

    @property
    def strange(self) -> float:
        """By how many of its one-sigmas the cost is more than it should be."""
        return self.beyond(1.0)

    def beyond(self, per_number: float) -> float:
        """By how many of its one-sigmas the cost is above so much per number read."""
        return (self.per_number - per_number) * math.sqrt(self.record.numbers / 2)

    @property
    def since_whole(self) -> float:
        """By which factor the record has grown since all of it was fitted."""
        return self.intervals / (len(self.whole.motion.R) - 1)

    @property
    def found_twice(self) -> bool:
        """Whether another start has come to the same, of no less than two thirds of it or of `FOUND_S`."""
        return 3 * self.confirmed >= 2 * min(self.intervals, round(FOUND_S / SPACING_S))

    @property
    def alone(self) -> bool:
        """Whether nothing else has come to it though it asks for that: finer harmonics bend to much, short records too.

        What has foretold `FOUND_S` and costs no more than its noise does not.
        """
        bent = self.strange >= STRANGE or self.order > FINER[0]
        asks = bent or self.intervals < round(FOUND_S / SPACING_S)
        return asks and not self.found_twice

    @property
    def innovation_test(self) -> float:
        """What the last window cost per number read."""
        return self.windows[-1][1] if self.windows else 0.0

    def startled(self, lately: int) -> bool:
        """Whether a window of so many last intervals was foretold badly, after a tumble: more than one way led on.

        What turns slowly and is foretold badly is sharper than its harmonics; contacts tell where that goes.
        """
        spin, until = np.linalg.norm(self.motion.omega, axis=1), self.intervals
        for intervals, innovation_test in reversed(self._last_windows(lately)):
            since = max(until - intervals - round(LATELY_S / SPACING_S), 0)
            if innovation_test > STARTLED and spin[since : until + 1].max() > TUMBLES_RAD_S:
                return True
            until -= intervals
        return False

    @property
    def lost(self) -> bool:
        """Whether what it foretells has nothing to do with what is read any more."""
        if self.astray:
            return True
        lately = LATELY_S / SPACING_S
        windows = self._last_windows(lately)
        length = sum(intervals for intervals, _ in windows)
        return (
            length >= lately
            and sum(intervals * innovation_test for intervals, innovation_test in windows) > LOST * length
        )

    def _last_windows(self, intervals: float) -> tuple[tuple[int, float], ...]:
        """The fewest that reach back so far; all, if they do not."""
        length, first = 0, len(self.windows)
        while length < intervals and first > 0:
            first -= 1
            length += self.windows[first][0]
        return self.windows[first:]

    @property
    def plausible(self) -> bool:
        """Whether a body may be so: its inertia, and its surface where a palm has touched."""
        return self.largest_lambda <= MOST_LAMBDA and self.may_be_convex

    @property
    def largest_lambda(self) -> float:
        """Of the numbers that tell its inertia, which are 0 for a dense ball."""
        return float(np.abs(self.motion.p[-BODY:-3]).max())

    @property
    def order(self) -> int:
        """The degree of its outline."""
        return order_of(len(self.motion.p) - BODY)

    @property
    def felt(self) -> FloatArray:
        """(3 K + 3, 3) outward normals, in the body's frame, where a palm touched it at a node."""
        return touching(self.motion.R, self.record.node_palms).reshape(-1, 3)

    @property
    def may_be_convex(self) -> bool:
        """Whether what is known of it allows of a convex body, wherever a palm has touched it."""
        if self._least_radius(self.motion.p[:-BODY]) > 0.0:
            return True
        try:
            covariance = np.linalg.inv(self.ahead.information)[STATES:, STATES:]
        except np.linalg.LinAlgError:
            return False
        return bool(self.made_convex(self.motion.p, np.asarray(covariance, np.float64))[1] <= HOLLOW_CHI2)

    def made_convex(self, x: FloatArray, covariance: FloatArray) -> tuple[FloatArray, float]:
        """What is believed of it, x (m,) and its covariance (m, m), convex wherever a palm has touched; χ² of the move.

        x: parameters, or states before them. It is moved as little as its covariance allows, and not at all where it is
        convex; χ² is infinite where that does not make it so.
        """
        shape = slice(len(x) - len(self.motion.p), len(x) - BODY)
        if self._least_radius(x[shape]) > 0.0:
            return x, 0.0
        moved = convex(x, covariance, shape, self._bending)
        if self._least_radius(moved[shape]) <= 0.0:
            return moved, math.inf
        return moved, float((moved - x) @ np.linalg.solve(covariance, moved - x))

    @property
    def _bending(self) -> FloatArray:
        return bending(order_of(len(self.motion.p) - BODY), self.felt[::CURVATURE_EVERY])

    def _least_radius(self, c: FloatArray) -> float:
        """Of curvature, of a body with these coefficients where a palm has touched this one (m)."""
        return float(least_radii(c, self._bending)[0].min())

    def same_as(self, other: Grown) -> bool:
        """Whether both have come to the same motion of the same body."""
        off = np.abs(self.motion.omega[-1] - other.motion.omega[-1]).max()
        return bool(off < SAME_RAD_S and abs(self.cost - other.cost) < SAME_COST)

    def contradicts(self, other: Grown) -> bool:
        """Whether it explains as much about as well by another motion."""
        if self.intervals < other.intervals or self.cost > other.cost + DECISIVE:
            return False
        return not self.moves_as(other)

    def moves_as(self, other: Grown) -> bool:
        """Whether both have about the same motion, of as long a record; their minima may lie beside each other."""
        off = self.motion.omega - other.motion.omega
        return bool(np.sqrt(np.mean(off**2)) < OTHER_RAD_S)


def best(task: Task) -> list[Grown]:
    """Rivals followed to the end or to where they are lost: who got furthest first, then bodies, then the cheapest."""
    ended: list[Grown] = []
    for running, forks in _starts(task):
        ended = sorted([*ended, *raced(task, running, forks=forks)], key=_rank)
        if ended and ended[0].intervals == task.intervals(task.end - task.start):
            first, *others = sorted(sharpened(task, ended), key=_rank)
            ended = sorted([_again(task, first), *others], key=_rank)
            first = ended[0]
            if first.per_number <= MOST_COST and first.plausible and not first.alone:
                break
    if ended and (ended[0].lost or ended[0].since_whole > 1.0):
        ended[0] = smoothed(task, ended[0])
    return ended


def _rank(rival: Grown) -> tuple[int, bool, float]:
    return -rival.intervals, not rival.plausible, rival.cost


def sharpened(task: Task, ended: list[Grown]) -> list[Grown]:
    """Those that explain all of the record about as cheaply as the first, with finer harmonics where that pays."""
    if not ended or ended[0].strange < STRANGE or ended[0].per_number > HOPELESS:
        return ended
    first = ended[0]

    def near(each: Grown) -> bool:
        return each.intervals == first.intervals and each.cost < first.cost + BEHIND

    return [finer(task, each, task.finer) if near(each) else each for each in ended]


def finer(task: Task, now: Grown, orders: tuple[int, ...]) -> Grown:
    """With an outline up to finer degrees, one after the other, as far as they pay; all of its record is fitted."""
    if now.refined == now.intervals:
        return now
    now = replace(now, refined=now.intervals)
    for order in orders:
        if order <= now.order or now.strange < STRANGE:
            continue
        prior = beliefs.raised_belief(now.prior, order)
        smoother = BodySmoother(now.record, prior, task.noise, task.rig)
        fit = smoother.fit(replace(now.motion, p=beliefs.raised(now.motion.p, order)), FINE_TRIES)
        if fit.cost > now.cost - BEHIND:
            break
        if now.cost - fit.cost > fit.cost - now.record.numbers:  # it explains most of what was left
            fit = smoother.fit(fit.motion)
        ahead = smoother.ahead(fit)
        now = replace(now, prior=prior, motion=fit.motion, ahead=ahead, cost=fit.cost, whole=fit, windows=())
    return now


def _again(task: Task, now: Grown) -> Grown:
    """The rival; where it is alone, found again from itself, or what it leads to if that costs less.

    All of it is roughened, loosened and tightened again: a right motion comes back, a wrong one goes elsewhere.
    """
    if not now.alone or now.per_number > SURE or now.doubted == now.intervals:
        return now
    again = _tightened(task, now, roughened(task, now.record, now.prior, now.motion).motion)
    return _met(again, now) or min(again, replace(now, doubted=now.intervals), key=lambda each: each.cost)


def _starts(task: Task) -> Iterator[tuple[list[Grown], float]]:
    """What rivals are followed from, one set after the other, each sought only when it is asked for.

    With each, in how many windows a lap they are forked: what leads on from seconds as a whole needs no more than one.
    """
    for seconds in WHOLE_STARTS_S:
        ways = islice(beliefs.hypotheses(), WAYS if seconds > min(WHOLE_STARTS_S) else None)
        yield _likely(anew(task, task.record(seconds), ways)), FORKS_A_LAP
    for seconds in STARTS_S:
        yield begun_in_ways(task, [each for each in rivals(task, seconds) if each.per_number < HOPELESS]), math.inf
    spinning = task.record(SPINNING_S)
    slippery = [way for way in beliefs.hypotheses() if way.mu == beliefs.FRICTIONLESS]
    found = [each for way in slippery for each in anew(task, spinning, [way])]
    yield _likely(apart(sorted(found, key=lambda each: each.cost))), math.inf


def _likely(found: list[Grown]) -> list[Grown]:
    """Of starts, the cheapest first, those that explain their record, about as cheaply."""
    return [each for each in found if each.per_number < SURE and each.cost < found[0].cost + BEHIND]


def begun_in_ways(task: Task, found: list[Rival], forks: float = math.inf) -> list[Grown]:
    """What the starts go on as, a little further: the likeliest in several ways, as each may have minima beside it.

    None of these is forked again in more than so many windows.
    """
    if not found:
        return []
    started = sorted((begun(task, each) for each in found), key=lambda each: each.cost)
    near = [each for each in started if each.cost < started[0].cost + BEHIND]
    until = near[0].intervals + round(FORK_S / SPACING_S)
    ways = [way for each in near[:FORKED_STARTS] for way in _ways(task, each, until)]
    further = [advanced(task, each, until, forks=forks) for each in (*ways, *near[FORKED_STARTS:])]
    return apart(sorted(further, key=lambda each: each.cost))


def raced(task: Task, running: list[Grown], enough: float = math.inf, forks: float = math.inf) -> list[Grown]:
    """All of them followed side by side: who falls behind in cost is given up, who meets another goes on as one.

    None is followed that has come to cost more than `enough`; nor forked in more than so many windows a lap.
    """
    end = task.intervals(task.end - task.start)
    ended: list[Grown] = []
    while running:
        reached = max(each.intervals for each in running)
        if reached == end:
            break
        until = min(reached + round(LAP_S / SPACING_S), end) if len(running) > 1 else end
        first, *others = running
        first = advanced(task, first, until, enough, forks)
        most = enough if first.lost else min(first.cost + BEHIND, enough)
        running = [first, *(advanced(task, each, until, most, forks) for each in others)]
        ended += [each for each in running if each.lost]
        running = [each for each in running if not each.lost]
        most = min(min((each.cost for each in running if each.intervals == until), default=0.0) + BEHIND, enough)
        ended += [each for each in running if each.cost > most]
        running = apart(sorted((each for each in running if each.cost <= most), key=lambda each: each.cost))
    return ended + apart([smoothed(task, each, 15) for each in running])


def apart(rivals: list[Grown]) -> list[Grown]:
    """Those that have met as one, in their order."""
    kept: list[Grown] = []
    for each in rivals:
        twin = next((i for i, other in enumerate(kept) if each.same_as(other)), None)
        if twin is None:
            kept.append(each)
        else:
            kept[twin] = replace(
                kept[twin], met=kept[twin].met + each.met, confirmed=max(kept[twin].confirmed, each.confirmed)
            )
    return kept


def begun(task: Task, rival: Rival) -> Grown:
    """The rival with an outline up to degree `ORDER`."""
    prior = beliefs.prior(rival.radius, ORDER, task.spin_sd)
    motion = replace(rival.fit.motion, p=beliefs.raised(rival.fit.motion.p, ORDER))
    return smoothed(task, Grown(prior, rival.record, motion, prior, rival.fit.cost, rival.fit, met=rival.met), 15)


def smoothed(task: Task, now: Grown, iterations: int = 20) -> Grown:
    """All of it fitted as a whole."""
    smoother = BodySmoother(now.record, now.prior, task.noise, task.rig)
    # the body as the last window has it, or as all until then had it: what is nearer to a motion of all
    newest = now.motion.p
    before = beliefs.raised(now.whole.motion.p, order_of(len(newest) - BODY))
    bodies = [newest] if np.array_equal(newest, before) else [newest, before]
    starts = [smoother.settled(replace(now.motion, p=body)) for body in bodies]
    fit = smoother.fit(min(starts, key=lambda each: each.cost).motion, iterations)
    return replace(now, motion=fit.motion, ahead=smoother.ahead(fit), cost=fit.cost, whole=fit)


def anew(task: Task, record: BodyRecord, ways: Iterable[Hypothesis], most: float = math.inf) -> list[Grown]:
    """All of a record from its beginning explained blindly, the cheapest first, each way but once.

    Contacts of many seconds lead to where rivals that grow from a short start do not come: those keep to their valley.
    Sought with an outline of degree `START_ORDER`: higher ones bend to what the motion does not explain yet.
    Ends where two ways have met in the cheapest; none is gone on with that costs far more than `most`.
    """
    contacts = ContactCurves.smoothed(record.readings)
    ball = ContactBall.of(task.path, contacts, record)
    coarse, prior = (beliefs.prior(ball.radius, order, task.spin_sd) for order in (START_ORDER, ORDER))
    smoother = BodySmoother(record, prior, task.noise, task.rig)
    found: list[Grown] = []
    for way in ways:
        if way.mu == beliefs.FRICTIONLESS and found and found[0].per_number < EXPLAINED:
            break
        loose = loosely(task, record, coarse, contacts, ball, way)
        sought = task.fitted(record, coarse, None, loose.motion, TRIES[1]).motion
        fit = smoother.fit(replace(sought, p=beliefs.raised(sought.p, ORDER)), TRIES[0])
        if fit.cost > min(most + TOO_FAR, HOPELESS_WHOLE * record.numbers):
            continue
        fit = eased(task, record, prior, smoother.fit(fit.motion))
        most = min(most, fit.cost)
        now = Grown(prior, record, fit.motion, smoother.ahead(fit), fit.cost, fit)
        found = apart(sorted([*found, now], key=lambda each: each.cost))
        if found[0].met > 1:
            found[0] = replace(found[0], confirmed=found[0].intervals)
            break
    return found


def found_again(task: Task, rivals: list[Grown], ways: Iterable[Hypothesis], *, believed: bool = False) -> list[Grown]:
    """The rivals, the cheapest first, with what other starts of the same record lead to, until one meets the cheapest.

    That one is `confirmed`; so it is where all blind starts end far away, and one from itself, with much noise allowed
    to the equations at first, comes back. All of `rivals` are of one record, from its beginning. Where the cheapest is
    `believed`, it is enough that the other moves as it: what harmonics leave out makes minima beside each other.
    """

    for way in ways:
        first = rivals[0]
        for again in _begun_alike(task, first, [way], first.cost if first.order == ORDER else math.inf):
            if (both := _met(again, first, believed=believed)) is not None:
                return [both, *rivals[1:]]
            rivals = sorted([again, *rivals], key=lambda each: each.cost)
    first, *others = rivals
    if all(each.cost > first.cost + BEHIND for each in others):
        again = _tightened(task, first, loosened(task, first.record, first.prior, first.motion).motion)
        both = _met(again, first, believed=believed)
        found = [again, first] if both is None else [both]
        return sorted([*found, *others], key=lambda each: each.cost)
    return rivals


def moves_so(task: Task, now: Grown, ways: Iterable[Hypothesis]) -> bool:
    """Whether a blind start of the same record moves as it, which may go on from a belief and be in its frame."""
    return any(each.moves_as(now) for each in _begun_alike(task, now, ways))


def _begun_alike(task: Task, now: Grown, ways: Iterable[Hypothesis], most: float = math.inf) -> Iterator[Grown]:
    """What blind starts of the same record lead to, with harmonics as fine as its own; see `anew`."""
    orders = () if now.order == ORDER else (now.order,)
    return (finer(task, each, orders) for each in anew(task, now.record, ways, most))


def _met(again: Grown, first: Grown, *, believed: bool = False) -> Grown | None:
    """Both as one, which is confirmed, if the second start has come to the same; see `found_again`."""
    if again.same_as(first) or (believed and again.moves_as(first)):
        return replace(again if again.cost < first.cost - SAME_COST else first, confirmed=first.intervals)
    return None


def _tightened(task: Task, now: Grown, motion: BodyMotion) -> Grown:
    """The same record explained by what `motion` leads to."""
    smoother = BodySmoother(now.record, now.prior, task.noise, task.rig)
    fit = smoother.fit(motion)
    return replace(now, motion=fit.motion, ahead=smoother.ahead(fit), cost=fit.cost, whole=fit, confirmed=0)


def folded(task: Task, now: Grown, intervals: int, touched: Bools) -> Grown:
    """The rival without so many of its first intervals, which become the belief that its record begins with.

    touched: (D,) which directions of the body have been until then.
    """
    R, omega, p = now.motion.R, now.motion.omega, now.motion.p
    head = task.whole.first(intervals)
    smoother = BodySmoother(head, now.prior, task.noise, task.rig)
    ahead = smoother.ahead(smoother.evaluate(BodyMotion(R[: intervals + 1], omega[: intervals + 1], p)))
    prior = foretelling(ahead, touched)
    start = task.start + intervals * SPACING_S
    tail = lay_out(task.path, task.readings, start, now.intervals - intervals, SPACING_S)
    motion = BodyMotion(R[intervals:], omega[intervals:], p)
    lately = now.windows[-round(LATELY_S / SPACING_S) :]  # no window is shorter than an interval
    kept = smoothed(task, replace(now, prior=prior, record=tail, motion=motion, windows=lately))
    numbers, cost = now.folded
    return replace(kept, folded=(numbers + now.record.numbers - kept.record.numbers, cost + now.cost - kept.cost))


def advanced(task: Task, now: Grown, until: int, most: float = math.inf, forks: float = math.inf) -> Grown:
    """The rival followed to so many intervals, or to where it is lost or costs more than `most`.

    Windows beyond so many `forks` are taken as they are foretold.
    """
    while now.intervals < until and not now.lost and now.cost <= most:
        early = now.intervals * SPACING_S < FORKS_S
        if now.since_whole > (AGAIN_EARLY if early else AGAIN):
            now = _sure(task, smoothed(task, now))
        further = _window(task, now, WINDOWS_S[0], until)
        surprising = FORKED if early else FORETOLD
        if further.innovation_test > surprising and now.since_whole > AGAIN_WHEN_SURPRISED:
            now = _sure(task, smoothed(task, now))
            further = _window(task, now, WINDOWS_S[0], until)
        if further.innovation_test > surprising:
            if early and forks > 0:
                further, forks = _forked(task, now, until), forks - 1
            elif not early:
                for seconds in WINDOWS_S[1:]:
                    further = _window(task, now, seconds, until)
                    if further.innovation_test < FORETOLD:
                        break
        now = further
    return now


def _sure(task: Task, now: Grown) -> Grown:
    """The rival, all of which is fitted, with finer harmonics where they pay; astray where nothing explains it.

    Finer ones are for what spins: where a palm rubs they bend, for a while, to what a wrong motion leaves unexplained.
    """
    if not task.finer or now.strange < STRANGE:
        return now
    now = finer(task, now, task.finer) if now.motion.p[-2] < RUBS else now
    return replace(now, astray=now.beyond(MOST_COST) > STRANGE)


def _forked(task: Task, now: Grown, until: int) -> Grown:
    """One window further by the cheapest of several ways, each fitted as a whole from another spin at its beginning."""
    return replace(min(_ways(task, now, until), key=lambda each: each.cost), confirmed=0)


def _ways(task: Task, now: Grown, until: int) -> list[Grown]:
    """Of ways that have met in their window one goes on, and of those that are tried as a whole only the cheap ones.

    All come as far, for what costs less may be shorter: who is believed to spin fast turns enough in a short window.
    """
    there = min(now.intervals + round(FORK_S / SPACING_S), until)
    tried: list[Grown] = []
    for share in FORKS:
        way = _window(task, now, FORK_S, there, share)
        most = min((each.cost for each in tried), default=math.inf) + TOO_FAR
        while way.intervals < there and way.cost < most:
            way = _window(task, smoothed(task, way, TRIES[0]), FORK_S, there)
        if way.intervals == there:
            tried.append(way)
    for iterations in TRIES:
        tried.sort(key=lambda each: each.cost)
        tried = [smoothed(task, each, iterations) for each in apart(tried) if each.cost < tried[0].cost + BEHIND]
    return tried


def _shifted(belief: BodyPrior, share: float) -> BodyPrior:
    """The belief's mean moved so many standard deviations along the axis about which its spin is known least."""
    if share == 0.0:
        return belief
    covariance = np.linalg.inv(belief.information)
    variance, axes = np.linalg.eigh(covariance[3:STATES, 3:STATES])
    step = covariance[:, 3:STATES] @ axes[:, -1] * (share / math.sqrt(variance[-1]))
    R = rotation.exp(np.asarray(step[:3], np.float64)) @ belief.R
    return BodyPrior(R, belief.spin + step[3:STATES], belief.mean + step[STATES:], belief.information)


def _window(task: Task, now: Grown, seconds: float, until: int, share: float = 0.0) -> Grown:
    """One window further; its fit begins from the belief `_shifted` by `share`."""
    have = now.intervals
    more = min(max(round(seconds / SPACING_S), 1), until - have)
    start = task.start + have * SPACING_S
    begun_with = _shifted(now.ahead, share)
    told = _guess(task, begun_with, now.record.node_palms[-1:], start, more)
    more = len(told.R) - 1
    record = lay_out(task.path, task.readings, start, more, SPACING_S)
    smoother = BodySmoother(record, now.ahead, task.noise, task.rig)
    if task.finer:  # live it costs up to a fifth of a lap
        told = _nearer(smoother, record, told, _kept(begun_with, more))
    fit = smoother.fit(told, 15)
    if share == 0.0:  # else it is one of many ways that are tried
        fit = eased(task, record, now.ahead, fit)
    joined = BodyMotion(
        np.concatenate([now.motion.R[:-1], fit.motion.R]),
        np.concatenate([now.motion.omega[:-1], fit.motion.omega]),
        fit.motion.p,
    )
    numbers = max(record.numbers, 1)
    return replace(
        now, record=task.whole.first(have + more), motion=joined, ahead=smoother.ahead(fit), cost=now.cost + fit.cost,
        windows=(*now.windows, (more, fit.cost / numbers)),
    )  # fmt: skip


def _nearer(smoother: BodySmoother, record: BodyRecord, told: BodyMotion, kept: BodyMotion) -> BodyMotion:
    """A window as the contacts tell it, or with the spin kept, where that lies nearer: nodes settled, of either.

    Contacts tell a tumble, but of what is calm and round a spin that is not.
    """
    nearest = smoother.settled(told)
    if not by_chance(nearest, record):
        nearest = min(nearest, smoother.settled(kept), key=lambda each: each.cost)
    return nearest.motion


def _kept(ahead: BodyPrior, more: int) -> BodyMotion:
    """The motion carried on as if it kept its spin, over `more` intervals."""
    omega = np.tile(ahead.spin, (more + 1, 1))
    steps = SPACING_S * np.arange(more + 1)[:, None] * ahead.spin
    return BodyMotion(rotation.exp(np.asarray(steps, np.float64)) @ ahead.R, omega, ahead.mean)


def _guess(task: Task, ahead: BodyPrior, palms: FloatArray, start: float, more: int) -> BodyMotion:
    """The motion carried on as the contacts tell, over `more` intervals or until it has turned enough."""
    R, omega, p = ahead.R, ahead.spin, ahead.mean
    radius, gyration = Y00 * p[0], float(np.sqrt(np.trace(inertia(p)) / 3))
    belief = BallBelief(
        np.array([math.log(gyration), p[-3], math.log(max(p[-2], beliefs.FRICTIONLESS)), p[-1], radius]),
        np.array([0.02, 1e-6, 0.02, 0.02, 0.02 * radius]),
        np.concatenate([centres_of(R[None], palms, p)[0], omega]),
        np.array([1e-4] * 3 + [0.05] * 3),
    )
    driven = course(task.path, task.contacts, start, more, SPACING_S, belief, task.rig)
    turned: FloatArray = np.cumsum(np.linalg.norm(driven.omega, axis=1)) * SPACING_S
    within = max(int(np.searchsorted(turned, TURN_A_WINDOW)), round(WINDOWS_S[-1] / SPACING_S))
    more = min(more, within)
    return BodyMotion(driven.rotations(R)[: more + 1], driven.omega[: more + 1], p)
