"""Where things are in the frames: distances and tangents by elementary geometry."""

import numpy as np
import pytest
import reported

from palmd.record.run import read_run
from palmd.report.body import felt_points, frames, outline_known, points, pose_at, turned
from palmd.report.series import series_of


@pytest.fixture
def series(tmp_path):
    run = read_run(reported.write(tmp_path, reported.told(3.0, second_from=2.0)))
    return series_of(run, run.survey())


@pytest.mark.parametrize("count", [180, 181])
def test_outline_of_a_circle_beside_the_centre_of_mass(count):
    theta = np.arange(count) * (2 * np.pi / count)
    curve = points(theta, 0.02 + 0.003 * np.cos(theta) - 0.001 * np.sin(theta))
    assert np.hypot(curve[0] - 0.003, curve[1] + 0.001) == pytest.approx(np.full(count, 0.02))


def test_centre_is_r_away_from_each_palm_and_contacts_lie_on_them(series):
    pose = pose_at(series, 101)
    for angle, r, s, contact in (
        (pose.directions[0], series.estimate["r1_m"][101], 0.03, pose.contacts[0]),
        (pose.directions[1], series.estimate["r2_m"][101], 0.031, pose.contacts[1]),
    ):
        along = np.array([np.cos(angle), np.sin(angle)])
        assert abs(along[0] * pose.centre[1] - along[1] * pose.centre[0]) == pytest.approx(r)
        assert contact == pytest.approx(s * along)
    # between the palms, not behind one of them
    assert pose.directions[0] < np.arctan2(pose.centre[1], pose.centre[0]) < pose.directions[1]


def test_felt_points_are_the_contacts_turned_back(series):
    felt = felt_points(series, (101,))
    pose = pose_at(series, 101)
    back = turned(felt, pose.psi) + pose.centre[:, None]
    assert back == pytest.approx(np.stack(pose.contacts, axis=1))


def test_frames_are_valid_rising_and_reach_from_the_first_to_the_last(series):
    numbers = frames(series, 12)
    assert len(numbers) == 12
    assert series.valid[list(numbers)].all()
    assert (numbers[0], numbers[-1]) == (50, 299)
    assert (np.diff(numbers) > 0).all()


def test_frames_are_closer_where_the_outline_grows(series):
    touched = series.estimate["touched"]
    touched[:] = np.clip((series.estimate.t - 1.0) * 2, 0.0, 0.8)  # all of it between 1 s and 1.4 s
    t = series.estimate.t[list(frames(series, 12))]
    assert np.sum((t >= 1.0) & (t <= 1.4)) >= 5


def test_an_outline_is_never_shown_before_it_was_known_nor_of_another_object(series):
    assert outline_known(series, 1.05, 1).t == pytest.approx(1.0)
    assert outline_known(series, 2.05, 2).t == pytest.approx(2.0)
    assert outline_known(series, 1.95, 2) is None
