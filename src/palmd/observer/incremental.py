"""The smoother at a live observer's side: from everything felt of an object so far, a belief about its state now.

A filter keeps what it made of each reading when it came. The smoother looks again, with what is known now: first at the
whole record, in search of the object (`observer.initialiser`), then at the latest seconds of it, everything older being
kept as information (`observer.fixed_lag_smoother`). Its posterior at the last node is a Gaussian belief about the shape
map's state, from which a filter can start.
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
from palmd.observer.matching import Felt
from palmd.observer.noise import map_as_noise
from palmd.observer.numerical import NUMERICAL_FAILURES
from palmd.observer.outline import contact_normals, made_convex
from palmd.observer.reidentification import reidentified
from palmd.observer.search import LIVE_BUDGET, SPACING_S
from palmd.observer.smoother import Budget
from palmd.observer.smoothing import Session
from palmd.system.description import RigDescription

TRIAL_S = 2.0  # of readings that a follower on trial must explain at least (choice: two of its steps, `REACH_S`)
ARCHIVED = 4  # objects that were taken away

# Where each state of the shape map stands among (constants, last node).
_FROM = np.concatenate(
    [
        [CONSTANTS, CONSTANTS + 1, C.LN_RHO, C.DRAG, C.SATURATION, C.DAMPING],
        C.SHAPE + np.arange(2 * ORDER + 1),
    ]
).astype(np.intp)
_OUTLINE = slice(shape_map.Z.SHAPE, None)


NO_SESSION = Session(0, math.inf)


class IncrementalSmoother:
    """Takes an object's readings as they come, and answers when asked; not for use inside the loop.

    Deterministic: the same calls give the same answers. Memory and the time of an answer are bounded, however long it
    goes on.
    """

    def __init__(self, rig: RigDescription, seed: int = 0):
        """`seed` draws where blind searches start."""
        self._rig = map_as_noise(rig)
        self._seed = seed
        self._session = NO_SESSION
        self._hint: FloatArray | None = None
        self._events: list[Event] = []
        self._archive: list[Felt] = []  # of objects that were taken away, the latest first
        self._taken_away: Felt | None = None  # the last object, unless it was rejected or never confirmed
        self._left: tuple[float, float] | None = None  # when (s) it was last felt, and its ψ (rad) then
        self._frame = 1
        self._unexplained = False  # by the last answer
        self._initialiser = Initialiser(self._rig, seed)
        self._found: Solution | None = None
        self._fixed_lag: FixedLagSmoother | None = None
        self._trial_until = -math.inf  # (s): what a follower on trial must explain; -inf: not on trial

    @property
    def elapsed_s(self) -> float:
        """How long ago the present object was begun, by the latest event; 0 while there is none."""
        return max(self._events[-1].t_sample - self._session.begun, 0.0) if self._events else 0.0

    def add(self, session: Session, events: Sequence[Event]) -> None:
        """Take the latest events, and since when they are of what is now on the palms."""
        self._events += events
        self._hint = None if session.hint is None else constants_of(session.hint)
        if session.begun != self._session.begun:
            felt = data_segments([event for event in self._events if event.t_sample < session.begun])
            try:
                self._end(felt)
            except NUMERICAL_FAILURES:  # what was felt of it is lost
                self._seek()
            self._drop_before(session.begun)
        if math.isinf(session.begun) and self._events:
            self._drop_before(self._events[-1].t_sample)
        self._session = session

    def said(self) -> Improvement | Unexplained | None:
        """As `answer`; where nothing explains the readings, which is more than doubt, that."""
        answer = self.answer()
        if answer is None and self._unexplained and self._events:
            return Unexplained(self._events[-1].t_sample)
        return answer

    def answer(self) -> Improvement | None:
        """What everything so far tells about the state at the last reading; None while that is in doubt.

        Where numbers fail, the hypothesis at hand is dropped and the object is sought anew: nothing is explained then.
        """
        try:
            return self._answer()
        except NUMERICAL_FAILURES:
            self._unexplained = True
            self._seek()
            return None

    def _answer(self) -> Improvement | None:
        self._unexplained = False
        found = data_segments(self._events)
        if not found or math.isinf(self._session.begun):
            return None
        segment = found[-1]
        if self._fixed_lag is not None and segment.start > self._fixed_lag.needs_from + LEAD_S:
            self._end(found[:-1])  # the arm was silent for a moment
        answer = self._sought(segment) if self._fixed_lag is None else self._followed(segment, self._fixed_lag)
        return None if answer is None else self._improvement(answer)

    def _sought(self, segment: DataSegment) -> Solution | None:
        known, budget = self._taken_away, Budget(LIVE_BUDGET)
        if known is not None and LEAST_S < segment.lasts < SUFFICIENT_S:
            self._taken_away = None  # not tried again after a numerical failure
            half = Budget(LIVE_BUDGET / 2)
            fixed_lag = reidentified(known, segment, self._rig, half, self._hopped_from(segment.start))
            if fixed_lag is not None:
                self._archive = [felt for felt in self._archive if felt is not known]
                self._fixed_lag = fixed_lag
                return self._followed(segment, fixed_lag)
            self._taken_away, self._left = known, None  # wherever it lies, if it is the same
            budget = Budget(LIVE_BUDGET / 2 + half.left)
        answer = self._found = self._initialiser.sought(segment, self._hint, budget)
        self._unexplained = self._initialiser.unexplained
        self._drop_before(self._initialiser.needs_from)
        if answer is None:
            tried = self._initialiser.hypothesis
            if tried is None or not self._initialiser.stuck:
                return None
            self._fixed_lag = FixedLagSmoother(tried)
            self._trial_until = max(segment.start + SUFFICIENT_S, tried.end + TRIAL_S)
            return self._followed(segment, self._fixed_lag)
        found = self._initialiser.sure and answer.lasts > SUFFICIENT_S - SPACING_S
        if not found and not self._archive:
            return answer
        fixed_lag = FixedLagSmoother(answer)
        if not self._joined(fixed_lag) and not found:
            return answer
        self._fixed_lag = fixed_lag
        answer = fixed_lag.smoothed(segment) or answer
        self._drop_before(fixed_lag.needs_from)
        return answer

    def _followed(self, segment: DataSegment, fixed_lag: FixedLagSmoother) -> Solution | None:
        answer = fixed_lag.smoothed(segment)
        self._unexplained = answer is None
        if answer is None and self._on_trial:
            self._seek()
            self._drop_before(segment.end - RENEWED_S)
            return None
        if fixed_lag.lost:
            self._end([])
            self._drop_before(segment.end - LEAD_S)
            return None
        if answer is not None and self._joined(fixed_lag):
            self._trial_until = -math.inf
            answer = fixed_lag.smoothed(segment)
        if answer is not None and answer.end >= self._trial_until:
            self._trial_until = -math.inf
        if not self._on_trial:
            self._drop_before(fixed_lag.needs_from)
        return answer

    @property
    def _on_trial(self) -> bool:
        """Whether the follower is not confirmed yet; all readings are kept until then, for another search."""
        return self._trial_until > -math.inf

    def _joined(self, fixed_lag: FixedLagSmoother) -> bool:
        """Whether the object is one that was felt before; then its part of the archive is the follower's now."""
        known = fixed_lag.join(self._archive)
        self._archive = [felt for felt in self._archive if felt is not known]
        return known is not None

    def _hopped_from(self, t: float) -> float | None:
        """ψ (rad) of the last object if it is back at `t` (s) so soon that nobody can have exchanged it."""
        return self._left[1] if self._left is not None and t - self._left[0] < GONE_S else None

    def _end(self, felt: Sequence[DataSegment]) -> None:
        """The object is away, or must be sought again; `felt` are the last readings of it."""
        fixed_lag = self._fixed_lag
        if fixed_lag is None and self._found is not None:
            found = self._found.finding.until(self._found.end - TAIL_S)
            fixed_lag = FixedLagSmoother(Solution(self._found.search, found)) if found is not None else None
        if fixed_lag is not None:
            if felt:
                fixed_lag.end(felt[0])
            self._archive = [fixed_lag.felt(), *self._archive][:ARCHIVED]
            sure = (self._fixed_lag is not None and not self._on_trial) or self._initialiser.sure
            self._taken_away = self._archive[0] if sure and not fixed_lag.lost else None
            self._left = (felt[-1].end, fixed_lag.psi) if felt else None
        self._seek()

    def _seek(self) -> None:
        """Nothing is known of what the next readings are of."""
        self._frame += 1
        self._initialiser = Initialiser(self._rig, self._seed + 100 * self._frame)
        self._found = self._fixed_lag = None
        self._trial_until = -math.inf

    def _drop_before(self, t: float) -> None:
        """Forget events that no answer needs any more; the arm's reports of a moment before `t` (s) are kept."""
        self._events = [
            event
            for event in self._events
            if event.t_sample >= (t - 2 * LEAD_S if isinstance(event, PalmSample) else t - 1e-6)
        ]

    def _improvement(self, answer: Solution) -> Improvement | None:
        record, best = answer.finding.record, answer.finding.fits[0]
        posterior = answer.posterior
        if posterior is None:
            return None
        everything = np.concatenate([best.guess.p, best.guess.x[-1]])
        covariance = answer.belief.considering(posterior.covariance)
        try:
            x, P, spread = given_the_rig(everything, covariance)
        except np.linalg.LinAlgError:  # of a fit that has run aground on readings of no such motion
            return None
        made_convex(x, P, _OUTLINE)
        confirmed = None if self._on_trial else self._fixed_lag
        against = answer.belief.contradicted
        if confirmed is not None:
            touched = confirmed.touched
        else:
            touched = marks_of(contact_normals(record, best.guess.x[:, 0], best.guess.p[C.SHAPE :]))
            # what is not sure helps the bank, but vouches for nothing: on short records a rig that is off
            # is more often an object that is not this one
            touched &= self._initialiser.sure and not against.any()
            against = np.zeros_like(against)
        rig, rig_sd = everything[RIG], np.sqrt(np.diagonal(covariance)[RIG])
        return Improvement(answer.end, x, P, self._frame, confirmed is not None, touched, rig, rig_sd, spread, against)


