"""What a soak has found: one finding for each thing looked at, and all of them as a table. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from palmd.console.columns import aligned
from palmd.jsonvalues import or_none

JUDGED_FROM_S = 1800.0
"""A shorter soak cannot tell a leak or a drift from the noise; its slopes are told and not judged."""


@dataclass(frozen=True, slots=True)
class SoakFinding:
    """One thing looked at: the figure, what it must be, and whether it is; None where that is not judged.

    `group` is one of `leak`, `lateness`, `counters`, `recording`, `behaviour`.
    """

    group: str
    name: str
    value: float
    unit: str
    goal: str
    met: bool | None
    why: str = ""


def at_most(group: str, name: str, value: float, most: float, unit: str = "", why: str = "") -> SoakFinding:
    """A figure that must not exceed `most`; one that is not there has not met its goal."""
    return SoakFinding(group, name, value, unit, f"≤ {most:g}", value <= most, why)


def between(
    group: str, name: str, value: float, least: float, most: float, unit: str = "", why: str = ""
) -> SoakFinding:
    """A figure that must lie between two, both included."""
    goal = f"= {least:g}" if least == most else f"{least:g} to {most:g}"
    return SoakFinding(group, name, value, unit, goal, least <= value <= most, why)


def told(group: str, name: str, value: float, unit: str = "") -> SoakFinding:
    """A figure without a goal."""
    return SoakFinding(group, name, value, unit, "", None)


def all_met(findings: Sequence[SoakFinding]) -> bool:
    """Whether there is anything, and nothing has missed its goal."""
    return bool(findings) and all(finding.met is not False for finding in findings)


def as_line(finding: SoakFinding) -> dict[str, Any]:
    """One finding for JSON."""
    return {
        "group": finding.group,
        "name": finding.name,
        "value": or_none(finding.value),
        "unit": finding.unit,
        "goal": finding.goal,
        "met": finding.met,
        "why": finding.why,
    }


def table(findings: Sequence[SoakFinding]) -> str:
    """One line a finding."""
    verdict = {True: "met", False: "MISSED", None: "-"}
    head = ("finding", ("value", "unit", "goal", "verdict"))
    rows = [
        (f"{each.group}: {each.name}", (f"{each.value:.6g}", each.unit, each.goal, verdict[each.met]))
        for each in findings
    ]
    why = [f"  {each.name}: {each.why}" for each in findings if each.met is False and each.why]
    return "\n".join([aligned([head, *rows]), *why])
