import math
from dataclasses import replace
from itertools import pairwise

import pytest

from palmd.config.plans import ExploreGoal
from palmd.motion.pivot import PivotLimits
from palmd.motion.rolls import ENOUGH, MOST_PASSES, PASSES, SETTINGS, Rolls
from palmd.system.pivot import Touching

LIMITS = PivotLimits(
    angles=((0.002, 0.053), (0.006, 0.045)), rate=0.04, acceleration=0.4, pad_length=0.0555, force=2.0, slides=True
)
CONTACT = Touching(0.0, 0.0275, 0.022, 0.001, 1.2, True, math.nan, math.nan)
IN_AIR = replace(CONTACT, touching=False, e=math.nan, force=math.nan)


def set_down(goal=None):
    """A policy with a contact, whose stop has been lowered clear of the carriage."""
    rolls = Rolls(LIMITS, ExploreGoal() if goal is None else goal)
    assert rolls.look(CONTACT, (CONTACT.x, CONTACT.z), False).kind == "halt"
    step = rolls.look(CONTACT, (CONTACT.x, CONTACT.z), True)
    assert step.move.end[1] < CONTACT.z - 5e-3
    return rolls, step.move.end


def rolled(rolls, here, contact, count):
    """Execute the requested steps `count` times; the contact is right below the pivot but for `contact.e`."""
    steps = []
    for _ in range(count):
        steps.append(rolls.look(replace(contact, x=here[0]), here, True))
        if steps[-1].move is not None:
            here = steps[-1].move.end
    return steps, here


def test_it_descends_vertically_and_slowly():
    rolls = Rolls(LIMITS, ExploreGoal())
    move = rolls.look(IN_AIR, (0.02775, 0.04), True).move
    assert move.start[0] == move.end[0]
    assert move.duration > 4.0
    assert "nothing touches the pad" in rolls.look(IN_AIR, (0.02775, 0.006), True).reason


@pytest.mark.parametrize("e", [0.006, 0.0, -0.006])
def test_it_rolls_to_and_fro_with_the_contact_on_the_pad(e):
    rolls, here = set_down()
    steps, _ = rolled(rolls, here, replace(CONTACT, e=e), 60)
    places = [step.move.end[0] for step in steps if step.move is not None]
    assert all(0.005 < x + e < 0.0505 for x in places)
    assert max(places) - min(places) > 0.035
    assert rolls.coverage == 1.0


def test_it_ends_after_enough_passes_when_the_outline_is_known():
    rolls, here = set_down(ExploreGoal(band_mm=0.1))
    steps, _ = rolled(rolls, here, replace(CONTACT, band=5e-5), 60)
    ended = next(k for k, step in enumerate(steps) if step.kind == "done")
    turns = [step.move.end[0] > step.move.start[0] for step in steps[:ended] if step.move is not None]
    assert sum(a != b for a, b in pairwise(turns)) >= ENOUGH - 1


def test_an_undetermined_outline_is_set_down_elsewhere_and_finally_abandoned():
    rolls, here = set_down()
    for setting in range(SETTINGS):
        steps, here = rolled(rolls, here, CONTACT, 8 * PASSES)
        if setting < SETTINGS - 1:
            assert any("lifted off to be set down elsewhere" in step.reason for step in steps)
            rolls.phase = "settle"  # it has been set down elsewhere
    assert any("the outline is not determined" in step.reason for step in steps if step.kind == "done")


def test_the_stop_lifts_the_carriage():
    rolls, here = set_down()
    rolls.phase = "lift"
    move = rolls.look(CONTACT, here, True).move
    assert move.end[1] > CONTACT.z


def test_a_body_that_is_too_heavy_is_refused():
    rolls = Rolls(LIMITS, ExploreGoal())
    rolls.look(CONTACT, (CONTACT.x, CONTACT.z), False)
    step = rolls.look(replace(CONTACT, force=1.7), (CONTACT.x, CONTACT.z), True)
    assert step.kind == "done"
    assert "too heavy: raise limits.force_n" in step.reason


def test_an_outline_under_way_is_awaited_before_the_body_is_set_down_elsewhere():
    rolls, here = set_down()
    old = replace(CONTACT, t_answer=CONTACT.t - 1.0)  # about readings from before this contact
    steps, here = rolled(rolls, here, old, 12 * PASSES)
    assert {step.kind for step in steps} == {"move"}
    steps, here = rolled(rolls, here, replace(old, t_answer=old.t + 1.0), 2)
    assert any("lifted off to be set down elsewhere" in step.reason for step in steps)


def test_without_any_answer_the_body_is_set_down_elsewhere_at_last():
    rolls, here = set_down()
    steps, _ = rolled(rolls, here, replace(CONTACT, t_answer=-math.inf), 8 * MOST_PASSES)
    assert any("lifted off to be set down elsewhere" in step.reason for step in steps)


def test_an_outline_of_an_earlier_contact_does_not_end_the_exploration():
    rolls, here = set_down(ExploreGoal(band_mm=0.1))
    known = replace(CONTACT, band=5e-5)
    steps, here = rolled(rolls, here, replace(known, t_answer=CONTACT.t - 1.0), 60)
    assert "done" not in {step.kind for step in steps}
    steps, _ = rolled(rolls, here, replace(known, t_answer=CONTACT.t + 1.0), 2)
    assert steps[-1].kind == "done"
