"""No client's command changes the configured limits or moves the arm beyond them."""

import copy
import math
import os

import msgpack
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from test_core import Bench

from palmd import keys
from palmd.config.two_palms import LimitsConfig
from palmd.daemon.commands import COMMANDS, CommandError, parse
from palmd.rig.world import default_config

NARROW = LimitsConfig(phi1_deg=(30.0, 60.0), phi2_deg=(80.0, 115.0))
LIMITS = {"phi1_deg": [0, 180], "phi2_deg": [1, 179], "rate_deg_s": 2000.0, "acceleration_deg_s2": 50000.0}
AWAY = {"move": {"phi1_deg": 30, "phi2_deg": 110}, "duration_s": 1.0}
BACK = {"move": {"phi1_deg": 50, "phi2_deg": 90}, "duration_s": 1.0}
HOSTILE_PLANS = {
    "brings limits of its own": {"name": "x", "limits": LIMITS, "segments": [AWAY]},
    "brings limits in a segment": {"name": "x", "segments": [AWAY | {"limits": LIMITS}]},
    "a pose out of the limits": {"name": "x", "segments": [AWAY | {"move": {"phi1_deg": 179, "phi2_deg": 178}}]},
    "a pose that is no number": {"name": "x", "segments": [AWAY | {"move": {"phi1_deg": math.nan, "phi2_deg": 90}}]},
    "a pose at infinity": {"name": "x", "segments": [AWAY | {"move": {"phi1_deg": math.inf, "phi2_deg": 90}}]},
    "a move in no time": {"name": "x", "segments": [AWAY, BACK | {"duration_s": 1e-6}]},
    "a move faster than allowed": {"name": "x", "segments": [AWAY, BACK | {"duration_s": 0.1}]},
    "a rate above the limit": {"name": "x", "segments": [{"rate": {"phi1_deg_s": 1999.0}, "until": {"phi1_deg": 55}}]},
    "a swing out of the limits": {
        "name": "x", "segments": [AWAY, {"sine": {"phi1_deg": 90, "phi2_deg": 90}, "frequency_hz": 5, "duration_s": 2}],
    },
    "a violent dither": {"name": "x", "segments": [AWAY], "dither": {"amplitude_deg": 5, "frequency_hz": 20}},
    "a thousand blows": {"name": "x", "repeat": 1000, "segments": [AWAY, BACK | {"duration_s": 1e-3}]},
}  # fmt: skip

hostile_values = st.sampled_from(
    [
        math.nan,
        math.inf,
        -math.inf,
        1e308,
        0.5,
        -0.5,
        0.500001,
        10**18,
        True,
        None,
        "0.5",
        b"",
        [],
        LIMITS,
        "../palmd.yaml",
    ]
)
commands = st.tuples(
    st.sampled_from([*COMMANDS, *["jog"] * 10, "limits", "set", "config", "__init__"]),
    st.dictionaries(
        st.sampled_from(["phi1_deg", "phi2_deg", "path", "limits", "rate_deg_s", "bytes", "messages", "lost"]),
        hostile_values | st.floats(-0.5, 0.5),
        max_size=4,
    ),
)


def send(bench, command, args):
    """Sends through the real parser, as from the socket; then three ticks."""
    try:
        request = parse(msgpack.packb({"id": 1, "cmd": command, "args": args}))
    except CommandError:
        return
    bench.core.handle(request, bench.t)
    bench.go(0.03)


def armed(plan=None):
    bench = Bench(config=default_config().model_copy(update={"limits": NARROW, "plan": plan})).go(0.5)
    bench.do("arm")
    return bench.go(0.1)


@settings(max_examples=8)
@given(st.lists(commands, max_size=40), st.sampled_from([(0.5, 0.5), (-0.5, -0.5), (0.5, -0.5)]))
def test_no_command_changes_or_exceeds_the_limits(sent, push):
    bench = armed()
    limits, before = bench.core.setpoints.limits, copy.deepcopy(bench.core.setpoints.limits)
    for command, args in sent:
        send(bench, command, args)
    bench.ask("arm")
    for _ in range(60):  # until the limit
        send(bench, "jog", dict(zip(("phi1_deg", "phi2_deg"), push, strict=True)))
    bench.check_the_arm()
    assert bench.core.setpoints.limits is limits
    assert limits == before


@pytest.mark.parametrize("what", HOSTILE_PLANS)
def test_no_plan_changes_or_exceeds_the_limits(what):
    bench = armed()
    limits, before = bench.core.setpoints.limits, copy.deepcopy(bench.core.setpoints.limits)
    refused = bench.ask("plan", path="plan.yaml", text=yaml.safe_dump(HOSTILE_PLANS[what])).error
    assert refused
    assert refused.startswith("plan refused: plan.yaml:")
    bench.do("start")
    bench.go(1.0)
    assert bench.last("palm/motion")["plan"] == "swing"
    bench.check_the_arm()
    assert bench.core.setpoints.limits is limits
    assert limits == before


def test_a_first_move_of_zero_duration_takes_the_time_that_the_limits_need():
    bench = armed()
    bench.do("plan", path="plan.yaml", text=yaml.safe_dump({"name": "x", "segments": [AWAY | {"duration_s": 1e-6}]}))
    bench.do("start")
    bench.go(1.5)
    assert math.degrees(bench.commanded()) == pytest.approx(30.0)
    bench.check_the_arm()


def test_an_endless_plan_file_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "plan.yaml")
    assert "no such file" in armed(plan=tmp_path / "rock.yaml").ask("plan", path="plan.yaml").error


def test_a_plan_command_reveals_no_file(tmp_path):
    """`test_planner.py` tests many more files."""
    secret, _ = keys.make_pair(tmp_path, "server")
    hidden = keys.own_credentials(tmp_path).pair.secret.decode()
    refusal = armed(plan=tmp_path / "rock.yaml").ask("plan", path=str(secret)).error
    assert refusal
    assert not any(hidden[i : i + 8] in refusal for i in range(len(hidden) - 8))
    elsewhere = armed(plan=tmp_path / "plans/rock.yaml").ask("plan", path="/etc/passwd").error
    assert elsewhere.startswith("plan refused: /etc/passwd: no such file beside the configured plan")
