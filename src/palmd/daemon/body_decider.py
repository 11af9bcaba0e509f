"""Decide the next move of an exploration of a body between three palms. Not for the loop.

See `daemon.exploration_requests`.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from palmd.daemon.exploration_requests import ExplorationAnswer, Question
from palmd.model.convex_bodies import nearest_convex
from palmd.model.icosphere import icosphere
from palmd.model.three_palms import BODY
from palmd.motion.body_explorer import LEAST_FORCE, NEAR_RAD, BodyDraws, BodyExplorer
from palmd.motion.body_prediction import Bearings, BodyPredictor
from palmd.motion.body_swing import Swing
from palmd.motion.decisions import Decision
from palmd.motion.segments import Move
from palmd.system.three_palms import BodyPlanningBelief, ThreePalmsRig

HALVINGS = 3  # subdivisions of the icosphere by which coverage is counted: 642 directions
TOUCHED_RAD = NEAR_RAD - math.radians(4.0)  # from the touched directions of an answer, within 4 degrees of contacts
DETECTABLE_N = 0.05  # force that a pad reliably detects
CAUTION = 2.0  # factor on the least force while the estimate is not accepted
# limits of the body's mean turn rate: accepted, accepted before in the same record, never accepted
STRIDE_RAD_S, SLOWER_RAD_S, SHORT_RAD_S = 3.0, 1.2, 0.35
REST_LIMIT_S = 1.0  # time without a safe move after which a body whose estimate is not accepted is swung blindly
SHORTEST_S = 0.7  # shortest move; the next one is requested during it, and is not decided sooner
DECISION_S = 0.3  # time of a decision, for which the palms rest if no move is under way


class BodyDecider:
    """Decides brisk moves until a body is known, then moves that touch the rest of it."""

    def __init__(self, rig: ThreePalmsRig, seed: int = 0) -> None:
        self._rig, self._seed = rig, seed
        self._random = np.random.default_rng(seed)
        self._directions = icosphere(HALVINGS)[0]
        self._run: int | None = None
        self._record_key: tuple[int, float] | None = None  # object and record of the explorer
        self._frame: tuple[int, int] | None = None  # object and frame; `_turn`: from the record's frame to that one
        self._turn, self._touched_accepted = np.eye(3), np.zeros(len(self._directions), np.bool_)
        self._explorer: BodyExplorer | None = None
        self._swing: Move | None = None  # the last blind swing of a body with a belief
        self._unsafe_since = math.inf  # time since when no move has been safe

    def answer(self, question: Question) -> ExplorationAnswer:
        """Answer a question; a new task or a new record of the body starts with a new explorer."""
        task, belief, move = question.task, question.belief, question.under_way.move
        if task.run != self._run:
            self._run, self._run_start, self._record_key, self._frame = task.run, question.t, None, None
            self._unsafe_since = math.inf
        if belief is None:
            swing = Swing(task.limits).next(move.end, self._random)
            decision = Decision("move", swing, "swings the body until its pose is known")
            return ExplorationAnswer(question.t, task.run, move, None, decision)
        assert isinstance(belief, BodyPlanningBelief), "a belief of another system"
        return ExplorationAnswer(question.t, task.run, move, belief.object_count, self._decision(question, belief))

    def _decision(self, question: Question, belief: BodyPlanningBelief) -> Decision:
        task, under_way = question.task, question.under_way
        predictor, explorer = self._planner(question, belief)
        touched_directions = icosphere()[0][belief.touched]
        touched_since = explorer.covered(belief.normals_since)
        if belief.accepted:
            self._touched_here |= touched_since
        touched = explorer.covered(touched_directions, TOUCHED_RAD) | touched_since | self._touched_here
        if belief.accepted:
            self._touched_accepted = touched
        coverage = float(touched.mean())
        if coverage >= task.goal.coverage and belief.accepted:
            return Decision("done", None, f"{coverage:.0%} of all directions have been touched", coverage, 1.0)
        if question.t - self._run_start > task.goal.time_limit_s:
            return Decision("done", None, f"the time limit of {task.goal.time_limit_s:g} s is over", coverage, 1.0)
        begin = Bearings(belief.R[None], belief.omega[None], np.array([under_way.move.start]))
        left = under_way.move.duration - under_way.elapsed
        predicted = predictor.predict(
            begin, np.array([under_way.move.end]), np.array([max(under_way.move.duration, 1e-3)]),
            under_way.elapsed, max(DECISION_S - left, 0.0),
        )  # fmt: skip
        if not (predicted.least_force[0] > 0.0 and predicted.room[0] > 0.0):
            if left > 0.0 and under_way.move != self._swing:
                return Decision("unsafe", None, "the move under way would lose the body", coverage, 1.0)
            return self._wait_or_swing(question, belief, "the body would not stay on the palms", coverage)
        if not question.choose:
            return Decision("safe", None, "", coverage, 1.0)
        least = max(LEAST_FORCE, DETECTABLE_N / belief.mass if belief.mass > 0.0 else 0.0)
        touched_then = touched | explorer.covered(predicted.normals)
        draws = BodyDraws.of(belief.p, belief.covariance, self._random)
        self._was_accepted |= belief.accepted
        most = SLOWER_RAD_S if self._was_accepted else SHORT_RAD_S
        least, most = (least, STRIDE_RAD_S) if belief.accepted else (CAUTION * least, most)
        move = explorer.decide(predicted.after, touched_then, least, draws, most_rad_s=most, shortest_s=SHORTEST_S)
        if move is None:
            return self._wait_or_swing(question, belief, "no safe motion found yet", coverage)
        self._unsafe_since = math.inf
        return Decision("move", move, "", coverage, 1.0, then=explorer.then if belief.accepted else None)

    def _wait_or_swing(self, question: Question, belief: BodyPlanningBelief, reason: str, coverage: float) -> Decision:
        """Wait while no move is safe; after `REST_LIMIT_S` swing a body whose estimate is not accepted."""
        self._unsafe_since = min(self._unsafe_since, question.t)
        if belief.accepted or not question.choose or question.t - self._unsafe_since < REST_LIMIT_S:
            return Decision("wait", None, reason, coverage, 1.0)
        self._swing = Swing(question.task.limits).next(question.under_way.move.end, self._random)
        reason = "swings the body: no move can be predicted safely from the present estimate"
        return Decision("move", self._swing, reason, coverage, 1.0, blind=True)

    def _planner(self, question: Question, belief: BodyPlanningBelief) -> tuple[BodyPredictor, BodyExplorer]:
        """Predictor and explorer of this body, with the parameters of `belief`."""
        known = belief.object_count, belief.record_start
        p = nearest_convex(belief.p, belief.covariance[6:, 6:], slice(0, len(belief.p) - BODY))
        if self._explorer is None or known != self._record_key:
            self._record_key, self._was_accepted = known, belief.accepted
            # touched while the estimate was accepted; answers mark fewer directions as touched
            self._touched_here = self._touched_accepted = self._touched_before(belief)
            self._predictor = BodyPredictor(p, self._rig)
            self._explorer = BodyExplorer(self._predictor, question.task.limits, self._directions, self._seed)
        self._predictor.set_parameters(p)
        return self._predictor, self._explorer

    def _touched_before(self, belief: BodyPlanningBelief) -> npt.NDArray[np.bool_]:
        """(D,) directions touched in earlier records with accepted estimates, in the new record's frame.

        None if the frames are not related.
        """
        last, frame = self._turn, (belief.object_count, belief.frame)
        same, self._frame, self._turn = frame == self._frame, frame, belief.turn
        if not same:
            return np.zeros(len(self._directions), np.bool_)
        before = self._directions @ (last.T @ belief.turn).T
        return np.asarray(self._touched_accepted[(before @ self._directions.T).argmax(axis=1)], np.bool_)
