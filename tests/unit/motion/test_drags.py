import math
from dataclasses import replace

import pytest

from palmd.config.plans import ExploreGoal
from palmd.motion import drags
from palmd.motion.drags import Drags
from palmd.motion.pivot import PivotLimits
from palmd.system.pivot import Touching

LIMITS = PivotLimits(angles=((0.002, 0.053), (0.006, 0.045)), rate=0.04, acceleration=0.4, pad_length=0.0555, force=2.0)
CONTACT = Touching(0.0, 0.035, 0.025, 0.006, 0.5, True, math.nan, math.nan)
IN_AIR = replace(CONTACT, touching=False, e=math.nan, force=math.nan)


@pytest.fixture
def touched():
    """A policy after set-down, with the side found."""
    policy = Drags(LIMITS, ExploreGoal())
    policy.look(IN_AIR, (CONTACT.x, 0.03), True)
    assert policy.look(CONTACT, (CONTACT.x, CONTACT.z), False).kind == "halt"
    assert policy.look(CONTACT, (CONTACT.x, CONTACT.z), True).kind == "wait"
    assert policy.phase == "down"
    return policy


def settled(policy, contact, here):
    """The step after the arm has stood for long enough."""
    policy.look(contact, here, False)
    policy.look(contact, here, True)
    return policy.look(replace(contact, t=contact.t + drags.SETTLED_S), here, True)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_slip_has_the_trailing_sign_while_the_body_is_lowered(side):
    policy = Drags(LIMITS, ExploreGoal())
    contact = replace(CONTACT, e=side * CONTACT.e, x=0.02775 + side * 0.008)
    here = (contact.x, contact.z)
    policy.look(contact, here, True)
    policy.look(contact, here, True)
    move = policy.look(contact, here, True).move
    dx, dz = (end - start for start, end in zip(move.start, move.end, strict=True))
    slip = dx - contact.z * dz / contact.e  # of the contact: u dt = dX + z dθ', ω0 = −ż/e
    assert dz < 0.0
    assert slip * contact.e < 0.0
    assert abs(dz) < 0.1 * abs(contact.e)


def test_slip_has_the_trailing_sign_while_the_body_is_raised(touched):
    low = replace(CONTACT, z=CONTACT.z - 4e-3)
    for contact in (CONTACT, low):
        assert touched.look(contact, (contact.x, contact.z), True).kind == "move"
    touched.look(replace(low, force=1.9), (low.x, low.z), False)
    assert touched.phase == "up"
    first = touched.look(low, (low.x, low.z), True).move
    assert first.end[0] == first.start[0]  # straight up first: the force was near its limit
    for _ in range(3):
        move = touched.look(low, first.end, True).move
        dx, dz = (end - start for start, end in zip(move.start, move.end, strict=True))
        assert dz > 0.0
        assert (dx - low.z * dz / low.e) * low.e < 0.0


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({"force": 1.4}, "the force comes near its limit"),
        ({"force": math.nan}, "the force comes near its limit"),  # beyond the pad's scale
        ({"force": 0.05}, "the body hardly presses any more"),
        ({"e": 0.0015}, "the pivot is nearly above the contact"),
    ],
)
def test_it_turns_back_immediately_near_a_limit(touched, changed, why):
    step = touched.look(replace(CONTACT, **changed), (CONTACT.x, CONTACT.z), False)
    assert (step.kind, step.reason) == ("halt", f"turns back: {why}")
    assert touched.phase == "up"


def test_it_turns_back_before_the_pad_ends(touched):
    step = touched.look(replace(CONTACT, x=0.0025), (0.0025, CONTACT.z), True)
    assert step.reason == "turns back: the pad ends here"


def pressed(touched, *, raised):
    """A body whose lever shortens while it is lowered or raised; its force at rest is ∝ 1/e, less during motion."""
    torque, square, here = 7.0e-3, 5e-5, (CONTACT.x, CONTACT.z)
    if raised:
        touched.phase = "up"
    for k in range(60):
        z, e = CONTACT.z + (here[1] - CONTACT.z), math.sqrt(max(square - 2.2e-2 * abs(here[1] - CONTACT.z), 1e-8))
        yield torque / e
        on_the_way = replace(CONTACT, t=float(k), z=z, e=e, force=0.8 * torque / e)
        step = settled(touched, on_the_way, here) if raised else touched.look(on_the_way, here, True)
        if step.move is None:
            return
        here = here[0], step.move.end[1]


