"""Lists, searches and compares recordings: object, time, fault, accuracy, note.

Each recording is read once; the results are stored in a small index beside them, which may be deleted at any time. A
note is stored beside its recording, in a file of the same name with the suffix .note.
"""

from __future__ import annotations

import argparse
import json
import math
import shutil
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Any

from palmd.console.columns import number
from palmd.console.errors import BAD_INPUT, CliError
from palmd.console.progress import Progress
from palmd.record.index import IndexedRun, annotate, indexed

HERE = Path("runs")
NOT_RECOGNISED = "not recognised"
_WIDE = 1000
_HEAD = ("run", "for", "object", "touched", "outline ±", "worst ±", "mass", "faults and notes")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add = parser.add_argument
    add("folder", nargs="?", type=Path, metavar="FOLDER",
        help=f"folder of the recordings (default: {HERE}/, else that of the installed configuration)")  # fmt: skip
    add("--search", nargs="+", default=[], metavar="WORD",
        help="only runs with every WORD in name, time, object, plan, fault or note")  # fmt: skip
    add("--since", type=_day, metavar="DATE", help="only runs from this day on, such as 2026-11-23")
    add("--objects", action="store_true", help="group the runs by recognised object")
    add("--compare", nargs="+", metavar="RUN", help="show these runs side by side; the beginning of a name suffices")
    add("--note", nargs=2, metavar=("RUN", "TEXT"), help="write a note beside a run")
    add("--rebuild", action="store_true", help="read every recording again")
    add("--json", action="store_true", help="print the runs as JSON, in SI units")


def run(arguments: argparse.Namespace) -> int:
    """List, compare or annotate runs; CliError if the folder cannot be read or a run does not exist."""
    folder = arguments.folder or (HERE if HERE.is_dir() else _configured())
    found = _indexed(folder, rebuild=arguments.rebuild)
    if arguments.note:
        return _write_note(folder, found, *arguments.note)
    if arguments.compare:
        shown = [_named(found, name, folder) for name in arguments.compare]
    else:
        shown = [each for each in found if matches(each, arguments.search, arguments.since or "")]
    if arguments.json:
        print(json.dumps([_as_map(each) for each in shown], indent=2))
    elif arguments.compare:
        print("\n".join(compared(shown)))
    elif arguments.objects:
        print("\n".join(grouped(shown)))
    else:
        print("\n".join(_cut(table(shown))))
        count = f"{len(shown)} of {len(found)}" if len(shown) < len(found) else f"{len(found)}"
        print(f"{count} run{'' if len(found) == 1 else 's'} in {folder}")
    return 0


