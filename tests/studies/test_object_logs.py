"""The study of logs of polygons and dented lumps: what it simulates, and how it counts."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from palmd.config.plans import ExploreGoal
from palmd.console.shipped import shipped
from palmd.events import PadSample, PalmSample
from palmd.rig.dry_plant import DRY
from palmd.rig.world import default_config
from palmd.yamlfile import load_plan
from tools.studies.commands import main
from tools.studies.exploration_plans import plan
from tools.studies.object_logs import KINDS, OFFLINE, SharpRow, SharpTask, draw, simulated


@pytest.mark.nightly
def test_a_task_is_one_log_whose_truth_is_the_hull() -> None:
    (log, truth, _), (again, *_), (other, *_) = (simulated(SharpTask("dent of 10 mm", seed, 0.5)) for seed in (0, 0, 1))
    assert log.events == again.events
    assert log.events != other.events
    slopes = np.diff(np.array(truth["h_m"])) / np.diff(truth["theta_rad"])
    assert 9e-3 < np.abs(slopes[2:] - slopes[:-2]).max() < 14e-3  # h′ jumps by the chord's length


def test_correct_wrong_and_rejected_runs_are_counted_separately() -> None:
    kind = KINDS[0]
    one, two = {"accepted": True, "e_h_m": 9e-5, "most_m": 2e-4}, {"accepted": True, "e_h_m": 2e-4, "most_m": 6e-4}
    rows = [
        SharpRow(kind, 0, sd_m=3e-5, touched=0.1, explained_s=9.0, took_s=4.0, **one),
        SharpRow(kind, 1, sd_m=2e-5, touched=0.2, explained_s=7.0, took_s=6.0, **two),
        SharpRow(kind, 2, reason="why", took_s=30.0),
    ]
    rough = replace(rows[1], imperfections="calibrated", sd_m=9e-5)
    last_line = OFFLINE.tabled(rows).splitlines()[-1]
    assert last_line.split("  ")[0] == kind
    assert re.findall(r"(\d) of 3", last_line) == ["1", "0", "1", "1"]
    assert "6.5 / 10" in last_line
    said = OFFLINE.remarks(rows)
    assert ": right, 90 µm" in said[0]
    assert ": wrong, 200 µm" in said[1]
    assert said[2] == f"{kind} 2: rejected: why"
    assert (rough.right, rough.rough, rough.wrong) == (False, True, False)
    assert replace(rough, sd_m=6e-5).wrong  # 3.3 sd
    assert ": in its band, 200 µm" in OFFLINE.remarks([rough])[0]


def test_a_live_kind_is_rejected_for_logs(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["test-objects", "--offline", "--kind", "coin"]) == 1
    assert "--kind coin is only possible without --offline" in capsys.readouterr().err


def test_an_exploration_records_the_kinds_body_on_the_requested_rig() -> None:
    """Dry palms have dry friction; the recording holds the observer's events and the configured rig."""
    exploring = plan("explore", default_config(), ExploreGoal(), seed=0)
    task = SharpTask("dry lump", 3, 0.4, "calibrated", exploring)
    log, truth, _ = simulated(task)
    pads = {event.pad for event in log.events if isinstance(event, PadSample)}
    assert pads == {1, 2}
    assert any(isinstance(event, PalmSample) for event in log.events)
    assert truth["mass_kg"] == simulated(replace(task, seconds=0.1, plan=None)).truth["mass_kg"]
    assert truth["mu"] == DRY.mu
    assert log.rig.pads[0].standoff_sd > 0.0


def test_the_study_explored_reads_recordings() -> None:
    asked = SimpleNamespace(
        explored=True, plan=None, seconds=None, imperfections="none", kind="dry lump", seed=0, runs=2
    )
    exploring = plan("explore", default_config(), ExploreGoal(coverage=1.0, time_limit_s=20.0), seed=0)
    assert draw(asked) == [SharpTask("dry lump", seed, 20.0, "none", exploring) for seed in (0, 1)]
    with pytest.raises(SystemExit):
        main(["test-objects", "--explored", "--offline"])


def test_a_plan_is_recorded_and_one_beyond_the_limits_is_rejected_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wide = tmp_path / "wide.yaml"
    wide.write_text("name: wide\nsegments:\n  - {move: {phi1_deg: 12, phi2_deg: 170}, duration_s: 2}\n")
    assert main(["test-objects", "--plan", str(wide), "--kind", "die"]) == 1
    assert f"{wide}:3" in capsys.readouterr().err


@pytest.mark.nightly
def test_tipping_shows_several_sides() -> None:
    """A nut, tipped over on one palm and back on the other, shows more than half of its outline in 13 s."""
    moved = simulated(SharpTask("nut", 1, 13.0, plan=load_plan(shipped("plans/tip.yaml"))))
    assert moved.shown > 0.5
