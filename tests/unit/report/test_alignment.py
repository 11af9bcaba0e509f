"""Trajectories against a reference: clock, frame and tracked point are found, and the residual is the noise."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from palmd.report.alignment import AlignmentError, compare
from palmd.report.tracks import OutlineShape, PoseTrack, planar_fields

CLOCK_S, PLACE, MARK = 1234.567, np.array([0.3, -0.1, 0.7]), np.array([4e-3, -6e-3, 2e-3])
FRAME, BODY = Rotation.from_rotvec([0.3, -0.8, 1.1]), Rotation.from_rotvec([0.2, 0.5, -0.3])
NOISE_M, NOISE_RAD = 2e-4, 4e-3


def swung(seconds: float = 20.0, *, plane: bool = True) -> PoseTrack:
    """An object that turns to and fro."""
    t = np.arange(0.0, seconds, 0.01)
    angle = 0.8 * np.sin(2.1 * t) + 0.5 * np.sin(3.7 * t + 1.0)
    x, y = 0.03 * np.sin(1.3 * t), 0.02 * np.cos(1.9 * t)
    if plane:
        return PoseTrack("run", **planar_fields(t, x, y, angle))
    turns = Rotation.from_rotvec(np.stack([angle, 0.6 * np.sin(1.7 * t), 0.4 * np.cos(2.9 * t)], axis=1))
    return PoseTrack("run", t, np.stack([x, y, 0.01 * np.sin(t)], axis=1), turns)


def filmed(run: PoseTrack, rng: np.random.Generator) -> PoseTrack:
    """The reference of another system: every third pose, with its own clock, frame, tracked point and noise."""
    rows = np.arange(0, len(run.t), 3)
    turn = FRAME * run.rotation[rows] * BODY
    place = PLACE + FRAME.apply(run.position[rows] + run.rotation[rows].apply(MARK))
    noise = rng.normal(0.0, NOISE_M, place.shape)
    shaken = Rotation.from_rotvec(rng.normal(0.0, NOISE_RAD, place.shape)) * turn
    return PoseTrack("track", run.t[rows] + CLOCK_S, place + noise, shaken)


@pytest.mark.parametrize("plane", [True, False], ids=["plane", "space"])
def test_clock_and_frame_are_found_and_the_residual_is_the_noise(plane: bool) -> None:
    run = swung(plane=plane)
    found = compare(filmed(run, np.random.default_rng(1)), run)
    assert abs(found.alignment.offset - CLOCK_S) < min(2e-3, 4.0 * found.alignment.offset_sd)
    assert found.position.rms == pytest.approx(NOISE_M * math.sqrt(3), rel=0.1)
    assert found.rotation.rms == pytest.approx(NOISE_RAD * math.sqrt(3), rel=0.1)


def test_in_the_same_frame_an_offset_of_position_is_an_error() -> None:
    run = swung()
    moved = PoseTrack("moved", run.t, run.position + np.array([1e-3, 0.0, 0.0]), run.rotation)
    assert compare(run, moved, fit=False).position.rms == pytest.approx(1e-3)
    assert compare(run, moved).position.rms < 1e-9


def test_another_motion_is_refused() -> None:
    run = swung()
    other = PoseTrack("other", run.t, run.position, Rotation.from_rotvec(np.outer(np.sin(0.2 * run.t**2), [0, 0, 1.0])))
    with pytest.raises(AlignmentError, match="do both show the same motion"):
        compare(run, other)


def test_an_object_at_rest_has_no_clock() -> None:
    run = swung()
    still = PoseTrack("still", run.t, run.position, Rotation.identity(len(run.t)))
    with pytest.raises(AlignmentError, match="less than 2 degrees"):
        compare(run, still)


def test_trajectories_in_plane_and_space_are_different_motions() -> None:
    run = swung()
    with pytest.raises(AlignmentError, match="same motion"):
        compare(swung(plane=False), run)


def test_outlines_are_compared_at_touched_normals_after_the_best_rotation() -> None:
    run = swung()
    theta = np.linspace(0.0, math.tau, 180, endpoint=False)

    def body(at: np.ndarray, more: float = 0.0) -> OutlineShape:
        h = 0.02 + 1e-3 * np.cos(2 * at) + 4e-4 * np.cos(3 * at + 0.4) + more
        return OutlineShape(theta, h, (theta < 2.0).astype(float))

    true = PoseTrack("true", run.t, run.position, run.rotation, body(theta))
    mine = PoseTrack("mine", run.t, run.position, run.rotation, body(theta + 0.7, 5e-5))
    found = compare(true, mine, fit=False)
    assert found.outline.rms == pytest.approx(5e-5, rel=0.3)
    assert math.isnan(compare(run, mine, fit=False).outline.rms)
