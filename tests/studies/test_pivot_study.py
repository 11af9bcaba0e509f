"""The study of the pivoting grasp: what a row says of a run, and what the table makes of rows."""

import dataclasses
import json
import math

import pytest

from palmd.rig.pivot import simulate_pivot_log
from tools.studies import pivot
from tools.studies.pivot import PivotRow, PivotTask
from tools.studies.scoring import as_line

ROW = PivotRow("tilt", 1, 12.0, "none", True, "", 2e-5, 1e-5, 0.004, 2.0, 0.4, 1.0, 0.5)


def row(**changes):
    return dataclasses.replace(ROW, **changes)


def test_a_real_run_is_right_and_its_errors_are_in_units_of_what_it_claims():
    told = pivot.run(PivotTask("tilt", 3, 12.0, "none"))
    assert (told.kind, told.seed, told.converged, told.reason) == ("tilt", 3, True, "")
    assert told.e_m < pivot.RIGHT_M
    assert 0.2 < told.e_m / told.sd_m < 4.0
    assert abs(told.mu_z) < 4.0
    assert 0.0 < told.mu_error / told.mu_z < 0.05  # its one-sigma


def test_a_run_too_short_claims_nothing_and_says_why():
    told = pivot.run(PivotTask("tilt", 3, 2.5, "none"))
    assert not told.converged
    assert told.reason
    assert math.isnan(told.e_m)
    assert json.loads(json.dumps(as_line(told), allow_nan=False))["e_m"] is None


def test_an_error_of_ours_is_a_row():
    told = pivot.failed(PivotTask("float", 7, 1.0, "gaps"), ZeroDivisionError("a defect"))
    assert (told.kind, told.seed, told.trouble, told.converged) == ("float", 7, "gaps", False)
    assert told.reason == "ZeroDivisionError: a defect"


def test_what_is_claimed_and_wrong_is_counted_apart_and_refused_runs_are_in_no_figure():
    wrong = row(seed=2, e_m=3e-4, sd_m=1e-4, mu_error=-0.02, mu_z=-4.0)
    refused = row(seed=3, converged=False, reason="no", e_m=math.nan, sd_m=math.nan, mu_error=math.nan, mu_z=math.nan)
    head, spoilt, tilt = pivot.report([ROW, wrong, refused, row(trouble="gaps", converged=False)]).splitlines()
    assert head.split()[:3] == ["runs", "right", "wrong"]
    # 3 runs, 1 right, 1 wrong; medians of 20 and 300 µm; √((2² + 3²)/2); of 0.004 and 0.02; √((2² + 4²)/2)
    assert tilt.split() == ["tilt", "3", "1", "1", "160.0", "272.0", "2.55", "0.0120", "50%", "3.16"]
    assert spoilt.split() == ["tilt,", "gaps", "1", "0", "0"]


@pytest.mark.parametrize("kind", ["tilt", "float"])
def test_a_run_too_short_for_a_drag_is_refused_in_words(kind):
    with pytest.raises(ValueError, match="a run lasts 2 s at least"):
        simulate_pivot_log(kind, 3, 0.5)
