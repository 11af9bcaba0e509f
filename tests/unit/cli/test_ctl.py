"""`palmd ctl` against the daemon's own command socket: requests, replies, and a missing reply."""

import json
import math
import socket
import time
from contextlib import contextmanager

import pytest
from bus_daemon import bus_daemon

from palmd.bus.command_client import CommandClient
from palmd.bus.jogging import JOG_EVERY_S, jog_steps
from palmd.bus.link import COMMAND, PUBLISH
from palmd.cli import main
from palmd.cli.ctl import as_text
from palmd.config.any_config import BusConfig
from palmd.console.errors import CliError
from palmd.daemon.commands import JOG_STEP_MAX_DEG, Reply, Request
from palmd.daemon.jog import DEAD_MAN_S, RATE
from palmd.messages import LogEntry, log_fields

STATUS = {
    "state": "hold", "cause": "pad 1 was let go",
    "faults": ["pad1-lifted"], "severities": ["hold"], "hints": ["put the object back"],
    "plan": "rock", "segment": 2, "doing": "sine", "progress": 0.25, "moving": False,
    "arm_state": "T", "arm_error": "", "arm_linked": True,
}  # fmt: skip


@contextmanager
def daemon(folder, answer):
    """A daemon's bus at the given address that replies with `answer(request)`; collects the requests."""
    requests = []

    def answered(request):
        requests.append(request)
        return answer(request)

    with bus_daemon(folder, answered) as (_, address):
        yield address, requests


def granted(request):
    return Reply(request, None, STATUS if request.name == "status" else {"state": "tracking"})


def refusing(request):
    return Reply(request, f"{request.name} refused: the state is idle")


def test_default_addresses_are_those_of_the_configuration():
    assert BusConfig(publish=PUBLISH, command=COMMAND) == BusConfig()


@pytest.mark.parametrize("name", ["arm", "start", "hold", "stop", "reset"])
def test_commands(tmp_path, capsys, name):
    with daemon(tmp_path, granted) as (address, requests):
        assert main(["ctl", name, "--address", address]) == 0
    assert [(request.name, request.args) for request in requests] == [(name, {})]
    assert capsys.readouterr().out == "state tracking\n"


def test_status_is_formatted_for_reading(tmp_path, capsys):
    with daemon(tmp_path, granted) as (address, _):
        assert main(["ctl", "status", "--address", address]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "state   hold: pad 1 was let go",
        "plan    rock, segment 2 (sine), 25%",
        "arm     state T",
        "fault   pad1-lifted (hold): put the object back",
    ]


def test_status_shows_angles_and_estimate():
    seen = {"valid": True, "observer": "shape", "object": 2, "touched": 0.34, "nis": 0.98, "observability": None}
    seen |= {"r1_m": 0.02103, "mu": None, "sd": {"r1_m": 1.2e-5}}
    lines = as_text("status", STATUS | {"phi1_rad": 0.5, "phi2_rad": 1.5, "estimate": seen}).splitlines()
    assert lines[2:5] == [
        "angles  phi1 28.6°, phi2 85.9°",
        "object  valid, shape, object 2, touched 34 %, nis 0.98, obs –",
        "        r1    21.03 ±0.01 mm    r2        – ±– mm       w0        – ±– °/s",
    ]


def test_status_without_a_rig():
    nothing = {"plan": "", "segment": -1, "arm_state": "", "arm_error": "−600 link lost", "arm_linked": False}
    assert as_text("status", STATUS | nothing | {"state": "idle", "cause": ""}).splitlines()[:4] == [
        "state   idle",
        "plan    none",
        "arm     state unknown, does not answer",
        "        −600 link lost",
    ]


