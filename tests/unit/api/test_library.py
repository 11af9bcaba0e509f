"""`import palmd`: recorded runs and event logs as arrays, the observers, a running daemon."""

import json
import subprocess
import sys
import threading
import types

import numpy as np
import pytest
import recorded

import palmd
from palmd.api.table import table_of
from palmd.bus.command_client import own_client
from palmd.cli import main
from palmd.daemon.bus import Bus
from palmd.daemon.commands import Reply
from palmd.messages import PadView, contact_fields
from palmd.model.icosphere import icosphere
from palmd.observer.three_palms.reconstruct import BodyReconstruction
from palmd.polygon import boundary
from palmd.quantities import CONTACT, ESTIMATE, SHAPE
from palmd.record.systems import three_palms
from palmd.rig.simulate import simulate_log
from palmd.system.reasons import NO_REASON
from palmd.system.three_palms import ThreePalmsRig
from tools.studies.space_logs import header

SECONDS = 4.0


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    """An event log and its truth."""
    lines, truth = simulate_log("nominal", 3, SECONDS)
    path = tmp_path_factory.mktemp("library") / "log.jsonl"
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return path, truth


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A recorded run with contacts and outlines in addition to `recorded`."""
    file, _ = recorded.begun(tmp_path_factory.mktemp("runs"))
    for i in range(3):
        contact = contact_fields((PadView(s=0.01 * i), PadView(touch=True)), 0.02)
        file.write(recorded.message(CONTACT.name, contact, i, 0.01 * i))
        shape = {"theta_rad": np.radians(np.arange(0, 360, 2)).tolist(), "h_sd_m": [1e-4] * 180, "touched": [0, 1] * 90}
        file.write(recorded.message(SHAPE.name, shape | {"h_m": [0.01 * (i + 1)] * 180}, i, 0.01 * i))
    file.finish()
    return file.path


# --------------------------------------------------------------------------------------------------- the package


def test_importing_palmd_loads_no_other_library():
    program = "import sys, palmd; print(sorted(m for m in sys.modules if m.startswith(('palmd', 'numpy', 'zmq'))))"
    output = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert output.strip() == "['palmd']"


def test_every_exported_name_has_a_docstring():
    assert palmd.__all__ == sorted(palmd.__all__)
    for name in palmd.__all__:
        assert getattr(palmd, name).__doc__, name
        assert name in dir(palmd)
    with pytest.raises(AttributeError, match="has no attribute 'opne'"):
        palmd.opne  # noqa: B018


# ---------------------------------------------------------------------------------------------------- event logs


def test_an_event_log_gives_its_events_as_arrays(simulated):
    path, _ = simulated
    lines = [json.loads(line) for line in path.read_text().splitlines()[1:]]
    events = palmd.open(path).events
    for table, of in ((events.pads, "pad"), (events.palms, "palms")):
        rows = [line for line in lines if of in line]
        np.testing.assert_array_equal(table["t_s"], [row["t"] for row in rows])
    np.testing.assert_array_equal(events.pads["s_m"], [line["s_m"] for line in lines if "pad" in line])
    np.testing.assert_array_equal(events.palms["phi2_rad"], [line["palms"]["phi2_rad"] for line in rows])


def test_an_event_log_names_the_function_that_makes_its_estimates(simulated):
    for name in ("estimates", "contacts", "outlines", "outline"):
        with pytest.raises(palmd.PalmdError, match=r"log\.jsonl: is an event log .* palmd\.estimate"):
            getattr(palmd.open(simulated[0]), name)


@pytest.mark.parametrize("text", ["", "{}", '{"palmd_log":1}'])
def test_opening_a_file_that_is_no_log_is_an_error(tmp_path, text):
    (tmp_path / "x.jsonl").write_text(text)
    with pytest.raises(palmd.PalmdError, match=r"x\.jsonl:1: "):
        palmd.open(tmp_path / "x.jsonl")
    with pytest.raises(palmd.PalmdError, match="no such file"):
        palmd.open(str(tmp_path / "none.mcap"))


def test_estimate_agrees_with_the_command(simulated, tmp_path):
    path, _ = simulated
    estimated = palmd.estimate(str(path))
    assert main(["estimate", str(path), "-o", str(tmp_path / "out.jsonl")]) == 0
    lines = [json.loads(line) for line in (tmp_path / "out.jsonl").read_text().splitlines()]
    ticks = [line for line in lines if "shape" not in line]
    assert estimated.estimates.rows == len(ticks)
    assert estimated.estimates["valid"].dtype == bool
    np.testing.assert_allclose(estimated.estimates["t_s"], [line["t"] for line in ticks], atol=1e-9)
    valid = np.flatnonzero(estimated.estimates["valid"])
    assert len(valid)
    for i in valid[[0, -1]]:
        assert estimated.estimates["psi_rad"][i] == ticks[i]["psi_rad"]
        assert estimated.estimates["sd.psi_rad"][i] == ticks[i]["sd"]["psi_rad"]
    assert [outline.h_m.tolist() for outline in estimated.outlines] == [
        line["shape"]["h_m"] for line in lines if "shape" in line
    ]


def test_reconstruct_finds_the_outline_and_the_motion(simulated):
    path, truth = simulated
    reconstructed = palmd.reconstruct(palmd.open(path))
    assert reconstructed.converged, reconstructed.reason
    assert reconstructed.outline_xy().shape == (361, 2)
    psi = np.interp(reconstructed.trajectory["t_s"], truth["t"], np.unwrap(truth["psi_rad"]))
    turn = float(np.mean(psi - np.unwrap(reconstructed.trajectory["psi_rad"])))
    there = boundary(np.array(truth["h_m"]))
    distances = np.linalg.norm(reconstructed.outline.xy(-turn)[:, None] - there[None], axis=2).min(axis=1)
    assert np.median(distances[:360][reconstructed.outline.touched]) < 5e-4
    assert abs(reconstructed.rho_m - truth["rho_m"]) < 4 * reconstructed.rho_sd_m


def test_a_three_dimensional_body_has_a_surface_and_no_outline(tmp_path, monkeypatch):
    directions, triangles = icosphere(1)
    n = len(directions)
    one, none = np.eye(3)[None], np.zeros((1, 3))
    ball = BodyReconstruction(
        True, NO_REASON, 1.0, directions, triangles, np.full(n, 0.02), np.full(n, 1e-5), directions[:, 2] > 0.0,
        0.02 * directions, np.zeros(4), np.eye(3), np.eye(3), 0.1, 1e-3, 0.05, 1e-4,
        np.zeros(1), one, none, none, np.zeros((1, 3, 3)), 0.1,
    )  # fmt: skip
    monkeypatch.setattr(three_palms, "reconstruct", lambda *_: ball)
    lines = [header(ThreePalmsRig())]
    lines += [{"t": 0.01 * k, "joints": {"angle_rad": [0.9, 0.8, 0.8]}} for k in range(10)]
    (tmp_path / "ball.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    reconstructed = palmd.reconstruct(tmp_path / "ball.jsonl")
    assert reconstructed.converged
    assert reconstructed.outline is None
    np.testing.assert_array_equal(reconstructed.surface.points, 0.02 * directions)
    assert reconstructed.trajectory["quat_xyzw"].shape == (1, 4)
    with pytest.raises(palmd.PalmdError, match="no outline: the results of the system three_palms"):
        reconstructed.outline_xy()


def test_a_failed_reconstruction_gives_its_reason(tmp_path, simulated):
    head, *lines = simulated[0].read_text().splitlines()
    (tmp_path / "short.jsonl").write_text("\n".join([head, *lines[:50]]) + "\n")
    reconstructed = palmd.reconstruct(tmp_path / "short.jsonl")
    assert not reconstructed.converged
    assert reconstructed.trajectory.rows == 0
    with pytest.raises(palmd.PalmdError, match="no outline: no second"):
        reconstructed.outline_xy()


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"observer": "kalman"}, "no observer 'kalman'; the observers are shape, extended, quasistatic"),
        ({"observer": "extended", "shape": "x"}, "extended cannot use one"),
        ({"shape": "/nowhere.json"}, "/nowhere.json"),
    ],
)
def test_estimate_rejects_wrong_arguments(simulated, arguments, match):
    with pytest.raises(palmd.PalmdError, match=match):
        palmd.estimate(simulated[0], **arguments)


# -------------------------------------------------------------------------------------------------- recorded runs


def test_a_recorded_run_gives_topics_as_tables(recording):
    run = palmd.open(recording)
    assert run.topics[CONTACT.name] == 3
    assert run.contacts.rows == 3
    np.testing.assert_array_equal(run.contacts["s1_m"], [0.0, 0.01, 0.02])
    assert np.isnan(run.contacts["s2_m"]).all()
    assert run.contacts["touch2"].tolist() == [True] * 3
    np.testing.assert_allclose(run.contacts["t_s"], [0.0, 0.01, 0.02])
    assert run.table("rig/truth")["psi_rad"].shape == (5,)
    assert [pad.length for pad in run.rig.pads] == [0.0555, 0.0555]
    with pytest.raises(palmd.PalmdError, match=f"holds no {ESTIMATE.name}; its topics are .*{CONTACT.name}"):
        run.estimates  # noqa: B018


def test_a_recorded_run_gives_its_events_and_lift_offs(recording):
    events = palmd.open(recording).events
    fed = [event for number in range(5) for event in recorded.events(number)]
    assert events.pads.rows + events.palms.rows == len(fed)
    lifted = np.isnan(events.pads["s_m"])
    assert lifted.sum() == 4
    assert (events.pads["pad"][lifted] == 2).all()
    assert np.isnan(events.palms["alpha1_rad_s2"]).sum() == 4


def test_an_outline_is_placed_by_rotation_and_centre_of_mass(recording):
    run = palmd.open(recording)
    assert len(run.outlines) == 3
    np.testing.assert_allclose(np.linalg.norm(run.outline_xy(), axis=1), 0.03)
    np.testing.assert_allclose(run.outline_xy()[0], [0.03, 0.0], atol=1e-12)
    np.testing.assert_allclose(run.outline.xy(np.pi / 2, (1.0, 2.0))[0], [1.0, 2.03])
    np.testing.assert_array_equal(run.outline_xy()[0], run.outline_xy()[-1])


# --------------------------------------------------------------------------------------------------------- tables


def test_a_missing_field_becomes_a_missing_value():
    table = table_of([{"a": 1, "ok": True, "list": [1, 2]}, {"b": "x", "list": [3, 4]}])
    np.testing.assert_array_equal(table["a"], [1.0, np.nan])
    assert table["ok"].tolist() == [True, False]
    assert table["b"].tolist() == ["", "x"]
    assert table["list"].shape == (2, 2)
    with pytest.raises(KeyError, match="no column 'c'; the columns are a, ok, list, b"):
        table["c"]


def test_texts_and_lists_of_unequal_length_stay_lists():
    table = table_of([{"faults": [], "x": [1]}, {"faults": ["pad1-silent"], "x": [1, 2]}])
    assert table["faults"].tolist() == [[], ["pad1-silent"]]
    assert table["x"].tolist() == [[1], [1, 2]]


def test_pandas_gets_the_columns(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", types.SimpleNamespace(DataFrame=dict))
    frame = table_of([{"a": 1.0, "v": [1, 2]}, {"a": 2.0, "v": [3, 4]}]).to_pandas()
    assert frame["a"].tolist() == [1.0, 2.0]
    assert [each.tolist() for each in frame["v"]] == [[1, 2], [3, 4]]


def test_without_pandas_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(palmd.PalmdError, match=r"-m pip install .*pandas"):
        table_of([{"a": 1.0}]).to_pandas()


# ------------------------------------------------------------------------------------------------ a running daemon


@pytest.fixture
def daemon():
    """A daemon's bus that publishes an estimate repeatedly and grants every command except `arm`.

    The answer to `hold` is the client's identity.
    """
    bus, over = Bus("tcp://127.0.0.1:*", "tcp://127.0.0.1:*"), threading.Event()

    def work():
        number = 0
        while not over.wait(0.005):
            number += 1
            bus.publish(ESTIMATE, {"r1_m": float(number)}, 0.0, 0.0)
            for request in bus.receive():
                refused = "not ready" if request.name == "arm" else None
                sender = {"client": request.client, "lease_s": request.lease_s}
                bus.reply(Reply(request, refused, sender if request.name == "hold" else {"state": "ready"}))

    thread = threading.Thread(target=work)
    thread.start()
    yield {name: each.last_endpoint.decode() for name, each in zip(("publish", "command"), bus._sockets, strict=True)}
    over.set()
    thread.join()
    bus.close()


def test_a_client_iterates_estimates_and_gives_commands(daemon):
    with palmd.connect(**daemon) as live:
        numbers = [fields["r1_m"] for fields, _ in zip(live, range(20), strict=False)]
        assert numbers == [numbers[0] + i for i in range(20)]
        assert live.status() == {"state": "ready"}
        with pytest.raises(palmd.PalmdError, match="arm: not ready"):
            live.command("arm")


def test_a_client_sends_its_name_and_its_lease(daemon):
    with palmd.connect(**daemon, client="bench", lease_s=7.0) as live:
        assert live.command("hold") == {"client": "bench", "lease_s": 7.0}
    with palmd.connect(**daemon) as live:
        assert live.command("hold") == {"client": own_client(), "lease_s": None}


def test_a_client_listens_for_the_requested_seconds(daemon):
    with palmd.connect(**daemon) as live:
        assert [message.topic for message in live.messages("palm/est", seconds=0.5)]
        assert not list(live.messages("palm/state", seconds=0.0))


def test_a_daemon_that_does_not_answer_is_an_error(monkeypatch):
    monkeypatch.setattr("palmd.api.live.SILENT_S", 0.1)
    with palmd.connect("tcp://127.0.0.1:9", "tcp://127.0.0.1:9") as live:
        with pytest.raises(palmd.PalmdError, match=r"no message from tcp://127\.0\.0\.1:9: is a palmd running there"):
            next(live.estimates())
        with pytest.raises(palmd.PalmdError, match=r"no answer from tcp://127\.0\.0\.1:9"):
            live.status()


def test_a_wrong_address_or_key_is_refused(tmp_path):
    with pytest.raises(palmd.PalmdError, match="nowhere: not an address"):
        palmd.connect(command="nowhere")
    with pytest.raises(palmd.PalmdError, match="none"):
        palmd.connect(key=tmp_path / "none")
