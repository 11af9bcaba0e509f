"""Exploring on cradles beside flat palms: what is counted as touched, which objects, and what is told."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from palmd.config.plans import ExploreGoal
from palmd.console.shipped import shipped
from palmd.events import PalmMotion
from palmd.harness.wireless import Instant
from palmd.model.shape import coefficients_of
from palmd.motion.check import motion_limits
from palmd.motion.explorer import careful_angles
from palmd.motion.plan import compile_plan
from palmd.motion.reach import reach, surface_limits
from palmd.motion.rollout_predictor import BINS
from palmd.quantities import ESTIMATE
from palmd.rig.curved_plant import CurvedPlant
from palmd.rig.plant import FrictionSurface, Hinge
from palmd.rig.shapes import cylinder
from palmd.system.arcs import FLAT, joints_of
from palmd.yamlfile import load_config
from tools.studies import curved_exploring, exploring_plans
from tools.studies.curved_exploring import CradleRow, CradleTask, remarks, table, tasks_of
from tools.studies.exploring import ExploringRow
from tools.studies.exploring_watch import ExplorationWatch


def test_what_is_touched_on_arcs_is_told_by_the_tangents_at_the_contacts() -> None:
    curvatures = (14.0, -9.0)
    plant = CurvedPlant(cylinder(0.02, 0.1), Hinge("arc"), FrictionSurface(), curvatures)
    palms = PalmMotion.at_rest(joints_of(0.02, (0.75, 1.65), curvatures))
    plant.place(palms, 0.4)
    one, two = plant.contacts()
    truth: dict[str, Any] = {"phi1_rad": palms.angles[0], "phi2_rad": palms.angles[1], "psi_rad": 0.4,
                             "s1_m": one.s, "s2_m": two.s, "contact1": True, "contact2": True}  # fmt: skip
    watch = ExplorationWatch(np.ones(BINS, dtype=np.bool_), (0.0555, 0.0555), 0.0, curvatures)
    estimate = {"valid": False, "object": 1}
    watch.take(cast(Instant, SimpleNamespace(t=0.0, truth=truth, messages={ESTIMATE.name: estimate})))
    beta1, beta2 = plant.tangents()
    wanted = {
        math.floor((angle - 0.4) % math.tau / (math.tau / BINS)) for angle in (beta1 - math.pi / 2, beta2 + math.pi / 2)
    }
    assert set(np.flatnonzero(watch.touched).tolist()) == wanted


def test_both_sorts_of_palms_get_the_same_objects_at_the_same_rates() -> None:
    tasks = tasks_of(7, 3, 60.0)
    assert [(task.seed, task.curved) for task in tasks] == [
        (7, True),
        (7, False),
        (8, True),
        (8, False),
        (9, True),
        (9, False),
    ]
    cradle, flat = (curved_exploring._drawn(task) for task in tasks[:2])
    assert cradle[0] == flat[0]
    assert cradle[1].support.at(0.3) == flat[1].support.at(0.3)
    configs = [curved_exploring._config(each) for each in (cradle[0], None)]
    assert configs[0].rig.curvatures_per_m == cradle[0]
    assert not any(configs[1].rig.curvatures_per_m)
    assert configs[0].limits.rate_deg_s == configs[1].limits.rate_deg_s
    assert all(60.0 < 1e3 / kappa < 90.0 for kappa in cradle[0])


def test_the_study_explores_within_the_limits_of_the_example() -> None:
    assert load_config(shipped("cradle.yaml")).limits == curved_exploring.CRADLE


def test_a_plan_that_knows_nothing_keeps_to_gentle_angles_at_the_configured_rates() -> None:
    kappa, _ = curved_exploring._drawn(CradleTask("rig", 3, True, 5.0))
    config = curved_exploring._config(kappa)
    gentle, flat = (careful_angles(each) for each in (kappa, FLAT))
    for seed in range(3):
        spec = exploring_plans.plan("random", config, ExploreGoal(time_limit_s=30.0), seed)
        compiled = compile_plan(spec, motion_limits(config))
        poses = np.array([compiled.at(t).angles for t in np.linspace(1.0, compiled.duration, 200)])
        for (low, high), angles in zip(gentle, poses.T, strict=True):
            assert low - 1e-9 <= angles.min() <= angles.max() <= high + 1e-9
    assert all(wide[1] < narrow[1] for wide, narrow in zip(flat[1:], gentle[1:], strict=True))


def test_what_a_cradle_can_reach_is_read_off_its_own_surface() -> None:
    kappa, body = curved_exploring._drawn(CradleTask("nominal", 3, True, 60.0))
    outline = coefficients_of(body.support.sample(np.arange(360) * math.tau / 360))
    limits = surface_limits(motion_limits(curved_exploring._config(kappa)))
    assert limits.curvatures == kappa
    assert reach(outline, limits).mean() > 0.7
    narrow = replace(limits, phi1=(0.5, 0.7), phi2=(2.1, 2.2))
    assert (reach(outline, narrow) != reach(outline, replace(narrow, curvatures=FLAT))).any()


def test_the_table_tells_both_and_the_remarks_name_what_went_wrong() -> None:
    rows = [
        CradleRow((14.0, 13.0), ExploringRow("nominal", 1, "explore", enough_s=5.0, coverage=1.0, of_all=1.0)),
        CradleRow((14.0, 13.0), ExploringRow("rig", 2, "explore", coverage=0.7, of_all=0.7, losses=1, reason="late")),
        CradleRow((0.0, 0.0), ExploringRow("nominal", 1, "explore", enough_s=11.0, coverage=1.0, of_all=1.0)),
        curved_exploring.failed(CradleTask("rig", 2, False, 60.0), ValueError("no")),
    ]
    told = table(rows)
    assert "cradle" in told.splitlines()[0]
    assert "1 of 2" in told
    said = remarks(rows)
    assert said[0].startswith("cradle rig 2: touched 70% (late), contact lost 1 times")
    assert said[1] == "flat rig 2: ValueError: no"
    assert curved_exploring.as_line(rows[0])["curvatures_per_m"] == (14.0, 13.0)


def test_of_objects_that_were_not_held_it_is_told_how() -> None:
    rows = [
        CradleRow((14.0, 13.0), ExploringRow("rig", 1, "random", wedged_s=0.3, most_force_m_s2=71.0, pressed_s=0.1)),
        CradleRow((14.0, 13.0), ExploringRow("rig", 2, "random", parted_s=0.2, losses=1, unnoticed=1)),
    ]
    told = [line.split() for line in curved_exploring.plan_table(rows).splitlines()[1:]]
    assert [" ".join(line[-3:]) for line in told[:4]] == ["1 of 2"] * 4
    assert told[4][-1] == "71"
    assert remarks(rows) == [
        "cradle rig 1: wedged 0.30 s, pressed with up to 71 m/s²",
        "cradle rig 2: contact lost 1 times, at a pad's end 0.00 s",
    ]


@pytest.mark.parametrize("curved", [True, False])
def test_a_run_that_raises_becomes_a_row(curved: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tools.studies.exploring.explored", lambda *_: 1 / 0)
    row = curved_exploring.run(CradleTask("rig", 1, curved, 3.0))
    assert row.explored.error == "ZeroDivisionError: division by zero"
    assert any(row.curvatures) == curved