@pytest.mark.parametrize("raised", [False, True])
def test_the_force_at_rest_is_predicted_and_limited(touched, raised, monkeypatch):
    """Trailing friction reduces the force: the force during motion is less than the force at rest."""
    monkeypatch.setattr(drags, "FORCE_SHARE", math.inf)
    contact = list(pressed(touched, raised=raised))
    assert len(contact) > 1
    assert max(contact) < LIMITS.force


def test_it_turns_back_for_the_force_expected_after_the_latency(touched):
    for z, e in ((0.025, 5e-3), (0.0246, 4e-3)):
        assert touched.look(replace(CONTACT, z=z, e=e, force=3.2e-3 / e), (CONTACT.x, z), True).kind == "move"
    step = touched.look(replace(CONTACT, z=0.0244, e=3.1e-3, force=1.05), (CONTACT.x, 0.0244), False)
    assert (step.kind, step.reason) == ("halt", "turns back: the force comes near its limit")


def test_a_body_that_leaves_the_pad_is_lifted(touched):
    assert touched.look(IN_AIR, (CONTACT.x, CONTACT.z), False).kind == "halt"
    assert touched.look(replace(IN_AIR, t=0.3), (CONTACT.x, CONTACT.z), True).kind == "wait"
    step = touched.look(replace(IN_AIR, t=0.5), (CONTACT.x, CONTACT.z), True)
    assert "left the pad" in step.reason
    assert touched.lifted == 1
    move = touched.look(IN_AIR, (CONTACT.x, CONTACT.z), True).move
    assert move.end[1] > move.start[1]
    assert move.end[0] == move.start[0]


def test_the_search_starts_above_the_highest_contact_so_far(touched):
    touched.look(IN_AIR, (CONTACT.x, CONTACT.z), False)
    touched.look(replace(IN_AIR, t=0.5), (CONTACT.x, CONTACT.z), True)
    lifted = touched.look(IN_AIR, (CONTACT.x, CONTACT.z), True).move.end
    assert lifted[1] > CONTACT.z + 4e-3
    touched.phase = "seek"
    touched.look(replace(CONTACT, z=0.015), (CONTACT.x, 0.015), False)  # on the other side, much lower
    touched.phase = "turn"
    aside = touched.look(IN_AIR, (0.02, 0.04), True).move.end
    touched.look(replace(IN_AIR, t=9.0), aside, True)
    assert touched.phase == "seek"
    sunk = touched.look(replace(IN_AIR, t=9.0), aside, True).move
    assert sunk.end[0] == sunk.start[0]
    assert sunk.end[1] > CONTACT.z + 4e-3


def test_raising_ends_before_the_predicted_force_limit(touched):
    assert touched.look(CONTACT, (CONTACT.x, CONTACT.z), True).kind == "move"
    touched.phase = "up"
    here, e = (CONTACT.x, CONTACT.z), 0.008
    for k in range(4):  # the lever shortens as it is raised, and the force is far from its limit
        contact = replace(CONTACT, z=CONTACT.z + 5e-4 * k, e=e - 6e-4 * k, force=0.8)
        here = settled(touched, replace(contact, t=float(k)), here).move.end
    step = settled(touched, replace(contact, t=9.0, z=contact.z + 5e-4, e=contact.e - 6e-4, force=0.95), here)
    assert step.reason == "this side is done: lifted off"


def test_raising_continues_while_the_force_allows_even_with_a_short_lever(touched):
    touched.phase = "up"
    here = (CONTACT.x, CONTACT.z)
    for k, e in enumerate((0.0100, 0.0060, 0.0036, 0.0032)):  # the last is a third of the longest
        contact = replace(CONTACT, t=float(k), z=CONTACT.z + 5e-4 * k, e=e, force=2e-3 / e)
        here = settled(touched, contact, here).move.end
    step = settled(touched, replace(contact, t=9.0, z=contact.z + 5e-4, e=0.0021, force=0.8), here)
    assert step.reason == "this side is done: lifted off"  # it would reach the dead centre


def test_a_short_silence_of_the_pad_does_not_end_the_contact(touched):
    assert touched.look(IN_AIR, (CONTACT.x, CONTACT.z), False).kind == "halt"
    assert touched.look(replace(CONTACT, t=0.2), (CONTACT.x, CONTACT.z), True).kind == "move"
    assert (touched.phase, touched.lifted) == ("down", 0)


