"""Short text of an estimate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from palmd.quantities import Topic


def main_values(topic: Topic, estimate: Mapping[str, Any]) -> str:
    """Main quantities of `topic` that have a value, with their standard deviations, as text."""
    values = []
    for each in topic.quantities:
        if each.glance and estimate[each.name] is not None:
            factor, digits, unit = each.shown.factor, each.shown.digits, each.shown.unit
            sd = estimate["sd"].get(each.name)
            band = "" if sd is None else f" ± {sd * factor:.{digits}f}"
            values.append(f"{each.symbol} {estimate[each.name] * factor:.{digits}f}{band} {unit}".rstrip())
    return ", ".join(values)


def status_of(
    topic: Topic, estimate: Mapping[str, Any], directions: str, label: str, positions: Sequence[str]
) -> list[str]:
    """Status as text lines: the joints' `positions` labelled `label`, validity, and coverage of `directions`."""
    word = "valid" if estimate["valid"] else f"not valid: {estimate['reason']}"
    lines = [f"{label:7} {', '.join(positions)}"] if positions else []
    lines.append(f"object  {word}; {estimate['touched']:.0%} of the {directions} touched")
    values = main_values(topic, estimate)
    return [*lines, f"        {values}"] if values else lines
