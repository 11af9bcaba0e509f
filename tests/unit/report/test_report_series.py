"""A run as arrays: recorded values at their times, and missing ones marked."""

import math

import numpy as np
import pytest
import synthetic_runs

from palmd.quantities import ESTIMATE, MOTION, SHAPE
from palmd.record import RunError
from palmd.record.run import read_run
from palmd.report.series import SD, series_of


def test_every_value_is_at_its_time(tmp_path):
    messages = list(synthetic_runs.messages(3.0, second_from=2.0))
    read = synthetic_runs.series(tmp_path, messages)
    sent = [fields for topic, fields, *_ in messages if topic == ESTIMATE.name]
    assert len(read.estimate.t) == len(sent) == 300
    assert read.estimate.t == pytest.approx(np.arange(300) * 0.01, abs=1e-8)
    for name in ("r1_m", "psi_rad", "nis"):
        assert read.estimate[name].tolist() == [fields[name] for fields in sent]
    assert read.estimate[SD + "r1_m"].tolist() == [fields["sd"]["r1_m"] for fields in sent]
    assert np.isnan(read.estimate["e_f_m"]).all()
    assert read.valid.sum() == sum(fields["valid"] for fields in sent) == 250
    assert read.objects == (1, 2)
    assert [outline.number for outline in read.outlines] == [1] * 20 + [2] * 10
    assert [outline.valid for outline in read.outlines] == [False] * 5 + [True] * 25
    assert read.duration == pytest.approx(2.99)
    assert read.counts["pad1_bad_header"] == 3
    assert len(read.truth.t) == 300
    assert len(read.bodies) == 3


def test_durations_and_failures_are_counted(tmp_path):
    read = synthetic_runs.series(tmp_path, synthetic_runs.messages(2.5))
    assert [spell.label for spell in read.states] == ["idle", "tracking"]
    assert read.states[0].end == read.states[1].begin == pytest.approx(0.2)
    assert read.states[-1].end == read.duration
    assert [(spell.label, round(spell.begin, 6)) for spell in read.segments] == [
        ("", 0.0), ("rock 0", 0.3), ("rock 1", 1.0), ("rock 2", 2.0),
    ]  # fmt: skip
    late, garbled = read.faults
    assert (late.code, late.severity, late.hint, late.active_at_end) == (
        "arm-late",
        "degrade",
        "mend <arm-late>",
        False,
    )
    assert (late.begin, late.end) == pytest.approx((0.6, 0.9))
    assert (garbled.code, garbled.active_at_end, garbled.end) == ("pad1-garbled", True, read.duration)
    assert garbled.begin == pytest.approx(1.0)


def test_a_field_that_appears_late_is_unknown_before(tmp_path):
    messages = list(synthetic_runs.messages(1.0, shapes=False, truths=False))
    for topic, fields, t, _ in messages:
        if topic == ESTIMATE.name and t > 0.495:
            fields["sd"]["com_z_m"] = 1.0
    column = synthetic_runs.series(tmp_path, messages).estimate[SD + "com_z_m"]
    assert np.isnan(column).sum() == 50
    assert column[50:].tolist() == [1.0] * 50


def test_a_truncated_run_reports_what_was_left_out(tmp_path):
    path = synthetic_runs.write(tmp_path, synthetic_runs.messages(1.0), finish=False)
    whole = path.read_bytes()
    path.write_bytes(whole[:-137])
    run = read_run(path)
    read = series_of(run, run.survey())
    assert not run.complete
    assert 0 < run.damage.torn_bytes < 2000
    assert 90 <= len(read.estimate.t) <= 100


def test_missing_topics_are_empty(tmp_path):
    kept = (ESTIMATE.name,)
    read = synthetic_runs.series(tmp_path, [each for each in synthetic_runs.messages(0.5) if each[0] in kept])
    assert len(read.motion.t) == len(read.loop.t) == len(read.truth.t) == 0
    assert read.states == read.segments == read.faults == read.outlines == read.bodies == ()
    assert read.counts == {}


def test_progress_counts_every_message(tmp_path):
    messages = list(synthetic_runs.messages(0.3))
    run = read_run(synthetic_runs.write(tmp_path, messages))
    done = []
    series_of(run, run.survey(), done.append)
    assert done == list(range(1, len(messages) + 1))


def test_a_run_without_an_estimate_cannot_be_reported(tmp_path):
    with pytest.raises(RunError, match=r"holds no palm/estimate: there is nothing to report"):
        synthetic_runs.series(tmp_path, [each for each in synthetic_runs.messages(0.3) if each[0] == MOTION.name])


@pytest.mark.parametrize(
    ("topic", "field", "value"),
    [(ESTIMATE, "r1_m", "wide"), (ESTIMATE, "nis", None), (MOTION, "phi1_rad", [1.0]), (SHAPE, "h_m", [0.02])],
)
def test_a_message_that_violates_its_topics_table_is_named(tmp_path, topic, field, value):
    messages = list(synthetic_runs.messages(0.3))
    next(fields for name, fields, *_ in messages if name == topic.name)[field] = value
    path = synthetic_runs.write_packed(tmp_path / "run.mcap", messages)
    with pytest.raises(RunError, match=rf"{topic.name}, message 0: "):
        series_of(read_run(path), read_run(path).survey())


def test_a_column_never_published_is_unknown(tmp_path):
    read = synthetic_runs.series(tmp_path, synthetic_runs.messages(0.2))
    assert math.isnan(read.contact["age9_ms"][0])
    assert len(read.contact["age9_ms"]) == 20