def given_the_rig(y: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The shape map's state of (constants, last node) y: mean, covariance given the rig's constants, and its spread.

    Their covariance being L Lᵀ, spread = cov(state, rig) L⁻ᵀ over L, so that with the state's rows of it
    covariance + spread·spreadᵀ is the whole one.
    """
    x, J = _as_shape_map(y[_FROM])
    scale = np.sqrt(np.diagonal(covariance)[RIG])
    root = np.linalg.cholesky(covariance[RIG, RIG] / np.outer(scale, scale))
    spread = J @ np.linalg.solve(root, covariance[RIG, _FROM] / scale[:, None]).T
    P = J @ covariance[np.ix_(_FROM, _FROM)] @ J.T - spread @ spread.T
    return x, (P + P.T) / 2, np.vstack([spread, scale[:, None] * root])


def _as_shape_map(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """With μ = B/√w and ln u_d = −ln(w)/2 in the place of B and w of `model.smoothing`, and the Jacobian of that."""
    at = [shape_map.Z.MU, shape_map.Z.LN_DITHER]
    drag, saturation = x[at]
    dither = saturation**-0.5
    moved, J = x.copy(), np.eye(len(x))
    moved[at] = drag * dither, math.log(dither)
    J[np.ix_(at, at)] = [[dither, -0.5 * drag * dither**3], [0.0, -0.5 / saturation]]
    return moved, J
