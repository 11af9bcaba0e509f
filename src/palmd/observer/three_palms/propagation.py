"""Propagate hypotheses of a body's motion along a record, window by window; prune, merge and confirm them.

Readings before a window are summarised by a Gaussian belief of the window's first node and the body, so that extending
a hypothesis takes time in proportion to the window and not to the record. A window's cost per number read measures how
well the hypothesis predicted it; surface that was never touched is uncertain in the belief and does not count against
it. From time to time the whole record is refitted, and the belief recomputed from that fit. Costs are sums of squares
of normalised residuals of readings, equations and prior.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from palmd.events import FloatArray
from palmd.model import rotation
from palmd.model.convex_bodies import curvature_rows, least_radii, nearest_convex
from palmd.model.spherical import Y00, order_of
from palmd.model.three_palms import BODY
from palmd.observer.three_palms import beliefs
from palmd.observer.three_palms.arrow import STATES
from palmd.observer.three_palms.beliefs import Bools, StartAssumption
from palmd.observer.three_palms.body import FINER_ORDERS, ORDER, centres_of, contact_normals, inertia
from palmd.observer.three_palms.driven import BallBelief, ContactCurves, smooth_course
from palmd.observer.three_palms.equations import BodyMotion
from palmd.observer.three_palms.record import BodyRecord, lay_out
from palmd.observer.three_palms.search import (
    EXPLAINED_COST,
    HOPELESS_COST,
    SPACING_S,
    START_ORDER,
    ContactBall,
    StartCandidate,
    Task,
    fit_blind_start,
    fit_with_loose_equations,
    graduated_fit,
    graduated_refit,
    start_candidates,
    within_chance,
)
from palmd.observer.three_palms.smoother import BodyFit, BodyPrior, BodySmoother
from palmd.observer.three_palms.touched_outline import predictive_belief

WHOLE_STARTS_S = (2.0, 5.0, 8.0, math.inf)
"""Lengths of the record's beginning that are fitted as a whole from blind starts, tried in turn.

A calm motion is determined soonest by its beginning. A tumble makes hypotheses diverge that are propagated from before
it, but not a fit of the whole record.
"""
LONG_START_ASSUMPTIONS = 4
"""Start assumptions tried with the longer beginnings; the shortest one is tried with all."""
FRICTIONLESS_START_S = 0.7
"""Length fitted as a whole with each frictionless start assumption: a fast spin turns too far within 2 s."""
SHORT_STARTS_S = (1.3, 0.8)
"""Lengths of short starts, from which hypotheses are branched; the last resort but one."""
PRUNE_EVERY_S = 1.5
"""Time between two prunings of the hypotheses."""
CONFIRMED_S = 9.0
"""Longer records need no further confirmation once two thirds of this length have been confirmed."""
PRUNE_COST = 40.0  # cost above the cheapest hypothesis at which one is pruned
EXCESS_SD = 3.0
"""Excess of a record's cost, in its standard deviations, from which finer harmonics are tried."""
FRICTIONAL_MU = 0.02  # friction coefficient above which a body moves with the palms
REFINE_ITERATIONS = 8
"""First iterations with finer harmonics; only if they explain half of the excess cost, the fit is completed."""
SAME_COST, SAME_RAD_S = 3.0, 0.02  # differences of cost and spin below which two hypotheses are duplicates
START_PRUNE_COST = 100.0  # cost above the cheapest at which a start is dropped after a few iterations
START_COST_LIMIT = 1.7  # cost per number read after these iterations above which a start is dropped
DECISIVE_COST, DISTINCT_RAD_S = 12.0, 0.05
"""Cost margin over a hypothesis with another motion (RMS difference of spin) for acceptance: odds of 400 to 1."""
TRUNCATION_COST = 1.35  # cost per number read up to which truncated harmonics may be the cause
MOST_COST = 1.12
"""Largest cost per number read of an accepted motion, with readings, equations and prior together."""
MOST_LAMBDA = 0.5
"""Largest |λ| of the inertia: beyond it the inertia compensates for another model error."""
CURVATURE_EVERY = 5  # every how many contacts the curvature is tested
HOLLOW_CHI2 = 9.0
"""χ² of the move to the nearest convex body, above which the estimate is not compatible with a convex body."""
WINDOWS_S = (0.5, 0.2, 0.1)
"""Window lengths; the shorter ones are used where the prediction is poor."""
WINDOW_TURN_RAD = 1.0  # rad; the body's largest turn within a window
WINDOW_COST_GATE = 1.35
"""Cost per number read of a window, above which it is tried again: after a refit of the whole record, and shorter."""
BRANCH_COST_GATE, BRANCH_UNTIL_S = 1.15, 3.0
"""The same limit during the first seconds, in which the belief is multimodal and hypotheses are branched."""
BRANCH_WINDOW_S = 0.4  # length of a branched window
BRANCHED_STARTS, BRANCHINGS_PER_ROUND = 2, 1
"""Number of starts that are branched; number of windows of a hypothesis that may be branched per round."""
BRANCH_ITERATIONS = (4, 12)
"""Iterations of the whole-record fits by which branches are compared, in turn, while they are cheap enough."""
BRANCH_OFFSETS = (0.0, -1.5, 1.5, -3.0, 3.0)
"""Offsets of the branches, in standard deviations of the spin along its least known axis."""
INNOVATION_GATE, TUMBLE_RAD_S = 3.0, 6.0
"""Cost per number read of a window, above which a body that spun faster than that must be confirmed again."""
RECENT_S, LOST_COST = 1.0, 6.0
"""A hypothesis is lost if windows of at least this length cost more than that per number read in the mean."""
REFIT_GROWTH, REFIT_GROWTH_EARLY, REFIT_GROWTH_ON_MISFIT = 1.6, 1.2, 1.15
"""Growth of the record since the last refit at which the whole record is refitted: usually; in the first seconds, while
the posterior is far from Gaussian; and when a window is predicted poorly."""


