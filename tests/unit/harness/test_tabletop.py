"""The rig of strips (or input devices) and servos in closed loop without ports: it follows, and faults are reported.

The campaign: each failure and its expected fault, as in docs/reference/faults.md. After a fault that stops the palms
they come to rest within a limited time.
"""

import copy
import math
from functools import cache
from pathlib import Path

import pytest

from palmd.config.two_palms import Config, PlanSpec
from palmd.daemon.lifecycle import State
from palmd.events import PadSample
from palmd.rig.fault_injection import order
from palmd.rig.imperfections import perfect
from palmd.yamlfile import load_config
from tools.closed_loop import TwoPalmsLoop

TABLETOP = Path(__file__).parents[3] / "config/tabletop.yaml"
ROCK = PlanSpec.model_validate(
    {
        "name": "rock",
        "repeat": "forever",
        "segments": [
            {"move": {"phi1_deg": 45, "phi2_deg": 90}, "duration_s": 0.5},
            {"sine": {"phi1_deg": 15, "phi2_deg": 8}, "frequency_hz": [0.9, 0.7], "duration_s": 60},
        ],
    }
)
BEGIN_S = 2.0
STAND_S = 0.200
STANDING_RAD_S = math.radians(1.0)


def config(pads="strip", pressure=True) -> Config:
    made = perfect(load_config(TABLETOP))
    if pads == "strip":
        return made
    each = {"kind": "evdev", "zero_mm": 0.0, "counts_per_mm": 20.0, "noise_mm": 0.1, "pressure": pressure}
    values = made.model_dump(mode="json") | {"pads": {f"palm{i}": each | {"port": f"p{i}"} for i in (1, 2)}}
    return Config.model_validate(values | {"plan": None})


@cache
def begun(pads, **how):
    run = TwoPalmsLoop(config(pads, **how), ROCK, seed=2, observer_name="quasistatic")
    run.start()
    for _ in run.run(BEGIN_S):
        pass
    assert run.core.state is State.TRACKING
    return run


def moving(pads="strip", **how):
    """A rig of its own, started as all others of its kind."""
    return copy.deepcopy(begun(pads, **how))


def test_a_copy_of_a_rig_continues_bit_identically():
    def bits(run):
        return repr([(instant.messages, instant.truth) for instant in run.run(0.3)])

    one, other, third = (moving() for _ in range(3))
    third.world.fault_injector.add(order("lift", third.t))
    assert bits(third) != bits(one) == bits(other)


@pytest.mark.parametrize("pads", ["strip", "evdev"])
def test_palms_follow_and_readings_are_true(pads):
    run = moving(pads)
    apart, off = [], []
    for instant in run.run(2.0):
        actual, truth = run.core.arm.actual, instant.truth
        apart.append(max(abs(actual.angles[i] - truth[f"phi{i + 1}_rad"]) for i in range(2)))
        contact = instant.messages["palm/contact"]
        off += [abs(contact[f"s{i}_m"] - truth[f"s{i}_m"]) for i in (1, 2) if contact[f"touch{i}"]]
    assert max(apart) < math.radians(1.5), "play, a count, and the motion in ten milliseconds"
    assert sorted(off)[len(off) // 2] < 4e-4
    assert len(off) > 350
    assert not [fault.code for fault in run.core.faults.active if str(fault.severity) in ("stop", "hold")]
    assert run.world.status()["setpoints_outside_limits"] == 0


def test_without_pressure_no_reading_has_a_force():
    run = moving("evdev", pressure=False)
    events = [event for _ in run.run(0.5) for event in run.core._fed_events]
    samples = [event for event in events if isinstance(event, PadSample)]
    assert len(samples) > 50
    assert all(sample.force is None for sample in samples)


CAMPAIGN = [
    ("strip", "mute", "pad1", None, {"pad1-silent"}, State.HOLD),
    ("strip", "mute", "pad2", None, {"pad2-silent"}, State.HOLD),
    ("strip", "garble", "pad1", 0.1, {"pad1-garbled"}, None),
    ("strip", "burst", "pad1", 0.040, {"pad1-batched"}, None),
    ("strip", "lift", None, None, {"pad1-lifted", "pad2-lifted"}, State.HOLD),
    ("strip", "misbaud", "pad2", None, {"pad2-silent"}, State.HOLD),
    ("evdev", "lift", None, None, {"pad1-lifted", "pad2-lifted"}, State.HOLD),
    ("evdev", "mute", "pad1", None, {"pad1-silent"}, State.HOLD),
    ("evdev", "overflow", "pad2", None, set(), State.TRACKING),
    ("strip", "mute", "arm", None, {"arm-link-lost"}, State.FAULT),
    ("strip", "misbaud", "arm", None, {"arm-link-lost"}, State.FAULT),
    ("strip", "garble", "arm", 0.002, {"arm-garbled"}, None),
    ("strip", "power_off", "arm", None, {"arm-link-lost"}, State.FAULT),
    ("strip", "overload", "arm", None, {"arm-fault", "arm-servo-overload"}, State.FAULT),
    ("strip", "overheat", "arm", None, {"arm-fault", "arm-servo-hot"}, State.FAULT),
    ("strip", "undervoltage", "arm", None, {"arm-fault", "arm-servo-voltage"}, State.FAULT),
    ("strip", "brownout", "arm", None, {"arm-link-lost"}, State.FAULT),
]


@pytest.mark.parametrize(
    ("pads", "name", "port", "strength", "codes", "state"),
    CAMPAIGN,
    ids=["-".join(filter(None, row[:3])) for row in CAMPAIGN],
)
def test_each_failure_has_its_documented_fault(pads, name, port, strength, codes, state):
    run = moving(pads)
    run.world.fault_injector.add(order(name, run.t, port, strength))
    t_cause, seen, t_stood = run.t, set(), None
    stops = state in (State.HOLD, State.FAULT)
    while run.t < t_cause + 2.0 and not (codes <= seen and (t_stood is not None if stops else codes)):
        instant = run.tick()
        seen |= {fault.code for fault in run.core.faults.active}
        speed = max(abs(instant.truth[f"omega{i}_rad_s"]) for i in (1, 2))
        if run.core.state in (State.HOLD, State.FAULT) and speed < STANDING_RAD_S:
            t_stood = run.t - t_cause
    assert codes <= seen
    if state is None:
        assert run.core.state in (State.TRACKING, State.HOLD)
    else:
        assert run.core.state is state
    if stops:
        assert t_stood < 0.5


@pytest.mark.parametrize("end", ["pad1", "pad2", "arm"])
@pytest.mark.parametrize("pads", ["strip", "evdev"])
def test_a_port_that_vanishes_is_reported(pads, end):
    run = moving(pads)
    run.core.lost(end, run.t)
    run.tick()
    assert f"{end}-port" in {fault.code for fault in run.core.faults.active}
    assert run.core.state is (State.FAULT if end == "arm" else State.HOLD)


def test_after_a_servo_fault_reset_and_start_resume():
    run = moving()
    run.world.fault_injector.add(order("overload", run.t, "arm"))
    for _ in range(100):
        run.tick()
    assert run.core.state is State.FAULT
    run.ask("reset")
    for _ in range(50):
        run.tick()
    assert run.core.state is State.READY
    run.ask("arm")
    run.ask("start")
    assert run.core.state is State.TRACKING