def _day(text: str) -> str:
    """Argument type: an ISO date or time."""
    try:
        datetime.fromisoformat(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a date; write one as 2026-11-23") from None
    return text


def _configured() -> Path:
    from palmd.console.configured import configured, default_path

    return configured(default_path(None)).record.directory


def _indexed(folder: Path, *, rebuild: bool) -> list[IndexedRun]:
    bars: list[Progress] = []

    def progress(done: int, total: int) -> None:
        if not bars:
            bars.append(Progress("reading", total, "runs").__enter__())
        bars[0].at(done)

    try:
        return indexed(folder, rebuild=rebuild, progress=progress)
    except FileNotFoundError:
        text = f"{folder}: no such folder: no run has been recorded into it; `palmd demo` records one into {HERE}/"
        raise CliError(BAD_INPUT, text) from None
    except NotADirectoryError:
        raise CliError(BAD_INPUT, f"{folder}: is a file; name its folder") from None
    except OSError as error:
        raise CliError(BAD_INPUT, f"{folder}: {error.strerror or error}") from None
    finally:
        for bar in bars:
            bar.__exit__(None, None, None)


def _write_note(folder: Path, found: Sequence[IndexedRun], name: str, text: str) -> int:
    path = folder / _named(found, name, folder).name
    try:
        print(f"written: {annotate(path, text)}")
    except OSError as error:
        raise CliError(BAD_INPUT, f"{path}: no note can be written: {error.strerror or error}") from None
    return 0


def _named(found: Sequence[IndexedRun], name: str, folder: Path) -> IndexedRun:
    """Return the only run whose name begins with `name`; CliError if there is none, or several."""
    wanted = Path(name).name
    hits = [each for each in found if each.name.startswith(wanted)]
    exact = [each for each in hits if each.name == wanted]
    if len(exact or hits) != 1:
        text = (
            f"{len(hits)} runs have names that begin so; write more of the name"
            if hits
            else f"there is no such run in {folder}"
        )
        raise CliError(BAD_INPUT, f"{name}: {text}")
    return (exact or hits)[0]


def matches(run: IndexedRun, words: Sequence[str], since: str) -> bool:
    """Whether a run has all words in its texts, ignoring case, and is not older than `since`. Pure."""
    summary = run.summary
    text = " ".join((run.name, summary.started, summary.object or NOT_RECOGNISED, *summary.plans, *summary.faults,
                     *summary.notes, summary.damage,
                     summary.problem)).lower()  # fmt: skip
    return all(word.lower() in text for word in words) and (summary.started or run.name) >= since


def table(runs: Sequence[IndexedRun]) -> Iterator[str]:
    """Return a table: a head and one line per run. Pure."""
    return _left_aligned([_HEAD, *map(_row, runs)])


def _left_aligned(rows: Sequence[tuple[str, ...]]) -> Iterator[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        yield "  ".join(f"{cell:{width}}" for cell, width in zip(row, widths, strict=True)).rstrip()


def _row(run: IndexedRun) -> tuple[str, ...]:
    summary = run.summary
    lost = [f"lost {summary.lost}×"] if summary.lost else []
    lost += ["not valid at the end"] if summary.lost and not summary.valid else []
    last = [
        *lost,
        *summary.faults,
        *(f'"{note}"' for note in summary.notes),
        *([summary.problem] if summary.problem else []),
    ]
    if summary.damage:
        last.append(summary.damage)
    elif not summary.complete and not summary.problem:
        last.append("not finished")
    return (
        run.name.removesuffix(".mcap"),
        number(summary.seconds, 1.0, 0, " s"),
        summary.object or "–",
        number(summary.touched, 100.0, 0, " %"),
        number(summary.sd_m, 1e6, 0, " µm"),
        number(summary.worst_sd_m, 1e6, 0, " µm"),
        number(summary.mass_kg, 1e3, 1, " g"),
        ", ".join(last),
    )


def compared(runs: Sequence[IndexedRun]) -> Iterator[str]:
    """Return a table with one column per run. Pure."""
    columns = [_HEAD, *map(_row, runs)]
    columns = [(*column[:-1], *_plans(run)) for column, run in zip(columns, (None, *runs), strict=True)]
    return _left_aligned([*zip(*columns, strict=True)])


def _plans(run: IndexedRun | None) -> tuple[str, ...]:
    """Last rows of a comparison; without a run, their heads."""
    if run is None:
        return ("plans", "faults", "notes")
    summary = run.summary
    return (", ".join(summary.plans), ", ".join(summary.faults) or "none", "; ".join(summary.notes) or summary.problem)


def grouped(runs: Sequence[IndexedRun]) -> Iterator[str]:
    """Yield the runs grouped by recognised object, most frequent first. Pure."""
    groups: dict[str, list[IndexedRun]] = {}
    for each in runs:
        groups.setdefault(each.summary.object or NOT_RECOGNISED, []).append(each)
    for name, members in sorted(groups.items(), key=lambda item: (item[0] == NOT_RECOGNISED, -len(item[1]), item[0])):
        best = min(
            (each.summary.worst_sd_m for each in members if math.isfinite(each.summary.worst_sd_m)), default=math.nan
        )
        masses = [each.summary.mass_kg for each in members if math.isfinite(each.summary.mass_kg)]
        mass = f", mass {number(min(masses), 1e3, 1)} to {number(max(masses), 1e3, 1, ' g')}" if masses else ""
        count = f"{len(members)} run" + ("" if len(members) == 1 else "s")
        yield f"{name}: {count}, outline within ±{number(best, 1e6, 0, ' µm')} at best{mass}"
        yield from (f"  {line}" for line in list(table(members))[1:])


def _cut(lines: Iterator[str]) -> Iterator[str]:
    columns = shutil.get_terminal_size().columns if sys.stdout.isatty() else _WIDE
    return (line[:columns] for line in lines)


def _as_map(run: IndexedRun) -> dict[str, Any]:
    fields = asdict(run.summary)
    values = {name: None if value != value else value for name, value in fields.items()}
    return {"run": run.name, "size_bytes": run.size_bytes} | values