@dataclass(frozen=True, slots=True)
class BodyHypothesis:
    """A hypothesis of motion and body, propagated to the end of `record`.

    motion: at all nodes of `record`. end_belief: of the last node and the body. whole_fit: the last fit of the whole
    record. windows: (intervals, cost per number read) of each window since the start. merged: number of starts
    that led to it. confirmed: length in intervals when an independent restart last found it. marginalised: (numbers
    read, their cost) before the record. refined: length in intervals when finer harmonics were tried; restarted: when
    it was last restarted from itself. diverged: no fit explains the whole record.
    """

    prior: BodyPrior
    record: BodyRecord
    motion: BodyMotion
    end_belief: BodyPrior
    cost: float
    whole_fit: BodyFit
    windows: tuple[tuple[int, float], ...] = ()
    merged: int = 1
    confirmed: int = 0
    marginalised: tuple[int, float] = (0, 0.0)
    refined: int = 0
    restarted: int = 0
    diverged: bool = False

    @property
    def intervals(self) -> int:
        """Length of the record."""
        return len(self.record.middle_palms)

    @property
    def cost_per_number(self) -> float:
        """Cost per number read; near 1 if the hypothesis is right."""
        return self.cost / self.record.numbers

    def excess_cost_per_number(self, hidden_cost: float = 0.0) -> float:
        """Cost per number ever read in excess of 1 plus its standard deviation; 0 if everything is explained.

        hidden_cost: cost that finer harmonics have absorbed; they adapt to model errors.
        """
        numbers, cost = self.marginalised[0] + self.record.numbers, self.marginalised[1] + self.cost + hidden_cost
        return max(cost / numbers - 1.0 - math.sqrt(2.0 / numbers), 0.0)

    @property
    def excess_sd(self) -> float:
        """Excess of the cost over its expectation, in its standard deviations."""
        return self.sd_above(1.0)

    def sd_above(self, cost_per_number: float) -> float:
        """Excess of the cost over `cost_per_number` each, in its standard deviations."""
        return (self.cost_per_number - cost_per_number) * math.sqrt(self.record.numbers / 2)

    @property
    def growth_since_refit(self) -> float:
        """Growth factor of the record since it was last fitted as a whole."""
        return self.intervals / (len(self.whole_fit.motion.R) - 1)

    @property
    def is_confirmed(self) -> bool:
        """Whether an independent restart found it on at least two thirds of the record, or of `CONFIRMED_S`."""
        return 3 * self.confirmed >= 2 * min(self.intervals, round(CONFIRMED_S / SPACING_S))

    @property
    def needs_confirmation(self) -> bool:
        """Whether it needs confirmation by an independent restart and has none.

        It does if the record is shorter than `CONFIRMED_S`, the cost is too high, or the outline has the finest
        harmonics, which adapt to model errors.
        """
        suspicious = self.excess_sd >= EXCESS_SD or self.order > FINER_ORDERS[0]
        needed = suspicious or self.intervals < round(CONFIRMED_S / SPACING_S)
        return needed and not self.is_confirmed

    @property
    def last_window_cost(self) -> float:
        """Cost per number read of the last window: how well it was predicted."""
        return self.windows[-1][1] if self.windows else 0.0

    def failed_innovation_test(self, recent: int) -> bool:
        """Whether a window among the last `recent` intervals failed the innovation test after a tumble.

        After a tumble several continuations may explain the readings. A slowly turning body that is predicted poorly
        is only sharper than its harmonics; contacts determine how it goes on.
        """
        spin, until = np.linalg.norm(self.motion.omega, axis=1), self.intervals
        for intervals, cost in reversed(self._last_windows(recent)):
            since = max(until - intervals - round(RECENT_S / SPACING_S), 0)
            if cost > INNOVATION_GATE and spin[since : until + 1].max() > TUMBLE_RAD_S:
                return True
            until -= intervals
        return False

    @property
    def lost(self) -> bool:
        """Whether its predictions no longer agree with the readings."""
        if self.diverged:
            return True
        recent = RECENT_S / SPACING_S
        windows = self._last_windows(recent)
        length = sum(intervals for intervals, _ in windows)
        return length >= recent and sum(intervals * cost for intervals, cost in windows) > LOST_COST * length

    def _last_windows(self, intervals: float) -> tuple[tuple[int, float], ...]:
        """The fewest last windows that together last `intervals`; all, if they are shorter."""
        length, first = 0, len(self.windows)
        while length < intervals and first > 0:
            first -= 1
            length += self.windows[first][0]
        return self.windows[first:]

    @property
    def plausible(self) -> bool:
        """Whether inertia and touched surface are those of a possible body."""
        return self.largest_lambda <= MOST_LAMBDA and self.may_be_convex

    @property
    def largest_lambda(self) -> float:
        """Largest |λ| of the inertia's parameters, which are 0 for a dense ball."""
        return float(np.abs(self.motion.p[-BODY:-3]).max())

    @property
    def order(self) -> int:
        """Degree of the outline's harmonics."""
        return order_of(len(self.motion.p) - BODY)

    @property
    def touched_normals(self) -> FloatArray:
        """(3 K + 3, 3) outward normals, in the body's frame, at the contacts of all nodes."""
        return contact_normals(self.motion.R, self.record.node_palms).reshape(-1, 3)

    @property
    def may_be_convex(self) -> bool:
        """Whether the estimate is compatible with a body that is convex wherever a palm touched it."""
        if self._least_radius(self.motion.p[:-BODY]) > 0.0:
            return True
        try:
            covariance = np.linalg.inv(self.end_belief.information)[STATES:, STATES:]
        except np.linalg.LinAlgError:
            return False
        return bool(self.made_convex(self.motion.p, np.asarray(covariance, np.float64))[1] <= HOLLOW_CHI2)

    def made_convex(self, x: FloatArray, covariance: FloatArray) -> tuple[FloatArray, float]:
        """Move x (m,) to the nearest body that is convex where touched; returns it and the χ² of the move.

        x: parameters, possibly preceded by states; covariance (m, m). The move is the smallest in that metric, and none
        if x is convex already; χ² is infinite if it cannot be made convex.
        """
        shape = slice(len(x) - len(self.motion.p), len(x) - BODY)
        if self._least_radius(x[shape]) > 0.0:
            return x, 0.0
        moved = nearest_convex(x, covariance, shape, self._curvature_rows)
        if self._least_radius(moved[shape]) <= 0.0:
            return moved, math.inf
        return moved, float((moved - x) @ np.linalg.solve(covariance, moved - x))

    @property
    def _curvature_rows(self) -> FloatArray:
        return curvature_rows(order_of(len(self.motion.p) - BODY), self.touched_normals[::CURVATURE_EVERY])

    def _least_radius(self, c: FloatArray) -> float:
        """Smallest radius of curvature (m) of the outline c at the contacts."""
        return float(least_radii(c, self._curvature_rows)[0].min())

    def is_duplicate_of(self, other: BodyHypothesis) -> bool:
        """Whether both have converged to the same motion of the same body."""
        difference = np.abs(self.motion.omega[-1] - other.motion.omega[-1]).max()
        return bool(difference < SAME_RAD_S and abs(self.cost - other.cost) < SAME_COST)

    def contradicts(self, other: BodyHypothesis) -> bool:
        """Whether it explains as long a record about as well by another motion."""
        if self.intervals < other.intervals or self.cost > other.cost + DECISIVE_COST:
            return False
        return not self.has_motion_of(other)

    def has_motion_of(self, other: BodyHypothesis) -> bool:
        """Whether both, of equally long records, have about the same motion; their minima may differ."""
        difference = self.motion.omega - other.motion.omega
        return bool(np.sqrt(np.mean(difference**2)) < DISTINCT_RAD_S)


