"""Where an exploration goes next: questions and answers, and who decides."""

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
    """One exploration from its start to its end, counted by `run`."""

    run: int
    goal: ExploreGoal
    limits: MotionLimits


@dataclass(frozen=True, slots=True)
class Question:
    """What the palms should do after the move that is under way at `t` (s); without an outlook, to get one.

    `outlook`: as the system's observer gives it. Without `choose`: only whether that move may go on. `sticking`: of an
    object that sticks, where its contacts are (m). `cornered`: the object was felt to have a corner.
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
    """A decision, and what it was about: when it was asked for (s), after which move, for which object (None: any)."""

    t: float
    run: int
    after: Move
    object_count: int | None
    decision: Decision


class Decides(Protocol):
    """Who answers questions, of whichever system; not for the loop."""

    def answer(self, question: Question) -> ExplorationAnswer:
        """The answer to a question."""


class Source(Protocol):
    """Where decisions come from; nothing here keeps the loop waiting."""

    def prepare(self) -> None:
        """Get ready; called again and again for as long as a plan that explores is in hand."""

    def ask(self, question: Question) -> None:
        """Pass a question on; it may be dropped."""

    def collect(self, t: float) -> ExplorationAnswer | None:
        """The newest answer that has come by `t` (s), each once."""


class Decider:
    """Answers for two palms: explores, rocks while nothing is known, makes what sticks slip, tips what has corners.

    Not for the loop.
    """

    def __init__(self, rig: RigDescription, seed: int = 0) -> None:
        self._rig = rig
        self._seed = seed
        self._run: int | None = None

    def answer(self, question: Question) -> ExplorationAnswer:
        """The answer to a question; a new task begins with a new explorer."""
        task, belief, move = question.task, question.belief, question.under_way.move
        if task.run != self._run:
            from palmd.motion.explorer import Explorer  # here: who only asks need not load it

            self._run = task.run
            self._explorer = Explorer(self._rig, task.limits, task.goal, self._seed)
            self._centre: Angles | None = None  # of the rocking
            self._corners: tuple[Angles, ...] = ()  # that are still to come of the rounds that provoke slips
            self._tips = False
            self._aim: Angles | None = None  # the pose of the rounds that tip it which comes next
        if belief is not None:
            assert isinstance(belief, PlanningBelief), "it is of two palms"
        stuck_at = None if belief is not None and belief.confirmed else question.sticking
        if stuck_at is None:
            self._corners = ()
        self._tips = self._tips or question.cornered  # whatever is believed of it later
        if self._tips:
            decision = self._tipped(move.end, task.limits, question.choose)
        elif stuck_at is not None:
            decision = self._provoked(stuck_at, move, task.limits, question.choose)
        elif belief is not None:
            self._centre = None
            decision = self._explorer.decide(belief, question.under_way, choose=question.choose)
        else:
            decision = self._until_known(move.end, task.limits)
        return ExplorationAnswer(question.t, task.run, move, None if belief is None else belief.object_count, decision)

    def _provoked(self, contacts: tuple[float, ...], last: Move, limits: MotionLimits, choose: bool) -> Decision:
        """The move after `last` of an object that sticks, its contacts (m) being there: no belief foresees any."""
        if not choose:
            return Decision("safe")
        from palmd.motion.provocation import provoke, rounds  # as above

        here = last.end
        if self._corners and here == self._corners[0]:
            self._corners = self._corners[1:]
        self._corners = self._corners or rounds(contacts, here, limits)
        move = provoke(here, self._corners, limits)
        if move is None:
            return Decision("wait", reason="the object sticks, and there is no room to make it slip")
        return Decision("move", move, "the object sticks: it is made to slip along either palm in turn", blind=True)

    def _tipped(self, here: Angles, limits: MotionLimits, choose: bool) -> Decision:
        """The move from `here` (rad) of an object with corners: from side to side, whatever it is."""
        if not choose:
            return Decision("safe")
        move = tip(here, self._aim, limits)
        if move is None:
            return Decision("wait", reason="the object has corners, and there is no room to tip it from side to side")
        self._aim = move.end
        return Decision("move", move, "the object has corners: it is tipped from side to side", blind=True)

    def _until_known(self, here: Angles, limits: MotionLimits) -> Decision:
        """The next move of the palms, which stand at `here` (rad), when it is not known where the object is."""
        if (back := homewards(here, limits)) is not None:
            self._centre = None
            return Decision("move", back, "goes back to where an object lies well, until it is known where it is")
        self._centre = self._centre or here
        to_and_fro = rock(here, self._centre, limits)
        if to_and_fro is None:
            return Decision("wait", reason="there is no room to rock the object")
        return Decision("move", to_and_fro, "rocks the object until it is known where it is")
