"""Which law of friction an excitation asks for: the rule, and figures of the theory."""

import math

import pytest

from palmd.system.excitation import (
    Excitation,
    Regime,
    friction_acceleration,
    least_speed,
    regime,
    resonance_hz,
    resonates,
    sticks,
    swung,
)

G = 9.81


def test_rocking_by_a_plan_is_motion_and_sticks():
    """0.1 degrees at 10 Hz, 22 mm from the hinge: 2πfV is 0.15 m/s² against 1 m/s² of friction and more."""
    rocked = swung(math.radians(0.1), 10.0, 0.022)
    assert rocked.acceleration == pytest.approx(0.15, abs=0.01)
    friction = friction_acceleration(0.1, G)
    assert friction > 1.0
    assert sticks(rocked, friction)
    assert regime(rocked, friction) is Regime.DRY


@pytest.mark.parametrize(
    ("frequency", "speed", "wanted"),
    [
        (250.0, 0.015, Regime.AVERAGED),
        (250.0, 0.005, Regime.STEPS),  # sticks
        (40.0, 1.0, Regime.STEPS),  # too slow
        (50.0, 1.0, Regime.AVERAGED),
        (20.0, 10.0, Regime.DRY),  # of a plan, however hard it shakes
    ],
)
def test_a_vibration_is_averaged_where_it_is_fast_and_strong(frequency, speed, wanted):
    assert regime(Excitation(frequency, speed), friction_acceleration(0.3, G)) is wanted


def test_a_faster_object_asks_for_a_faster_vibration():
    shaken, friction = Excitation(80.0, 0.1), friction_acceleration(0.1, G)
    assert regime(shaken, friction, slow_hz=7.9) is Regime.AVERAGED
    assert regime(shaken, friction, slow_hz=8.1) is Regime.STEPS


def test_least_speed_is_where_contacts_begin_to_slip_through():
    friction = friction_acceleration(0.3, G)
    least = least_speed(250.0, friction)
    assert sticks(Excitation(250.0, 0.999 * least), friction)
    assert not sticks(Excitation(250.0, 1.001 * least), friction)


def test_a_hundred_grams_on_a_quarter_of_a_million_newtons_a_metre_resonate_at_250_hz():
    resonance = resonance_hz(2.5e5, 0.1)
    assert resonance == pytest.approx(250.0, rel=0.01)
    assert [resonates(f * resonance, resonance) for f in (0.4, 0.6, 1.9, 2.1)] == [False, True, True, False]
