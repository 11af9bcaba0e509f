"""The demo's text about three palms in space, from messages."""

import math

import numpy as np
import pytest

from palmd.bus.subscriber import Message
from palmd.harness.system_comparisons import CENTRE, SPIN, ThreePalmsComparison
from palmd.model.icosphere import icosphere
from palmd.three_palms_quantities import PALM3, PALM3_BODY, PALM3_SHAPE, PALM3_TRUTH

DIRECTIONS, _ = icosphere()
TRUE_H = np.linalg.norm(DIRECTIONS * [0.03, 0.025, 0.02], axis=1)  # an ellipsoid's
TURN = 0.02  # error of the estimate's frame, about z (rad)


def feed(compared, topic, t=0.0, **fields):
    compared.take(Message(topic.name, fields | {"mono_ns": t * 1e9}, 0.0))


def estimate(compared, t, valid=True, mu=0.2, spin=0.0, centre=0.0):
    values = dict.fromkeys(SPIN, spin) | dict.fromkeys(CENTRE, centre)
    sd = dict.fromkeys(SPIN, 0.1) | dict.fromkeys(CENTRE, 1e-4) | {"mu": 0.01}
    reason = "" if valid else "nothing is known yet"
    feed(compared, PALM3, t, valid=valid, reason=reason, mu=mu, sd=sd, object=1, quat_xyzw=(0, 0, 0, 1), **values)


@pytest.fixture
def compared():
    made = ThreePalmsComparison(7, "imperfect")
    feed(made, PALM3_BODY, h_m=TRUE_H.tolist(), mu=0.21)
    made.started(2.0)
    return made


def test_errors_are_those_of_valid_estimates_with_simultaneous_truth(compared):
    feed(compared, PALM3_TRUTH, 3.0, **dict.fromkeys((*SPIN, *CENTRE), 0.0))
    estimate(compared, 3.001, valid=False, spin=9.0)
    estimate(compared, 3.002, spin=0.1, centre=2e-4)
    estimate(compared, 3.02, spin=9.0)  # the truth is too old
    assert compared.settled
    said = compared.summary()
    assert said.startswith("palmd demo: seed 7, rig imperfect, settled after 1.0 s, object 1 valid at the end, ")
    assert "omega 0.100 rad/s, centre 200 µm" in said
    assert "(error/sd)² 2.50, mu 0.200 ± 0.010 (true 0.210), ticks 3, valid 2, " in said


def test_the_surface_error_is_that_after_the_best_rotation(compared):
    half = TURN / 2.0
    feed(compared, PALM3_TRUTH, 3.0, quat_xyzw=(0, 0, math.sin(half), math.cos(half)),
         **dict.fromkeys((*SPIN, *CENTRE), 0.0))  # fmt: skip
    estimate(compared, 3.0)
    touched = (DIRECTIONS[:, 2] > 0.0).astype(int).tolist()
    feed(compared, PALM3_SHAPE, 3.0, valid=True, object=1, touched=touched, h_m=(TRUE_H + 1e-4).tolist(),
         h_sd_m=[2e-4] * len(TRUE_H))  # fmt: skip
    assert "surface 100 µm RMS on 49% touched directions (sd 200 µm)" in compared.summary()
    line = compared.progress(5.0)
    assert not compared.progress(14.9)  # nothing has changed
    assert compared.progress(15.0).lstrip().startswith("13 s")
    assert line.index("± 200 µm (1σ)") < line.index("49%") < line.index("true error: 100 µm")
    estimate(compared, 4.0, valid=False)
    assert "µm" not in compared.progress(16.0)
