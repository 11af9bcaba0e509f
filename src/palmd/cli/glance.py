"""An estimate's first look in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from palmd.quantities import Topic


def known_in_words(topic: Topic, told: Mapping[str, Any]) -> str:
    """Those quantities of `topic` that are told at a glance and have a value, with their bands."""
    known = []
    for each in topic.quantities:
        if each.glance and told[each.name] is not None:
            factor, digits, unit = each.shown.factor, each.shown.digits, each.shown.unit
            sd = told["sd"].get(each.name)
            band = "" if sd is None else f" ± {sd * factor:.{digits}f}"
            known.append(f"{each.symbol} {told[each.name] * factor:.{digits}f}{band} {unit}".rstrip())
    return ", ".join(known)


def status_of(topic: Topic, told: Mapping[str, Any], felt: str, where: str, places: Sequence[str]) -> list[str]:
    """A status in lines: the joints' `places` under the word `where`, and how far the object is known and `felt`."""
    word = "valid" if told["valid"] else f"not valid: {told['reason']}"
    lines = [f"{where:7} {', '.join(places)}"] if places else []
    lines.append(f"object  {word}; {told['touched']:.0%} of the {felt} felt")
    known = known_in_words(topic, told)
    return [*lines, f"        {known}"] if known else lines
