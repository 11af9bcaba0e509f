"""Errors against the rig's truth, from runs with known errors."""

import math

import numpy as np
import pytest
import synthetic_runs

from palmd.report.errors import (
    body_at,
    count_within_band,
    errors_of,
    last_outlines,
    normalised_errors,
    outline_errors,
    scores_over_time,
)


@pytest.fixture
def series(tmp_path):
    return lambda **how: synthetic_runs.series(tmp_path, synthetic_runs.messages(2.5, **how))


def changed(folder, seconds, from_s, change, **how):
    """A run whose estimates are changed from a time on."""
    messages = list(synthetic_runs.messages(seconds, **how))
    for topic, fields, t, _ in messages:
        if topic == "palm/estimate" and t > from_s - 0.005:
            change(fields)
    return synthetic_runs.series(folder, messages)


def test_errors_and_the_share_within_the_band(series):
    read = series()
    errors = errors_of(read)
    by_hand = [synthetic_runs.SD_M * (3.0 if tick % 4 == 0 else 1.5) for tick in range(250)]
    assert errors.error["r1_m"] == pytest.approx(by_hand, abs=1e-12)
    assert count_within_band(read, errors, "r1_m") == (150, 200)  # in 2 s of valid ticks every fourth is outside
    assert count_within_band(read, errors, "r2_m") == (200, 200)
    mean = (9.0 / 4 + 2.25 * 3 / 4) / 3  # only r1 has an error
    assert np.nanmean(normalised_errors(read, errors)) == pytest.approx(mean)
    assert np.isnan(normalised_errors(read, errors)).sum() == 50


def test_the_gauge_of_psi_is_removed(series):
    read = series()
    errors = errors_of(read)
    assert np.abs(errors.error["psi_rad"]).max() < 1e-6
    drawn = errors.true["psi_rad"] - read.estimate["psi_rad"]
    assert np.abs(drawn).max() < 1e-6


def test_every_object_has_a_gauge_of_its_own(tmp_path):
    read = changed(tmp_path, 3.0, 1.5, lambda fields: fields.update(psi_rad=fields["psi_rad"] - 7.0), second_from=1.5)
    errors = errors_of(read)
    assert np.abs(errors.error["psi_rad"]).max() < 1e-6
    assert np.abs(errors.true["psi_rad"] - read.estimate["psi_rad"]).max() < 1e-6  # drawn close to it, no turn away


def test_a_few_large_errors_do_not_move_the_gauge(tmp_path):
    read = changed(tmp_path, 2.0, 1.8, lambda fields: fields.update(psi_rad=fields["psi_rad"] + 0.5))
    error = errors_of(read).error["psi_rad"]
    assert np.abs(error[:180]).max() < 1e-6
    assert error[180:] == pytest.approx(np.full(20, 0.5))


def test_truth_that_begins_late_is_not_extrapolated(tmp_path):
    messages = [each for each in synthetic_runs.messages(2.0) if not (each[0] == "rig/truth" and each[2] < 0.995)]
    read = synthetic_runs.series(tmp_path, messages)
    errors = errors_of(read)
    for name in ("r1_m", "psi_rad", "f1_n"):
        assert np.isnan(errors.error[name]).sum() == 100
    assert count_within_band(read, errors, "r2_m") == (100, 100)


def test_without_truth_there_are_no_errors(series):
    read = series(truths=False)
    assert errors_of(read) is None
    assert body_at(read, 1.0) is None


def test_the_outline_is_rotated_back_and_compared(series):
    read = series()
    (outline,) = last_outlines(read)
    found = outline_errors(outline, body_at(read, outline.t))
    assert found.error == pytest.approx(np.full(180, synthetic_runs.OFF_M), abs=1e-9)
    assert found.h == pytest.approx(synthetic_runs.true_h(synthetic_runs.THETA + synthetic_runs.GAUGE), abs=1e-9)
    assert found.whole_score.e_h == pytest.approx(synthetic_runs.OFF_M, rel=1e-3)
    assert found.whole_score.max_error == pytest.approx(synthetic_runs.OFF_M, rel=1e-2)
    assert math.remainder(found.whole_score.rotation - synthetic_runs.GAUGE, math.tau) == pytest.approx(0.0, abs=1e-3)
    assert found.touched_score.touched == pytest.approx(np.mean(outline.touched))


def test_well_known_normals_determine_the_outlines_rotation(series):
    read = series()
    (outline,) = last_outlines(read)
    outline.h[90:] += 1e-3 * np.sin(3 * synthetic_runs.THETA[90:])
    outline.h_sd[90:] = 2e-3
    found = outline_errors(outline, body_at(read, outline.t))
    assert np.abs(found.error[:90] - synthetic_runs.OFF_M).max() < 2e-6


def test_each_object_with_a_valid_outline_is_shown_once(series):
    read = series(second_from=1.5)
    assert [(each.number, round(each.t, 3)) for each in last_outlines(read)] == [(1, 1.4), (2, 2.4)]


def test_outlines_after_the_last_valid_one_are_not_shown(tmp_path):
    (outline,) = last_outlines(changed(tmp_path, 2.5, 2.0, lambda fields: fields.update(valid=False)))
    assert outline.t == pytest.approx(1.9)


def test_without_a_valid_outline_the_last_one_is_shown(series):
    (outline,) = last_outlines(series(valid=False))
    assert not outline.valid
    assert outline.t == pytest.approx(2.4)


def test_outline_errors_over_time(series):
    t, e_h, largest = scores_over_time(series())
    assert len(t) == 20
    assert e_h == pytest.approx(np.full(20, synthetic_runs.OFF_M), rel=1e-3)
    assert (largest >= e_h).all()
    assert [len(each) for each in scores_over_time(series(valid=False))] == [0, 0, 0]
