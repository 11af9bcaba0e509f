"""`palmd export`: each format read back by an independent reader and compared with the published messages."""

import csv
import json
import math
import sys
import types
import zipfile

import numpy as np
import pytest
import recorded
import rig_recording
import synthetic_runs
from mcap.reader import make_reader

from palmd.cli import main
from palmd.console.extras import install_line
from palmd.events import PadLift
from palmd.motion.kinematics import RigGeometry
from palmd.record.eventlog import read_log
from palmd.record.run import read_run
from palmd.record.scene import SceneBuilder
from palmd.rig.world import default_config


def exported(target, *arguments, run=None):
    assert main(["export", str(run or rig_recording.path()), "-o", str(target), *arguments]) == 0
    return target


def of(topic):
    return [fields for name, fields in rig_recording.published() if name == topic]


@pytest.fixture
def odd(tmp_path):
    """A run with lifts, missing forces and rates, and a tick without events."""
    file, _ = recorded.begun(tmp_path)
    file.finish()
    return file.path


# ---------------------------------------------------------------------------------------------- event log


def test_an_exported_event_log_reads_back_as_the_events_fed_to_the_observer(tmp_path):
    log = read_log(exported(tmp_path / "run.jsonl"))
    run = read_run(rig_recording.path()).event_log()
    assert log.events == run.events
    assert log.rig == run.rig
    assert log.notes == ()


def test_events_without_a_form_in_event_logs_are_left_out(odd, tmp_path):
    log = read_log(exported(tmp_path / "odd.jsonl", run=odd))
    assert list(log.events) == [
        event for event in read_run(odd).event_log().events if not isinstance(event, PadLift)
    ]  # fmt: skip


def test_the_rigs_truth_is_placed_at_its_time(tmp_path):
    lines = [json.loads(line) for line in exported(tmp_path / "run.jsonl").read_text().splitlines()]
    truths = [line for line in lines if "truth" in line]
    assert [line["truth"] for line in truths] == [
        {name: value for name, value in fields.items() if name not in ("v", "timestamp", "mono_ns", "seq")}
        for fields in of("rig/truth")
    ]
    assert [line["t"] for line in truths] == pytest.approx([fields["mono_ns"] * 1e-9 for fields in of("rig/truth")])
    t_truth = -math.inf  # the time of the last truth
    behind = 0
    for line in lines[1:]:
        if "truth" in line:
            t_truth = line["t"]
        else:
            behind += line["t"] < t_truth
    assert behind == 0  # no event follows a later truth


# ---------------------------------------------------------------------------------------------- CSV


def rows(stream):
    return list(csv.DictReader(stream))


def test_a_table_has_a_row_for_each_message_and_loses_no_bit(tmp_path):
    folder = exported(tmp_path / "tables")
    assert {path.name for path in folder.iterdir()} == {
        f"{name.replace('/', '-')}.csv" for name in {name for name, _ in rig_recording.published()}
    }
    with (folder / "palm-estimate.csv").open(newline="") as stream:
        table = rows(stream)
    estimates = of("palm/estimate")
    assert list(table[0])[:4] == ["v", "timestamp", "mono_ns", "seq"]
    assert len(table) == len(estimates)
    for row, fields in zip(table, estimates, strict=True):
        for name in ("r1_m", "mass_kg", "timestamp", "nis"):
            assert row[name] == "" if math.isnan(fields[name]) else float(row[name]) == fields[name]
        assert row["valid"] == str(int(fields["valid"]))
        assert int(row["mono_ns"]) == fields["mono_ns"]
        sd = fields["sd"].get("r1_m", math.nan)
        assert row["sd.r1_m"] == "" if math.isnan(sd) else float(row["sd.r1_m"]) == sd


def test_lists_are_json_in_one_cell(odd, tmp_path):
    with (exported(tmp_path / "tables", run=odd) / "palm-events.csv").open(newline="") as stream:
        table = rows(stream)
    published = next(iter(read_run(odd).messages("palm/events"))).fields
    assert json.loads(table[0]["force_n"]) == [None if math.isnan(force) else force for force in published["force_n"]]
    assert json.loads(table[0]["source"]) == published["source"]
    assert table[3]["source"] == "[]"


