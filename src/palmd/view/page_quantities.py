"""What the page is told of the published quantities, which names none of them and no unit by itself. Pure."""

from __future__ import annotations

import math
from dataclasses import asdict, fields
from typing import Any

from palmd.quantities import (
    CHARTS,
    CONTACT,
    ESTIMATE,
    LOOP,
    MOTION,
    REPLAY,
    Chart,
    Quantity,
    Shown,
    Topic,
    drawn,
)
from palmd.system.mechanism import JOINTS, PALMS, SIDES
from palmd.systems import LIVE, TWO_PALMS
from palmd.three_palms_quantities import PALM3, PALM3_CONTACT
from palmd.topics import RIG_TOPICS, SYSTEM_TOPICS, TOPICS, truth_of

FOLLOWING = "following_error_rad"
"""A list in a motion message, one for each joint; its limits are `following_limit_rad`. Old daemons have neither."""
_FOLLOWING_SHOWN = Shown("°", math.degrees(1.0), 2)
_JOINTS_MOST = 3
_FORCE_LIMIT = {"topic": "palm/info", "name": "force_limit_n"}

ESTIMATES = (ESTIMATE, PALM3)
"""Those that have quantities of their own; a pivoting grasp's are among two palms'."""
_AS = {
    getattr(topics, field.name).name: getattr(SYSTEM_TOPICS[TWO_PALMS], field.name).name
    for topics in SYSTEM_TOPICS.values()
    for field in fields(topics)
    if field.name != "extra"
}


def page_quantities() -> dict[str, Any]:
    """As JSON: how old topics may be, how their quantities are shown, the strips, and what else of an estimate is told.

    `as` says under which topic of two palms the page keeps each system's; what is `shown` under it are the quantities
    of all systems. `strips` are charts with the names of their quantities and a colour for each; `told` are the
    quantities to be told as numbers alone; `ages` are those of what has been heard last; `usual` is what there is
    before anything has been heard; `system` is what `palm/info` says of the palms, for runs that are older than it.
    `listed` are the quantities that are taken from lists; `shows` is what a demo of each system shows, in a sentence.
    """
    strips = [_strip(topic, chart) for topic in ESTIMATES for chart in CHARTS if chart.span is not None]
    in_strips = {chart.name for chart in CHARTS if chart.span is not None}
    rated = [topic for topic in (*TOPICS, REPLAY, *RIG_TOPICS) if topic.rate_hz]
    titles = {chart.name: chart.title for chart in CHARTS}
    told = {quantity.name: quantity for topic in reversed(ESTIMATES) for quantity in topic.quantities}
    ages = {quantity.name: quantity for topic in (CONTACT, PALM3_CONTACT) for quantity in drawn(topic, chart="age")}
    return {
        "as": _AS,
        "listed": [
            {"name": name, "topic": MOTION.name, "list": FOLLOWING, "index": index}
            for index, name in enumerate(_following()["names"])
        ],
        "shows": {"" if name == TWO_PALMS else name: live.shows for name, live in LIVE.items()},
        "stale_ms": {topic.name: topic.stale_s * 1e3 for topic in rated},
        "shown": {
            ESTIMATE.name: _shown(PALM3) | _shown(ESTIMATE) | _listed(),
            CONTACT.name: _formats(PALM3_CONTACT) | _formats(CONTACT),
            **{topic.name: _formats(topic) for topic in (MOTION, LOOP)},
        },
        "strips": [strip for i, strip in enumerate(strips) if strip["names"] and strip not in strips[:i]]
        + [_following()],
        "told": [
            {
                "name": quantity.name,
                "title": titles.get(quantity.chart, quantity.meaning.capitalize()),
                "compared": truth_of(quantity) is not None and quantity.chart != "turn",  # counted from elsewhere
            }
            for topic in ESTIMATES
            for quantity in topic.quantities
            if quantity.glance and quantity.chart not in in_strips and told[quantity.name] is quantity
        ],
        "ages": [
            {"name": quantity.name, "title": quantity.symbol, "palm": quantity.palm} for quantity in ages.values()
        ],
        "usual": [quantity.name for topic in (ESTIMATE, CONTACT) for quantity in topic.quantities],
        "system": {"palms": list(PALMS), "joints": list(JOINTS), "sides": list(SIDES)},
    }


def _formats(topic: Topic) -> dict[str, dict[str, Any]]:
    """How its numbers are written."""
    return {quantity.name: asdict(quantity.shown) for quantity in topic.quantities if quantity.kind == "number"}


def _shown(topic: Topic) -> dict[str, Any]:
    """How its numbers are written, what they are called and mean, and what they are compared with."""
    formats = _formats(topic)
    return {
        quantity.name: {"symbol": quantity.symbol, "meaning": quantity.meaning}
        | formats[quantity.name]
        | ({"uncertain": True} if quantity.uncertain else {})
        | ({} if (truth := truth_of(quantity)) is None else {"truth": _AS[truth.name]})
        for quantity in topic.quantities
        if quantity.name in formats
    }


def _strip(topic: Topic, chart: Chart) -> dict[str, Any]:
    quantities = list(drawn(topic, chart=chart.name))
    told: dict[str, Any] = {"title": chart.title, "group": chart.group, "span": chart.span, "low": chart.low}
    told |= {"names": [each.name for each in quantities], "colours": _colours(quantities)}
    good: list[float | None] | None = chart.good and [end if math.isfinite(end) else None for end in chart.good]
    shown = quantities[0].shown if quantities else None
    limit = {"limit": _FORCE_LIMIT} if chart.name == "force" else {}
    return told | {"good": good} | limit | ({} if shown is None else asdict(shown))


def _following() -> dict[str, Any]:
    """The strip of the following errors, which are a list in a message."""
    names = [f"{FOLLOWING} {joint}" for joint in range(1, 1 + _JOINTS_MOST)]
    limit = {"topic": MOTION.name, "name": "following_limit_rad", "listed": FOLLOWING}
    title = "Following error, with its limit"
    strip = {"title": title, "group": "Palms", "span": 1.0, "low": None, "good": None, "limit": limit}
    return (
        strip
        | {"names": names, "colours": [f"palm{joint}" for joint in range(1, 1 + _JOINTS_MOST)]}
        | asdict(_FOLLOWING_SHOWN)
    )


def _listed() -> dict[str, Any]:
    return {
        name: {"symbol": f"e{chr(ord('₀') + joint)}", "meaning": f"following error of joint {joint}"}
        | asdict(_FOLLOWING_SHOWN)
        for joint, name in enumerate(_following()["names"], start=1)
    }


def _colours(quantities: list[Quantity]) -> list[str]:
    """That of each one's palm; of several which are of no palm, that of the place."""
    numbers = [each.palm or (i if len(quantities) > 1 else 0) for i, each in enumerate(quantities, start=1)]
    return [f"palm{number}" if number else "single" for number in numbers]
