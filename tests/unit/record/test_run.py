"""A recorded run, read back."""

import json
import math

import numpy as np
import pytest
import recorded
from improvements import improvement

from palmd.config.two_palms import rig_description
from palmd.messages import improvement_fields
from palmd.quantities import ESTIMATE, EVENTS, IMPROVEMENT
from palmd.record.mcapfile import Preface
from palmd.record.run import RunError, read_run
from palmd.record.runfile import RunFile
from palmd.system.rig_constants import RIG_NAMES


@pytest.fixture
def finished(tmp_path):
    file, _ = recorded.begun(tmp_path)
    file.finish()
    return file.path


def written(path, messages, **attachments):
    """A file with exactly these messages."""
    preface = recorded.preface(recorded.config(path.parent), "")
    files = {**preface.attachments, **attachments}
    return recorded.written(path, messages, Preface(preface.metadata, files), compressed=True)


def test_ticks_have_their_times_and_events_bit_for_bit(finished):
    ticks = list(read_run(finished).ticks())
    assert [tick.number for tick in ticks] == list(range(5))
    assert [tick.t for tick in ticks] == [0.1 * i for i in range(5)]
    assert [list(tick.events) for tick in ticks] == [recorded.events(i) for i in range(5)]


def test_the_run_has_its_metadata(finished):
    run = read_run(finished)
    config = recorded.config(finished.parent)
    assert run.complete
    assert run.outlines() == ()
    assert run.config == config
    assert run.rig == rig_description(config)
    assert run.metadata["started"] == "2026-11-21T22:30:05+00:00"
    assert set(run.metadata) == {
        "schema", "palmd", "python", "numpy", "casadi", "machine", "config_hash", "started", "continues", "gap_s",
    }  # fmt: skip


def test_messages_can_be_selected_by_topic(finished):
    run = read_run(finished)
    assert [message.topic for message in run.messages("palm/loop", "palm/info")] == ["palm/loop", "palm/info"]
    (loop,) = run.messages("palm/loop")
    assert loop.fields["pad1_bytes"] == 3
    assert len(list(run.messages())) == 12


def test_the_survey_counts_messages_and_gaps(tmp_path):
    kept = [message for message in recorded.messages(9) if message.sequence not in (3, 4, 101)]
    survey = read_run(written(tmp_path / "run.mcap", kept)).survey()
    events, truth = survey["palm/events"], survey["rig/truth"]
    assert (events.count, events.first, events.missing) == (7, 0, 2)
    assert (truth.count, truth.first, truth.missing) == (8, 100, 1)
    assert events.end_ns - events.begin_ns == pytest.approx(0.8e9)


def test_a_run_can_be_read_as_an_event_log(finished):
    log = read_run(finished).event_log()
    assert list(log.events) == [event for i in range(5) for event in recorded.events(i)]
    assert log.rig == rig_description(recorded.config(finished.parent))
    assert log.notes == ()


def test_an_unfinished_run_is_marked(tmp_path):
    file, ends = recorded.begun(tmp_path)
    file.abandon()
    with file.path.open("r+b") as stream:
        stream.truncate(ends[4] - 1)  # the third tick's events are the fifth message
    run = read_run(file.path)
    assert not run.complete
    assert len(list(run.ticks())) == 2
    (note,) = run.event_log().notes
    assert "was not finished" in note


RIG = np.arange(float(len(RIG_NAMES)))
RIG_SD = np.linspace(1.0, 2.0, len(RIG_NAMES))
AGAINST = np.linspace(-9.0, 9.0, len(RIG_NAMES))
SPREAD = np.arange((2.0 + len(RIG_NAMES)) * len(RIG_NAMES)).reshape(-1, len(RIG_NAMES))  # of two states and the rig


def test_improvements_are_read_back_with_their_ticks(tmp_path):
    x, covariance = np.array([1 / 3, math.pi]), np.array([[1.0, 0.1], [0.1, 2.0]]) / 7
    touched = np.arange(72) % 3 == 0
    arrays = {"touched": touched, "rig": RIG, "rig_sd": RIG_SD, "spread": SPREAD, "contradicted": AGAINST}
    sent = improvement(x, covariance, t=0.1, frame=3, **arrays)
    message = recorded.message(IMPROVEMENT.name, improvement_fields(1 / 7, sent), 0)
    ((t, answer),) = read_run(written(tmp_path / "run.mcap", [message])).improvements()
    assert (t, answer.t) == (1 / 7, 0.1)
    assert answer.x.tobytes() == x.tobytes()
    assert answer.P.tobytes() == covariance.tobytes()
    assert (answer.frame, answer.established) == (3, True)
    for name, array in arrays.items():
        assert np.array_equal(getattr(answer, name), array), name


