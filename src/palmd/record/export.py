"""A recorded run in the forms of other programs, each written as a whole or not at all."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Literal, get_args

from palmd.messages import Fields
from palmd.record.export_csv import write_csv, write_zip
from palmd.record.export_json import write_json
from palmd.record.export_log import write_log
from palmd.record.outline_curves import OutlineCurves
from palmd.record.outline_files import Writer, writer_of
from palmd.record.run import AnyRun, Run, RunError, read_any_run
from palmd.systems import SYSTEMS

Form = Literal["log", "csv", "mcap-json", "rrd", "lerobot", "svg", "dxf", "points"]
FORMS: tuple[Form, ...] = get_args(Form)
_SUFFIXES: dict[str, Form] = {
    ".jsonl": "log",
    ".zip": "csv",
    "": "csv",
    ".mcap": "mcap-json",
    ".rrd": "rrd",
    ".svg": "svg",
    ".dxf": "dxf",
    ".csv": "points",
}
DRAWINGS: dict[Form, str] = {"svg": ".svg", "dxf": ".dxf", "points": ".csv"}
"""The forms of one outline, and the suffix of each."""
OTHERS = "its events are in the tables of a folder (CSV) and in .mcap"
_FOLDERS = ("csv", "lerobot")
_TWICE = ("csv", "mcap-json")
"""The forms that a run must be read through beforehand for."""


class ExportError(Exception):
    """An output that is not written to; its text is one line `file: what`."""


def form_of(target: Path) -> Form | None:
    """What the name of the output asks for, None when it does not tell; a folder is for CSV."""
    return "csv" if target.is_dir() else _SUFFIXES.get(target.suffix.lower())


def passes(form: Form) -> int:
    """How often every message is read."""
    return 2 if form in _TWICE else 1


def export(run: AnyRun, target: Path, form: Form, done: Callable[[], None]) -> None:
    """Write `run` to `target`; `done` is called after each message of each pass.

    A file that is there is replaced unless it is a recording; a folder must be empty. Raises ExportError, RunError,
    OSError, and ModuleNotFoundError without rerun, pandas or ezdxf; there is then no part of an output.
    """
    if _is_recording(target):
        raise ExportError(f"{target}: is a recorded run, which an export does not replace; export to another file")
    if target.exists() and not (target.is_file() or target.is_dir()):
        raise ExportError(f"{target}: is a device; export to a file")
    if target.is_dir() and form not in _FOLDERS:
        raise ExportError(f"{target}: is a folder; the form {form} is one file")
    if target.is_dir() and any(target.iterdir()):
        raise ExportError(f"{target}: is not empty; export to a new folder")
    part = target.with_name(f".{target.name}.part")
    try:
        _writer(form, target)(run, part, done)
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


def _writer(form: Form, target: Path) -> Callable[[AnyRun, Path, Callable[[], None]], None]:
    match form:
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
            drawn = writer_of(DRAWINGS[form])
            return lambda run, path, done: _write_outline(drawn, run, path, done)


def _write_log(run: AnyRun, path: Path, done: Callable[[], None]) -> None:
    if not isinstance(run, Run):
        raise ExportError(f"{run.path}: is of {SYSTEMS[run.system].words}, of which no event log is written; {OTHERS}")
    write_log(run, path, done)


def _write_outline(drawn: Writer, run: AnyRun, path: Path, done: Callable[[], None]) -> None:
    path.write_bytes(drawn(last_outline(run, done)))


def last_outline(run: AnyRun, done: Callable[[], None]) -> OutlineCurves:
    """The last outline of a run whose estimate was valid; raises ExportError when there is none."""
    estimate: Fields | None = None
    found: tuple[Fields, Fields] | None = None
    for message in run.messages():
        if message.topic == run.topics.estimate.name:
            estimate = message.fields
        elif message.topic == run.topics.shape.name and estimate is not None and estimate["valid"]:
            found = message.fields, estimate
        done()
    if found is None:
        raise ExportError(f"{run.path}: no outline in it was ever called valid: there is nothing to draw")
    return run.drawn(*found)
