"""The guards' reaction to failures of the arm or a pad, in closed loop without ports."""

import copy
import math
from functools import cache

import pytest
import yaml
from campaign import nightly

from palmd.config.two_palms import Config, PlanSpec
from palmd.rig.fault_injection import order
from palmd.rig.world import default_config
from tools.closed_loop import ClosedLoopError, TwoPalmsLoop
from tools.studies.stub_observers import TrivialObserver

PLAN = PlanSpec.model_validate(
    yaml.safe_load(
        "name: ordinary\nrepeat: forever\nsegments:\n- move: {phi1_deg: 42, phi2_deg: 92}\n  duration_s: 1.5\n"
        "- sine: {phi1_deg: 18, phi2_deg: 8}\n  frequency_hz: [0.4, 0.31]\n  duration_s: 60\n"
    )
)
ADEPT = default_config()
PALM_M = 0.12
AFTER_S = (3.3, 4.1, 4.9)
FAULTY = [("adept", t) for t in AFTER_S] + [("dynamixel", AFTER_S[1]), ("feetech", AFTER_S[1])]
FAULTY += nightly(*((servo, t) for servo in ("dynamixel", "feetech") for t in (AFTER_S[0], AFTER_S[2])))
"""Rigs and times of a fault (s)."""


def servos(kind):
    fields = ADEPT.model_dump(mode="json")
    fields["arm"] = {"kind": kind, "port": "arm"}
    fields["rig"]["hinge"] = "fixed"
    return Config.model_validate(fields)


RIGS = {"adept": lambda: ADEPT, "dynamixel": lambda: servos("dynamixel"), "feetech": lambda: servos("feetech")}


@cache
def begun(rig, seed, after_s):
    earlier_s = max((each for each in AFTER_S if each < after_s), default=0.0)
    if earlier_s:
        loop = started(rig, seed, earlier_s)
    else:
        loop = TwoPalmsLoop(RIGS[rig](), PLAN, seed, estimator=TrivialObserver())
        loop.start()
    for _ in loop.run(after_s - earlier_s):
        pass
    return loop


def started(rig="adept", seed=7, after_s=AFTER_S[1]):
    """A rig of its own, started as all others of its kind."""
    return copy.deepcopy(begun(rig, seed, after_s))


def tip(loop):
    """Position of palm 2's far end, from the base or the hinge (m)."""
    phi1, phi2 = loop.world._arm.palms_at(loop.world.t).angles
    x, y = PALM_M * math.cos(phi1 + phi2), PALM_M * math.sin(phi1 + phi2)
    if loop.core.setpoints.limits.workspace is None:
        return x, y
    return x - PALM_M * math.cos(phi1), y - PALM_M * math.sin(phi1)


def provoked(loop, name, strength=None, seconds=3.0):
    """Codes of the first hold or stop fault, its delay, and the tip's positions from then on."""
    t = loop.t
    ports = ["pad1", "pad2"] if name == "saturate" else ["arm"]
    for port in ports:
        loop.world.fault_injector.add(order(name, t, port, strength, for_s=seconds))
    while loop.t < t + seconds:
        loop.tick()
        grave = [fault for fault in loop.core.faults.active if fault.severity in ("hold", "stop")]
        if grave:
            return {fault.code for fault in grave}, loop.t - t, " ".join(fault.text for fault in grave)
    return set(), math.inf, ""


def travel(loop, seconds):
    places = []
    t_end = loop.t + seconds
    while loop.t < t_end:
        loop.tick()
        places.append(tip(loop))
    return max(math.dist(places[0], each) for each in places)


@pytest.mark.parametrize(("rig", "after_s"), FAULTY)
def test_a_blocked_arm_is_stopped_and_does_not_jump_when_released(rig, after_s):
    loop = started(rig, after_s=after_s)
    codes, after, text = provoked(loop, "block", seconds=2.0)
    assert codes == {"following-error"}
    assert after <= 0.5
    assert "°" in text
    while loop.world.fault_injector.names():
        loop.tick()
    assert travel(loop, 1.0) <= 0.015
    assert "following-error" in {fault.code for fault in loop.core.faults.active}


@pytest.mark.parametrize(("seed", "seconds"), [(7, 8.0), *nightly((7, 20.0), (8, 20.0))])
def test_servos_with_a_degree_of_play_and_friction_raise_no_alarm(seed, seconds):
    loop = started("feetech", seed=seed, after_s=0.0)
    for _ in loop.run(seconds):
        assert not {fault.code for fault in loop.core.faults.active if fault.severity in ("hold", "stop")}
    errors = loop.core.arm.guards.following.errors
    assert all(map(math.isfinite, errors))


@pytest.mark.parametrize(("rig", "after_s"), FAULTY)
def test_a_frozen_encoder_is_reported_and_the_arm_stops(rig, after_s):
    loop = started(rig, after_s=after_s)
    codes, after, _ = provoked(loop, "freeze")
    assert codes == {"following-error"}
    assert after <= 0.5
    travel(loop, 0.5)
    assert travel(loop, 1.0) <= 1e-4


@pytest.mark.parametrize("rig", RIGS)
@pytest.mark.parametrize("strength_m", [0.02, 0.5])
def test_an_impossible_pose_is_reported(rig, strength_m):
    loop = started(rig)
    codes, after, text = provoked(loop, "jump", strength_m)
    assert "pose-implausible" in codes
    assert after <= 0.3
    assert "the arm reports" in text


def test_saturated_pads_hold_the_motion():
    loop = started()
    codes, after, text = provoked(loop, "saturate", 40.0)
    assert "force-limit" in codes
    assert after <= 0.5
    assert "at least" in text


def test_after_a_block_a_start_begins_at_the_arms_pose():
    loop = started()
    provoked(loop, "block", seconds=1.0)
    while loop.world.fault_injector.names():
        loop.tick()
    for _ in range(50):
        loop.tick()
    for command in ("reset", "arm", "start"):
        loop.ask(command)
    before, largest = loop.core.arm.actual.angles, 0.0
    for _ in range(100):
        loop.tick()
        now = loop.core.setpoints.commanded.angles
        largest = max(largest, *(abs(a - b) for a, b in zip(now, before, strict=True)))
        before = now
    assert largest <= math.radians(120.0) * 0.032 + math.radians(0.2)
    assert not {fault.code for fault in loop.core.faults.active if fault.severity == "stop"}


@pytest.mark.parametrize("yaw_deg", [90.0, 180.0])
def test_an_arm_whose_base_is_rotated_in_the_configuration_is_not_armed(yaw_deg):
    wrong = ADEPT.model_copy(update={"arm": ADEPT.arm.model_copy(update={"base_yaw_deg": yaw_deg})})
    loop = TwoPalmsLoop(ADEPT, PLAN, 7, estimator=TrivialObserver())
    loop.core = TwoPalmsLoop(wrong, PLAN, 7, estimator=TrivialObserver()).core
    for _ in range(100):
        loop.tick()
    assert "pose-contradicts-rig" in {fault.code for fault in loop.core.faults.active}
    with pytest.raises(ClosedLoopError, match=r"mm.*base_yaw_deg: -?0.*palmd doctor.*palmd calibrate arm"):
        loop.ask("arm")
