"""The smoother beside a live observer: a posterior of the present state from all readings of an object.

A filter never relinearises past readings; the smoother does. First it searches for the object in the whole record
(`observer.initialiser`), then it smooths the latest seconds, with everything older kept as information
(`observer.fixed_lag_smoother`). Its posterior at the last node is a Gaussian belief about the shape map's state, from
which a filter can start.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from palmd.events import Event, FloatArray, Improvement, PalmSample, Unexplained
from palmd.model import shape_map
from palmd.model.smoothing import CONSTANTS, ORDER, RIG, C
from palmd.observer.contacts import GONE_S
from palmd.observer.coverage import marks_of
from palmd.observer.data_segment import LEAD_S, DataSegment, data_segments
from palmd.observer.first_guess import constants_of
from palmd.observer.fixed_lag_smoother import TAIL_S, FixedLagSmoother, Solution
from palmd.observer.initialiser import LEAST_S, RENEWED_S, SUFFICIENT_S, Initialiser
from palmd.observer.matching import ObjectInformation
from palmd.observer.noise import MAP_READINGS, map_as_noise
from palmd.observer.numerical import NUMERICAL_FAILURES
from palmd.observer.outline import contact_normals, made_convex
from palmd.observer.reidentification import reidentified
from palmd.observer.search import LIVE_BUDGET, SPACING_S
from palmd.observer.smoother import Budget
from palmd.observer.smoothing import Session
from palmd.system.description import RigDescription

TRIAL_S = 2.0  # s of readings that a fixed-lag smoother on trial must explain (choice: two of its steps, `REACH_S`)
ARCHIVED = 4  # former objects that are kept

# Indices of the shape map's states in (constants, last node).
_FROM = np.concatenate(
    [
        [CONSTANTS, CONSTANTS + 1, C.LN_RHO, C.DRAG, C.SATURATION, C.DAMPING],
        C.SHAPE + np.arange(2 * ORDER + 1),
    ]
).astype(np.intp)
_OUTLINE = slice(shape_map.Z.SHAPE, None)


NO_SESSION = Session(0, math.inf)


class IncrementalSmoother:
    """Takes an object's readings as they arrive and estimates on request; not for use inside the loop.

    Deterministic: the same calls give the same results. Memory and the time of an estimate are bounded, however long
    the record.
    """

    def __init__(self, rig: RigDescription, seed: int = 0):
        """`seed`: for the starts of blind searches."""
        self._rig = map_as_noise(rig, MAP_READINGS)
        self._seed = seed
        self._session = NO_SESSION
        self._hint: FloatArray | None = None
        self._events: list[Event] = []
        self._archive: list[ObjectInformation] = []  # information about former objects, the latest first
        self._last_object: ObjectInformation | None = None  # the last object, unless it was rejected or never confirmed
        self._last_contact: tuple[float, float] | None = None  # time (s) of its last contact, and ψ (rad) then
        self._frame = 1
        self._unexplained = False  # the readings, by the last estimate
        self._initialiser = Initialiser(self._rig, seed)
        self._initial_solution: Solution | None = None
        self._fixed_lag: FixedLagSmoother | None = None
        self._trial_until = -math.inf  # time (s) up to which a smoother on trial must explain readings; -inf: no trial

    @property
    def elapsed_s(self) -> float:
        """Duration (s) of the readings of an object that is followed; 0 while an object is searched for."""
        followed = self._fixed_lag is not None and self._events
        return max(self._events[-1].t_sample - self._session.start_time, 0.0) if followed else 0.0

    def add(self, session: Session, events: Sequence[Event]) -> None:
        """Take the latest events, and the session of the object that is on the palms now."""
        self._events += events
        self._hint = None if session.hint is None else constants_of(session.hint)
        if session.start_time != self._session.start_time:
            segments = data_segments([event for event in self._events if event.t_sample < session.start_time])
            try:
                self._end(segments)
            except NUMERICAL_FAILURES:  # the information about the object is lost
                self._restart_search()
            self._drop_before(session.start_time)
        if math.isinf(session.start_time) and self._events:
            self._drop_before(self._events[-1].t_sample)
        self._session = session

    def result(self) -> Improvement | Unexplained | None:
        """As `answer`, but `Unexplained` instead of None if no smooth outline explains the readings."""
        improvement = self.answer()
        if improvement is None and self._unexplained and self._events:
            return Unexplained(self._events[-1].t_sample)
        return improvement

    def answer(self) -> Improvement | None:
        """Estimate the state at the last explained reading from all readings so far; None while it is ambiguous.

        After a numerical failure the hypothesis is dropped, the search restarts, and the readings count as unexplained.
        """
        try:
            return self._answer()
        except NUMERICAL_FAILURES:
            self._unexplained = True
            self._restart_search()
            return None

    def _answer(self) -> Improvement | None:
        self._unexplained = False
        segments = data_segments(self._events)
        if not segments or math.isinf(self._session.start_time):
            return None
        segment = segments[-1]
        if self._fixed_lag is not None and segment.start > self._fixed_lag.needs_from + LEAD_S:
            self._end(segments[:-1])  # the arm was silent for a moment
        solution = self._initialise(segment) if self._fixed_lag is None else self._smooth(segment, self._fixed_lag)
        return None if solution is None else self._improvement(solution)

    def _initialise(self, segment: DataSegment) -> Solution | None:
        known, budget = self._last_object, Budget(LIVE_BUDGET)
        if known is not None and LEAST_S < segment.lasts < SUFFICIENT_S:
            self._last_object = None  # not tried again after a numerical failure
            half = Budget(LIVE_BUDGET / 2)
            fixed_lag = reidentified(known, segment, self._rig, half, self._psi_before_gap(segment.start))
            if fixed_lag is not None:
                self._archive = [entry for entry in self._archive if entry is not known]
                self._fixed_lag = fixed_lag
                return self._smooth(segment, fixed_lag)
            self._last_object, self._last_contact = known, None  # at any orientation, if it is the same object
            budget = Budget(LIVE_BUDGET / 2 + half.left)
        solution = self._initial_solution = self._initialiser.search(segment, self._hint, budget)
        self._unexplained = self._initialiser.unexplained
        self._drop_before(self._initialiser.needs_from)
        if solution is None:
            tried = self._initialiser.hypothesis
            if tried is None or not self._initialiser.extension_failed:
                return None
            self._fixed_lag = FixedLagSmoother(tried)
            self._trial_until = max(segment.start + SUFFICIENT_S, tried.end + TRIAL_S)
            return self._smooth(segment, self._fixed_lag)
        confirmed = self._initialiser.confirmed and solution.lasts > SUFFICIENT_S - SPACING_S
        confirmed = confirmed and not self._initialiser.cost_jumped
        if not confirmed and not self._archive:
            return solution.with_correlated_errors(alone=True)
        fixed_lag = FixedLagSmoother(solution)
        if not self._join_archive(fixed_lag) and not confirmed:
            return solution.with_correlated_errors(alone=True)
        self._fixed_lag = fixed_lag
        solution = fixed_lag.smoothed(segment) or solution
        self._drop_before(fixed_lag.needs_from)
        return solution

    def _smooth(self, segment: DataSegment, fixed_lag: FixedLagSmoother) -> Solution | None:
        solution = fixed_lag.smoothed(segment)
        self._unexplained = solution is None
        if self._on_trial and (solution is None or solution.contradicts_friction):
            self._restart_search()
            self._drop_before(segment.end - RENEWED_S)
            return None
        if fixed_lag.lost:
            self._end([])
            self._drop_before(segment.end - LEAD_S)
            return None
        if solution is not None and self._join_archive(fixed_lag):
            self._trial_until = -math.inf
            solution = fixed_lag.smoothed(segment)
        if solution is not None and solution.end >= self._trial_until:
            self._trial_until = -math.inf
        if not self._on_trial:
            self._drop_before(fixed_lag.needs_from)
        return solution

    @property
    def _on_trial(self) -> bool:
        """Whether the fixed-lag smoother is not confirmed yet; all readings are kept for another search until then."""
        return self._trial_until > -math.inf

    def _join_archive(self, fixed_lag: FixedLagSmoother) -> bool:
        """Whether the object is in the archive; if so its information moves from there to the fixed-lag smoother."""
        known = fixed_lag.join(self._archive)
        self._archive = [entry for entry in self._archive if entry is not known]
        return known is not None

    def _psi_before_gap(self, t: float) -> float | None:
        """ψ (rad) of the last object if contact returned at `t` (s) too soon for an exchange of objects, else None."""
        return self._last_contact[1] if self._last_contact is not None and t - self._last_contact[0] < GONE_S else None

    def _end(self, segments: Sequence[DataSegment]) -> None:
        """Archive the object, which is gone or must be searched for again; `segments`: its last readings."""
        fixed_lag = self._fixed_lag
        if fixed_lag is None and self._initial_solution is not None:
            found = self._initial_solution.finding.until(self._initial_solution.end - TAIL_S)
            fixed_lag = FixedLagSmoother(Solution(self._initial_solution.search, found)) if found is not None else None
        if fixed_lag is not None:
            if segments:
                fixed_lag.end(segments[0])
            self._archive = [fixed_lag.summary(), *self._archive][:ARCHIVED]
            confirmed = (self._fixed_lag is not None and not self._on_trial) or self._initialiser.confirmed
            self._last_object = self._archive[0] if confirmed and not fixed_lag.lost else None
            self._last_contact = (segments[-1].end, fixed_lag.psi) if segments else None
        self._restart_search()

    def _restart_search(self) -> None:
        """Start a new search without any hypothesis about the next readings."""
        self._frame += 1
        self._initialiser = Initialiser(self._rig, self._seed + 100 * self._frame)
        self._initial_solution = self._fixed_lag = None
        self._trial_until = -math.inf

    def _drop_before(self, t: float) -> None:
        """Drop events that are not needed any more; the arm's reports of a moment before `t` (s) are kept."""
        self._events = [
            event
            for event in self._events
            if event.t_sample >= (t - 2 * LEAD_S if isinstance(event, PalmSample) else t - 1e-6)
        ]

    def _improvement(self, solution: Solution) -> Improvement | None:
        record, best = solution.finding.record, solution.finding.fits[0]
        posterior = solution.posterior
        if posterior is None:
            return None
        estimate = np.concatenate([best.guess.p, best.guess.x[-1]])
        covariance = solution.belief.considering(posterior.covariance)
        try:
            x, P, spread = given_the_rig(estimate, covariance)
        except np.linalg.LinAlgError:  # a degenerate fit to readings that no such motion explains
            return None
        made_convex(x, P, _OUTLINE)
        confirmed = None if self._on_trial else self._fixed_lag
        contradicted = solution.belief.contradicted
        if confirmed is not None:
            touched = confirmed.touched
        else:
            touched = marks_of(contact_normals(record, best.guess.x[:, 0], best.guess.p[C.SHAPE :]))
            # an unconfirmed solution helps the bank, but confirms no normal: on short records a contradicted rig
            # constant more often means a wrong object
            touched &= self._initialiser.confirmed and not contradicted.any()
            contradicted = np.zeros_like(contradicted)
        rig, rig_sd = estimate[RIG], np.sqrt(np.diagonal(covariance)[RIG])
        return Improvement(
            solution.end, x, P, self._frame, confirmed is not None, touched, rig, rig_sd, spread, contradicted
        )