def test_a_zip_holds_the_same_tables(tmp_path):
    folder = exported(tmp_path / "tables")
    with zipfile.ZipFile(exported(tmp_path / "tables.zip")) as archive:
        for name in archive.namelist():
            assert archive.read(name) == (folder / name).read_bytes()
        assert len(archive.namelist()) == len(list(folder.iterdir()))


def test_a_field_that_appears_later_has_its_column(tmp_path):
    said = {"valid": False, "sd": {}}, {"valid": True, "sd": {"r1_m": 0.5}, "late": [1]}, {"valid": True, "sd": {}}
    entries = [("palm/estimate", fields, 0.1 * number, number) for number, fields in enumerate(said)]
    run = synthetic_runs.write_packed(tmp_path / "run.mcap", entries)
    with (exported(tmp_path / "tables", run=run) / "palm-estimate.csv").open(newline="") as stream:
        table = rows(stream)
    assert [(row["valid"], row["sd.r1_m"], row["late"]) for row in table] == [
        ("0", "", ""),
        ("1", "0.5", "[1]"),
        ("1", "", ""),
    ]


# ---------------------------------------------------------------------------------------------- MCAP with JSON


@pytest.fixture(scope="module")
def in_json(tmp_path_factory):
    """(topic, message, schema) of the exported file, as the mcap library reads it."""
    path = exported(tmp_path_factory.mktemp("json") / "run.mcap")
    with path.open("rb") as stream:
        found = list(make_reader(stream, validate_crcs=True).iter_messages(log_time_order=False))
    return [
        (channel.topic, json.loads(message.data), json.loads(schema.data), message, channel, schema)
        for schema, channel, message in found
    ]


def refuse(name):
    raise AssertionError(f"{name} is no JSON")


def null(value):
    """The JSON form of a value found independently: written with NaN, and read back."""
    return json.loads(json.dumps(value), parse_constant=lambda _: None)


def test_every_message_is_exported_as_json(in_json):
    assert [(topic, fields) for topic, fields, *_ in in_json if topic != "scene"] == [
        (topic, null(fields)) for topic, fields in rig_recording.published()
    ]


def test_json_messages_keep_their_times_and_are_strict(in_json):
    wanted = [rig_recording.raw(*each) for each in rig_recording.published()]
    found = [message for topic, _, _, message, _, _ in in_json if topic != "scene"]
    for message, raw in zip(found, wanted, strict=True):
        assert (message.log_time, message.publish_time) == (raw.log_time_ns, raw.publish_time_ns)
        json.loads(message.data, parse_constant=refuse)


def lichtblick(schema):
    """The requirements of Lichtblick's parser of JSON schemas: an object, every property of a single plain type."""
    assert schema["type"] == "object"
    for inner in schema["properties"].values():
        if inner["type"] == "object":
            lichtblick(inner)
        elif inner["type"] == "array":
            assert inner["items"]["type"] in ("number", "string", "boolean")
        else:
            assert inner["type"] in ("number", "string", "boolean")


def test_schemas_suit_those_readers_and_name_every_field(in_json):
    for topic, fields, schema, _, channel, registered in in_json:
        assert (channel.message_encoding, registered.encoding, registered.name) == ("json", "jsonschema", topic)
        lichtblick(schema)
        assert set(fields) <= set(schema["properties"])
        if "sd" in fields:
            assert set(fields["sd"]) <= set(schema["properties"]["sd"]["properties"])


def test_each_outline_comes_with_a_scene(in_json):
    scenes = [(message.log_time, fields) for topic, fields, _, message, _, _ in in_json if topic == "scene"]
    valid = {fields["mono_ns"]: fields["valid"] for fields in of("palm/estimate") if math.isfinite(fields["psi_rad"])}
    shapes = [fields for fields in of("palm/shape") if fields["mono_ns"] in valid]
    assert len(shapes) >= 10
    assert [fields["valid"] for _, fields in scenes] == [valid[fields["mono_ns"]] for fields in shapes]
    assert [t for t, _ in scenes] == [rig_recording.raw("palm/shape", fields).log_time_ns for fields in shapes]
    assert all(len(fields["outline_x_m"]) == len(fields["outline_y_m"]) == 361 for _, fields in scenes)