def test_status_of_a_pivoting_gripper_is_shown_with_and_without_its_arm():
    known = {"valid": False, "observer": "pivot", "object": 1, "touched": 0.25, "nis": 1.0, "reason": "why not",
             "z_m": 0.018, "s1_m": None, "e_m": None, "psi_rad": None, "omega0_rad_s": None, "f1_n": None, "mu": None,
             "sd": {"z_m": 2e-5}}  # fmt: skip
    silent = as_text("status", STATUS | {"estimate": known})
    assert "\nobject  not valid: why not; 25% of the normals touched\n        z 18.00 ± 0.02 mm\n" in silent
    assert "pivot   " not in silent
    assert "\npivot   x 20.0 mm, z 18.0 mm\nobject" in as_text(
        "status", STATUS | {"estimate": known, "x_m": 0.02, "z_m": 0.018}
    )


def test_a_plan_file_is_sent_along_and_any_other_text_is_a_name_on_the_daemons_side(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with daemon(tmp_path, granted) as (address, requests):
        assert main(["ctl", "plan", "rock.yaml", "--address", address]) == 0
        (tmp_path / "rock.yaml").write_text("name: rock  # µ\n")
        assert main(["ctl", "plan", "rock.yaml", "--address", address]) == 0
    path = "rock.yaml"
    assert [request.args for request in requests] == [{"path": path}, {"path": path, "text": "name: rock  # µ\n"}]


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (b"name: \xff\n", ":1:7: not UTF-8 text"),
        (b"", ":1:1: the file is empty"),
        (b"#" * 40_000, ": larger than 32 kB"),
        (b"#" * 300_000, ":1:1: larger than 256 kB"),
        (None, ":1:1: this is a folder"),
    ],
)
def test_a_plan_that_cannot_be_sent_is_a_local_error(tmp_path, content, complaint, capsys):
    path = tmp_path / "odd.yaml"
    path.mkdir() if content is None else path.write_bytes(content)
    with daemon(tmp_path, granted) as (address, requests):
        assert main(["ctl", "plan", str(path), "--address", address]) == 1
    assert requests == []
    assert f"{path}{complaint}" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("more", "expected"),
    [
        (
            {"explored": {"coverage": 0.83, "reachable": 0.91, "reason": "the time is over, untouched: 40–60°"}},
            "explored 83% of the 91% of the outline that can be reached: the time is over, untouched: 40–60°",
        ),
        (
            {"explored": {"coverage": None, "reachable": None, "reason": "it has just begun"}},
            "explored nothing yet: it has just begun",
        ),
        (
            {"recorder": {"bytes": 4_800_000, "messages": 9392, "lost": 0, "path": "runs/a.mcap", "age_s": 0.4}},
            "record  runs/a.mcap, 9392 messages, 4.8 MB, 0 s ago",
        ),
        (
            {"recorder": {"bytes": 0, "messages": 0, "lost": 7, "age_s": 0.4, "problem": "/runs: the disk is full"}},
            "record  no file, 0 messages, 0.0 MB, 7 lost: /runs: the disk is full",
        ),
        (
            {"t_s": 100.0, "log": log_fields([LogEntry(3, 98.0, "command", "hold", "", "ann", math.nan, "done")])},
            "log       2.0 s   ago  hold, by ann: done",
        ),
    ],
)
def test_status_shows_exploration_recorder_and_log(more, expected):
    assert expected in [line.strip() for line in as_text("status", STATUS | more).splitlines()]


def test_an_invalid_estimate_is_shown_without_numbers():
    estimate = {"observer": "shape", "object": 2, "valid": False, "r1_m": 0.02103, "sd": {"r1_m": 1e-5}}
    lines = as_text("status", STATUS | {"estimate": estimate})
    assert "not valid" in lines
    assert "±0" not in lines
    assert "21.03" not in lines


def test_options_may_precede_or_follow_the_command(monkeypatch):
    asked = []
    monkeypatch.setattr("palmd.cli.ctl.CommandClient", lambda address, **_: asked.append(address) or Asked())

    class Asked:
        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

        def ask(self, command, args=None):
            asked.append((command, args))
            return {"ok": True}

    assert main(["ctl", "--address", "tcp://a:1", "note", "hello", "there"]) == 0
    assert main(["ctl", "--address", "tcp://a:1", "hold", "--address", "tcp://b:2"]) == 0
    assert asked == ["tcp://a:1", ("note", {"text": "hello there"}), "tcp://b:2", ("hold", {})]


