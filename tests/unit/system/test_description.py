"""Rig description: variances of each pad, calibration uncertainties, hinge."""

from __future__ import annotations

import numpy as np
import pytest

from palmd.system.description import AS_CALIBRATED, PadSensor, RigDescription

QUIET, NOISY = PadSensor(), PadSensor(noise=5e-4, resolution=0.0, force_scale_std=0.2, force_resolution=0.0)


def test_each_pad_has_its_own_variances():
    rig = RigDescription(pads=(QUIET, NOISY))
    assert rig.reading_variances == pytest.approx([1e-8 + 1.27e-4**2 / 12, 25e-8])
    variances = rig.force_variances(np.array([2.0, 2.0, 1.0]), np.array([2.0, 1.0, 2.0]))
    assert variances == pytest.approx([0.16, 0.01 + 0.02**2 / 12, 0.04])


def test_known_to_sets_the_uncertainties_of_every_pad_and_rejects_unknown_keys():
    rig = RigDescription(pads=(QUIET, NOISY)).known_to(AS_CALIBRATED | {"zero_sd": 5e-4, "gravity_sd": 0.1})
    assert [(pad.zero_sd, pad.noise) for pad in rig.pads] == [(5e-4, QUIET.noise), (5e-4, NOISY.noise)]
    assert (rig.gravity_sd, rig.angle_sd) == (0.1, AS_CALIBRATED["angle_sd"])
    with pytest.raises(TypeError, match="colour"):
        rig.known_to({"colour": 1.0})


def test_a_fixed_hinge_has_an_arc_of_zero_length():
    assert RigDescription(hinge="fixed").arc == ((0.0, 0.0), 0.0)
    assert RigDescription(palm1_length=0.1, base=(0.1, 0.2)).arc == ((0.1, 0.2), 0.1)