def ranked_hypotheses(task: Task) -> list[BodyHypothesis]:
    """Search a whole record: hypotheses propagated to its end, or until lost, the longest first, then the cheapest.

    Of equally long ones those come first that are plausible.
    """
    ended: list[BodyHypothesis] = []
    for running, branchings in _start_sets(task):
        ended = sorted([*ended, *propagate_and_prune(task, running, branchings=branchings)], key=_rank)
        if ended and ended[0].intervals == task.intervals(task.end - task.start):
            first, *others = sorted(refine_near_best(task, ended), key=_rank)
            ended = sorted([_restart_from_itself(task, first), *others], key=_rank)
            first = ended[0]
            if first.cost_per_number <= MOST_COST and first.plausible and not first.needs_confirmation:
                break
    if ended and (ended[0].lost or ended[0].growth_since_refit > 1.0):
        ended[0] = refit(task, ended[0])
    return ended


def _rank(hypothesis: BodyHypothesis) -> tuple[int, bool, float]:
    return -hypothesis.intervals, not hypothesis.plausible, hypothesis.cost


def refine_near_best(task: Task, ended: list[BodyHypothesis]) -> list[BodyHypothesis]:
    """Refine those hypotheses that explain the whole record about as cheaply as the first, where that pays."""
    if not ended or ended[0].excess_sd < EXCESS_SD or ended[0].cost_per_number > HOPELESS_COST:
        return ended
    first = ended[0]

    def near(each: BodyHypothesis) -> bool:
        return each.intervals == first.intervals and each.cost < first.cost + PRUNE_COST

    return [refine_outline(task, each, task.finer_orders) if near(each) else each for each in ended]


