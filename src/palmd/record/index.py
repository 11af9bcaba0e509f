"""Index of the recordings in a folder: a summary of each, cached in a small file that can always be rebuilt."""

from __future__ import annotations

import contextlib
import json
import math
import os
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from palmd.record import MAGIC, SUFFIX

NAME = ".palmd-runs.json"
FORMAT = 2
NOTE_SUFFIX = ".note"
BEING_WRITTEN_S = 3.0
"""A file without an end that was modified less than this long ago is being recorded; it is read when finished."""


@dataclass(frozen=True, slots=True)
class RunSummary:
    """Summary of a recording; NaN or empty for unknown values.

    state: last state of the daemon. valid: validity of the last estimate. lost: how often a known object was lost.
    object: name of the recognised stored outline, `NONE_OF_THESE`, or empty. touched: fraction of the normals of the
    last valid outline. sd_m, worst_sd_m: median and largest standard deviation of that outline.
    faults: codes of faults that held or stopped. damage: text on unreadable parts. problem: why it cannot be used.
    """

    started: str = ""
    seconds: float = math.nan
    complete: bool = False
    plans: tuple[str, ...] = ()
    object: str = ""
    objects: int = 0
    touched: float = math.nan
    sd_m: float = math.nan
    worst_sd_m: float = math.nan
    mass_kg: float = math.nan
    state: str = ""
    valid: bool = False
    lost: int = 0
    faults: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    damage: str = ""
    problem: str = ""


@dataclass(frozen=True, slots=True)
class IndexedRun:
    """One recording of the folder, by file name."""

    name: str
    size_bytes: int
    mtime_ns: int
    summary: RunSummary


def indexed(
    folder: Path, *, rebuild: bool = False, progress: Callable[[int, int], None] | None = None
) -> list[IndexedRun]:
    """The recordings in a folder, latest first; reads new and changed ones and updates the index.

    `progress` is called with the number of recordings read and to be read. An index that is damaged, of another format
    or not writable only costs time. Raises OSError for a folder that cannot be read.
    """
    known = {} if rebuild else _read(folder / NAME)
    files = sorted(_files(folder), key=lambda each: each[0], reverse=True)
    current = {(run.name, run.size_bytes, run.mtime_ns) for run in known.values()}
    stale = [each for each in files if each not in current]
    for number, (name, size, mtime_ns) in enumerate(stale, 1):
        live = time.time_ns() - mtime_ns < BEING_WRITTEN_S * 1e9 and not _has_end(folder / name)
        summary = RunSummary(problem="is being recorded") if live else _read_through(folder / name)
        known[name] = IndexedRun(name, size, 0 if live else mtime_ns, summary)
        if progress is not None:
            progress(number, len(stale))
    runs = [known[name] for name, _, _ in files]
    if stale or len(known) > len(files):
        _write(folder / NAME, runs)
    return [_with_note(folder, run) for run in runs]


def annotate(recording: Path, note: str) -> Path:
    """Write a note file beside a recording, replacing an earlier one; raises OSError."""
    path = recording.with_suffix(NOTE_SUFFIX)
    path.write_text(f"{note.strip()}\n", encoding="utf-8")
    return path


def _has_end(recording: Path) -> bool:
    """Whether the file ends as a finished MCAP file does; it is then no longer being written."""
    with contextlib.suppress(OSError), recording.open("rb") as stream:
        stream.seek(max(0, stream.seek(0, 2) - len(MAGIC)))
        return stream.read() == MAGIC
    return False


def _read_through(recording: Path) -> RunSummary:
    from palmd.record.summary import summary_of  # loading the reader takes longer than reading an index

    return summary_of(recording)


def _files(folder: Path) -> Iterator[tuple[str, int, int]]:
    """Name, size (bytes) and modification time (ns) of each recording."""
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.endswith(SUFFIX) and entry.is_file():
                status = entry.stat()
                yield entry.name, status.st_size, status.st_mtime_ns


def _with_note(folder: Path, run: IndexedRun) -> IndexedRun:
    """The run with the note from the file beside its recording, if there is one."""
    with contextlib.suppress(OSError):
        text = (folder / run.name).with_suffix(NOTE_SUFFIX).read_text(encoding="utf-8", errors="replace")
        if note := " ".join(text.split()):
            return replace(run, summary=replace(run.summary, notes=(*run.summary.notes, note)))
    return run


def _read(path: Path) -> dict[str, IndexedRun]:
    """The entries of the index; empty if it is missing, damaged or of another format."""
    with contextlib.suppress(OSError, ValueError, TypeError, KeyError, AttributeError):
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["format"] == FORMAT:
            return {
                each["name"]: IndexedRun(**each | {"summary": _summary(each["summary"])}) for each in content["runs"]
            }
    return {}


def _summary(fields: Mapping[str, Any]) -> RunSummary:
    """Decode a summary; raises KeyError, TypeError for other fields."""
    names = RunSummary.__dataclass_fields__
    return RunSummary(**{name: _value(fields[name]) for name in names})


def _value(value: Any) -> Any:
    return math.nan if value is None else tuple(value) if isinstance(value, list) else value


def _write(path: Path, runs: list[IndexedRun]) -> None:
    """Write the index atomically; if that is not permitted, the recordings are read again next time."""
    rows = [asdict(run) for run in runs]
    for row in rows:
        row["summary"] = {name: None if value != value else value for name, value in row["summary"].items()}
    part = path.with_suffix(f".{os.getpid()}")
    with contextlib.suppress(OSError):
        part.write_text(json.dumps({"format": FORMAT, "runs": rows}, allow_nan=False), encoding="utf-8")
        part.replace(path)
    with contextlib.suppress(OSError):
        part.unlink()
