"""The verdict on a result: `accepted`, `partial` or `rejected`. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from palmd.observer.visits import Marks
from palmd.system.reasons import Code, Reason

ACCEPTED, PARTIAL, REJECTED = "accepted", "partial", "rejected"
MIN_COVERAGE = 0.10
"""Smallest fraction of the normals that an accepted result covers (convention)."""


def verdict(explained: bool, touched: Marks | None, reason: Reason) -> dict[str, Any]:
    """The fields `verdict`, `converged`, `coverage` (0 to 1), `reason` and `reason_code` of a result.

    explained: whether the readings are explained to within their noise. touched: whether each normal was touched, None
    without an outline. `converged` is True for accepted results only.
    """
    coverage = 0.0 if touched is None else float(np.mean(touched))
    found = (ACCEPTED if coverage >= MIN_COVERAGE else PARTIAL) if explained else REJECTED
    if found == PARTIAL:
        reason = Reason(
            Code.LOW_COVERAGE,
            f"only {coverage:.1%} of the normals were touched, and the estimate holds for these; at least"
            f" {MIN_COVERAGE:.0%} are needed: move the palms so that the object rolls farther",
        )
    why = {"reason": reason or None, "reason_code": reason.code or None}
    return {"verdict": found, "converged": found == ACCEPTED, "coverage": coverage, **why}


def in_one_line(line: Mapping[str, Any], summary: str) -> str:
    """A result in one line for people; `summary` describes its estimate, if it has one."""
    if line["verdict"] == REJECTED:
        return f"not converged: {line['reason']}"
    return summary if line["verdict"] == ACCEPTED else f"partial: {line['reason']}; {summary}"


def has_estimate(line: Mapping[str, Any]) -> bool:
    """Whether a result, of this version or an older one, holds an estimate of at least part of an object."""
    return bool(line.get("converged")) or line.get("verdict") == PARTIAL