def refine_outline(task: Task, hypothesis: BodyHypothesis, orders: tuple[int, ...]) -> BodyHypothesis:
    """Refit the whole record with outlines of these degrees, one after the other, as long as each lowers the cost."""
    if hypothesis.refined == hypothesis.intervals:
        return hypothesis
    hypothesis = replace(hypothesis, refined=hypothesis.intervals)
    for order in orders:
        if order <= hypothesis.order or hypothesis.excess_sd < EXCESS_SD:
            continue
        prior = beliefs.belief_with_order(hypothesis.prior, order)
        smoother = BodySmoother(hypothesis.record, prior, task.noise, task.rig)
        fit = smoother.fit(
            replace(hypothesis.motion, p=beliefs.with_order(hypothesis.motion.p, order)), REFINE_ITERATIONS
        )
        if fit.cost > hypothesis.cost - PRUNE_COST:
            break
        if hypothesis.cost - fit.cost > fit.cost - hypothesis.record.numbers:  # it explains half of the excess cost
            fit = smoother.fit(fit.motion)
        end_belief = smoother.end_belief(fit)
        hypothesis = replace(
            hypothesis, prior=prior, motion=fit.motion, end_belief=end_belief, cost=fit.cost, whole_fit=fit, windows=()
        )
    return hypothesis


def _restart_from_itself(task: Task, hypothesis: BodyHypothesis) -> BodyHypothesis:
    """Try to confirm a hypothesis by a restart from itself; returns the cheaper of both if they differ.

    The whole record is refitted by graduated optimisation: a right motion is found again, a wrong one is not.
    """
    if (
        not hypothesis.needs_confirmation
        or hypothesis.cost_per_number > TRUNCATION_COST
        or hypothesis.restarted == hypothesis.intervals
    ):
        return hypothesis
    restart = _fitted_from(
        task, hypothesis, graduated_fit(task, hypothesis.record, hypothesis.prior, hypothesis.motion).motion
    )
    return _confirmed_by(restart, hypothesis) or min(
        restart, replace(hypothesis, restarted=hypothesis.intervals), key=lambda each: each.cost
    )


def _start_sets(task: Task) -> Iterator[tuple[list[BodyHypothesis], float]]:
    """Sets of hypotheses to start from, one after the other; each is computed only when it is needed.

    Each set comes with the number of windows per round that may be branched: one for starts of several seconds.
    """
    for seconds in WHOLE_STARTS_S:
        assumptions = islice(
            beliefs.start_assumptions(), LONG_START_ASSUMPTIONS if seconds > min(WHOLE_STARTS_S) else None
        )
        yield _acceptable_starts(fit_blind_starts(task, task.record(seconds), assumptions)), BRANCHINGS_PER_ROUND
    for seconds in SHORT_STARTS_S:
        yield (
            branch_starts(
                task, [each for each in start_candidates(task, seconds) if each.cost_per_number < HOPELESS_COST]
            ),
            math.inf,
        )
    spinning = task.record(FRICTIONLESS_START_S)
    frictionless = [assumption for assumption in beliefs.start_assumptions() if assumption.mu == beliefs.FRICTIONLESS]
    found = [each for assumption in frictionless for each in fit_blind_starts(task, spinning, [assumption])]
    yield _acceptable_starts(merge_duplicates(sorted(found, key=lambda each: each.cost))), math.inf


def _acceptable_starts(found: list[BodyHypothesis]) -> list[BodyHypothesis]:
    """Those of `found`, the cheapest first, that explain their record about as cheaply as the first."""
    return [each for each in found if each.cost_per_number < TRUNCATION_COST and each.cost < found[0].cost + PRUNE_COST]


