"""The study of the pivoting grasp: the row of a run, and the table of rows."""

import dataclasses
import json
import math

import pytest

from tools.studies import pivot
from tools.studies.harness import as_line
from tools.studies.pivot import LIVE, OFFLINE, LiveRow, PivotRow, PivotTask
from tools.studies.pivot_logs import simulate_pivot_log

ROW = PivotRow("tilt", 1, 12.0, "none", "", True, "", 2e-5, 1e-5, 0.004, 2.0, 0.4, 1.0, 0.5)


def row(**changes):
    return dataclasses.replace(ROW, **changes)


def test_a_real_run_is_correct_and_its_errors_agree_with_its_standard_deviations():
    result = pivot.run(PivotTask("tilt", 3, 12.0, "none"))
    assert (result.kind, result.seed, result.converged, result.reason) == ("tilt", 3, True, "")
    assert result.e_m < pivot.RIGHT_M
    assert 0.2 < result.e_m / result.sd_m < 4.0
    assert abs(result.mu_z) < 4.0
    assert 0.0 < result.mu_error / result.mu_z < 0.05  # its 1σ


def test_a_short_run_is_rejected_with_a_reason():
    result = pivot.run(PivotTask("tilt", 3, 2.5, "none"))
    assert not result.converged
    assert result.reason
    assert math.isnan(result.e_m)
    assert json.loads(json.dumps(as_line(result), allow_nan=False))["e_m"] is None


def test_wrong_accepted_runs_are_counted_separately_and_rejected_runs_are_excluded():
    wrong = row(seed=2, e_m=3e-4, sd_m=1e-4, mu_error=-0.02, mu_z=-4.0)
    refused = row(seed=3, converged=False, reason="no", e_m=math.nan, sd_m=math.nan, mu_error=math.nan, mu_z=math.nan)
    head, tilt, spoilt = OFFLINE.tabled([ROW, wrong, refused, row(trouble="gaps", converged=False)]).splitlines()
    assert head.split()[:3] == ["runs", "right", "accepted,"]
    # 3 runs, 1 correct, 1 wrong; medians of 20 and 300 µm; √((2² + 3²)/2); of 0.004 and 0.02; √((2² + 4²)/2)
    assert tilt.split() == ["tilt", "3", "1", "1", "160", "272", "2.55", "0.012", "50.0", "3.16"]
    assert spoilt.split() == ["tilt,", "gaps", "1", "0", "0", *["–"] * 6]


GOOD = LiveRow(
    7, "calibrated", 5.0, accepted=True, ended="done", t_end=90.0, t_accepted=50.0, e=2e-5, most=4e-5, sd=3e-5,
    touched=0.7, worst_e=5e-5, worst_z=1.2, acceptances=4, mu_error=0.002, mu_z=0.5, ticks=9000, valid=4000,
    most_force=1.2,
    force_limit=2.0,
)  # fmt: skip


def test_correct_and_wrong_live_runs():
    assert GOOD.right
    assert not GOOD.accepted_wrong
    assert dataclasses.replace(GOOD, worst_z=3.5).accepted_wrong
    assert dataclasses.replace(GOOD, worst_e=4e-4).accepted_wrong
    assert not dataclasses.replace(GOOD, accepted=False).right
    assert not LiveRow(7, "calibrated", 5.0, error="no").accepted_wrong


def test_the_table_of_live_runs_counts_them():
    wrong = dataclasses.replace(GOOD, seed=8, e=4e-4, worst_e=4e-4)
    slide = dataclasses.replace(GOOD, vertical="float", left=3, jams=2, most_force=2.3)
    rows = [GOOD, wrong, slide, LiveRow(9, "none", 5.0, error="no")]
    _, calibrated, sliding, perfect = (line.split() for line in LIVE.tabled(rows).splitlines())
    assert sliding[:5] == ["calibrated,", "slide", "1", "1", "0"]
    assert calibrated[:5] == ["calibrated", "2", "1", "0", "1"]
    assert perfect[:5] == ["none", "1", "0", "1", "0"]
    assert sliding[-6:-2] == ["1", "1", "1", "2.3"], "one left the pad, one jammed, one over its limit"
    assert calibrated[-6:-2] == ["0", "0", "0", "1.2"]
    assert "error 400 µm" in LIVE.remarks([wrong])[0]


@pytest.mark.parametrize("kind", ["tilt", "float"])
def test_a_run_too_short_for_a_drag_is_rejected_with_a_message(kind):
    with pytest.raises(ValueError, match="at least 2 s"):
        simulate_pivot_log(kind, 3, 0.5)
