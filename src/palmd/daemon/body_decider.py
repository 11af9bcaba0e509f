"""Where an exploration of a body between three palms goes next: see `daemon.exploration_requests`. Not for the loop."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from palmd.daemon.exploration_requests import ExplorationAnswer, Question
from palmd.model.convex_bodies import convex
from palmd.model.icosphere import icosphere
from palmd.model.three_palms import BODY
from palmd.motion.body_explorer import LEAST_FORCE, NEAR_RAD, BodyDraws, BodyExplorer
from palmd.motion.body_prediction import Bearings, BodyPredictor
from palmd.motion.body_swing import Swing
from palmd.motion.decisions import Decision
from palmd.motion.segments import Move
from palmd.system.three_palms import BodyPlanningBelief, ThreePalmsRig

HALVINGS = 3  # of the directions that are counted: 642
TOUCHED_RAD = NEAR_RAD - math.radians(4.0)  # from what an answer calls touched, which is within 4 degrees of it
FELT_N = 0.05  # that a pad surely feels
CAREFUL = 2.0  # times the force, while a body is not claimed
# That strides turn a body by: which is claimed, which has been in the same frame, and which has not.
STRIDE_RAD_S, SLOWER_RAD_S, SHORT_RAD_S = 3.0, 1.2, 0.35
STOOD_S = 1.0  # without a safe move, after which a body that is not claimed is swung: it stays, whatever is believed
SHORTEST_S = 0.7  # of a move: the next one is asked for while it is under way, and is answered no sooner
DECIDED_S = 0.3  # that a decision takes: so long the palms stand where no move is under way


class BodyDecider:
    """Brisk moves until a body is known, then those that show the rest of it."""

    def __init__(self, rig: ThreePalmsRig, seed: int = 0) -> None:
        self._rig, self._seed = rig, seed
        self._random = np.random.default_rng(seed)
        self._directions = icosphere(HALVINGS)[0]
        self._run: int | None = None
        self._known: tuple[int, float] | None = None  # which object, by which record
        self._frame: tuple[int, int] | None = None  # the same, in which frame, and how the record's lies in that
        self._turn, self._sure = np.eye(3), np.zeros(len(self._directions), np.bool_)
        self._explorer: BodyExplorer | None = None
        self._swing: Move | None = None  # the last one of a body of which something is believed
        self._stood = math.inf  # since when no move of it has been safe

    def answer(self, question: Question) -> ExplorationAnswer:
        """The answer to a question; a new task, and a body in a new frame, begin with a new explorer."""
        task, belief, move = question.task, question.belief, question.under_way.move
        if task.run != self._run:
            self._run, self._begun, self._known, self._frame = task.run, question.t, None, None
            self._stood = math.inf
        if belief is None:
            swing = Swing(task.limits).next(move.end, self._random)
            decision = Decision("move", swing, "swings the body until it is known where it is")
            return ExplorationAnswer(question.t, task.run, move, None, decision)
        assert isinstance(belief, BodyPlanningBelief), "it is of three palms"
        return ExplorationAnswer(question.t, task.run, move, belief.object_count, self._decided(question, belief))

    def _decided(self, question: Question, belief: BodyPlanningBelief) -> Decision:
        task, under_way = question.task, question.under_way
        foresight, explorer = self._of(question, belief)
        felt = icosphere()[0][belief.touched]
        since = explorer.covered(belief.since)
        if belief.claimed:
            self._shown |= since
        touched = explorer.covered(felt, TOUCHED_RAD) | since | self._shown
        if belief.claimed:
            self._sure = touched
        coverage = float(touched.mean())
        if coverage >= task.goal.coverage and belief.claimed:
            return Decision("done", None, f"{coverage:.0%} of all directions have been touched", coverage, 1.0)
        if question.t - self._begun > task.goal.time_limit_s:
            return Decision("done", None, f"the time limit of {task.goal.time_limit_s:g} s is over", coverage, 1.0)
        begin = Bearings(belief.R[None], belief.omega[None], np.array([under_way.move.start]))
        left = under_way.move.duration - under_way.elapsed
        foreseen = foresight.of(
            begin, np.array([under_way.move.end]), np.array([max(under_way.move.duration, 1e-3)]),
            under_way.elapsed, max(DECIDED_S - left, 0.0),
        )  # fmt: skip
        if not (foreseen.least_force[0] > 0.0 and foreseen.room[0] > 0.0):
            if left > 0.0 and under_way.move != self._swing:
                return Decision("unsafe", None, "the move under way would lose the body", coverage, 1.0)
            return self._waits(question, belief, "the body will not stay where it is", coverage)
        if not question.choose:
            return Decision("safe", None, "", coverage, 1.0)
        least = max(LEAST_FORCE, FELT_N / belief.mass if belief.mass > 0.0 else 0.0)
        seen = touched | explorer.covered(foreseen.normals)
        drawn = BodyDraws.of(belief.p, belief.covariance, self._random)
        self._was_claimed |= belief.claimed
        most = SLOWER_RAD_S if self._was_claimed else SHORT_RAD_S
        least, most = (least, STRIDE_RAD_S) if belief.claimed else (CAREFUL * least, most)
        move = explorer.decide(foreseen.after, seen, least, drawn, most_rad_s=most, shortest_s=SHORTEST_S)
        if move is None:
            return self._waits(question, belief, "no safe motion found yet", coverage)
        self._stood = math.inf
        return Decision("move", move, "", coverage, 1.0, then=explorer.then if belief.claimed else None)

    def _waits(self, question: Question, belief: BodyPlanningBelief, reason: str, coverage: float) -> Decision:
        """No move is safe by what is believed, so that the palms stand; not for ever, as nothing is learnt so."""
        self._stood = min(self._stood, question.t)
        if belief.claimed or not question.choose or question.t - self._stood < STOOD_S:
            return Decision("wait", None, reason, coverage, 1.0)
        self._swing = Swing(question.task.limits).next(question.under_way.move.end, self._random)
        reason = "swings the body, for what is believed of it lets nothing be foreseen"
        return Decision("move", self._swing, reason, coverage, 1.0, blind=True)

    def _of(self, question: Question, belief: BodyPlanningBelief) -> tuple[BodyPredictor, BodyExplorer]:
        """Who foresees this body as it is known now."""
        known = belief.object_count, belief.begun
        p = convex(belief.p, belief.covariance[6:, 6:], slice(0, len(belief.p) - BODY))
        if self._explorer is None or known != self._known:
            self._known, self._was_claimed = known, belief.claimed
            # What has been touched while it was claimed: answers tell it by less, in steps of their directions.
            self._shown = self._sure = self._carried(belief)
            self._foresight = BodyPredictor(p, self._rig)
            self._explorer = BodyExplorer(self._foresight, question.task.limits, self._directions, self._seed)
        self._foresight.learn(p)
        return self._foresight, self._explorer

    def _carried(self, belief: BodyPlanningBelief) -> npt.NDArray[np.bool_]:
        """(D,) what earlier records touched while they were claimed, in the frame of a new one; none in another."""
        last, frame = self._turn, (belief.object_count, belief.frame)
        same, self._frame, self._turn = frame == self._frame, frame, belief.turn
        if not same:
            return np.zeros(len(self._directions), np.bool_)
        before = self._directions @ (last.T @ belief.turn).T
        return np.asarray(self._sure[(before @ self._directions.T).argmax(axis=1)], np.bool_)
