"""A run through an observer that knows outlines: which object it was in the end, and since when that was said. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from palmd.events import DECIDED, FloatArray, ObjectEstimate

NONE_OF_THESE = "none of these"


@dataclass(frozen=True, slots=True)
class Recognition:
    """What was said at the end of a run.

    names, probability: of each stored outline; none: of none of them. said: the name that has at least `DECIDED`,
    or `NONE_OF_THESE`, empty when nothing has. decided: when that had been said for good (s), NaN when it was not.
    """

    names: tuple[str, ...]
    probability: FloatArray
    none: float
    said: str
    decided: float


def verdict(estimates: Iterable[ObjectEstimate]) -> Recognition | None:
    """The verdict of a run's estimates, in their order; None when there is none."""
    told = list(estimates)
    if not told:
        return None
    last = told[-1]
    said, decided = _said(last), math.nan
    if said:
        for estimate in reversed(told):
            if _said(estimate) != said:
                break
            decided = estimate.t
    return Recognition(last.names, last.probability, last.none, said, decided)


def _said(estimate: ObjectEstimate) -> str:
    return NONE_OF_THESE if estimate.none >= DECIDED else estimate.best


def as_line(verdict: Recognition) -> dict[str, Any]:
    """The verdict as a JSON object; `best` is empty for none of them, and `decided_s` None when nothing was decided."""
    return {
        "names": list(verdict.names),
        "probability": verdict.probability.tolist(),
        "none": verdict.none,
        "best": "" if verdict.said == NONE_OF_THESE else verdict.said,
        "decided_s": None if math.isnan(verdict.decided) else verdict.decided,
    }


def table(verdict: Recognition) -> str:
    """Names and probabilities, the likeliest first, and a line about the decision."""
    order = np.argsort(-verdict.probability, kind="stable")
    rows = [(verdict.names[i], float(verdict.probability[i])) for i in order]
    rows.append((NONE_OF_THESE, verdict.none))
    width = max(len(name) for name, _ in rows)
    lines = [f"{name:{width}}  {probability:.3f}" for name, probability in rows]
    lines.append(f"{verdict.said}, since {verdict.decided:.2f} s" if verdict.said else "undecided")
    return "\n".join(lines)
