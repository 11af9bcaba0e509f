"""The loop's side of an exploration with scripted decisions: which are followed, which are dropped, what stops it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from palmd.config.arms import AdeptConfig
from palmd.config.pads import VersaPadConfig
from palmd.config.two_palms import Config, PadsConfig, PlanSpec, rig_description
from palmd.daemon.exploration_requests import Decider, ExplorationAnswer, ExplorationTask, Question
from palmd.daemon.exploring import (
    AHEAD_S,
    ASK_S,
    BLIND_S,
    CHECK_S,
    LEAD_S,
    LOST_S,
    MORE_S,
    OVERTIME_S,
    SILENT_S,
    STALE_S,
    DelegatedExploration,
    ExplorationInputs,
)
from palmd.daemon.poses import make_poses
from palmd.daemon.setpoints import SetPoints
from palmd.events import PalmMotion, PlanningBelief
from palmd.motion.check import motion_limits
from palmd.motion.decisions import Decision, UnderWay
from palmd.motion.plan import compile_plan
from palmd.motion.segments import Move
from palmd.motion.tipping import tip
from palmd.system.rig_constants import RIG_NAMES
from tools.closed_loop import InlineExplorer

STEP_S = 0.002
CYCLE_STEPS, TICK_STEPS = 8, 5
CONFIG = Config(
    pads=PadsConfig(palm1=VersaPadConfig(port="a"), palm2=VersaPadConfig(port="b")), arm=AdeptConfig(port="c")
)
LIMITS = motion_limits(CONFIG)
HERE = PalmMotion.at_rest((math.radians(45.0), math.radians(90.0)))
WAY = math.radians(10.0)

Decide = Callable[[Question], Decision | None]


def onwards(question: Question) -> Decision:
    """Endless moves between two poses."""
    start = question.under_way.move.end
    step = WAY if start[0] < HERE.angles[0] + 0.5 * WAY else -WAY
    return Decision("move", Move(start, (start[0] + step, start[1]), 0.8), "goes on", coverage=0.5, reachable=0.9)


class Scripted:
    """A scripted explorer; each decision is delivered `latency` seconds after its question."""

    def __init__(self, decide: Decide) -> None:
        self.decide = decide
        self.latency = 0.1
        self.questions: list[Question] = []
        self.answers: list[ExplorationAnswer] = []
        self.prepared = 0

    def prepare(self) -> None:
        self.prepared += 1

    def ask(self, question: Question) -> None:
        self.questions.append(question)
        decision = self.decide(question)
        if decision is not None:
            seen = None if question.belief is None else question.belief.object_count
            self.answers.append(
                ExplorationAnswer(question.t, question.task.run, question.under_way.move, seen, decision)
            )

    def collect(self, t: float) -> ExplorationAnswer | None:
        newest = None
        while self.answers and self.answers[0].t + self.latency <= t:
            newest = self.answers.pop(0)
        return newest


class Stage:
    """Set-points that are all sent, and an exploration on them."""

    def __init__(self, decide: Decide = onwards, time_limit_s: float = 1000.0) -> None:
        self.poses = make_poses(CONFIG)
        self.setpoints = SetPoints(self.poses, LIMITS)
        self.source = Scripted(decide)
        self.exploring = DelegatedExploration(self.setpoints, self.source)
        self.steps = 5000
        self.valid = self.touching = self.tracking = True
        self.object_count = 1
        self.sticking: tuple[float, ...] | None = None
        self.cornered = False
        self.motions: list[PalmMotion] = []
        self.spec = PlanSpec.model_validate(
            {"name": "out", "segments": [{"explore": {"time_limit_s": time_limit_s, "coverage": 0.9}}]}
        )
        self.setpoints.stand(HERE, self.poses.pose(HERE.angles), self.t)
        self.start()

    def start(self) -> None:
        here = self.setpoints.commanded
        self.setpoints.start(compile_plan(self.spec, LIMITS, here.angles))

    @property
    def t(self) -> float:
        return self.steps * STEP_S

    def look(self) -> PlanningBelief:
        return PlanningBelief(self.t, np.zeros((1, 21)), np.zeros(72, dtype=bool), np.zeros(72), self.object_count)

    def go(self, seconds: float) -> Iterator[PalmMotion]:
        """Runs on; the commanded motion of each cycle."""
        for _ in range(round(seconds / STEP_S)):
            self.steps += 1
            if self.steps % TICK_STEPS == 0:
                known = self.tracking, self.touching, self.valid
                senses = ExplorationInputs(*known, self.object_count, self.look, self.sticking, self.cornered)
                self.exploring.step(self.t, senses)
            if self.steps % CYCLE_STEPS == 0:
                assert self.setpoints.target(self.t) is not None
                self.motions.append(self.setpoints.sent(self.t))
                yield self.motions[-1]

    def after(self, seconds: float) -> PalmMotion:
        """The last motion after a number of seconds."""
        return list(self.go(seconds))[-1]

    def reason(self) -> str:
        status = self.exploring.summary()
        return str(status["reason"])


def moves(motion: PalmMotion) -> bool:
    return motion.rates[0] != 0.0 or motion.rates[1] != 0.0


def stands(stage: Stage, seconds: float = 0.3) -> bool:
    motions = list(stage.go(seconds))
    return len({motion.angles for motion in motions}) == 1


def test_moves_follow_each_other_without_rest_and_without_jumps() -> None:
    stage = Stage()
    motions = list(stage.go(8.0))
    resting = [not moves(motion) for motion in motions[round(0.4 / 0.016) :]]
    at_a_time = [len(list(run)) for rests, run in itertools.groupby(resting) if rests]
    assert max(at_a_time, default=0) <= 1  # the instant between two moves
    rates = [abs(b.angles[0] - a.angles[0]) / 0.016 for a, b in itertools.pairwise(motions)]
    assert 1.7 * WAY / 0.8 < max(rates) < 2.0 * WAY / 0.8
    assert stage.setpoints.interventions == 0
    assert stage.exploring.summary() == {"coverage": 0.5, "reachable": 0.9, "reason": "goes on"}
    place = stage.setpoints.place
    assert place.progress == 0.5
    assert stage.exploring.explored.running
    assert stage.exploring.explored.seconds == pytest.approx(8.0, abs=0.1)


def test_questions_follow_a_grid_and_concern_the_last_move_only() -> None:
    stage = Stage()
    list(stage.go(5.0))
    times = [question.t for question in stage.source.questions]
    assert min(b - a for a, b in itertools.pairwise(times)) >= ASK_S - 1e-9
    assert 5 < len(times) <= 5.0 / ASK_S + 1
    for question in stage.source.questions:
        move = question.under_way.move
        assert question.under_way.elapsed >= 0.0
        assert question.belief is not None
        assert move.end == move.start or question.under_way.elapsed < move.duration - LEAD_S + 0.02


def test_a_long_move_is_checked_at_intervals_until_its_end_is_near() -> None:
    def far(question: Question) -> Decision:
        start = question.under_way.move.end
        return Decision("move", Move(start, (start[0] + (0.3 if start[0] < 0.9 else -0.3), start[1]), 4.0))

    stage = Stage(far)
    list(stage.go(8.0))
    early = [q.t for q in stage.source.questions if 0.0 < q.under_way.elapsed < 4.0 - AHEAD_S - ASK_S]
    gaps = [b - a for a, b in itertools.pairwise(early) if b - a < 2.0]
    assert min(gaps) > CHECK_S - 0.05
    late = [q for q in stage.source.questions if 4.0 - AHEAD_S <= q.under_way.elapsed < 4.0]
    assert late


def test_a_choice_is_asked_for_when_due_and_only_until_it_is_made() -> None:
    def in_time(question: Question) -> Decision:
        return onwards(question) if question.choose else Decision("safe")

    stage = Stage(in_time)
    stage.source.latency = 0.02
    list(stage.go(6.0))
    chosen: set[int] = set()
    for question in stage.source.questions:
        move, elapsed = question.under_way.move, question.under_way.elapsed
        due = move.duration - elapsed <= AHEAD_S
        assert question.choose is (due and id(move) not in chosen)
        if question.choose:
            chosen.add(id(move))
    assert len(chosen) > 5
    assert moves(stage.motions[-1])
    assert stage.reason() == "goes on"


def test_short_moves_wait_for_exactly_one_decision_each() -> None:
    """With an explorer that answers one question after the other, as its process does."""
    begun: list[Move] = []

    class Quick:
        def answer(self, question: Question) -> ExplorationAnswer:
            start = question.under_way.move.end
            step = WAY if start[0] < HERE.angles[0] + 0.5 * WAY else -WAY
            move = Move(start, (start[0] + step, start[1]), 0.2)
            decision = Decision("move", move) if question.choose else Decision("safe")
            seen = None if question.belief is None else question.belief.object_count
            return ExplorationAnswer(question.t, question.task.run, question.under_way.move, seen, decision)

    stage = Stage()
    stage.exploring = DelegatedExploration(stage.setpoints, InlineExplorer(Quick(), latency_s=ASK_S))
    for _ in stage.go(6.0):
        exploration = stage.setpoints.exploration
        if exploration is not None and exploration[0].last not in begun[-1:]:
            begun.append(exploration[0].last)
    assert len(begun) > 0.9 * 6.0 / (ASK_S + LEAD_S)


def test_the_newest_decision_counts() -> None:
    """All answers before a move's end but the last lead elsewhere."""
    stage = Stage()

    def wavering(question: Question) -> Decision:
        left = question.under_way.move.duration - question.under_way.elapsed
        start = question.under_way.move.end
        away = math.radians(3.0) if left > 0.5 else 0.0
        return Decision("move", Move(start, (onwards(question).move.end[0], start[1] + away), 0.8))  # type: ignore[union-attr]

    stage.source.decide = wavering
    list(stage.go(0.5))
    assert all(motion.angles[1] == pytest.approx(HERE.angles[1], abs=1e-9) for motion in stage.go(5.0))