def test_a_scene_shows_the_outline_at_the_objects_pose():
    truth, body = of("rig/truth")[-1], of("rig/object")[-1]
    watch = SceneBuilder(default_config())
    watch.take("palm/estimate", truth | {"valid": True})
    theta, h = body["theta_rad"][::2], body["h_m"][::2]
    scene = watch.take("palm/shape", {"mono_ns": truth["mono_ns"], "theta_rad": theta, "h_m": h})
    x, y = scene.outline.T
    assert (x[0], y[0]) == (x[-1], y[-1])
    assert tuple(scene.centre) == (truth["com_x_m"], truth["com_y_m"])
    # its extent in every direction is the body's
    theta = np.array(body["theta_rad"]) + truth["psi_rad"]
    support = (np.outer(np.cos(theta), x) + np.outer(np.sin(theta), y)).max(axis=1)
    wanted = body["h_m"] + np.cos(theta) * truth["com_x_m"] + np.sin(theta) * truth["com_y_m"]
    assert np.abs(support - wanted).max() < 1e-5
    # it touches both pads at the measured contacts
    tip1, hinge, tip2 = scene.palms
    for tip, side, s in ((tip1, 1.0, truth["s1_m"]), (tip2, -1.0, truth["s2_m"])):
        along = (tip - hinge) / np.linalg.norm(tip - hinge)
        assert np.linalg.norm(tip - hinge) == pytest.approx(55.5e-3)
        across = side * ((y - hinge[1]) * along[0] - (x - hinge[0]) * along[1])
        nearest = across.argmin()
        assert across[nearest] == pytest.approx(0.0, abs=5e-5)
        assert (scene.outline[nearest] - hinge) @ along == pytest.approx(s, abs=1e-3)


def test_a_scene_needs_an_estimate_of_the_same_tick_with_a_pose():
    watch = SceneBuilder(default_config())
    (shape, *_), estimate = of("palm/shape"), next(f for f in of("palm/estimate") if f["valid"])
    shape = shape | {"mono_ns": estimate["mono_ns"]}
    assert watch.take("palm/shape", shape) is None
    watch.take("palm/estimate", estimate | {"psi_rad": math.nan})
    assert watch.take("palm/shape", shape) is None
    watch.take("palm/estimate", estimate | {"mono_ns": 1})
    assert watch.take("palm/shape", shape) is None
    watch.take("palm/estimate", estimate)
    scene = watch.take("palm/shape", shape)
    assert scene.valid
    hinge = RigGeometry.from_config(default_config()).hinge(estimate["phi1_rad"])
    assert tuple(scene.palms[1]) == hinge


# ---------------------------------------------------------------------------------------------- rerun


class Kept:
    """A stand-in for the package rerun that records calls."""

    def __init__(self):
        self.calls, self.columns, self.logged, self.time = [], {}, [], None

    def module(self):
        made = types.ModuleType("rerun")
        made.RecordingStream = self.stream
        made.TimeColumn = lambda name, timestamp: (name, timestamp)
        made.Scalars = types.SimpleNamespace(columns=lambda scalars: scalars)
        made.ViewCoordinates = types.SimpleNamespace(RIGHT_HAND_Y_UP="y up")
        for name in ("LineStrips3D", "Points3D", "TextLog"):
            setattr(made, name, lambda data, _name=name, **how: (_name, data, how))
        return made

    def stream(self, application, recording_id):
        self.calls.append(("stream", application, recording_id))
        return self

    def save(self, path):
        self.path = path
        path.write_bytes(b"RRF2")

    def send_columns(self, entity, indexes, columns):
        ((name, times),) = indexes
        assert name == "time"
        before = self.columns.setdefault(entity, [])
        before += zip(times.astype(np.int64).tolist(), columns.tolist(), strict=True)

    def set_time(self, _name, timestamp):
        self.time = timestamp.astype(np.int64)

    def log(self, entity, what, static=False):
        self.logged.append((None if static else int(self.time), entity, what))

    def flush(self):
        self.calls.append("flush")

    def disconnect(self):
        self.calls.append("disconnect")


@pytest.fixture
def rerun(monkeypatch):
    kept = Kept()
    monkeypatch.setitem(sys.modules, "rerun", kept.module())
    monkeypatch.delitem(sys.modules, "palmd.record.export_rerun", raising=False)
    yield kept
    sys.modules.pop("palmd.record.export_rerun", None)


