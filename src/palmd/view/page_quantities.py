"""What the page is told of the published quantities, which names none of them and no unit by itself. Pure."""

from __future__ import annotations

import math
from typing import Any

from palmd.quantities import (
    CHARTS,
    CONTACT,
    ESTIMATE,
    LOOP,
    MOTION,
    REPLAY,
    RIG_TOPICS,
    TOPICS,
    Chart,
    Quantity,
    drawn,
    truth_of,
)
from palmd.system.mechanism import JOINTS, PALMS, SIDES


def page_quantities() -> dict[str, Any]:
    """As JSON: how old topics may be, how their quantities are shown, the strips, and what else of an estimate is told.

    `strips` are charts with the names of their quantities; `told` are the quantities to be told as numbers alone;
    `ages` are those of what has been heard last; `system` is what `palm/info` says of the palms, for runs that are
    older than it.
    """
    strips = [chart for chart in CHARTS if chart.span is not None]
    in_strips = {chart.name for chart in strips}
    rated = [topic for topic in (*TOPICS, REPLAY, *RIG_TOPICS) if topic.rate_hz]
    titles = {chart.name: chart.title for chart in CHARTS}
    return {
        "stale_ms": {topic.name: topic.stale_s * 1e3 for topic in rated},
        "shown": {topic.name: _shown(topic.quantities) for topic in (ESTIMATE, CONTACT, MOTION, LOOP)},
        "strips": [_strip(chart) for chart in strips],
        "told": [
            {
                "name": quantity.name,
                "title": titles.get(quantity.chart, quantity.meaning.capitalize()),
                "compared": truth_of(quantity) is not None and quantity.chart != "turn",  # counted from elsewhere
            }
            for quantity in ESTIMATE.quantities
            if quantity.glance and quantity.chart not in in_strips
        ],
        "ages": [
            {"name": quantity.name, "title": quantity.symbol, "palm": quantity.palm}
            for quantity in drawn(CONTACT, chart="age")
        ],
        "system": {"palms": list(PALMS), "joints": list(JOINTS), "sides": list(SIDES)},
    }


def _shown(quantities: tuple[Quantity, ...]) -> dict[str, Any]:
    return {
        quantity.name: {
            "symbol": quantity.symbol,
            "meaning": quantity.meaning,
            "unit": quantity.shown.unit,
            "factor": quantity.shown.factor,
            "digits": quantity.shown.digits,
            "uncertain": quantity.uncertain,
            "truth": None if (topic := truth_of(quantity)) is None else topic.name,
            "colour": f"palm{quantity.palm}" if quantity.palm else "single",
        }
        for quantity in quantities
        if quantity.kind == "number"
    }


def _strip(chart: Chart) -> dict[str, Any]:
    names = [quantity.name for quantity in drawn(ESTIMATE, chart=chart.name)]
    shown = ESTIMATE[names[0]].shown
    told = {"title": chart.title, "group": chart.group, "names": names, "span": chart.span, "low": chart.low}
    good: list[float | None] | None = chart.good and [end if math.isfinite(end) else None for end in chart.good]
    return told | {"good": good, "unit": shown.unit, "factor": shown.factor, "digits": shown.digits}
