"""Whether all that was published in a soak is in its recording, once and in order, and says the same again. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from palmd.record.recheck import Checked
from palmd.record.run import Survey
from tools.studies.soak import SoakFinding, between, told
from tools.studies.soak_watch import Numbers


def recorded(
    surveys: Sequence[Mapping[str, Survey]], heard: Mapping[str, Numbers], published: int
) -> list[SoakFinding]:
    """Of one run's files in their order, beside what we heard on the bus and what the daemon says it published."""
    missing: list[str] = []
    count = 0
    for topic in sorted({topic for survey in surveys for topic in survey} | set(heard)):
        parts = [survey[topic] for survey in surveys if topic in survey]
        ours = topic.startswith("palm/")
        count += sum(part.count for part in parts) if ours else 0
        if not parts:
            missing.append(f"all of {topic}")
            continue
        lost = sum(part.missing for part in parts)
        after = parts[0].first + parts[0].count + parts[0].missing
        for part in parts[1:]:
            lost += part.first - after
            after = part.first + part.count + part.missing
        if ours:
            lost += parts[0].first
        if topic in heard:
            lost += max(0, heard[topic].last + 1 - after)
        if lost:
            missing.append(f"{lost} of {topic}")
    lost_by_us = sum(numbers.missing for numbers in heard.values())
    return [
        told("recording", "files", len(surveys)),
        told("recording", "messages", count),
        between("recording", "topics with gaps", len(missing), 0, 0, why=", ".join(missing[:8])),
        between("recording", "messages published and not recorded", max(0, published - count), 0, 0),
        between("recording", "messages that this bench missed", lost_by_us, 0, 0),
    ]


def replayed(ticks: Iterable[Checked]) -> list[SoakFinding]:
    """Of the first ticks, given to the observer again."""
    count = differ = 0
    for tick in ticks:
        count += 1
        differ += bool(tick.differences)
    return [
        SoakFinding("recording", "ticks replayed", count, "", "> 0", count > 0),
        between("recording", "ticks replayed that differ", differ, 0, 0),
    ]