def test_answers_of_an_earlier_smoother_are_rejected_with_advice(tmp_path):
    fields = improvement_fields(1 / 7, improvement(np.zeros(2), np.eye(2)))
    for name in ("frame", "established", "touched", "rig", "spread"):
        del fields[name]
    run = read_run(written(tmp_path / "run.mcap", [recorded.message(IMPROVEMENT.name, fields, 0)]))
    with pytest.raises(
        RunError, match=r"cannot be checked by this palmd; `palmd estimate \S*run.mcap` runs the smoother again"
    ):
        next(run.improvements())


def test_stored_outlines_are_in_the_run(tmp_path):
    theta = np.linspace(0.0, 2 * np.pi, 360, endpoint=False)
    outline = {"theta_rad": theta.tolist(), "h_m": (0.02 + 1e-3 * np.cos(2 * theta)).tolist(), "rho_m": 0.014}
    (tmp_path / "outlines").mkdir()
    for name in ("nut", "bolt"):
        (tmp_path / "outlines" / f"{name}.json").write_text(json.dumps(outline))
    config = recorded.config(tmp_path)
    observer = config.observer.model_copy(update={"shape": tmp_path / "outlines"})
    config = config.model_copy(update={"observer": observer})
    file = RunFile(tmp_path, recorded.preface(config, ""), recorded.BEGIN)
    for message in recorded.messages(1):
        file.write(message)
    file.finish()
    for each in (tmp_path / "outlines").iterdir():
        each.unlink()
    (tmp_path / "outlines").rmdir()
    run = read_run(file.path)
    assert [one.name for one in run.outlines()] == ["bolt", "nut"]
    assert run.config.observer.shape is None


# ------------------------------------------------------------------------------------------------- bad input


def refusal(path):
    with pytest.raises(RunError) as caught:
        read_run(path)
    text = str(caught.value)
    assert "\n" not in text
    assert text.startswith(f"{path}: ")
    return text.removeprefix(f"{path}: ")


def test_a_run_without_readable_messages_is_rejected(tmp_path):
    file, ends = recorded.begun(tmp_path, 1)
    file.abandon()
    data = file.path.read_bytes()
    for length in (8, 9, 100, len(data) - ends[-1] + ends[0] - 1, ends[0] - 1):
        file.path.write_bytes(data[:length])
        assert "is truncated before" in refusal(file.path)
    file.path.write_bytes(data[: ends[0]])
    assert len(list(read_run(file.path).messages())) == 1


def test_a_run_without_messages_is_refused(tmp_path):
    assert refusal(written(tmp_path / "run.mcap", [])) == "holds no messages: the recording ended before any arrived"


@pytest.mark.parametrize(
    ("name", "data", "what"),
    [
        ("config.yaml", b"pads: 3", "its configuration cannot be read"),
        ("config.yaml", b"{", "its configuration cannot be read"),
        ("config.yaml", b"observer: 3", "its configuration cannot be read"),
        ("config.yaml", b"rig: {system: sledge}", "is a recording of a system that this palmd does not know: sledge"),
        ("config.yaml", b"rig: {system: [1]}", "is a recording of a system that this palmd does not know: [1]"),
        ("rig.json", b"{", "its description of the rig cannot be read"),
        ("rig.json", b'{"gravity": "much"}', "its description of the rig cannot be read"),
    ],
)
def test_a_damaged_preface_is_rejected(tmp_path, name, data, what):
    assert what in refusal(written(tmp_path / "run.mcap", recorded.messages(1), **{name: data}))


def test_missing_topics_are_named(finished):
    run = read_run(finished)
    run.require(EVENTS)
    with pytest.raises(RunError, match=r"holds no palm/estimate and no palm/improvement"):
        run.require(EVENTS, ESTIMATE, IMPROVEMENT)


def test_invalid_events_are_rejected(tmp_path):
    bad = recorded.message(EVENTS.name, {"t_tick_s": 0.0, "source": [1]}, 4)
    with pytest.raises(RunError, match="palm/events, message 4"):
        list(read_run(written(tmp_path / "a.mcap", [bad])).ticks())
    garbage = recorded.RawMessage(EVENTS.name, 0, 0, 5, b"\xc1")
    with pytest.raises(RunError, match="palm/events, message 5: not a msgpack map"):
        list(read_run(written(tmp_path / "b.mcap", [garbage])).ticks())


def test_a_run_without_events_is_no_event_log(tmp_path):
    empty = recorded.message(EVENTS.name, {**recorded.events_fields(0.0, [])}, 0)
    with pytest.raises(RunError, match="no data came from pads or arm"):
        read_run(written(tmp_path / "a.mcap", [empty])).event_log()
    others = [message for message in recorded.messages(1) if message.topic != EVENTS.name]
    with pytest.raises(RunError, match="holds no palm/events"):
        read_run(written(tmp_path / "b.mcap", others)).event_log()
