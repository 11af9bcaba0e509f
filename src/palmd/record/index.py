"""The recordings in a folder, each summarised once: a small index beside them, which can always be rebuilt."""

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
LIVE_S = 3.0
"""A file that was written to so lately and has no end is being recorded: it is listed, and read when it is finished."""


@dataclass(frozen=True, slots=True)
class RunSummary:
    """A recording in a few words; NaN and empty for what it does not tell.

    state: the daemon's last one. valid: whether the last estimate was. lost: how often a known object was lost.
    object: the stored outline it was recognised as, `NONE_OF_THESE`, or empty. touched: share of the normals, of
    the last valid outline. sd_m, worst_sd_m: of that outline, median and largest.
    faults: codes of those that held or stopped. damage: what of it cannot be read. problem: why it cannot be used.
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
    """One recording, by its file's name in the folder."""

    name: str
    size_bytes: int
    mtime_ns: int
    summary: RunSummary

    def noted(self, note: str) -> IndexedRun:
        """With the note that lies beside it."""
        if not note:
            return self
        return replace(self, summary=replace(self.summary, notes=(*self.summary.notes, note)))


def indexed(
    folder: Path, *, rebuild: bool = False, progress: Callable[[int, int], None] | None = None
) -> list[IndexedRun]:
    """The recordings in a folder, the latest first; reads those that are new or changed and keeps what it finds.

    `progress` hears how many of how many that must be read have been. An index that is damaged, of another format, or
    may not be written, costs time and nothing else. Raises OSError for a folder that cannot be read.
    """
    known = {} if rebuild else _read(folder / NAME)
    files = sorted(_files(folder), key=lambda each: each[0], reverse=True)
    stale = [each for each in files if not _is(known.get(each[0]), each)]
    for number, (name, size, mtime_ns) in enumerate(stale, 1):
        live = time.time_ns() - mtime_ns < LIVE_S * 1e9 and not _has_end(folder / name)
        summary = RunSummary(problem="is being recorded") if live else _read_through(folder / name)
        known[name] = IndexedRun(name, size, 0 if live else mtime_ns, summary)
        if progress is not None:
            progress(number, len(stale))
    runs = [known[name] for name, _, _ in files]
    if stale or len(known) > len(files):
        _write(folder / NAME, runs)
    return [run.noted(_note(folder / run.name, notes)) for notes in [_notes(folder)] for run in runs]


def annotate(recording: Path, note: str) -> Path:
    """Puts a note beside a recording, in place of the one that was there; raises OSError."""
    path = recording.with_suffix(NOTE_SUFFIX)
    path.write_text(f"{note.strip()}\n", encoding="utf-8")
    return path


def _has_end(recording: Path) -> bool:
    """Whether it ends as a finished one does, so that nobody writes to it any more."""
    with contextlib.suppress(OSError), recording.open("rb") as stream:
        stream.seek(max(0, stream.seek(0, 2) - len(MAGIC)))
        return stream.read() == MAGIC
    return False


def _read_through(recording: Path) -> RunSummary:
    from palmd.record.summary import summary_of  # what reads recordings takes longer to load than an index

    return summary_of(recording)


def _files(folder: Path) -> Iterator[tuple[str, int, int]]:
    """Name, size and time of each recording."""
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.endswith(SUFFIX) and entry.is_file():
                status = entry.stat()
                yield entry.name, status.st_size, status.st_mtime_ns


def _notes(folder: Path) -> frozenset[str]:
    with os.scandir(folder) as entries:
        return frozenset(entry.name for entry in entries if entry.name.endswith(NOTE_SUFFIX))


def _note(recording: Path, notes: frozenset[str]) -> str:
    path = recording.with_suffix(NOTE_SUFFIX)
    if path.name not in notes:
        return ""
    with contextlib.suppress(OSError):
        return " ".join(path.read_text(encoding="utf-8", errors="replace").split())
    return ""


def _is(known: IndexedRun | None, file: tuple[str, int, int]) -> bool:
    return known is not None and (known.name, known.size_bytes, known.mtime_ns) == file


def _read(path: Path) -> dict[str, IndexedRun]:
    """What was found before; nothing where the index does not say it in its own form."""
    with contextlib.suppress(OSError, ValueError, TypeError, KeyError, AttributeError):
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["format"] == FORMAT:
            return {
                each["name"]: IndexedRun(**each | {"summary": _summary(each["summary"])}) for each in content["runs"]
            }
    return {}


def _summary(fields: Mapping[str, Any]) -> RunSummary:
    """Raises KeyError, TypeError for fields that are not those of a summary."""
    names = RunSummary.__dataclass_fields__
    return RunSummary(**{name: _value(fields[name]) for name in names})


def _value(value: Any) -> Any:
    return math.nan if value is None else tuple(value) if isinstance(value, list) else value


def _write(path: Path, runs: list[IndexedRun]) -> None:
    """As a whole or not at all; who may not write here reads the recordings again next time."""
    rows = [asdict(run) for run in runs]
    for row in rows:
        row["summary"] = {name: None if value != value else value for name, value in row["summary"].items()}
    part = path.with_suffix(f".{os.getpid()}")
    with contextlib.suppress(OSError):
        part.write_text(json.dumps({"format": FORMAT, "runs": rows}, allow_nan=False), encoding="utf-8")
        part.replace(path)
    with contextlib.suppress(OSError):
        part.unlink()
