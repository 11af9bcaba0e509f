"""Export of a recorded run as an event log."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path

from palmd.jsonvalues import or_none
from palmd.messages import events_of
from palmd.quantities import EVENTS, STAMP, TRUTH
from palmd.record.eventlog import event_line, header_line, line_text
from palmd.record.logline import Line
from palmd.record.run import Run

_STAMP = {field.name for field in STAMP}


def write_log(run: Run, path: Path, done: Callable[[], None]) -> None:
    """Write every event in the order in which the observer received it, interleaved with an emulated rig's truth.

    The format has no line for the end of a contact; it shows as a gap in the readings. `done` is called after each
    message. Raises RunError, OSError.
    """
    run.event_log()  # raises RunError if there is nothing to write
    with path.open("w", encoding="utf-8") as stream:
        stream.write(line_text(header_line(run.rig)))
        for line in _lines(run, done):
            stream.write(line_text(line))


def _lines(run: Run, done: Callable[[], None]) -> Iterator[Line]:
    """Events, each preceded by the truth up to its time; truth messages arrive before the daemon's events."""
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
    values = {name: or_none(value) for name, value in fields.items() if name not in _STAMP}
    return {"t": fields["mono_ns"] * 1e-9, "truth": values}
