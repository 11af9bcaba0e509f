"""Export of a recorded run to the formats of other programs; an output is written completely or not at all."""

from __future__ import annotations

import csv
import json
import math
import re
import shutil
import tempfile
import zipfile
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Literal, get_args

from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

from palmd.jsonvalues import or_none
from palmd.messages import Fields, events_of
from palmd.quantities import EVENTS, STAMP, TRUTH
from palmd.record.eventlog import event_line, header_line, line_text
from palmd.record.logline import Line
from palmd.record.mcapfile import SCHEMA_ENCODING, json_schema
from palmd.record.outline_files import OutlineCurves, Writer, writer_of
from palmd.record.run import AnyRun, Run, RunError, read_any_run
from palmd.record.scene import Scene
from palmd.record.tables import field_examples, flat
from palmd.systems import SYSTEMS


def write_csv(run: AnyRun, folder: Path, done: Callable[[], None]) -> None:
    """Write the tables into a new `folder`; `cell` defines the cells. Raises RunError, OSError.

    `done` is called twice for each message.
    """
    folder.mkdir()
    known = field_examples(run, done)
    with ExitStack() as stack:
        tables = {}
        for topic, fields in known.items():
            stream = stack.enter_context((folder / file_name(topic)).open("w", encoding="utf-8", newline=""))
            tables[topic] = csv.DictWriter(stream, [name for name, _ in flat(fields)], restval="")
            tables[topic].writeheader()
        for message in run.messages():
            tables[message.topic].writerow({name: cell(value) for name, value in flat(message.fields)})
            done()


def write_zip(run: AnyRun, path: Path, done: Callable[[], None]) -> None:
    """Write the same files into a ZIP archive. Raises RunError, OSError."""
    with tempfile.TemporaryDirectory(prefix="palmd-export-", dir=path.parent) as scratch:
        folder = Path(scratch) / "tables"
        write_csv(run, folder, done)
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for file in sorted(folder.iterdir()):
                archive.write(file, file.name)


def file_name(topic: str) -> str:
    """`palm-estimate.csv` for `palm/estimate`."""
    return re.sub(r"[^A-Za-z0-9_.-]", "-", topic) + ".csv"


def cell(value: Any) -> Any:
    """One cell: empty for NaN, 1 or 0 for a boolean, JSON text for a list; numbers keep full precision."""
    if isinstance(value, list):
        return json.dumps(or_none(value), allow_nan=False, separators=(",", ":"), ensure_ascii=False)
    if isinstance(value, bool):
        return int(value)
    return "" if isinstance(value, float) and math.isnan(value) else value


MESSAGE_ENCODING = "json"
EXPORTED = "palmd-export"
SCENE = "scene"
_SCENE = ("palms_x_m", "palms_y_m", "outline_x_m", "outline_y_m", "com_x_m", "com_y_m")
_TYPES = {bool: "boolean", int: "number", float: "number", str: "string"}


def write_json(run: AnyRun, path: Path, done: Callable[[], None]) -> None:
    """Write every message with its times (null for NaN), and a topic `scene`: palms and outline in the world frame (m).

    `done` is called twice for each message. Raises RunError, OSError.
    """
    scenes = run.scene_builder()
    known = field_examples(run, done)
    if scenes is not None:
        known |= {SCENE: {"valid": True} | {name: [0.0] for name in _SCENE}}
    with path.open("wb") as stream:
        writer = McapWriter(stream, compression=CompressionType.ZSTD)
        writer.start()
        writer.add_metadata(EXPORTED, dict(run.metadata))
        channels = {topic: _channel(writer, topic, fields) for topic, fields in known.items()}
        drawn = 0
        for message in run.messages():
            fields = message.fields
            times = message.log_time_ns, message.publish_time_ns
            _write_message(writer, channels[message.topic], fields, times, message.sequence)
            scene = None if scenes is None else scenes(message.topic, fields)
            if scene is not None:
                _write_message(writer, channels[SCENE], _scene_fields(scene), times, drawn)
                drawn += 1
            done()
        writer.finish()  # type: ignore[no-untyped-call]


def schema(topic: str, fields: Fields) -> dict[str, Any]:
    """A JSON schema of messages like `fields`, in the subset that those readers support.

    They need every property of every object by name, without patterns and with a single type; the schema therefore does
    not state that a number may be null.
    """
    documented = json_schema(topic).get("properties", {})
    properties = {
        name: _typed(name, value)
        | {key: text for key, text in documented.get(name, {}).items() if key == "description"}
        for name, value in fields.items()
    }
    return {"title": topic, "type": "object", "properties": properties}


def _typed(name: str, value: Any) -> dict[str, Any]:
    if isinstance(value, dict):
        return schema(name, value)
    if isinstance(value, list):
        return {"type": "array", "items": _typed(name, value[0] if value else 0.0)}
    return {"type": _TYPES[type(value)]}


def _channel(writer: McapWriter, topic: str, fields: Fields) -> int:
    data = json.dumps(schema(topic, fields), ensure_ascii=False).encode()
    return writer.register_channel(topic, MESSAGE_ENCODING, writer.register_schema(topic, SCHEMA_ENCODING, data))


def _write_message(writer: McapWriter, channel: int, fields: Fields, times: tuple[int, int], sequence: int) -> None:
    data = json.dumps(or_none(fields), allow_nan=False, separators=(",", ":"), ensure_ascii=False).encode()
    writer.add_message(channel, times[0], data, times[1], sequence)


def _scene_fields(scene: Scene) -> Fields:
    curves = (scene.palms, scene.outline, scene.centre[None])
    columns = (column.tolist() for points in curves for column in points.T)
    return {"valid": scene.valid} | dict(zip(_SCENE, columns, strict=True))


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
            fields = message.fields
            values = {name: or_none(value) for name, value in fields.items() if name not in _STAMP}
            truths.append({"t": fields["mono_ns"] * 1e-9, "truth": values})
        elif message.topic == EVENTS.name:
            for line in filter(None, map(event_line, events_of(message.fields))):
                while truths and truths[0]["t"] <= line["t"]:
                    yield truths.popleft()
                yield line
        done()
    yield from truths


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