def branch_starts(task: Task, found: list[StartCandidate], branchings: float = math.inf) -> list[BodyHypothesis]:
    """Hypotheses from short starts, propagated a little further; the likeliest are branched against local minima.

    branchings: number of windows of each that may be branched after that.
    """
    if not found:
        return []
    started = sorted((hypothesis_of(task, each) for each in found), key=lambda each: each.cost)
    near = [each for each in started if each.cost < started[0].cost + PRUNE_COST]
    until = near[0].intervals + round(BRANCH_WINDOW_S / SPACING_S)
    branches = [branch for each in near[:BRANCHED_STARTS] for branch in _branches(task, each, until)]
    propagated = [propagate(task, each, until, branchings=branchings) for each in (*branches, *near[BRANCHED_STARTS:])]
    return merge_duplicates(sorted(propagated, key=lambda each: each.cost))


def propagate_and_prune(
    task: Task, running: list[BodyHypothesis], cost_limit: float = math.inf, branchings: float = math.inf
) -> list[BodyHypothesis]:
    """Propagate hypotheses to the task's end, round by round; prune the costly ones and merge duplicates.

    cost_limit: hypotheses are not propagated beyond this cost. branchings: number of windows per round and hypothesis
    that may be branched. Returns the lost and pruned ones, too.
    """
    end = task.intervals(task.end - task.start)
    ended: list[BodyHypothesis] = []
    while running:
        reached = max(each.intervals for each in running)
        if reached == end:
            break
        until = min(reached + round(PRUNE_EVERY_S / SPACING_S), end) if len(running) > 1 else end
        first, *others = running
        first = propagate(task, first, until, cost_limit, branchings)
        limit = cost_limit if first.lost else min(first.cost + PRUNE_COST, cost_limit)
        running = [first, *(propagate(task, each, until, limit, branchings) for each in others)]
        ended += [each for each in running if each.lost]
        running = [each for each in running if not each.lost]
        limit = min(
            min((each.cost for each in running if each.intervals == until), default=0.0) + PRUNE_COST, cost_limit
        )
        ended += [each for each in running if each.cost > limit]
        running = merge_duplicates(sorted((each for each in running if each.cost <= limit), key=lambda each: each.cost))
    return ended + merge_duplicates([refit(task, each, 15) for each in running])


def merge_duplicates(hypotheses: list[BodyHypothesis]) -> list[BodyHypothesis]:
    """Merge duplicates, keeping the order."""
    kept: list[BodyHypothesis] = []
    for each in hypotheses:
        twin = next((i for i, other in enumerate(kept) if each.is_duplicate_of(other)), None)
        if twin is None:
            kept.append(each)
        else:
            kept[twin] = replace(
                kept[twin], merged=kept[twin].merged + each.merged, confirmed=max(kept[twin].confirmed, each.confirmed)
            )
    return kept


def hypothesis_of(task: Task, candidate: StartCandidate) -> BodyHypothesis:
    """The candidate as a hypothesis, refitted with an outline up to degree `ORDER`."""
    prior = beliefs.prior(candidate.radius, ORDER, task.spin_sd)
    motion = replace(candidate.fit.motion, p=beliefs.with_order(candidate.fit.motion.p, ORDER))
    return refit(
        task,
        BodyHypothesis(prior, candidate.record, motion, prior, candidate.fit.cost, candidate.fit),
        15,
    )


def refit(task: Task, hypothesis: BodyHypothesis, iterations: int = 20) -> BodyHypothesis:
    """Refit the whole record."""
    smoother = BodySmoother(hypothesis.record, hypothesis.prior, task.noise, task.rig)
    # start from the last window's body or from the last whole fit's, whichever costs less
    newest = hypothesis.motion.p
    before = beliefs.with_order(hypothesis.whole_fit.motion.p, order_of(len(newest) - BODY))
    bodies = [newest] if np.array_equal(newest, before) else [newest, before]
    starts = [smoother.fit_nodes(replace(hypothesis.motion, p=body)) for body in bodies]
    fit = smoother.fit(min(starts, key=lambda each: each.cost).motion, iterations)
    return replace(hypothesis, motion=fit.motion, end_belief=smoother.end_belief(fit), cost=fit.cost, whole_fit=fit)


