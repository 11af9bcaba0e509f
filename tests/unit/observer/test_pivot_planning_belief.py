"""The planning belief of a dragging gripper, measured while it moves."""

import math

import pytest

from palmd.events import PadSample, PalmSample
from palmd.observer.pivot.incremental import SimulatedSmoothing
from palmd.observer.pivot.live import PivotObserver
from palmd.system.pivot import PAD, PivotRig

SPEED_M_S, LEVER_M, HEIGHT_M = -0.014, 5e-3, 0.02


def test_the_lever_is_that_of_each_reading_at_any_gripper_speed():
    rig = PivotRig()
    observer = PivotObserver(rig, SimulatedSmoothing(rig, math.inf))
    for k in range(40):
        t = 0.008 * k
        x = 0.03 + SPEED_M_S * t
        observer.feed(PalmSample(t, (x, HEIGHT_M), (SPEED_M_S, 0.0), (0.0, 0.0)))
        observer.feed(PadSample(t + 0.004, PAD, x + SPEED_M_S * 0.004 + LEVER_M, 0.5))
    belief = observer.planning_belief(t + 0.02)
    assert belief.e == pytest.approx(LEVER_M, abs=1e-6)
    assert belief.force == 0.5