def test_without_decisions_it_finishes_the_move_stops_and_says_why() -> None:
    stage = Stage()
    list(stage.go(0.5))
    stage.source.decide = lambda _: None
    list(stage.go(2.0))
    assert stands(stage)
    list(stage.go(SILENT_S))
    assert stage.exploring.silent
    stage.source.decide = onwards
    assert moves(stage.after(0.5))
    assert not stage.exploring.silent


def test_a_late_answer_is_dropped_and_counted() -> None:
    stage = Stage()
    stage.source.latency = STALE_S + 0.05
    assert stands(stage, STALE_S + 3.0)
    assert stage.exploring.dropped > 5
    assert stage.exploring.silent


def begun(stage: Stage, seconds: float) -> list[tuple[float, Move]]:
    """The start times of the moves in a number of seconds."""
    found: list[tuple[float, Move]] = []
    for _ in stage.go(seconds):
        exploration = stage.setpoints.exploration
        if exploration is not None and (not found or exploration[0].under_way(exploration[1])[0] is not found[-1][1]):
            found.append((stage.t, exploration[0].under_way(exploration[1])[0]))
    return found


def test_a_slow_explorer_is_asked_earlier_and_followed() -> None:
    """A busy machine: decisions that take longer than moves still concern the end of the current move."""
    stage = Stage()
    stage.source.latency = 1.5
    times = [t for t, _ in begun(stage, 12.0)]
    assert stage.exploring.dropped == 0
    asked = [q for q in stage.source.questions if q.choose and q.t > times[2]]
    assert min(q.under_way.elapsed for q in asked) < 0.05  # as soon as a move begins
    gaps = [b - a for a, b in itertools.pairwise(times[2:])]
    assert max(gaps) < 1.5 + ASK_S + 0.1