def fit_blind_starts(
    task: Task, record: BodyRecord, assumptions: Iterable[StartAssumption], cost_limit: float = math.inf
) -> list[BodyHypothesis]:
    """Fit a whole record from blind starts, one for each start assumption; returns the fits, the cheapest first.

    A fit of many seconds reaches minima that hypotheses propagated from a short start do not. The search uses an
    outline of degree `START_ORDER`: higher degrees adapt to errors of the motion. It ends when two starts have
    converged to the cheapest fit. Starts that cost far more than `cost_limit` are dropped.
    """
    contacts = ContactCurves.smoothed(record.readings)
    ball = ContactBall.of(task.path, contacts, record)
    coarse_prior, prior = (beliefs.prior(ball.radius, order, task.spin_sd) for order in (START_ORDER, ORDER))
    smoother = BodySmoother(record, prior, task.noise, task.rig)
    found: list[BodyHypothesis] = []
    for assumption in assumptions:
        if assumption.mu == beliefs.FRICTIONLESS and found and found[0].cost_per_number < EXPLAINED_COST:
            break
        coarse_fit = fit_blind_start(task, record, coarse_prior, contacts, ball, assumption)
        coarse_motion = task.fit_with(record, coarse_prior, None, coarse_fit.motion, BRANCH_ITERATIONS[1]).motion
        fit = smoother.fit(replace(coarse_motion, p=beliefs.with_order(coarse_motion.p, ORDER)), BRANCH_ITERATIONS[0])
        if fit.cost > min(cost_limit + START_PRUNE_COST, START_COST_LIMIT * record.numbers):
            continue
        fit = graduated_refit(task, record, prior, smoother.fit(fit.motion))
        cost_limit = min(cost_limit, fit.cost)
        hypothesis = BodyHypothesis(prior, record, fit.motion, smoother.end_belief(fit), fit.cost, fit)
        found = merge_duplicates(sorted([*found, hypothesis], key=lambda each: each.cost))
        if found[0].merged > 1:
            found[0] = replace(found[0], confirmed=found[0].intervals)
            break
    return found


def confirm_by_restarts(
    task: Task, hypotheses: list[BodyHypothesis], assumptions: Iterable[StartAssumption], *, accepted: bool = False
) -> list[BodyHypothesis]:
    """Try to confirm the cheapest hypothesis by blind restarts; returns all hypotheses, the cheapest first.

    It is confirmed as soon as a restart converges to it; also if all restarts end far away, but one from itself, with
    much equation noise at first, converges to it again. All hypotheses are of one record, from its beginning. If the
    cheapest has been `accepted` before, the same motion is enough: truncated harmonics cause neighbouring minima.
    """

    for assumption in assumptions:
        first = hypotheses[0]
        for restart in _restarts(task, first, [assumption], first.cost if first.order == ORDER else math.inf):
            if (confirmed := _confirmed_by(restart, first, accepted=accepted)) is not None:
                return [confirmed, *hypotheses[1:]]
            hypotheses = sorted([restart, *hypotheses], key=lambda each: each.cost)
    first, *others = hypotheses
    if all(each.cost > first.cost + PRUNE_COST for each in others):
        restart = _fitted_from(
            task, first, fit_with_loose_equations(task, first.record, first.prior, first.motion).motion
        )
        confirmed = _confirmed_by(restart, first, accepted=accepted)
        found = [restart, first] if confirmed is None else [confirmed]
        return sorted([*found, *others], key=lambda each: each.cost)
    return hypotheses


def restart_has_motion(task: Task, hypothesis: BodyHypothesis, assumptions: Iterable[StartAssumption]) -> bool:
    """Whether a blind restart on the same record has its motion; rotations are not compared, as frames may differ."""
    return any(each.has_motion_of(hypothesis) for each in _restarts(task, hypothesis, assumptions))


def _restarts(
    task: Task, hypothesis: BodyHypothesis, assumptions: Iterable[StartAssumption], cost_limit: float = math.inf
) -> Iterator[BodyHypothesis]:
    """Fits of the same record from blind starts, with harmonics as fine as its own; see `fit_blind_starts`."""
    orders = () if hypothesis.order == ORDER else (hypothesis.order,)
    return (
        refine_outline(task, each, orders)
        for each in fit_blind_starts(task, hypothesis.record, assumptions, cost_limit)
    )


def _confirmed_by(restart: BodyHypothesis, first: BodyHypothesis, *, accepted: bool = False) -> BodyHypothesis | None:
    """The cheaper of both, marked as confirmed, if the restart found the same; else None. See `confirm_by_restarts`."""
    if restart.is_duplicate_of(first) or (accepted and restart.has_motion_of(first)):
        return replace(restart if restart.cost < first.cost - SAME_COST else first, confirmed=first.intervals)
    return None


def _fitted_from(task: Task, hypothesis: BodyHypothesis, motion: BodyMotion) -> BodyHypothesis:
    """Fit the same record from `motion`."""
    smoother = BodySmoother(hypothesis.record, hypothesis.prior, task.noise, task.rig)
    fit = smoother.fit(motion)
    return replace(
        hypothesis, motion=fit.motion, end_belief=smoother.end_belief(fit), cost=fit.cost, whole_fit=fit, confirmed=0
    )


