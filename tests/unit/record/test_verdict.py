"""The verdict on a result: an object, a part of it, or rejected."""

from __future__ import annotations

import numpy as np
import pytest

from palmd.record.verdict import has_estimate, in_one_line, verdict
from palmd.system.reasons import NO_REASON, Code, Reason


@pytest.mark.parametrize(
    ("explained", "share", "said"),
    [(True, 0.3, "accepted"), (True, 0.1, "accepted"), (True, 0.075, "partial"), (False, 0.3, "rejected")],
)
def test_an_object_with_enough_coverage_is_accepted(explained: bool, share: float, said: str) -> None:
    touched = np.arange(360) < 360 * share
    line = verdict(explained, touched, NO_REASON if explained else Reason(Code.UNEXPLAINED, "it slid away"))
    assert line["verdict"] == said
    assert line["converged"] is (said == "accepted")
    assert line["coverage"] == pytest.approx(share, abs=1e-9)
    assert (line["reason"] is None) == (line["reason_code"] is None) == (said == "accepted")
    assert has_estimate(line) == explained


def test_a_partial_outline_has_a_reason_and_advice() -> None:
    line = verdict(True, np.arange(360) < 20, NO_REASON)
    assert "5.6%" in line["reason"]
    assert line["reason_code"] == "low-coverage"
    assert in_one_line(line, "outline 9 um").endswith("outline 9 um")


def test_a_run_without_any_outline_is_rejected() -> None:
    line = verdict(False, None, Reason(Code.UNDETERMINED, "too little"))
    assert (line["verdict"], line["coverage"], line["converged"]) == ("rejected", 0.0, False)


def test_results_of_older_versions_have_only_converged() -> None:
    assert has_estimate({"converged": True})
    assert not has_estimate({"converged": False})
