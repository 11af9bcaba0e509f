"""The demo's text about a pivoting grasp, from messages."""

import math

import numpy as np
import pytest

from palmd.bus.subscriber import Message
from palmd.harness.system_comparisons import PivotComparison
from palmd.pivot_quantities import PIVOT, PIVOT_BODY, PIVOT_SHAPE, PIVOT_TRUTH

THETA = np.arange(360) * math.tau / 360
TRUE_H = 0.02 + 0.003 * np.cos(2 * THETA) + 0.002 * np.cos(3 * THETA)
TOUCHED = THETA < 2.0


def feed(compared, topic, **fields):
    compared.take(Message(topic, fields, 0.0))


def estimate(compared, t, valid=True, omega0=0.5, mu=0.2):
    feed(compared, PIVOT.name, mono_ns=t * 1e9, valid=valid, reason="" if valid else "it has not moved",
         mu=mu, sd={"mu": 0.01}, omega0_rad_s=omega0)  # fmt: skip


def truth(compared, t, touch=1, omega0=0.4, force=1.0):
    feed(compared, PIVOT_TRUTH.name, mono_ns=t * 1e9, touch1=touch, f1_n=force, omega0_rad_s=omega0)


@pytest.fixture
def compared():
    made = PivotComparison(7, "imperfect")
    feed(made, PIVOT_BODY.name, hP_m=TRUE_H.tolist(), mu=0.21)
    return made


def test_settling_is_the_first_valid_estimate_after_the_motion_began(compared):
    estimate(compared, 1.0)
    assert not compared.settled
    compared.started(2.0)
    estimate(compared, 2.5, valid=False)
    assert not compared.settled
    estimate(compared, 3.5)
    compared.started(9.0)  # again: the first time counts
    estimate(compared, 10.0)
    assert compared.settled
    assert compared.summary().startswith("palmd demo: seed 7, rig imperfect, settled after 1.5 s, ")
    assert "ticks 4, valid 2, " in compared.summary()


def test_the_spin_error_uses_simultaneous_truth_and_touched_objects_only(compared):
    compared.started(0.0)
    truth(compared, 1.0)
    estimate(compared, 1.004)  # wrong by 0.1
    estimate(compared, 1.02, omega0=9.0)  # the truth is too old
    truth(compared, 1.03, touch=0)
    estimate(compared, 1.03, omega0=9.0)  # untouched
    estimate(compared, 1.03, omega0=9.0, valid=False)
    truth(compared, 1.04, force=2.5)
    estimate(compared, 1.04, omega0=0.1)  # wrong by 0.3
    said = compared.summary()
    assert f"omega0 {math.sqrt((0.1**2 + 0.3**2) / 2):.3f} rad/s" in said
    assert "largest force 2.50 N" in said
    assert "mu 0.200 ± 0.010 (true 0.210)" in said


def test_the_outline_error_is_that_of_touched_normals_in_the_best_rotation(compared):
    shape = {"theta_rad": THETA.tolist(), "hP_sd_m": np.where(TOUCHED, 3e-5, 1.0).tolist()}
    turned = 0.02 + 0.003 * np.cos(2 * (THETA + 1.0)) + 0.002 * np.cos(3 * (THETA + 1.0))
    far = np.where(TOUCHED, turned + 4e-5 * np.where(np.arange(360) % 2, 1.0, -1.0), 0.5)
    feed(compared, PIVOT_SHAPE.name, hP_m=far.tolist(), touched=[0] * 360, **shape)
    assert "outline" not in compared.summary()
    feed(compared, PIVOT_SHAPE.name, hP_m=far.tolist(), touched=TOUCHED.astype(int).tolist(), **shape)
    assert "outline about the pivot 40 µm RMS on 32% touched normals (sd 30 µm)" in compared.summary()


def test_without_a_valid_estimate_the_reason_and_the_state_are_given(compared):
    assert "never settled: no message received" in compared.summary()
    compared.started(1.0)
    estimate(compared, 2.0, valid=False, mu=math.nan)
    said = {"state": "tracking", "reason": "lowered", "exploring": True, "faults": ["lost"], "severities": ["hold"],
            "coverage": 0.5}  # fmt: skip
    feed(compared, "palm/state", **said)
    feed(compared, "palm/loop", work_p99_ms=1.5)
    feed(compared, "palm/loop", work_p99_ms=2.5)
    line = compared.progress(3.0)
    assert all(part in line for part in ("2 s", "tracking", "50%", "lowered", "it has not moved", "lost"))
    assert "never settled: it has not moved" in compared.summary()
    assert "explored 50%" in compared.summary()
    assert "mu" not in compared.summary()
    assert compared.summary().endswith("work p99 2.0 ms")
