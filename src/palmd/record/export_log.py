"""A recorded run as an event log."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path

from palmd.jsonvalues import or_none
from palmd.messages import events_of
from palmd.quantities import EVENTS, STAMP, TRUTH
from palmd.record.eventlog import event_line, header_line
from palmd.record.logline import Line
from palmd.record.run import Run

_STAMP = {field.name for field in STAMP}


def write_log(run: Run, path: Path, done: Callable[[], None]) -> None:
    """Every event in the order in which the observer was fed it, with an emulated rig's truth in between.

    The end of a contact has no form there and shows as the silence that follows it. `done` is called after
    each message. Raises RunError, OSError.
    """
    run.event_log()  # raises RunError when there is nothing to write
    with path.open("w", encoding="utf-8") as stream:
        stream.write(_text(header_line(run.rig)))
        for line in _lines(run, done):
            stream.write(_text(line))


def _lines(run: Run, done: Callable[[], None]) -> Iterator[Line]:
    """Events, each after the truth up to its time; the rig is heard sooner than what the daemon makes of it."""
    truths: deque[Line] = deque()
    for message in run.messages():
        if message.topic == TRUTH.name:
            truths.append(_truth_line(message.fields))
        elif message.topic == EVENTS.name:
            for line in filter(None, map(event_line, events_of(message.fields))):
                while truths and truths[0]["t"] <= line["t"]:
                    yield truths.popleft()
                yield line
        done()
    yield from truths


def _truth_line(fields: Line) -> Line:
    told = {name: or_none(value) for name, value in fields.items() if name not in _STAMP}
    return {"t": fields["mono_ns"] * 1e-9, "truth": told}


def _text(line: Line) -> str:
    return json.dumps(line, allow_nan=False, separators=(",", ":")) + "\n"