def test_reset_reports_which_faults_it_has_cleared():
    cleared = {"state": "ready", "cleared": ["arm-lost", "arm-fault"]}
    assert as_text("reset", cleared) == "state ready, cleared: arm-lost, arm-fault"
    assert as_text("reset", {"state": "ready", "cleared": []}) == "state ready, there was nothing to reset"


def test_only_commands_meant_for_people_are_offered(capsys):
    with pytest.raises(SystemExit):
        main(["ctl", "recorder"])
    assert "there is no 'recorder'; choose from status, arm, " in capsys.readouterr().err


def test_a_refusal_is_printed_and_the_exit_status_is_1(tmp_path, capsys):
    with daemon(tmp_path, refusing) as (address, _):
        assert main(["ctl", "arm", "--address", address]) == 1
        assert capsys.readouterr().err == "arm refused: the state is idle\n"
        assert main(["ctl", "arm", "--address", address, "--json"]) == 1
    assert json.loads(capsys.readouterr().out) == {"id": 1, "ok": False, "error": "arm refused: the state is idle"}


def test_json_output_is_the_unchanged_reply(tmp_path, capsys):
    with daemon(tmp_path, granted) as (address, _):
        assert main(["ctl", "status", "--json", "--address", address]) == 0
    assert json.loads(capsys.readouterr().out) == {"id": 1, "ok": True, "result": STATUS}


def test_a_jog_sends_steps_declares_the_whole_angle_with_the_first_and_arrives(tmp_path):
    with daemon(tmp_path, granted) as (address, requests):
        assert main(["ctl", "jog", "--phi1-deg", "0.6", "--phi2-deg", "-1", "--address", address]) == 0
    for palm, whole in (("phi1_deg", 0.6), ("phi2_deg", -1.0)):
        assert sum(request.args[palm] for request in requests) == pytest.approx(whole)
    first, *others = (request.args for request in requests)
    assert (first["whole_phi1_deg"], first["whole_phi2_deg"]) == (0.6, -1.0)
    assert all(args.keys() == {"phi1_deg", "phi2_deg"} for args in others)


def test_a_jog_ends_when_it_is_refused(tmp_path, capsys):
    with daemon(tmp_path, refusing) as (address, requests):
        assert main(["ctl", "jog", "--phi1-deg", "5", "--address", address]) == 1
    assert len(requests) == 1
    assert capsys.readouterr().err == "jog refused: the state is idle\n"


@pytest.mark.parametrize("angles", [(0.0, 0.0), (0.1, -0.1), (7.3, 0.2), (-90.0, 45.0)])
def test_jog_steps_add_up_within_the_daemons_bounds(angles):
    steps = list(jog_steps(*angles))
    for palm in (0, 1):
        assert sum(step[palm] for step in steps) == pytest.approx(angles[palm])
        assert max(abs(step[palm]) for step in steps) <= JOG_STEP_MAX_DEG
        assert max(abs(step[palm]) for step in steps) / JOG_EVERY_S < RATE * 57.3
    assert JOG_EVERY_S < DEAD_MAN_S / 2
    assert steps[-1] == (0.0, 0.0)


def test_a_reply_to_another_request_is_ignored(tmp_path):
    def confused(request):
        meant = request.id - 1 if request.id == 1 else request.id
        return Reply(Request(request.name, id=meant, route=request.route), None, {"state": "ready"})

    with daemon(tmp_path, confused) as (address, _), CommandClient(address, 0.2) as client:
        with pytest.raises(CliError, match="no answer"):
            client.ask("status")
        assert client.ask("status")["result"] == {"state": "ready"}


def test_a_reply_from_another_program_is_not_accepted(capsys, monkeypatch):
    monkeypatch.setattr("palmd.cli.ctl.CommandClient", lambda address, key, **_: CommandClient(address, 0.2, key))
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        begun = time.monotonic()
        assert main(["ctl", "status", "--address", address]) == 3
    assert time.monotonic() - begun < 2.0
    assert "no answer" in capsys.readouterr().err