def test_the_search_descends_in_strokes_towards_the_middle():
    policy = Drags(LIMITS, ExploreGoal())
    here, ways = (0.0277, 0.04), []
    for k in range(6):
        move = policy.look(replace(IN_AIR, t=float(k)), here, True).move
        assert move is not None
        here = move.end
        ways.append((move.end[0] - move.start[0], move.end[1] - move.start[1]))
    sinking = [(dx, dz) for dx, dz in ways if dz < 0.0]
    assert len(sinking) >= 2
    assert all(
        dx < 0.0 and abs(dx) > 9.0 * abs(dz) for dx, dz in sinking
    )  # towards the middle: it began at the far end


def test_it_does_not_search_below_its_limits():
    policy = Drags(LIMITS, ExploreGoal())
    low = LIMITS.angles[1][0]
    start = policy.look(IN_AIR, (0.0277, low), True).move
    step = policy.look(IN_AIR, start.end, True)
    assert step.kind == "done"
    assert "nothing touches the pad" in step.reason


def test_a_side_is_followed_back_up_from_its_low_end(touched):
    """The lever is short at the low end and grows on the way back, which is known from the way down."""
    low = replace(CONTACT, z=CONTACT.z - 8e-3, e=2.1e-3, force=1.0)
    for contact in (CONTACT, replace(CONTACT, z=CONTACT.z - 4e-3, e=4.5e-3)):
        assert touched.look(contact, (contact.x, contact.z), True).kind == "move"
    touched.look(replace(low, e=1.9e-3), (low.x, low.z), False)
    assert touched.phase == "up"
    here = (low.x, low.z)
    for _ in range(5):
        here = touched.look(replace(low, z=here[1]), here, True).move.end
    assert touched.phase == "up"
    assert here[1] > low.z + 1e-3


def test_a_body_is_lifted_off_in_one_fast_move(touched):
    """At rest near the dead centre the force is ∝ 1/e, and a slow move is like rest."""
    touched.phase = "lift"
    here = (CONTACT.x, CONTACT.z)
    move = touched.look(CONTACT, here, True).move
    assert move.end == (CONTACT.x, CONTACT.z + drags.LIFTED_M)
    peak = max(move.at(move.duration * k / 20).rates[1] for k in range(21))
    assert peak == pytest.approx(0.9 * LIMITS.rate, rel=0.01)
    left = replace(IN_AIR, z=CONTACT.z + 2e-3)
    assert touched.look(left, move.end, False).kind == "wait"  # off the pad, but with no room for a hand yet
    assert touched.look(replace(left, z=CONTACT.z + drags.NEAR_M + 1e-4), move.end, False).kind == "halt"


def test_it_turns_back_before_the_body_swings_off_the_pad(touched):
    """The torque falls by the same amount each step as the centre of mass approaches the line below the pivot."""
    here, forces = (CONTACT.x, CONTACT.z), (0.46, 0.36, 0.27, 0.18)
    for k, force in enumerate(forces):
        contact = replace(CONTACT, t=float(k), z=CONTACT.z - 5e-4 * k, force=force)
        assert touched.phase == "down"
        step = touched.look(contact, here, True)
        here = step.move.end if step.move else here
    assert (step.kind, step.reason) == ("wait", "turns back: the body hardly presses any more")


def test_leaving_the_pad_on_the_way_up_does_not_complete_a_side(touched):
    low = replace(CONTACT, z=CONTACT.z - 4e-3)
    for contact in (CONTACT, low):
        assert touched.look(contact, (contact.x, contact.z), True).kind == "move"
    touched.look(replace(low, force=1.9), (low.x, low.z), False)
    gone = replace(IN_AIR, t=1.0, z=low.z)
    touched.look(gone, (low.x, low.z), True)
    step = touched.look(replace(gone, t=1.5), (low.x, low.z), True)
    assert "left the pad" in step.reason
    assert touched.coverage == 0.25


def test_the_predicted_force_at_rest_includes_the_observed_friction(touched):
    """μ = 0.1: force at rest τ|e|/(e² − μ²z²), trailing τ/(|e| + μz).

    From the lever alone 0.83 N would be predicted; half of 2 N is allowed.
    """
    mu, torque = 0.1, 2.4e-3
    touched.phase = "up"
    here = (CONTACT.x, CONTACT.z)
    for k, e in enumerate((6e-3, 5e-3)):
        z = CONTACT.z + 5e-4 * k
        trailing = replace(CONTACT, t=float(k), z=z, e=e, force=torque / (e + mu * z))
        assert touched.look(trailing, here, False).kind == "wait"
        touched.look(replace(trailing, force=torque * e / (e**2 - (mu * z) ** 2)), here, True)
        step = settled(touched, replace(trailing, force=torque * e / (e**2 - (mu * z) ** 2)), here)
    assert step.reason == "this side is done: lifted off"
