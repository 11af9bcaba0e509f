"""Requests for the next exploration move: questions, answers, and the interfaces of those that decide."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from palmd.config.plans import ExploreGoal
from palmd.events import PlanningBelief
from palmd.motion.decisions import Decision, UnderWay
from palmd.motion.excitation import homewards, rock
from palmd.motion.limits import MotionLimits
from palmd.motion.segments import Angles, Move
from palmd.motion.tipping import tip
from palmd.system.description import RigDescription


@dataclass(frozen=True, slots=True)
class ExplorationTask:
    """One exploration from start to end; `run` is its number."""

    run: int
    goal: ExploreGoal
    limits: MotionLimits


@dataclass(frozen=True, slots=True)
class Question:
    """Request for the move after the one under way at `t` (s).

    `belief`: the observer's belief for planning; None asks for a move that makes the object observable. `choose`: False
    if the question is only whether the move under way is still safe. `sticking`: contact positions (m) of an object
    that sticks, else None. `cornered`: whether a corner of the object was detected.
    """

    t: float
    task: ExplorationTask
    belief: object | None
    under_way: UnderWay
    choose: bool = True
    sticking: tuple[float, ...] | None = None
    cornered: bool = False


@dataclass(frozen=True, slots=True)
class ExplorationAnswer:
    """A decision, with its question's time (s), the move it follows and the number of its object (None: any)."""

    t: float
    run: int
    after: Move
    object_count: int | None
    decision: Decision


class ExplorationDecider(Protocol):
    """Answers questions, for any system; not for the loop."""

    def answer(self, question: Question) -> ExplorationAnswer:
        """The answer to a question."""


class DecisionSource(Protocol):
    """Where the loop gets decisions from; no method blocks."""

    def prepare(self) -> None:
        """Get ready; called repeatedly while a plan that explores is loaded."""

    def ask(self, question: Question) -> None:
        """Pass on a question; it may be dropped."""

    def collect(self, t: float) -> ExplorationAnswer | None:
        """The newest answer that has arrived by `t` (s); each answer is returned once."""


class Decider:
    """Decides for two palms: explores, rocks unknown objects, makes sticking ones slip, tips those with corners.

    Not for the loop.
    """

    def __init__(self, rig: RigDescription, seed: int = 0) -> None:
        self._rig = rig
        self._seed = seed
        self._run: int | None = None

    def answer(self, question: Question) -> ExplorationAnswer:
        """The answer to a question; a new task starts a new explorer."""
        task, belief, move = question.task, question.belief, question.under_way.move
        if task.run != self._run:
            from palmd.motion.explorer import Explorer  # here: the asking process need not load it

            self._run = task.run
            self._explorer = Explorer(self._rig, task.limits, task.goal, self._seed)
            self._centre: Angles | None = None  # about which the object is rocked
            self._slip_poses: tuple[Angles, ...] = ()  # remaining poses of the round that provokes slip
            self._tipping = False
            self._next_tip: Angles | None = None  # next pose of the round that tips the object
        if belief is not None:
            assert isinstance(belief, PlanningBelief), "the belief must be that of two palms"
        stuck_at = None if belief is not None and belief.confirmed else question.sticking
        if stuck_at is None:
            self._slip_poses = ()
        self._tipping = self._tipping or question.cornered  # whatever is estimated later
        if self._tipping:
            decision = self._tip(move.end, task.limits, question.choose)
        elif stuck_at is not None:
            decision = self._provoke_slip(stuck_at, move, task.limits, question.choose)
        elif belief is not None:
            self._centre = None
            decision = self._explorer.decide(belief, question.under_way, choose=question.choose)
        else:
            decision = self._rock(move.end, task.limits)
        return ExplorationAnswer(question.t, task.run, move, None if belief is None else belief.object_count, decision)

    def _provoke_slip(self, contacts: tuple[float, ...], last: Move, limits: MotionLimits, choose: bool) -> Decision:
        """The move after `last` for an object that sticks at `contacts` (m); no belief predicts its motion."""
        if not choose:
            return Decision("safe")
        from palmd.motion.provocation import provoke, rounds  # here for the same reason

        here = last.end
        if self._slip_poses and here == self._slip_poses[0]:
            self._slip_poses = self._slip_poses[1:]
        self._slip_poses = self._slip_poses or rounds(contacts, here, limits)
        move = provoke(here, self._slip_poses, limits)
        if move is None:
            return Decision("wait", reason="the object sticks, and the limits leave no room to make it slip")
        return Decision("move", move, "the object sticks: makes it slip along each palm in turn", blind=True)

    def _tip(self, here: Angles, limits: MotionLimits, choose: bool) -> Decision:
        """The move from `here` (rad) for an object with corners: tip it from side to side."""
        if not choose:
            return Decision("safe")
        move = tip(here, self._next_tip, limits)
        if move is None:
            return Decision(
                "wait", reason="the object has corners, and the limits leave no room to tip it from side to side"
            )
        self._next_tip = move.end
        return Decision("move", move, "the object has corners: tips it from side to side", blind=True)

    def _rock(self, here: Angles, limits: MotionLimits) -> Decision:
        """The next move from `here` (rad) while the object's position is unknown."""
        if (back := homewards(here, limits)) is not None:
            self._centre = None
            return Decision(
                "move", back, "moves to a pose in which objects rest stably, until the object's position is known"
            )
        self._centre = self._centre or here
        to_and_fro = rock(here, self._centre, limits)
        if to_and_fro is None:
            return Decision("wait", reason="the limits leave no room to rock the object")
        return Decision("move", to_and_fro, "rocks the object until its position is known")