def given_the_rig(y: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The shape map's state from y = (constants, last node): mean, covariance given the rig's constants, and spread.

    With L Lᵀ the covariance of the rig's constants, spread is cov(state, rig) L⁻ᵀ stacked over L, so that
    covariance + spread·spreadᵀ, with the state's rows of spread, is the total covariance of the state.
    """
    x, J = _as_shape_map(y[_FROM])
    scale = np.sqrt(np.diagonal(covariance)[RIG])
    root = np.linalg.cholesky(covariance[RIG, RIG] / np.outer(scale, scale))
    spread = J @ np.linalg.solve(root, covariance[RIG, _FROM] / scale[:, None]).T
    P = J @ covariance[np.ix_(_FROM, _FROM)] @ J.T - spread @ spread.T
    return x, (P + P.T) / 2, np.vstack([spread, scale[:, None] * root])


def _as_shape_map(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Replace B and w of `model.smoothing` by μ = B/√w and ln u_d = −ln(w)/2; returns the state and its Jacobian."""
    at = [shape_map.Z.MU, shape_map.Z.LN_DITHER]
    drag, saturation = x[at]
    dither = saturation**-0.5
    moved, J = x.copy(), np.eye(len(x))
    moved[at] = drag * dither, math.log(dither)
    J[np.ix_(at, at)] = [[dither, -0.5 * drag * dither**3], [0.0, -0.5 / saturation]]
    return moved, J