def test_a_decision_gives_two_moves_if_the_palms_would_otherwise_stop() -> None:
    def two(question: Question) -> Decision:
        first = onwards(question).move
        return Decision("move", first, then=Move(first.end, first.start, 0.8))

    slow, quick = Stage(two), Stage(two)
    slow.source.latency = 0.8 + MORE_S + 0.1
    quick.source.latency = 0.8 + MORE_S - 0.1
    for stage, apace in ((slow, True), (quick, False)):
        times, moves_made = zip(*begun(stage, 10.0), strict=True)
        assert all(b.start == a.end for a, b in itertools.pairwise(moves_made))
        gaps = [b - a for a, b in itertools.pairwise(times[1:])]
        assert len(gaps) > 5
        assert (min(gaps) < 0.8 + 2 * LEAD_S) is apace
    assert slow.exploring.dropped == 0


def test_a_decision_about_another_object_or_from_another_pose_is_not_followed() -> None:
    stage = Stage()
    list(stage.go(0.05))
    stage.object_count = 2
    stage.source.answers = [
        ExplorationAnswer(answer.t, answer.run, answer.after, 1, answer.decision) for answer in stage.source.answers
    ]
    stage.source.decide = lambda _: Decision("move", Move((0.7, 1.5), (0.8, 1.5), 1.0))
    assert stands(stage, 2.0)


