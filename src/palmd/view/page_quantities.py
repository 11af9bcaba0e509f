"""Table of the published quantities for the page, whose scripts name no quantity or unit themselves. Pure."""

from __future__ import annotations

import math
from dataclasses import asdict, fields
from typing import Any

from palmd.aliases import aliases_of
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
"""A list in a motion message, one value per joint; its limits are `following_limit_rad`. Old daemons have neither."""
_FOLLOWING_SHOWN = Shown("°", math.degrees(1.0), 2)
_MAX_JOINTS = 3
_FORCE_LIMIT = {"topic": "palm/info", "name": "force_limit_n"}

ESTIMATES = (ESTIMATE, PALM3)
"""Estimate topics with their own quantities; those of a pivoting grasp are a subset of two palms'."""
_COMMON_TOPIC = {
    getattr(topics, field.name).name: getattr(SYSTEM_TOPICS[TWO_PALMS], field.name).name
    for topics in SYSTEM_TOPICS.values()
    for field in fields(topics)
    if field.name != "extra"
}


def page_quantities() -> dict[str, Any]:
    """The table as JSON.

    as: the topic of two palms under which the page stores each system's topic. listed: quantities that are elements of
    lists. shows: a sentence on the demo of each system. stale_ms: largest age of topics. former: standard names by
    former names, by topic. shown: presentation of the quantities of all systems, by topic. strips: charts with their
    quantities and colours. numbers: quantities shown as numbers only. ages: quantities with the age of data. usual:
    quantities assumed before the first message. system: description of the palms for runs without `palm/info`.
    """
    strips = [_strip(topic, chart) for topic in ESTIMATES for chart in CHARTS if chart.span is not None]
    in_strips = {chart.name for chart in CHARTS if chart.span is not None}
    rated = [topic for topic in (*TOPICS, REPLAY, *RIG_TOPICS) if topic.rate_hz]
    titles = {chart.name: chart.title for chart in CHARTS}
    by_name = {quantity.name: quantity for topic in reversed(ESTIMATES) for quantity in topic.quantities}
    ages = {quantity.name: quantity for topic in (CONTACT, PALM3_CONTACT) for quantity in drawn(topic, chart="age")}
    return {
        "as": _COMMON_TOPIC,
        "listed": [
            {"name": name, "topic": MOTION.name, "list": FOLLOWING, "index": index}
            for index, name in enumerate(_following_strip()["names"])
        ],
        "shows": {"" if name == TWO_PALMS else name: live.shows for name, live in LIVE.items()},
        "stale_ms": {topic.name: topic.stale_s * 1e3 for topic in rated},
        "former": {
            topic.name: {each.former: each.standard for each in aliases}
            for topic in TOPICS
            if (aliases := aliases_of(topic.name))
        },
        "shown": {
            ESTIMATE.name: _presentation(PALM3) | _presentation(ESTIMATE) | _list_formats(),
            CONTACT.name: _formats(PALM3_CONTACT) | _formats(CONTACT),
            **{topic.name: _formats(topic) for topic in (MOTION, LOOP)},
        },
        "strips": [strip for i, strip in enumerate(strips) if strip["names"] and strip not in strips[:i]]
        + [_following_strip()],
        "numbers": [
            {
                "name": quantity.name,
                "title": titles.get(quantity.chart, quantity.meaning.capitalize()),
                "compared": truth_of(quantity) is not None and quantity.chart != "turn",  # relative to another zero
            }
            for topic in ESTIMATES
            for quantity in topic.quantities
            if quantity.glance and quantity.chart not in in_strips and by_name[quantity.name] is quantity
        ],
        "ages": [
            {"name": quantity.name, "title": quantity.symbol, "palm": quantity.palm} for quantity in ages.values()
        ],
        "usual": [quantity.name for topic in (ESTIMATE, CONTACT) for quantity in topic.quantities],
        "system": {"palms": list(PALMS), "joints": list(JOINTS), "sides": list(SIDES)},
    }


def _formats(topic: Topic) -> dict[str, dict[str, Any]]:
    """Number formats of a topic's quantities."""
    return {quantity.name: asdict(quantity.shown) for quantity in topic.quantities if quantity.kind == "number"}


def _presentation(topic: Topic) -> dict[str, Any]:
    """Number format, symbol, meaning and truth topic of a topic's quantities."""
    formats = _formats(topic)
    return {
        quantity.name: {"symbol": quantity.symbol, "meaning": quantity.meaning}
        | formats[quantity.name]
        | ({"uncertain": True} if quantity.uncertain else {})
        | ({} if (truth := truth_of(quantity)) is None else {"truth": _COMMON_TOPIC[truth.name]})
        for quantity in topic.quantities
        if quantity.name in formats
    }


def _strip(topic: Topic, chart: Chart) -> dict[str, Any]:
    quantities = list(drawn(topic, chart=chart.name))
    strip: dict[str, Any] = {"title": chart.title, "group": chart.group, "span": chart.span, "low": chart.low}
    strip |= {"names": [each.name for each in quantities], "colours": _colours(quantities)}
    good: list[float | None] | None = chart.good and [end if math.isfinite(end) else None for end in chart.good]
    shown = quantities[0].shown if quantities else None
    limit = {"limit": _FORCE_LIMIT} if chart.name == "force" else {}
    return strip | {"good": good} | limit | ({} if shown is None else asdict(shown))


def _following_strip() -> dict[str, Any]:
    """The strip of the following errors, which are published as a list."""
    names = [f"{FOLLOWING} {joint}" for joint in range(1, 1 + _MAX_JOINTS)]
    limit = {"topic": MOTION.name, "name": "following_limit_rad", "listed": FOLLOWING}
    title = "Following error, with its limit"
    strip = {"title": title, "group": "Palms", "span": 1.0, "low": None, "good": None, "limit": limit}
    return (
        strip
        | {"names": names, "colours": [f"palm{joint}" for joint in range(1, 1 + _MAX_JOINTS)]}
        | asdict(_FOLLOWING_SHOWN)
    )


def _list_formats() -> dict[str, Any]:
    return {
        name: {"symbol": f"e{chr(ord('₀') + joint)}", "meaning": f"following error of joint {joint}"}
        | asdict(_FOLLOWING_SHOWN)
        for joint, name in enumerate(_following_strip()["names"], start=1)
    }


def _colours(quantities: list[Quantity]) -> list[str]:
    """The colour of each quantity's palm; without a palm, by position among several quantities."""
    numbers = [each.palm or (i if len(quantities) > 1 else 0) for i, each in enumerate(quantities, start=1)]
    return [f"palm{number}" if number else "single" for number in numbers]
