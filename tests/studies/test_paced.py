"""What is thought at a pace comes so many times its processor time later, and the newest question is answered next."""

import itertools

import pytest

from palmd.config.three_palms import TiltGoal
from palmd.console.errors import BAD_INPUT
from palmd.daemon.exploration_requests import ExplorationAnswer, ExplorationTask, Question
from palmd.motion.decisions import Decision, UnderWay
from palmd.motion.segments import Move
from palmd.motion.three_palms import TiltLimits
from palmd.observer.three_palms.growing import GrowingBody
from palmd.system.three_palms import ThreePalmsRig
from tools.studies import paced
from tools.studies.commands import main
from tools.studies.paced import PASSED_ON_S, PacedExplorer, PacedGrowing
from tools.studies.space_exploring import WIDE

COST_S, PACE = 0.5, 3.0


@pytest.fixture(autouse=True)
def costly(monkeypatch):
    """Every thought takes half a second of processor time."""
    clock = itertools.count()
    monkeypatch.setattr(paced.time, "process_time", lambda: COST_S * next(clock))


def test_decisions_take_their_time_and_the_last_question_of_those_that_wait_is_answered_next():
    class Decides:
        def answer(self, question):
            return ExplorationAnswer(question.t, 1, question.under_way.move, None, Decision("wait"))

    here = (0.9, 0.8, 0.8)
    task = ExplorationTask(1, TiltGoal(), TiltLimits.over(WIDE, 75.0))
    explorer = PacedExplorer(Decides(), PACE)
    asked, heard = {0.0, 0.3, 0.6, 0.9}, []
    for k in range(400):
        t = 0.01 * k
        if round(t, 2) in asked:
            explorer.ask(Question(round(t, 2), task, None, UnderWay(Move(here, here, 0.0), 0.0)))
        if (answer := explorer.collect(t)) is not None:
            heard.append((round(t, 2), answer.t))
    assert heard == [(1.5, 0.0), (3.0, 0.9)]


def test_the_smoother_takes_its_time_and_begins_again_when_it_has_answered(monkeypatch):
    begun = []
    monkeypatch.setattr(GrowingBody, "answer", lambda _: begun.append(1) or "an answer")
    growing, heard = PacedGrowing(ThreePalmsRig(), PACE), []
    for k in range(400):
        growing.submit(0.01 * k, [])
        if growing.collect(0.01 * k) is not None:
            heard.append(0.01 * k)
    assert heard == pytest.approx([1.6, 3.21], abs=0.021)
    assert heard[0] >= COST_S * PACE + PASSED_ON_S - 1e-9
    assert len(begun) == 3


@pytest.mark.parametrize("pace", ["0", "-1", "nan", "inf"])
def test_a_pace_that_is_none_is_refused(pace, capsys):
    assert main(["space", "--live", f"--pace={pace}"]) == BAD_INPUT
    assert capsys.readouterr().err == f"--pace must be a number above 0, got {float(pace):g}\n"