def test_a_decision_of_an_earlier_exploration_is_not_followed() -> None:
    stage = Stage(time_limit_s=1.0)
    stage.source.decide = lambda _: Decision("done", reason="all of it")
    list(stage.go(0.3))
    stage.source.decide = lambda _: None
    assert not stage.setpoints.moving
    left = ExplorationAnswer(stage.t, 1, Move(HERE.angles, HERE.angles, 0.0), 1, Decision("done"))
    stage.start()
    stage.source.answers = [left]
    list(stage.go(0.4))
    assert stage.setpoints.moving
    assert stage.reason() == "it has just started"


def test_an_unsafe_move_is_stopped_on_its_path_and_replaced() -> None:
    stage = Stage()
    list(stage.go(0.6))
    stage.source.decide = lambda _: Decision("unsafe", reason="it would slip")
    stood = stage.after(0.7)
    assert HERE.angles[0] + 0.05 * WAY < stood.angles[0] < HERE.angles[0] + 0.95 * WAY
    assert stands(stage)
    assert stage.reason() == "it would slip"
    asked = stage.source.questions[-1].under_way.move
    assert (asked.start, asked.duration) == (asked.end, 0.0)
    assert asked.end[0] == pytest.approx(stood.angles[0])
    stage.source.decide = onwards
    steps = [abs(b.angles[0] - a.angles[0]) for a, b in itertools.pairwise([stood, *stage.go(1.0)])]
    assert 0.0 < max(steps) < LIMITS.rate * 0.016
    assert moves(stage.motions[-1])


def test_a_verdict_on_the_previous_move_does_not_stop_the_current_one() -> None:
    stage = Stage()
    list(stage.go(0.6))
    before = stage.source.questions[-1].under_way.move
    list(stage.go(0.8))
    assert stage.source.questions[-1].under_way.move != before
    for kind in ("unsafe", "done"):
        stage.source.decide = lambda _: None
        stage.source.answers = [ExplorationAnswer(stage.t, 1, before, 1, Decision(kind))]  # type: ignore[arg-type]
        assert moves(stage.after(0.15))
        assert stage.reason() == "goes on"


def test_a_pending_move_is_withdrawn_when_the_next_answer_says_so() -> None:
    stage = Stage()
    list(stage.go(0.45))
    assert moves(stage.motions[-1])
    stage.source.decide = lambda _: Decision("wait", reason="nothing is safe")
    list(stage.go(1.0))
    assert stands(stage)
    assert stage.reason() == "nothing is safe"


def test_done_ends_the_exploration_after_the_current_move() -> None:
    stage = Stage()
    list(stage.go(0.5))
    stage.source.decide = lambda _: Decision("done", reason="all that can be reached", coverage=0.96)
    assert moves(stage.after(0.3))
    list(stage.go(1.0))
    assert not stage.setpoints.moving
    assert stage.setpoints.exploration is None
    assert not stage.setpoints.held
    assert stage.motions[-1].angles[0] == pytest.approx(HERE.angles[0] + WAY)
    assert stage.exploring.summary() == {"coverage": 0.96, "reachable": 0.9, "reason": "all that can be reached"}
    explored = stage.exploring.explored
    assert (explored.running, explored.coverage, explored.goal, explored.reachable) == (False, 0.96, 0.9, 0.9)
    assert 0.6 < explored.seconds < 1.4
    stage.source.decide = onwards
    assert stands(stage)
    stage.start()
    assert moves(stage.after(0.5))


