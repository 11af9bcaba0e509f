"""The study explore: one real run of each strategy, its score, and the table."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from palmd.config.plans import ExploreGoal
from palmd.motion.check import motion_limits
from palmd.motion.plan import compile_plan
from palmd.motion.rollout_predictor import BINS
from palmd.quantities import ESTIMATE, SHAPE
from palmd.rig.shapes import KINDS
from palmd.rig.world import default_config
from tools.closed_loop import Instant
from tools.studies import exploration_plans, explore
from tools.studies.commands import main
from tools.studies.exploration_plans import STRATEGIES
from tools.studies.exploration_statistics import ExplorationStatistics
from tools.studies.explore import STUDY, ExploringRow, ExploringTask

# ---------------------------------------------------------------------------------------------- real runs


@pytest.mark.nightly
def test_exploring_touches_more_than_the_open_loop_plans_and_every_field_is_filled():
    """Eight seconds of each strategy on the same object; the first run has the smoother."""
    explored, random = (explore.run(ExploringTask("odd", 5, strategy, 8.0)) for strategy in STRATEGIES)
    assert [row.error for row in (explored, random)] == ["", ""]
    assert explored.coverage > 0.35
    assert random.coverage < explored.coverage
    assert explored.reachable > 0.9
    assert 0.0 < explored.valid_s < 8.0
    assert explored.hausdorff_m < 3.0 * explored.band_m  # a third of the outline has not been touched
    assert explored.e_h_m <= explored.hausdorff_m
    assert (explored.losses, explored.outside, explored.refused, explored.recovered) == (0, 0, 0, True)
    assert math.isnan(random.hausdorff_m)


def test_each_kind_gets_another_object():
    asked = SimpleNamespace(kind="all", seed=10, runs=3, seconds=60.0, imperfections="none", config=None)
    tasks = explore.draw(asked)
    seeds = {kind: {task.seed for task in tasks if task.kind == kind} for kind in KINDS}
    assert {len(each) for each in seeds.values()} == {3}
    assert len(set.union(*seeds.values())) == 12
    assert {task.strategy for task in tasks} == set(STRATEGIES)


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_plans_are_valid_and_last_long_enough(strategy):
    config = default_config()
    limits, goal = motion_limits(config), ExploreGoal(time_limit_s=60.0)
    for seed in range(5):
        spec = exploration_plans.plan(strategy, config, goal, seed)
        assert compile_plan(spec, limits).duration >= 60.0
    assert (exploration_plans.plan(strategy, config, goal, 1) == spec) is (strategy != "random")


# ------------------------------------------------------------------------------------------------ scoring


def instant(t, psi, contacts=(True, True), s=(0.02, 0.03), valid=True):
    truth = {
        "psi_rad": psi, "phi1_rad": 0.5, "phi2_rad": 1.5, "s1_m": s[0], "s2_m": s[1],
        "contact1": contacts[0], "contact2": contacts[1],
    }  # fmt: skip
    return Instant(t, {ESTIMATE.name: {"valid": valid, "object": 1}}, truth)


def watch(**how):
    return ExplorationStatistics(np.ones(BINS, dtype=np.bool_), (0.0555, 0.0555), t_start=100.0, **how)


def test_bins_of_both_normals_are_touched_during_contact():
    both, one = watch(), watch()
    both.take(instant(100.0, psi=0.0))
    one.take(instant(100.0, psi=0.0, contacts=(False, True)))
    # θ1 = 0.5 − π/2 = −61.4°, θ2 = 2 − 3π/2 = −155.4°; bins are 5° wide
    assert set(np.flatnonzero(both.touched)) == {298 // 5, 204 // 5}
    assert set(np.flatnonzero(one.touched)) == {204 // 5}
    assert (both.parted, one.parted, both.on_both, one.on_both) == (0, 1, True, False)


def test_time_to_coverage_counts_only_reachable_normals():
    reachable = np.zeros(BINS, dtype=np.bool_)
    reachable[50:60] = True
    mine = ExplorationStatistics(reachable, (0.0555, 0.0555), t_start=100.0)
    for k in range(400):  # ψ falls by 10° per second: θ1 rises from 298° through the bins from 59
        mine.take(instant(100.0 + 0.01 * k, psi=math.radians(45.0 - 0.15 * k)))
    # bin 50 is touched when θ1 = 298.6° − 45° + 15°/s · t reaches 250°: at once; bin 59 at 295° after 2.76 s
    assert mine.t_enough == pytest.approx((295 - (298.65 - 45.0)) / 15.0, abs=0.02)
    assert mine.coverage == 1.0


def test_a_contact_at_a_pads_end_is_counted():
    for s, ticks in (((0.0004, 0.03), 1), ((0.02, 0.0552), 1), ((0.001, 0.054), 0)):
        mine = watch()
        mine.take(instant(100.0, 0.0, s=s))
        assert mine.at_edge == ticks


def test_the_largest_error_covers_untouched_normals_too():
    theta = np.arange(360) * (math.tau / 360)
    true_h = 0.02 + 1e-3 * np.cos(2 * theta) + 4e-4 * np.sin(3 * theta)
    h = np.roll(true_h, 40)
    h[100] += 2e-4
    shape = {"theta_rad": theta, "h_m": h, "touched": [0] * 360, "h_sd_m": [1e-5] * 360}
    score = watch(shape=shape).outline_score(true_h)
    assert score.max_error == pytest.approx(2e-4, rel=0.02)
    assert score.e_h == pytest.approx(2e-4 / math.sqrt(360), rel=0.05)
    assert watch(shape=shape).largest_sigmas(true_h) == pytest.approx(20.0, rel=0.02)
    shape["h_sd_m"][100] = 1e-4
    assert watch(shape=shape).largest_sigmas(true_h) == pytest.approx(2.0, rel=0.02)
    assert watch().outline_score(true_h) is None
    assert math.isnan(watch().largest_sigmas(true_h))


def test_an_outline_counts_only_while_the_estimate_is_valid():
    mine = watch()
    for t, valid, name in ((100.0, False, "early"), (100.1, True, "good"), (100.2, False, "late")):
        tick = instant(t, 0.0, valid=valid)
        tick.messages[SHAPE.name] = name
        mine.take(tick)
    assert mine.shape == "good"
    assert mine.t_valid == pytest.approx(0.1)


# ------------------------------------------------------------------------------------------------ table


def row(strategy="explore", seed=0, **numbers):
    defaults = {"coverage": 0.97, "enough_s": 12.0, "hausdorff_m": 3e-5, "valid_s": 2.0, "reachable": 1.0}
    return ExploringRow("odd", seed, strategy, **defaults | numbers)


def test_missing_times_count_as_infinite_in_the_table():
    rows = [row(seed=s) for s in range(3)] + [row(seed=3, enough_s=math.nan, coverage=0.4)]
    rows += [row("random", enough_s=math.nan, coverage=0.3)]
    cells = {line[:48].strip(): line[48:].split("  ") for line in STUDY.tabled(rows).splitlines()}
    defaults = {name: [cell.strip() for cell in each if cell.strip()] for name, each in cells.items()}
    assert defaults[""] == ["odd", "odd, random"]
    assert defaults["touched 95 % (% of objects)"] == ["75.0", "0.0"]
    assert defaults["time to 95 %, median / p90 (s)"] == ["12 / ∞", "∞ / ∞"]
    assert defaults["whole outline: largest error, median / p90 (mm)"][0] == "0.03 / 0.03"


def test_remarks_list_only_the_failures():
    bad = [
        row(),
        row("random", seed=1, enough_s=math.nan),
        row(seed=2, enough_s=math.nan, coverage=0.5, reason="the time limit of 60 s is over"),
        row(seed=3, losses=2, parted_s=0.3, recovered=False),
        row(seed=4, outside=1),
        row(seed=5, error="ValueError: no"),
    ]
    assert STUDY.remarks(bad) == [
        "odd 2: touched 50% of the 100% that can be reached (the time limit of 60 s is over)",
        "odd 3: contact lost 2 times, 0.30 s; at a pad's end for 0.00 s; not recovered",
        "odd 4: 1 set-points outside the limits, 0 refused",
        "odd 5: ValueError: no",
    ]


def test_an_unreadable_configuration_is_rejected_before_the_first_run(tmp_path, capsys):
    missing, folder = tmp_path / "no.yaml", tmp_path / "new"
    assert main(["explore", "--config", str(missing), "-o", str(folder)]) == 1
    assert f"{missing}:1:1: no such file" in capsys.readouterr().err
    assert not folder.exists()