def marginalised(task: Task, hypothesis: BodyHypothesis, intervals: int, touched: Bools) -> BodyHypothesis:
    """Marginalise the first `intervals` of the record into the prior with which the shorter record begins.

    touched: (D,) directions of the body that have been touched until then.
    """
    R, omega, p = hypothesis.motion.R, hypothesis.motion.omega, hypothesis.motion.p
    head = task.full_record.first(intervals)
    smoother = BodySmoother(head, hypothesis.prior, task.noise, task.rig)
    end_belief = smoother.end_belief(smoother.evaluate(BodyMotion(R[: intervals + 1], omega[: intervals + 1], p)))
    prior = predictive_belief(end_belief, touched)
    start = task.start + intervals * SPACING_S
    tail = lay_out(task.path, task.readings, start, hypothesis.intervals - intervals, SPACING_S)
    motion = BodyMotion(R[intervals:], omega[intervals:], p)
    recent_windows = hypothesis.windows[-round(RECENT_S / SPACING_S) :]  # no window is shorter than an interval
    shortened = refit(task, replace(hypothesis, prior=prior, record=tail, motion=motion, windows=recent_windows))
    numbers, cost = hypothesis.marginalised
    return replace(
        shortened,
        marginalised=(
            numbers + hypothesis.record.numbers - shortened.record.numbers,
            cost + hypothesis.cost - shortened.cost,
        ),
    )


def propagate(
    task: Task, hypothesis: BodyHypothesis, until: int, cost_limit: float = math.inf, branchings: float = math.inf
) -> BodyHypothesis:
    """Propagate a hypothesis to `until` (intervals), or until it is lost or costs more than `cost_limit`.

    branchings: number of windows that may be branched; further ones are taken as they are predicted.
    """
    while hypothesis.intervals < until and not hypothesis.lost and hypothesis.cost <= cost_limit:
        early = hypothesis.intervals * SPACING_S < BRANCH_UNTIL_S
        if hypothesis.growth_since_refit > (REFIT_GROWTH_EARLY if early else REFIT_GROWTH):
            hypothesis = _refine_or_mark_diverged(task, refit(task, hypothesis))
        extended = _extended(task, hypothesis, WINDOWS_S[0], until)
        cost_gate = BRANCH_COST_GATE if early else WINDOW_COST_GATE
        if extended.last_window_cost > cost_gate and hypothesis.growth_since_refit > REFIT_GROWTH_ON_MISFIT:
            hypothesis = _refine_or_mark_diverged(task, refit(task, hypothesis))
            extended = _extended(task, hypothesis, WINDOWS_S[0], until)
        if extended.last_window_cost > cost_gate:
            if early and branchings > 0:
                extended, branchings = _best_branch(task, hypothesis, until), branchings - 1
            elif not early:
                for seconds in WINDOWS_S[1:]:
                    extended = _extended(task, hypothesis, seconds, until)
                    if extended.last_window_cost < WINDOW_COST_GATE:
                        break
        hypothesis = extended
    return hypothesis


def _refine_or_mark_diverged(task: Task, hypothesis: BodyHypothesis) -> BodyHypothesis:
    """Refine a hypothesis after a refit where that pays; mark it as diverged if its cost remains too high.

    Only frictionless bodies are refined here: with friction, finer harmonics adapt to errors of a wrong motion.
    """
    if not task.finer_orders or hypothesis.excess_sd < EXCESS_SD:
        return hypothesis
    hypothesis = (
        refine_outline(task, hypothesis, task.finer_orders) if hypothesis.motion.p[-2] < FRICTIONAL_MU else hypothesis
    )
    return replace(hypothesis, diverged=hypothesis.sd_above(MOST_COST) > EXCESS_SD)


def _best_branch(task: Task, hypothesis: BodyHypothesis, until: int) -> BodyHypothesis:
    """Extend by one window on the cheapest of several branches; each starts from another spin."""
    return replace(min(_branches(task, hypothesis, until), key=lambda each: each.cost), confirmed=0)


def _branches(task: Task, hypothesis: BodyHypothesis, until: int) -> list[BodyHypothesis]:
    """Branches with spins offset by `BRANCH_OFFSETS`, all extended equally far, duplicates and costly ones dropped.

    Costs are comparable over equal lengths only; with a fast spin one window is shorter.
    """
    end = min(hypothesis.intervals + round(BRANCH_WINDOW_S / SPACING_S), until)
    tried: list[BodyHypothesis] = []
    for offset in BRANCH_OFFSETS:
        branch = _extended(task, hypothesis, BRANCH_WINDOW_S, end, offset)
        limit = min((each.cost for each in tried), default=math.inf) + START_PRUNE_COST
        while branch.intervals < end and branch.cost < limit:
            branch = _extended(task, refit(task, branch, BRANCH_ITERATIONS[0]), BRANCH_WINDOW_S, end)
        if branch.intervals == end:
            tried.append(branch)
    for iterations in BRANCH_ITERATIONS:
        tried.sort(key=lambda each: each.cost)
        tried = [
            refit(task, each, iterations) for each in merge_duplicates(tried) if each.cost < tried[0].cost + PRUNE_COST
        ]
    return tried