def test_the_time_limit_ends_it() -> None:
    stage = Stage(time_limit_s=3.0)
    list(stage.go(3.0 + OVERTIME_S))
    assert stage.setpoints.moving
    list(stage.go(1.2))
    assert not stage.setpoints.moving
    assert stage.reason() == "the time limit of 3 s is over"


def test_the_reason_for_stopping_is_kept() -> None:
    stage = Stage()
    list(stage.go(0.5))
    stage.setpoints.leave()
    stage.exploring.step(stage.t, ExplorationInputs(False, True, True, 1, stage.look))
    assert stage.reason() == "it was stopped"


def test_a_short_loss_of_the_estimate_changes_nothing_and_a_long_one_drops_the_move() -> None:
    stage = Stage(lambda question: Decision("move", Move(question.under_way.move.end, (1.2, 1.5), 3.0)))
    list(stage.go(0.5))
    stage.valid = False
    assert moves(stage.after(0.8 * LOST_S))
    stage.valid = True
    list(stage.go(0.1))
    stage.valid = False
    stood = stage.after(LOST_S + 0.3)
    assert stands(stage)
    assert stood.angles[0] < 1.0
    assert "lost" in stage.reason()
    stage.valid = True
    assert moves(stage.after(0.5))


def test_without_an_estimate_the_object_is_rocked_gently() -> None:
    stage = Stage()
    decider = Decider(rig_description(CONFIG))
    stage.source.decide = lambda question: (
        onwards(question) if question.belief is not None else decider.answer(question).decision
    )
    stage.valid = False
    assert stands(stage, BLIND_S)
    list(stage.go(0.3))
    rocked = list(stage.go(6.0))
    reach = max(abs(motion.angles[0] - HERE.angles[0]) for motion in rocked)
    assert reach == pytest.approx(math.radians(6.0), abs=1e-3)
    assert max(abs(motion.rates[0]) for motion in rocked) < 0.3 * LIMITS.rate
    assert sum(not moves(motion) for motion in rocked) < 0.1 * len(rocked)
    stage.valid = True
    list(stage.go(1.2))
    assert stage.reason() == "goes on"
    assert moves(stage.after(0.4))


def test_nothing_is_rocked_while_a_pad_is_untouched() -> None:
    stage = Stage()
    stage.valid = stage.touching = False
    assert stands(stage, 4.0)
    assert stage.source.questions == []
    assert not stage.exploring.silent


def test_a_hold_drops_the_move_and_start_continues_from_the_held_pose() -> None:
    stage = Stage()
    list(stage.go(0.6))
    stage.tracking = False
    stage.setpoints.hold()
    list(stage.go(0.3))
    assert stands(stage, 2.0)
    assert "held" in stage.reason()
    stood = stage.motions[-1]
    stage.tracking = True
    stage.setpoints.resume()
    list(stage.go(0.4))
    assert stage.reason() == "goes on"
    begun = stage.source.questions[-1].under_way.move
    assert begun.start == pytest.approx(stood.angles)
    assert moves(stage.after(0.3))


def asked(
    stage: Stage, belief: PlanningBelief | None, sticking: tuple[float, ...] | None, *, choose: bool = True
) -> Question:
    move = Move(HERE.angles, HERE.angles, 0.0)
    task = ExplorationTask(1, stage.spec.segments[-1].explore, LIMITS)  # type: ignore[union-attr]
    return Question(5.0, task, belief, UnderWay(move, 9.0), choose, sticking)


