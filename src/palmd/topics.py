"""All topics of all systems: each tells its own, by its row in `palmd.systems`."""

from __future__ import annotations

from collections.abc import Mapping

from palmd.quantities import CONFIG, LOG, LOOP, NOTE, RIG, STALL, STATE, Quantity, SystemTopics, Topic
from palmd.systems import LIVE, load_part

SYSTEM_TOPICS: Mapping[str, SystemTopics] = {name: load_part(live.topics) for name, live in LIVE.items()}
"""By the system's name."""

TOPICS: tuple[Topic, ...] = (
    *(topic for own in SYSTEM_TOPICS.values() for topic in own.published),
    *(STATE, LOOP, RIG, NOTE, LOG, CONFIG),
)
"""What the daemon publishes."""

RIG_TOPICS: tuple[Topic, ...] = (
    *(topic for own in SYSTEM_TOPICS.values() for topic in (own.truth, own.body)),
    STALL,
)
"""What an emulated rig publishes besides: what is really there."""


def truth_of(quantity: Quantity) -> Topic | None:
    """Which of the emulated rig's topics tells the truth of an estimated quantity, None where neither does."""
    for topic in RIG_TOPICS:
        if quantity.uncertain and any(each.name == quantity.name for each in topic.quantities):
            return topic
    return None
