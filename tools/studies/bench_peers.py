"""The same readings through palmd's filter and other people's: error, and time by step as ratios to palmd's.

LOG is an event log with its truth beside it (*.truth.json); without it a run is simulated. Takes some minutes.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from palmd.cli.logs import read
from palmd.console.arguments import seconds_within, seed
from palmd.console.errors import BAD_INPUT, CliError
from palmd.console.extras import missing, only_without
from palmd.console.progress import Progress
from palmd.jsonvalues import or_none
from palmd.record.eventlog import EventLog
from palmd.rig.shapes import KINDS
from tools.studies.peers.task import PeerStart, PeerTask, PeerTruth, task_from
from tools.studies.simulated import simulated

if TYPE_CHECKING:
    from tools.studies.peers.contest import BankTick, PeerRow

RESULT = "peers.json"
_HEAD = ("method", "start", "r RMS mm", "e_h µm", "µs per step", "× palmd", "remark")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument("log", type=Path, nargs="?", metavar="LOG", help="an event log, its truth beside it")
    parser.add_argument("--kind", choices=KINDS, default="nominal", help="of a simulated run; default: %(default)s")
    parser.add_argument("--seed", type=seed, default=100, help="of run and good start; default: %(default)s")
    parser.add_argument(
        "--seconds", type=seconds_within(1.0, 600.0), default=10.0, help="of the run; default: %(default)g"
    )
    parser.add_argument("-o", "--output", type=Path, metavar="FOLDER", help=f"write {RESULT} there")


def run(arguments: argparse.Namespace) -> int:
    """Prints the table; CliError without filterpy, and for a log or a truth that cannot be used."""
    try:
        from tools.studies.peers.contest import bank_tick, starts, with_ratios
    except ModuleNotFoundError as error:
        only_without("filterpy", error)
        raise missing("the study peers", "filterpy", "studies") from None
    if arguments.output is not None:
        _make_folder(arguments.output)
    what, log, truth = _run_to_compare(arguments)
    try:
        task = task_from(log.rig, log.events)
    except ValueError as error:
        raise CliError(BAD_INPUT, f"{what}: {error}") from None
    both = starts(task, truth, arguments.seed)
    rows = list(with_ratios(list(_rows(log, task, truth, both))))
    tick = bank_tick(task, both[0])
    for line in _table(rows):
        print(line)
    print(f"bank of {tick.size}: {tick.tick_ms:.2f} ms per tick of 10 ms, {tick.step_us:.1f} µs per filter and step")
    if arguments.output is not None:
        _write(arguments.output / RESULT, what, arguments.seconds, rows, tick)
    return 0


def _rows(log: EventLog, task: PeerTask, truth: PeerTruth, starts: tuple[PeerStart, PeerStart]) -> Iterator[PeerRow]:
    from tools.studies.peers.contest import BANK, bank_row, compete, entries

    everybody = entries(task, truth)
    for start in starts:
        for entry in everybody:
            with Progress(f"{entry.method}, {start.name} start", len(task.readings), "readings") as progress:
                yield compete(entry, start, task, truth, progress.at)
    with Progress(BANK, len(log.events), "events") as progress:
        yield bank_row(log.rig, log.events, task, truth, progress.at)


def _run_to_compare(arguments: argparse.Namespace) -> tuple[str, EventLog, PeerTruth]:
    """What it is called, its events up to `--seconds`, and its truth."""
    if arguments.log is not None:
        log = read(arguments.log)
        t_end = log.events[0].t_sample + arguments.seconds
        events = tuple(event for event in log.events if event.t_sample <= t_end)
        return arguments.log.name, dataclasses.replace(log, events=events), _truth(arguments.log)
    log, told = simulated(arguments.kind, arguments.seed, arguments.seconds)
    return f"{arguments.kind}, seed {arguments.seed}", log, PeerTruth.from_fields(told)


def _truth(log: Path) -> PeerTruth:
    path = log.with_suffix(".truth.json")
    try:
        return PeerTruth.from_fields(json.loads(path.read_text(encoding="utf-8")))
    except OSError as error:
        raise CliError(BAD_INPUT, f"{path}: the truth cannot be read: {error.strerror or error}") from None
    except (ValueError, KeyError, TypeError) as error:
        raise CliError(BAD_INPUT, f"{path}: is not the truth of a run: {error!r}") from None


def _table(rows: list[PeerRow]) -> Iterator[str]:
    cells = [_HEAD, *map(_cells, rows)]
    widths = [max(len(row[i]) for row in cells) for i in range(len(_HEAD) - 1)]
    for row in cells:
        words = [row[i].ljust(w) if i < 2 else row[i].rjust(w) for i, w in enumerate(widths)]
        yield "  ".join([*words, row[-1]]).rstrip()


def _cells(row: PeerRow) -> tuple[str, ...]:
    numbers = ((row.r_rms, 1e3, ".3f"), (row.e_h, 1e6, ".0f"), (row.us, 1.0, ".1f"), (row.ratio, 1.0, ".3g"))
    shown = ("–" if math.isnan(value) else _plain(value * unit, form) for value, unit, form in numbers)
    return row.method, row.start, *shown, row.remark


def _plain(value: float, form: str) -> str:
    return f"{value:.0f}" if value >= 1000 else f"{value:{form}}"


def _write(path: Path, what: str, seconds: float, rows: list[PeerRow], tick: BankTick) -> None:
    fields = [or_none(dataclasses.asdict(row)) for row in rows]
    result = {"run": what, "seconds": seconds, "rows": fields, "bank": dataclasses.asdict(tick)}
    try:
        path.write_text(json.dumps(result, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    except OSError as error:
        raise CliError(BAD_INPUT, f"{path}: cannot be written: {error.strerror or error}") from None


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CliError(BAD_INPUT, f"{folder}: cannot be made: {error.strerror or error}") from None
