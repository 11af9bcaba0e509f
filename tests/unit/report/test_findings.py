"""The verdict on a run: findings in order of severity, each with advice, and test ratios."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic_runs

from palmd.report import texts
from palmd.report.findings import LEVELS, verdict_of
from palmd.report.series import FOLLOWING_RATIO, FaultInterval, Series, TopicSeries


@pytest.fixture(scope="module")
def series(tmp_path_factory) -> Series:
    return synthetic_runs.series(tmp_path_factory.mktemp("run"), synthetic_runs.messages(2.0))


def changed(series: Series, topic: str, **columns: np.ndarray) -> Series:
    track: TopicSeries = getattr(series, topic)
    return replace(series, **{topic: TopicSeries(track.t, {**track.columns, **columns})})


def good(series: Series) -> Series:
    """The made-up run without faults, and valid throughout."""
    ones = np.ones(len(series.estimate.t))
    calm = replace(series, faults=(), rig_deviations=None, counts={**series.counts, "overruns": 0.0})
    return changed(calm, "estimate", valid=ones, nis=ones)


def test_a_run_without_failures_is_good(series) -> None:
    verdict = verdict_of(good(series))
    assert verdict.word == "good"
    assert texts.verdict(verdict) == "good: nothing failed"


def test_a_run_without_a_valid_estimate_has_failed_with_its_reasons(series) -> None:
    run = changed(good(series), "estimate", valid=np.zeros(len(series.estimate.t)))
    run = replace(run, invalid_reasons={"rig-unknown": 7, "the-readings-tell-too-little-of-it": 3, "third": 1})
    verdict = verdict_of(run)
    assert verdict.word == "failed"
    assert "rig-unknown and the readings tell too little of it" in verdict.findings[0].what
    assert "palmd reconstruct" in verdict.findings[0].action


def test_no_action_is_a_command_that_refuses_the_runs_system(series, monkeypatch) -> None:
    monkeypatch.setattr(type(series.run), "system", "pivot")
    for valid in (np.zeros(len(series.estimate.t)), (series.estimate.t < 1.0).astype(float)):
        action = verdict_of(changed(good(series), "estimate", valid=valid)).findings[0].action
        assert action
        assert "palmd reconstruct" not in action


def test_a_moment_without_a_valid_estimate_at_the_end_is_no_loss(series) -> None:
    valid = np.ones(len(series.estimate.t))
    valid[-10:] = 0.0
    verdict = verdict_of(changed(good(series), "estimate", valid=valid))
    assert not any("lost at the end" in each.what for each in verdict.findings)


def test_an_object_lost_at_the_end_outweighs_a_hold(series) -> None:
    valid = np.ones(len(series.estimate.t))
    valid[-70:] = 0.0
    hold = FaultInterval("pad1-lifted", "hold", "put the object back", 0.5, 0.7)
    verdict = verdict_of(replace(changed(good(series), "estimate", valid=valid), faults=(hold, hold)))
    first, *others = verdict.findings
    assert "lost at the end" in first.what
    assert [LEVELS.index(each.level) for each in verdict.findings] == sorted(
        LEVELS.index(each.level) for each in verdict.findings
    )
    (held,) = [each for each in others if each.what.startswith("pad1-lifted")]
    assert "2 times, 0.4 s in total" in held.what
    assert held.action == "put the object back"


@pytest.mark.parametrize(
    ("topic", "column", "value", "ratio"),
    [
        ("estimate", "nis", 3.0, 1.5),
        ("motion", FOLLOWING_RATIO, 1.25, 1.25),
        ("loop", "lateness_p99_ms", 6.0, 3.0),
        ("loop", "work_p99_ms", 10.0, 2.0),
    ],
)
def test_an_exceeded_limit_is_a_finding_with_an_action(series, topic, column, value, ratio) -> None:
    run = good(series)
    verdict = verdict_of(changed(run, topic, **{column: np.full(len(getattr(run, topic).t), value)}))
    assert verdict.word == "impaired"
    assert verdict.ratios[0].ratio == pytest.approx(ratio)
    (found,) = [each for each in verdict.findings if each.what.startswith(verdict.ratios[0].name)]
    assert found.action
    assert texts.ratios(verdict).rows[0][-1] == "failed"
