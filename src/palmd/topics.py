"""All topics of all systems; each system lists its own, by its row in `palmd.systems`."""

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
"""Topics that the daemon publishes."""

RIG_TOPICS: tuple[Topic, ...] = (
    *(topic for own in SYSTEM_TOPICS.values() for topic in (own.truth, own.body)),
    STALL,
)
"""Topics that an emulated rig publishes: the truth."""


def truth_of(quantity: Quantity) -> Topic | None:
    """The emulated rig's topic with the true value of an estimated quantity, None if there is none."""
    for topic in RIG_TOPICS:
        if quantity.uncertain and any(each.name == quantity.name for each in topic.quantities):
            return topic
    return None
