"""Export of a recorded run to the formats of other programs; an output is written completely or not at all."""

from __future__ import annotations

import shutil
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Literal, get_args

from palmd.jsonvalues import or_none
from palmd.messages import Fields, events_of
from palmd.quantities import EVENTS, STAMP, TRUTH
from palmd.record.eventlog import event_line, header_line, line_text
from palmd.record.export_csv import write_csv, write_zip
from palmd.record.export_json import write_json
from palmd.record.logline import Line
from palmd.record.outline_curves import OutlineCurves
from palmd.record.outline_files import Writer, writer_of
from palmd.record.run import AnyRun, Run, RunError, read_any_run
from palmd.systems import SYSTEMS

ExportFormat = Literal["log", "csv", "mcap-json", "rrd", "lerobot", "svg", "dxf", "points"]
FORMATS: tuple[ExportFormat, ...] = get_args(ExportFormat)
_SUFFIXES: dict[str, ExportFormat] = {
    ".jsonl": "log",
    ".zip": "csv",
    "": "csv",
    ".mcap": "mcap-json",
    ".rrd": "rrd",
    ".svg": "svg",
    ".dxf": "dxf",
    ".csv": "points",
}
DRAWINGS: dict[ExportFormat, str] = {"svg": ".svg", "dxf": ".dxf", "points": ".csv"}
"""Formats of a single outline, with their suffixes."""
_STAMP = {field.name for field in STAMP}
OTHERS = "export its events as CSV tables (a folder) or as .mcap"
_FOLDERS = ("csv", "lerobot")
_TWO_PASS_FORMATS = ("csv", "mcap-json")
"""Formats that need a first pass over all messages."""


class ExportError(Exception):
    """An output that is not written; the text is one line `file: what is wrong`."""


def format_of(target: Path) -> ExportFormat | None:
    """The format by the output's suffix, None if the suffix is unknown; a folder means CSV."""
    return "csv" if target.is_dir() else _SUFFIXES.get(target.suffix.lower())


def passes(export_format: ExportFormat) -> int:
    """Number of passes over the messages."""
    return 2 if export_format in _TWO_PASS_FORMATS else 1


def export(run: AnyRun, target: Path, export_format: ExportFormat, done: Callable[[], None]) -> None:
    """Write `run` to `target`; `done` is called after each message of each pass.

    An existing file is replaced unless it is a recording; a folder must be empty. Raises ExportError, RunError,
    OSError, and ModuleNotFoundError if rerun, pandas or ezdxf is needed and missing; no partial output remains then.
    """
    if _is_recording(target):
        raise ExportError(f"{target}: is a recorded run, which export never overwrites; export to another file")
    if target.exists() and not (target.is_file() or target.is_dir()):
        raise ExportError(f"{target}: is a device; export to a file")
    if target.is_dir() and export_format not in _FOLDERS:
        raise ExportError(f"{target}: is a folder; the format {export_format} is a single file")
    if target.is_dir() and any(target.iterdir()):
        raise ExportError(f"{target}: is not empty; export to a new folder")
    part = target.with_name(f".{target.name}.part")
    try:
        _writer(export_format, target)(run, part, done)
        part.rename(target)
    except BaseException:
        shutil.rmtree(part) if part.is_dir() else part.unlink(missing_ok=True)
        raise


def _is_recording(target: Path) -> bool:
    try:
        read_any_run(target)
    except RunError:
        return False
    return True


def _writer(export_format: ExportFormat, target: Path) -> Callable[[AnyRun, Path, Callable[[], None]], None]:
    match export_format:
        case "log":
            return _write_log
        case "csv":
            return write_zip if target.suffix.lower() == ".zip" else write_csv
        case "mcap-json":
            return write_json
        case "rrd":
            from palmd.record.export_rerun import write_rerun  # an optional extra, and a large one

            return write_rerun
        case "lerobot":
            from palmd.record.export_lerobot import write_lerobot  # an optional extra, and a large one

            return write_lerobot
        case "svg" | "dxf" | "points":
            drawn = writer_of(DRAWINGS[export_format])
            return lambda run, path, done: _write_outline(drawn, run, path, done)


def _write_log(run: AnyRun, path: Path, done: Callable[[], None]) -> None:
    """Write every event in the order in which the observer received it, interleaved with an emulated rig's truth.

    The format has no line for the end of a contact; it shows as a gap in the readings.
    """
    if not isinstance(run, Run):
        raise ExportError(f"{run.path}: event logs of {SYSTEMS[run.system].words} cannot be written; {OTHERS}")
    run.event_log()  # raises RunError if there is nothing to write
    with path.open("w", encoding="utf-8") as stream:
        stream.write(line_text(header_line(run.rig)))
        for line in _log_lines(run, done):
            stream.write(line_text(line))


def _log_lines(run: Run, done: Callable[[], None]) -> Iterator[Line]:
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


def _write_outline(drawn: Writer, run: AnyRun, path: Path, done: Callable[[], None]) -> None:
    path.write_bytes(drawn(last_outline(run, done)))


def last_outline(run: AnyRun, done: Callable[[], None]) -> OutlineCurves:
    """The last outline of a run with a valid estimate; raises ExportError if there is none."""
    estimate: Fields | None = None
    found: tuple[Fields, Fields] | None = None
    for message in run.messages():
        if message.topic == run.topics.estimate.name:
            estimate = message.fields
        elif message.topic == run.topics.shape.name and estimate is not None and estimate["valid"]:
            found = message.fields, estimate
        done()
    if found is None:
        raise ExportError(f"{run.path}: no outline in it was valid; there is nothing to draw")
    return run.outline_curves(*found)
