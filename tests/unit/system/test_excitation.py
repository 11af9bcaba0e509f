"""Which friction law holds for an excitation: the decision rule and figures from the theory."""

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


def test_a_plans_dither_sticks_so_friction_stays_dry():
    """0.1 degrees at 10 Hz, 22 mm from the hinge: 2πfV is 0.15 m/s²; friction is above 1 m/s²."""
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
        (20.0, 10.0, Regime.DRY),  # a plan's dither, however strong
    ],
)
def test_friction_is_averaged_for_fast_and_strong_vibration_only(frequency, speed, wanted):
    assert regime(Excitation(frequency, speed), friction_acceleration(0.3, G)) is wanted


def test_a_faster_object_needs_a_higher_vibration_frequency():
    shaken, friction = Excitation(80.0, 0.1), friction_acceleration(0.1, G)
    assert regime(shaken, friction, slow_hz=7.9) is Regime.AVERAGED
    assert regime(shaken, friction, slow_hz=8.1) is Regime.STEPS


def test_least_speed_is_the_limit_between_sticking_and_slipping():
    friction = friction_acceleration(0.3, G)
    least = least_speed(250.0, friction)
    assert sticks(Excitation(250.0, 0.999 * least), friction)
    assert not sticks(Excitation(250.0, 1.001 * least), friction)


def test_100_g_on_250_kn_per_m_resonates_at_250_hz():
    resonance = resonance_hz(2.5e5, 0.1)
    assert resonance == pytest.approx(250.0, rel=0.01)
    assert [resonates(f * resonance, resonance) for f in (0.4, 0.6, 1.9, 2.1)] == [False, True, True, False]
