"""Fit of the arm's linkage to poses, against an independent kinematic chain; insufficient data is refused."""

import math

import numpy as np
import pytest

from palmd.calibration.linkage_fit import MIN_POSES, TooLittleSwingError, fit_linkage

ENCODER_M = 1.5e-5
ALL_OVER = ((6.0, 120.0), (35.0, 155.0))


def swing(ranges, count):
    """Palm angle 1 and the opening (rad): two sines over these ranges (deg)."""
    t = np.linspace(0.0, 1.0, count)
    return [
        np.radians(low + (high - low) * (0.5 - 0.5 * np.cos(math.tau * turns * t)))
        for (low, high), turns in zip(ranges, (5.3, 7.1), strict=True)
    ]


def poses(rng, base, length1, length2, tool, ranges=ALL_OVER, count=400, noise_m=ENCODER_M):
    """Arm reports by complex numbers: from the base to the hinge, from there to the gripper."""
    palm1, opening = swing(ranges, count)
    hinge = complex(*base) + length1 * np.exp(1j * (palm1 + math.pi))
    grip = hinge + length2 * np.exp(1j * palm1) * np.exp(1j * opening)
    seen = grip + noise_m * (rng.normal(size=count) + 1j * rng.normal(size=count))
    theta = np.angle((grip - hinge) * np.exp(-1j * tool)) + rng.normal(0.0, 1e-5, count)
    return np.stack([seen.real, seen.imag, theta], axis=1)


@pytest.mark.parametrize("seed", range(12))
def test_the_fit_finds_the_simulated_linkage(seed):
    rng = np.random.default_rng(seed)
    base, lengths, tool = rng.uniform(-0.5, 0.5, 2), rng.uniform(0.09, 0.15, 2), float(rng.uniform(-0.3, 0.3))
    fit = fit_linkage(poses(rng, base, *lengths, tool))
    wrong = np.array([fit.base_x, fit.base_y, fit.palm1_length, fit.palm2_length, fit.tool])
    wrong -= np.array([*base, *lengths, tool])
    sd = np.array([fit.base_x_sd, fit.base_y_sd, fit.palm1_length_sd, fit.palm2_length_sd, fit.tool_sd])
    assert np.abs(wrong[:4]).max() < 2e-5  # a tenth of the tolerance
    assert abs(wrong[4]) < math.radians(0.01)
    assert (np.abs(wrong) < 4.0 * sd).all()
    assert fit.rms == pytest.approx(ENCODER_M, rel=0.15)
    assert math.degrees(fit.span1) == pytest.approx(114.0, abs=0.5)
    assert math.degrees(fit.span_opening) == pytest.approx(120.0, abs=0.5)


def test_the_sds_match_the_scatter_of_repeated_measurements():
    found = []
    for seed in range(60):
        fit = fit_linkage(poses(np.random.default_rng(seed), (0.4, 0.1), 0.12, 0.115, 0.05))
        found.append((fit.base_x, fit.base_y, fit.palm1_length, fit.palm2_length, fit.tool))
    sd = (fit.base_x_sd, fit.base_y_sd, fit.palm1_length_sd, fit.palm2_length_sd, fit.tool_sd)
    assert np.std(found, axis=0) == pytest.approx(sd, rel=0.35)


def test_play_in_a_hinge_shows_in_the_residual():
    rough = fit_linkage(poses(np.random.default_rng(1), (0.4, 0.1), 0.12, 0.12, 0.0, noise_m=5e-4))
    assert rough.rms == pytest.approx(5e-4, rel=0.15)


@pytest.mark.parametrize(
    ("ranges", "message"),
    [
        (((60.0, 60.0), (90.0, 90.0)), "palm 2 was swung through 0° only"),
        (((40.0, 50.0), (60.0, 120.0)), "palm 1 was swung through 10° only"),
        (((20.0, 90.0), (80.0, 95.0)), "the opening between the palms was swung through 15° only"),
        (((20.0, 90.0), (90.0, 90.0)), "about one point"),
        (((40.0, 40.0), (60.0, 120.0)), "about one point"),
    ],
)
def test_too_little_swing_is_refused_with_the_missing_motion(ranges, message):
    with pytest.raises(TooLittleSwingError, match=message):
        fit_linkage(poses(np.random.default_rng(2), (0.4, 0.1), 0.12, 0.12, 0.02, ranges=ranges))


def test_few_or_inconsistent_poses_are_refused():
    rng = np.random.default_rng(3)
    with pytest.raises(TooLittleSwingError, match="only 49 different poses"):
        fit_linkage(poses(rng, (0.4, 0.1), 0.12, 0.12, 0.0, count=MIN_POSES - 1))
    with pytest.raises(TooLittleSwingError, match="swing both palms further"):
        fit_linkage(poses(rng, (0.4, 0.1), 0.12, 0.12, 0.0, count=60, noise_m=5e-3))
