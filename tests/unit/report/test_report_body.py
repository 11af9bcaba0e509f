"""Positions in the frames: distances and tangents by elementary geometry."""

from dataclasses import replace

import numpy as np
import pytest
import synthetic_runs

from palmd.events import PalmMotion
from palmd.report.body import contact_points, frames, outline_known, points, pose_at, turned
from palmd.rig.curved_plant import CurvedPlant
from palmd.rig.plant import FrictionSurface, Hinge
from palmd.rig.shapes import random_body
from palmd.system.arcs import joints_of


@pytest.fixture
def series(tmp_path):
    return synthetic_runs.series(tmp_path, synthetic_runs.messages(3.0, second_from=2.0))


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


def test_contact_points_are_the_contacts_in_the_bodys_frame(series):
    touched_points = contact_points(series, (101,))
    pose = pose_at(series, 101)
    back = turned(touched_points, pose.psi) + pose.centre[:, None]
    assert back == pytest.approx(np.stack(pose.contacts, axis=1))


def test_frames_are_valid_increasing_and_cover_the_whole_run(series):
    numbers = frames(series, 12)
    assert len(numbers) == 12
    assert series.valid[list(numbers)].all()
    assert (numbers[0], numbers[-1]) == (50, 299)
    assert (np.diff(numbers) > 0).all()


@pytest.mark.parametrize("name", ["r1_m", "phi2_rad", "psi_rad"])
def test_a_valid_estimate_that_is_not_finite_gives_no_frame(series, name):
    series.estimate[name][60:200] = np.nan
    numbers = np.array(frames(series, 12))
    assert len(numbers) > 5
    assert not ((numbers >= 60) & (numbers < 200)).any()


def test_frames_are_denser_while_the_outline_grows(series):
    touched = series.estimate["touched"]
    touched[:] = np.clip((series.estimate.t - 1.0) * 2, 0.0, 0.8)  # all of it between 1 s and 1.4 s
    t = series.estimate.t[list(frames(series, 12))]
    assert np.sum((t >= 1.0) & (t <= 1.4)) >= 5


def test_an_outline_is_never_shown_before_it_was_known_nor_of_another_object(series):
    assert outline_known(series, 1.05, 1).t == pytest.approx(1.0)
    assert outline_known(series, 2.05, 2).t == pytest.approx(2.0)
    assert outline_known(series, 1.95, 2) is None


def test_on_curved_palms_centre_and_contacts_agree_with_the_plant(series):
    curvatures = (14.0, -9.0)
    plant = CurvedPlant(
        random_body("friction", np.random.default_rng(3)),
        Hinge("fixed", base=(0.0, 0.0)),
        FrictionSurface(),
        curvatures,
    )
    palms = PalmMotion.at_rest(joints_of(0.02, (0.75, 1.65), curvatures))
    plant.place(palms, 0.4)
    contacts, radii = plant.contacts(), plant.radii()
    columns_of_pose = {"psi_rad": 0.4}
    for number in range(2):
        columns_of_pose |= {f"phi{number + 1}_rad": palms.angles[number], f"s{number + 1}_m": contacts[number].s,
                 f"r{number + 1}_m": radii[number]}  # fmt: skip
    bent = tuple(replace(pad, curvature=kappa) for pad, kappa in zip(series.run.rig.pads, curvatures, strict=True))
    curved = replace(
        series,
        run=replace(series.run, rig=replace(series.run.rig, pads=bent)),
        estimate=replace(
            series.estimate, columns={name: np.full(len(series.estimate.t), x) for name, x in columns_of_pose.items()}
        ),
    )
    pose = pose_at(curved, 0)
    assert pose.centre == pytest.approx([plant.state.x, plant.state.y], abs=1e-9)
    for palm, contact, s in zip(pose.palms(0.06), pose.contacts, (each.s for each in contacts), strict=True):
        assert np.hypot(*np.diff(palm)).sum() == pytest.approx(0.06, rel=1e-3)
        assert np.hypot(*(palm - contact[:, None])).min() < 0.0015, "the contact lies on the drawn palm"
        assert np.hypot(*contact) < s, "a chord is shorter than its arc"
