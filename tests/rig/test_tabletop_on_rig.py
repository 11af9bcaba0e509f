"""Pads of every kind and servos as processes on pseudo-terminals: doctor, the daemon, a moving palm."""

import pytest
from harness import Client, LoneRig, Process, palmd, wait

pytestmark = pytest.mark.rig

ARRAY = {"kind": "taxels", "columns": 4, "zero_mm": 1.0}
PADS = {
    "strip": {"kind": "strip"},
    "evdev": {"kind": "evdev", "zero_mm": 0.0, "counts_per_mm": 20.0},
    "tsf85": ARRAY | {"protocol": "tsf85", "rows": 14, "pitch_mm": 4.5},
    "st0001": ARRAY | {"protocol": "st0001", "rows": 15, "pitch_mm": 4.0},
    "text": ARRAY | {"protocol": "text", "rows": 20, "pitch_mm": 3.0, "baud": 1000000},
}
MODELS = {"dynamixel": "XL430-W250, firmware 46", "feetech": "STS3215, firmware 3"}
RIGS = [("strip", "dynamixel"), ("evdev", "dynamixel"), ("st0001", "feetech")]
MORE = [("tsf85", "dynamixel"), ("text", "feetech")]  # decoders of these protocols are tested without processes


@pytest.fixture(
    scope="module", params=[*RIGS, *(pytest.param(rig, marks=pytest.mark.nightly) for rig in MORE)], ids="-".join
)
def rig(tmp_path_factory, request):
    """The emulated rig with pads of a kind."""
    pads, servos = request.param
    settings = {"rig": {"hinge": "fixed"}, "pads": PADS[pads], "arm": {"kind": servos}}
    rig = LoneRig(tmp_path_factory.mktemp("rig"), settings, "--seed", 3)
    rig.servos = servos
    yield rig
    rig.stop()


def test_doctor_finds_pads_and_servos(rig):
    done = palmd("doctor", rig.config)
    assert "Traceback" not in done.stderr
    assert "ok           pad 1 port" in done.stdout
    assert "reports in" in done.stdout, "the object lies on both pads"
    assert MODELS[rig.servos] in done.stdout
    assert "one servo has id 2" in done.stdout


def test_the_daemon_arms_jogs_and_stops(rig, tmp_path):
    daemon = Process(["run", rig.config, "--no-record"], tmp_path)
    try:
        with Client(rig.bus["command"]) as client:

            def until(state, arm_state):
                def look():
                    reply = client.ask("status")
                    status = reply["result"] if reply["ok"] else {}
                    return (status.get("state"), status.get("arm_state")) == (state, arm_state) and status

                return wait(look, f"state {state}, arm {arm_state}")

            until("ready", "R")
            client.do("arm")
            until("tracking", "T")
            client.do("jog", phi1_deg=0.5)
            client.do("stop")
            assert until("ready", "R")["arm_error"] == ""
    finally:
        daemon.stop()