def test_rerun_gets_every_number_with_its_time(rerun, tmp_path, monkeypatch):
    exported(tmp_path / "first.rrd")
    monkeypatch.setattr(sys.modules["palmd.record.export_rerun"], "ROWS", 50)
    exported(tmp_path / "run.rrd")
    assert (tmp_path / "run.rrd").exists()
    wanted = [(rig_recording.raw("palm/estimate", f).publish_time_ns, f["sd"].get("r1_m")) for f in of("palm/estimate")]
    found = rerun.columns["palm/estimate/sd/r1_m"]
    assert repr(found) == repr(2 * [each for each in wanted if each[1] is not None])
    assert rerun.columns["palm/estimate/valid"][-1][1] == float(of("palm/estimate")[-1]["valid"])
    assert "palm/estimate/observer" not in rerun.columns
    assert rerun.calls[-2:] == ["flush", "disconnect"]


def test_rerun_gets_scene_and_states(rerun, tmp_path):
    exported(tmp_path / "run.rrd")
    strips = [(t, what[1][0]) for t, entity, what in rerun.logged if entity == "scene/outline"]
    assert len(strips) >= 3
    assert all(strip.shape == (361, 3) and not strip[:, 2].any() for _, strip in strips)
    texts = [what[1] for _, entity, what in rerun.logged if entity == "palm/state/text"]
    states = [fields["state"] for fields in of("palm/state")]
    assert [text.split(":")[0] for text in texts][-1] == states[-1]
    assert len(texts) < len(states)


def test_without_rerun_the_error_says_what_to_install(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    monkeypatch.delitem(sys.modules, "palmd.record.export_rerun", raising=False)
    assert main(["export", str(rig_recording.path()), "-o", str(tmp_path / "run.rrd")]) == 1
    assert (
        capsys.readouterr().err
        == f"the format rrd needs rerun-sdk, which is not installed: {install_line('rerun-sdk', 'rerun')}\n"
    )
    assert list(tmp_path.iterdir()) == []


# ---------------------------------------------------------------------------------------------- the command


def test_the_format_can_be_named(tmp_path):
    assert read_log(exported(tmp_path / "run.txt", "--as", "log")).events
    assert (exported(tmp_path / "tables.d", "--as", "csv") / "palm-info.csv").exists()


def test_an_empty_folder_is_filled_and_a_file_replaced(tmp_path):
    (tmp_path / "tables").mkdir()
    assert (exported(tmp_path / "tables") / "palm-info.csv").exists()
    (tmp_path / "run.jsonl").write_text("old")
    assert read_log(exported(tmp_path / "run.jsonl")).events
    exported(exported(tmp_path / "run.mcap"))


def test_another_recording_is_not_replaced(odd, capsys):
    before = odd.read_bytes()
    assert main(["export", str(rig_recording.path()), "-o", str(odd)]) == 1
    assert "is a recorded run" in capsys.readouterr().err
    assert odd.read_bytes() == before


def test_an_unusable_target_is_a_one_line_error_and_nothing_is_lost(tmp_path, capsys):
    full = tmp_path / "full"
    full.mkdir()
    (full / "mine.txt").write_text("mine")
    before = rig_recording.path().read_bytes()
    for target, arguments, problem in (
        (tmp_path / "run.xyz", (), "add --as log|csv|mcap-json|rrd"),
        (tmp_path / "no" / "run.jsonl", (), "cannot be written: No such file"),
        (full, (), "is not empty"),
        (full, ("--as", "log"), "is a folder"),
        (rig_recording.path(), (), "is a recorded run"),
    ):
        assert main(["export", str(rig_recording.path()), "-o", str(target), *arguments]) == 1
        out, err = capsys.readouterr()
        assert out == ""
        assert problem in err
        assert err.startswith(str(target))
        assert err.count("\n") == 1
    assert [path.name for path in full.iterdir()] == ["mine.txt"]
    assert [path.name for path in tmp_path.iterdir()] == ["full"]
    assert rig_recording.path().read_bytes() == before


def test_an_error_midway_leaves_no_partial_export(tmp_path, capsys, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("palmd.record.export.cell", full)
    assert main(["export", str(rig_recording.path()), "-o", str(tmp_path / "tables")]) == 1
    assert "No space left" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_an_export_is_no_recording(tmp_path, capsys):
    path = exported(tmp_path / "run.mcap")
    assert main(["replay", str(path)]) == 1
    assert capsys.readouterr().err == f"{path}: is an MCAP file, but not a recording of palmd\n"
