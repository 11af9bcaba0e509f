"""An estimate's first look in words."""

from __future__ import annotations

from collections.abc import Mapping
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