def test_a_sticking_object_is_made_to_slip_unless_the_smoother_has_confirmed_the_estimate() -> None:
    stage, decider = Stage(), Decider(rig_description(CONFIG))
    guessed = replace(stage.look(), rig=np.zeros(len(RIG_NAMES)))
    for belief in (None, guessed):
        answer = decider.answer(asked(stage, belief, (0.02, 0.02)))
        assert answer.decision.blind
        assert "sticks" in answer.decision.reason
        assert answer.decision.move.start == HERE.angles
    assert decider.answer(asked(stage, guessed, (0.02, 0.02), choose=False)).decision.kind == "safe"
    answers = []
    for sticking in (None, (0.02, 0.02)):
        decider = Decider(rig_description(CONFIG))
        decider.answer(asked(stage, None, None))
        decider._explorer.decide = lambda *_, **__: Decision("wait", reason="explores")  # type: ignore[method-assign]
        answers.append(decider.answer(asked(stage, stage.look(), sticking)).decision)
    assert [decision.reason for decision in answers] == ["explores", "explores"]


def test_an_object_with_a_corner_is_tipped_whatever_the_later_belief() -> None:
    stage, decider = Stage(), Decider(rig_description(CONFIG))
    guessed = replace(stage.look(), rig=np.zeros(len(RIG_NAMES)))
    for belief, cornered in ((guessed, True), (None, False), (guessed, False)):
        question = replace(asked(stage, belief, (0.02, 0.02)), cornered=cornered)
        decision = decider.answer(question).decision
        assert decision.blind
        assert "corners" in decision.reason
        assert decision.move == tip(HERE.angles, None, LIMITS)
        assert decider.answer(replace(question, choose=False)).decision.kind == "safe"
    first, ends = tip(HERE.angles, None, LIMITS), []
    for here in (first.at(1.0).angles, first.end):  # stopped on its path, and arrived
        decision = decider.answer(replace(question, under_way=UnderWay(Move(here, here, 0.0), 9.0))).decision
        ends.append(decision.move.end)
    assert ends[0] == first.end != ends[1]
    other = replace(asked(stage, None, None), task=replace(question.task, run=2))
    assert "corners" not in decider.answer(other).decision.reason


def test_a_detected_corner_is_passed_to_the_decider() -> None:
    stage = Stage()
    for cornered in (False, True):
        stage.cornered = cornered
        list(stage.go(2.0))
        assert stage.source.questions[-1].cornered == cornered


def test_tipping_visits_each_corner_once() -> None:
    stage, decider, here = Stage(), Decider(rig_description(CONFIG)), HERE.angles
    ends = []
    for _ in range(6):
        question = replace(asked(stage, None, (0.02, 0.02)), under_way=UnderWay(Move(here, here, 0.0), 9.0))
        again = [decider.answer(question).decision.move for _ in range(2)]
        assert again[0] is not None
        assert again[0] == again[1]
        here = again[0].end
        ends.append(here)
    assert ends[4:] == ends[:2]
    assert len(set(ends)) == 4


def test_a_blind_move_continues_without_an_estimate_and_sticking_is_passed_on() -> None:
    def provoking(question: Question) -> Decision:
        return Decision("move", Move(question.under_way.move.end, (1.2, 1.5), 3.0), "slips", blind=True)

    stage = Stage(provoking)
    stage.sticking = (0.02, 0.03)
    list(stage.go(0.5))
    stage.valid = False
    assert moves(stage.after(2.0 * LOST_S))
    assert stage.reason() == "slips"
    assert stage.source.questions[-1].sticking == (0.02, 0.03)


def test_an_explorer_without_a_process_answers_a_fixed_time_after_the_question() -> None:
    inline = InlineExplorer(Decider(rig_description(CONFIG)), latency_s=0.3)
    here = HERE.angles
    task = ExplorationTask(1, Stage().spec.segments[-1].explore, LIMITS)  # type: ignore[union-attr]
    first = Question(5.0, task, None, UnderWay(Move(here, here, 0.0), 9.0))
    inline.ask(first)
    inline.ask(Question(5.1, task, None, first.under_way))  # while it is busy
    assert inline.collect(5.29) is None
    answer = inline.collect(5.3)
    assert (answer.t, answer.run, answer.after, answer.object_count) == (5.0, 1, first.under_way.move, None)
    assert answer.decision.kind == "move"
    assert inline.collect(9.0) is None
