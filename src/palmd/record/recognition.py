"""Recognition of stored outlines in a run: the final decision and the time since when it held. Pure."""

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
    """Recognition at the end of a run.

    names, probability: of each stored outline; none: probability of none of them. decision: the name with a probability
    of at least `DECIDED`, or `NONE_OF_THESE`, or empty. decided_at: time (s) since when the decision has held without
    interruption, NaN without a decision.
    """

    names: tuple[str, ...]
    probability: FloatArray
    none: float
    decision: str
    decided_at: float


def verdict(estimates: Iterable[ObjectEstimate]) -> Recognition | None:
    """The recognition from a run's estimates in time order; None if there are none."""
    history = list(estimates)
    if not history:
        return None
    last = history[-1]
    decision, decided_at = _decision(last), math.nan
    if decision:
        for estimate in reversed(history):
            if _decision(estimate) != decision:
                break
            decided_at = estimate.t
    return Recognition(last.names, last.probability, last.none, decision, decided_at)


def _decision(estimate: ObjectEstimate) -> str:
    return NONE_OF_THESE if estimate.none >= DECIDED else estimate.best


def as_line(verdict: Recognition) -> dict[str, Any]:
    """The verdict as a JSON object; `best` is empty for none of them, `decided_s` None without a decision."""
    return {
        "names": list(verdict.names),
        "probability": verdict.probability.tolist(),
        "none": verdict.none,
        "best": "" if verdict.decision == NONE_OF_THESE else verdict.decision,
        "decided_s": None if math.isnan(verdict.decided_at) else verdict.decided_at,
    }


def table(verdict: Recognition) -> str:
    """A text table of names and probabilities, most probable first, and a line with the decision."""
    order = np.argsort(-verdict.probability, kind="stable")
    rows = [(verdict.names[i], float(verdict.probability[i])) for i in order]
    rows.append((NONE_OF_THESE, verdict.none))
    width = max(len(name) for name, _ in rows)
    lines = [f"{name:{width}}  {probability:.3f}" for name, probability in rows]
    lines.append(f"{verdict.decision}, since {verdict.decided_at:.2f} s" if verdict.decision else "undecided")
    return "\n".join(lines)