def _shifted(belief: BodyPrior, offset: float) -> BodyPrior:
    """The belief with its mean moved by `offset` standard deviations of the spin along its least known axis."""
    if offset == 0.0:
        return belief
    covariance = np.linalg.inv(belief.information)
    variance, axes = np.linalg.eigh(covariance[3:STATES, 3:STATES])
    step = covariance[:, 3:STATES] @ axes[:, -1] * (offset / math.sqrt(variance[-1]))
    R = rotation.exp(np.asarray(step[:3], np.float64)) @ belief.R
    return BodyPrior(R, belief.spin + step[3:STATES], belief.mean + step[STATES:], belief.information)


def _extended(
    task: Task, hypothesis: BodyHypothesis, seconds: float, until: int, offset: float = 0.0
) -> BodyHypothesis:
    """Extend by one window; the fit starts from the belief `_shifted` by `offset`."""
    before = hypothesis.intervals
    more = min(max(round(seconds / SPACING_S), 1), until - before)
    start = task.start + before * SPACING_S
    start_belief = _shifted(hypothesis.end_belief, offset)
    guess = _contact_guess(task, start_belief, hypothesis.record.node_palms[-1:], start, more)
    more = len(guess.R) - 1
    record = lay_out(task.path, task.readings, start, more, SPACING_S)
    smoother = BodySmoother(record, hypothesis.end_belief, task.noise, task.rig)
    if task.finer_orders:  # not live, where it takes up to a fifth of an update
        guess = _better_guess(smoother, record, guess, _constant_spin_guess(start_belief, more))
    fit = smoother.fit(guess, 15)
    if offset == 0.0:  # else it is one of several branches
        fit = graduated_refit(task, record, hypothesis.end_belief, fit)
    joined = BodyMotion(
        np.concatenate([hypothesis.motion.R[:-1], fit.motion.R]),
        np.concatenate([hypothesis.motion.omega[:-1], fit.motion.omega]),
        fit.motion.p,
    )
    numbers = max(record.numbers, 1)
    return replace(
        hypothesis, record=task.full_record.first(before + more), motion=joined, end_belief=smoother.end_belief(fit),
        cost=hypothesis.cost + fit.cost, windows=(*hypothesis.windows, (more, fit.cost / numbers)),
    )  # fmt: skip


def _better_guess(
    smoother: BodySmoother, record: BodyRecord, from_contacts: BodyMotion, constant_spin: BodyMotion
) -> BodyMotion:
    """The cheaper initial guess of a window after its nodes are fitted: `from_contacts` or with constant spin.

    Contacts determine a tumble, but of a calm, round body they suggest a spin that is not there.
    """
    nearest = smoother.fit_nodes(from_contacts)
    if not within_chance(nearest, record):
        nearest = min(nearest, smoother.fit_nodes(constant_spin), key=lambda each: each.cost)
    return nearest.motion


def _constant_spin_guess(belief: BodyPrior, more: int) -> BodyMotion:
    """Predict `more` intervals with constant spin."""
    omega = np.tile(belief.spin, (more + 1, 1))
    steps = SPACING_S * np.arange(more + 1)[:, None] * belief.spin
    return BodyMotion(rotation.exp(np.asarray(steps, np.float64)) @ belief.R, omega, belief.mean)


def _contact_guess(task: Task, start_belief: BodyPrior, palms: FloatArray, start: float, more: int) -> BodyMotion:
    """Predict up to `more` intervals from the contacts by a ball-like model, no further than `WINDOW_TURN_RAD`."""
    R, omega, p = start_belief.R, start_belief.spin, start_belief.mean
    radius, gyration = Y00 * p[0], float(np.sqrt(np.trace(inertia(p)) / 3))
    belief = BallBelief(
        np.array([math.log(gyration), p[-3], math.log(max(p[-2], beliefs.FRICTIONLESS)), p[-1], radius]),
        np.array([0.02, 1e-6, 0.02, 0.02, 0.02 * radius]),
        np.concatenate([centres_of(R[None], palms, p)[0], omega]),
        np.array([1e-4] * 3 + [0.05] * 3),
    )
    driven = smooth_course(task.path, task.contacts, start, more, SPACING_S, belief, task.rig)
    turned: FloatArray = np.cumsum(np.linalg.norm(driven.omega, axis=1)) * SPACING_S
    within = max(int(np.searchsorted(turned, WINDOW_TURN_RAD)), round(WINDOWS_S[-1] / SPACING_S))
    more = min(more, within)
    return BodyMotion(driven.rotations(R)[: more + 1], driven.omega[: more + 1], p)
