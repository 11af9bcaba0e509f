"""The daemon explores a body between three palms, without ports; a smoother that knows the body saves time."""

import numpy as np
import pytest
from body_stand import known_parameters

from palmd.config.three_palms import TiltPlanSpec
from palmd.console.shipped import shipped
from palmd.daemon.lifecycle import State
from palmd.harness.system_comparisons import matrix
from palmd.model.icosphere import icosphere
from palmd.quantities import STATE
from palmd.system.three_palms import BodyAnswer
from palmd.yamlfile import load_any_config
from tools.closed_loop import ThreePalmsLoop
from tools.studies.space import LIVE, SpaceLiveRow, TrueCoverage

PLAN = TiltPlanSpec.model_validate({"name": "p", "segments": [{"explore": {"coverage": 0.9}}]})
ANSWER_S, SECONDS = 2.2, 6.5


class Informed:
    """A smoother that once returns the true body and its current motion."""

    rig: ThreePalmsLoop
    done = False

    def submit(self, *_):
        pass

    def collect(self, t):
        world = self.rig.world
        if self.done or t < ANSWER_S:
            return None
        self.done = True
        truth, n = world.truth(), len(icosphere()[0])
        p = known_parameters(world.body.body, world.body.friction)
        covariance = np.diag([1e-6] * 3 + [1e-4] * 3 + [1e-9] * (len(p) - 9) + [1e-4] * 8 + [1e-2])
        omega = np.array([truth[f"omega_{axis}_rad_s"] for axis in "xyz"])
        h = np.array(world.object_truth()["h_m"])
        return BodyAnswer(
            t, t, True, "", 1, matrix(truth["quat_xyzw"]), omega, p, covariance, h, np.full(n, 1e-5), np.zeros(n),
            np.zeros(9), float("nan"), float("nan"),
        )  # fmt: skip


@pytest.fixture(scope="module")
def explored():
    """(the rig, its true coverage, each tick's messages and reason)."""
    smoother = Informed()
    rig = smoother.rig = ThreePalmsLoop(load_any_config(shipped("three_palms.yaml")), PLAN, 3, smoother)
    rig.start()
    begun, coverage, said = rig.t, TrueCoverage(), []
    for now in rig.run(SECONDS):
        coverage.take(rig.t - begun, now.truth)
        said.append((now, rig.core.exploring.reason))
    return rig, coverage, said


def test_the_palms_swing_until_the_body_is_known_and_then_extend_the_coverage(explored):
    rig, coverage, said = explored
    reasons = [reason for _, reason in said]
    assert "swings the body until its pose is known" in reasons
    assert reasons[-1] == ""
    assert rig.core.state is State.TRACKING
    assert rig.world.contact_losses == 0
    assert coverage.share > 0.1  # swinging alone covers 4 %


def test_the_published_coverage_agrees_with_the_truth(explored):
    _, coverage, said = explored
    state = [now.messages[STATE.name] for now, _ in said if STATE.name in now.messages][-1]
    assert state["exploring"]
    assert state["reachable"] == 1.0
    assert coverage.share - 0.1 < state["coverage"] < coverage.share + 0.01


def test_every_set_point_keeps_the_limits(explored):
    rig, _, said = explored
    limits = rig.core.setpoints.limits.angles
    for now, _ in said:
        for joint, (low, high) in zip(("beta", "gamma2", "gamma3"), limits, strict=True):
            assert low - 2e-3 < now.truth[f"{joint}_rad"] < high + 2e-3
    assert rig.core.setpoints.interventions == 0


def test_a_row_reports_coverage_and_losses():
    row = SpaceLiveRow(
        5, 60.0, "explore", settled=8.0, converged_after=9.0, valid=0.9, surface_error=2e-5, ratio=0.5,
        coverage=(0.4, 0.6, 0.85), published=0.8, losses=1, recovered=1, back_s=9.5,
    )  # fmt: skip
    lines = LIVE.remarks([row])
    assert "fell off 1 times, 1 times valid again after 9.5 s" in lines[0]
    assert lines[1] == "       5: touched 40% after 20 s, 60% after 40 s, 85% after 60 s, published 80%"
    assert LIVE.tabled([row]).split()[-3:] == ["1", "85", "1"]
