"""Harness for studies of many independent runs: drawing, running, writing, resuming, tabulating, judging.

A study defines tasks (frozen dataclasses) and a function that makes a row from one. A row is a dataclass with the
task's fields, then `error` and the measured values, all with defaults. `run` depends on its task only, so that it gives
the same row in any process, on any machine and in any order.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import signal
import sys
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, Generic, TextIO, TypeVar

from palmd.cli import INTERRUPTED
from palmd.console.arguments import count, seconds, seed
from palmd.console.columns import aligned
from palmd.console.errors import BAD_INPUT, CliError
from palmd.console.extras import drawing, missing, raise_if_other
from palmd.console.progress import Progress
from palmd.jsonvalues import or_none
from palmd.rig.simulate import CALIBRATION
from tools.studies import runs

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

ROWS, ALL = "runs.jsonl", "all"

Line = dict[str, Any]
Task = TypeVar("Task", bound="DataclassInstance")
Row = TypeVar("Row", bound="DataclassInstance")
Panel = tuple[str, Callable[[Any], float], float, Sequence[float], bool]
Draw = Callable[[argparse.Namespace], Sequence[Task]]
Columns = Sequence[tuple[str, Callable[[Sequence[Row]], str]]]
"""Titles, and functions that give the cell for some rows (see `cells`)."""


@dataclass(frozen=True, slots=True)
class Goal(Generic[Row]):
    """A condition on all rows; a study that misses one ends with status 1."""

    text: str
    met: Callable[[Sequence[Row]], bool]


@dataclass(frozen=True)
class Study(Generic[Task, Row]):
    """See the module. `order`: sort key of rows. `by`: name of a row's group; each group is a line of the table.

    across: each group is a column instead. whole: name of a last group with all rows. report: replaces the table.
    totals: lines after the table. title: name of a run; remark: one or more remarks on it, "" for none; the error of a
    failed run is its remark. panels: of a figure (label, value, unit, marks, logarithmic; see `figure`); `output` is
    then a folder. resumes: rows in the file are kept, and their tasks are not repeated. line, row_of: writer and reader
    of rows with more than plain values; `row_of` raises TypeError, KeyError, ValueError or AttributeError for anything
    else.
    """

    name: str
    draw: Draw[Task]
    run: Callable[[Task], Row]
    row: type[Row]
    order: Callable[[Row], Any]
    by: Callable[[Row], str] = lambda _: ""
    columns: Columns[Row] = ()
    across: bool = False
    whole: str = ""
    report: Callable[[Sequence[Row]], str] | None = None
    totals: Callable[[Sequence[Row]], Sequence[str]] = lambda _: ()
    title: Callable[[Any], str] = lambda row: f"{row.kind} {row.seed}"
    remark: Callable[[Row], str | Sequence[str]] = lambda _: ""
    goals: Sequence[Goal[Row]] = ()
    panels: Sequence[Panel] = ()
    resumes: bool = False
    line: Callable[[Row], Line] | None = None
    row_of: Callable[[Line], Row] | None = None

    def conduct(self, arguments: argparse.Namespace) -> int:
        """Run the study as requested on the command line; if interrupted, report the finished runs.

        Raises CliError if the file belongs to another study or cannot be written, or if there is no such cluster.
        """
        tasks = self.draw(arguments)
        output: Path | None = arguments.output
        path = output / ROWS if output is not None and self.panels else output
        kept = self._kept(path, tasks) if self.resumes and path is not None else []
        done = {_key(row, tasks) for row in kept} if kept else set[Hashable]()
        left = [task for task in tasks if _key(task, tasks) not in done]
        finished, status = self._finished(left, workers(arguments), path)
        rows = sorted([*kept, *finished], key=self.order)
        return self._concluded(rows, path) or status if rows else status

    def tabled(self, rows: Sequence[Row]) -> str:
        """The table of these rows, which are sorted."""
        groups = self._grouped(rows)
        if self.whole and len(groups) > 1:
            groups[self.whole] = list(rows)
        if self.across:
            lines = [(title, [cell(some) for some in groups.values()]) for title, cell in self.columns]
            return aligned([("", list(groups)), *lines])
        lines = [(name, [cell(some) for _, cell in self.columns]) for name, some in groups.items()]
        return aligned([("", [title for title, _ in self.columns]), *lines])

    def remarks(self, rows: Iterable[Row]) -> list[str]:
        """A line for each remark on these runs."""
        found = [(row, getattr(row, "error", "") or self.remark(row)) for row in rows]
        each = [(row, [some] if isinstance(some, str) else some) for row, some in found]
        return [f"{self.title(row)}: {text}" for row, texts in each for text in texts if text]

    def _grouped(self, rows: Sequence[Row]) -> dict[str, list[Row]]:
        return {name: [row for row in rows if self.by(row) == name] for name in dict.fromkeys(map(self.by, rows))}

    def as_line(self, row: Row) -> Line:
        """The row as a JSON object; None for a number that is not finite."""
        return self.line(row) if self.line else as_line(row)

    def _finished(
        self, tasks: Sequence[Task], begin: Callable[[ExitStack], Executor], path: Path | None
    ) -> tuple[list[Row], int]:
        """Run the tasks. The workers start first, so that a wrong address does not destroy rows of an earlier study."""
        finished: list[Row] = []
        try:
            with terminable(), ExitStack() as stack:
                executor = begin(stack)
                stream = None if path is None else writable(stack, path, self.resumes)
                progress = stack.enter_context(Progress(self.name, len(tasks), "runs"))
                work, failed = partial(_attempted, self.run, self.row), partial(_failed, self.row)
                for row in runs.finished(executor, work, failed, tasks):
                    if stream is not None:
                        write(stream, [self.as_line(row)])
                    finished.append(row)
                    progress.at(len(finished))
        except KeyboardInterrupt:
            print(f"interrupted: {len(finished)} of {len(tasks)} runs are finished", file=sys.stderr)
            return finished, INTERRUPTED
        return finished, 0

    def _kept(self, path: Path, tasks: Sequence[Task]) -> list[Row]:
        rows = already_in(path, self.row_of or partial(row_of, self.row))
        durations = {task.seconds for task in tasks if hasattr(task, "seconds")}
        given = [float(row.seconds) for row in rows if hasattr(row, "seconds")]
        other = next((each for each in given if durations and each not in durations), None)
        if other is not None:
            raise CliError(BAD_INPUT, f"{path}: has runs of {other:g} s, not {min(durations):g} s")
        return list({_key(row, tasks): row for row in rows}.values())

    def _concluded(self, rows: Sequence[Row], path: Path | None) -> int:
        written = [] if path is None else [path]
        if path is not None:
            rewrite(path, map(self.as_line, rows))
        if hasattr(rows[0], "seed"):
            print(f"seeds {numbers(row.seed for row in rows if hasattr(row, 'seed'))}")
        print(self.report(rows) if self.report else self.tabled(rows))
        for line in (*self.totals(rows), *self.remarks(rows)):
            print(line)
        missed = [goal for goal in self.goals if not goal.met(rows)]
        for goal in missed:
            print(f"goal missed: {goal.text}")
        if path is not None and self.panels and (figure := drawing("tools.studies.figure")):
            panels = [figure.Panel(*panel) for panel in self.panels]
            written += figure.save(self._grouped(rows), panels, path.with_name(self.name))
        if written:
            print(f"written: {', '.join(map(str, written))}")
        return BAD_INPUT if missed else 0


def add_arguments(
    parser: argparse.ArgumentParser,
    *,
    runs: int,
    seconds_each: float | None,
    output: str | None,
    kinds: Sequence[str] = (),
    length: Callable[[str], float] = seconds,
    what: str = "how many of each kind",
) -> None:
    """Add the common arguments: number and kinds of runs, first seed, duration, output, workers."""
    add = parser.add_argument
    add("--runs", type=count, default=runs, metavar="N", help=f"{what} (default: %(default)s)")
    if kinds:
        add("--kind", choices=(*kinds, ALL), default=ALL, help="kind of run (default: %(default)s)")
    add("--seed", type=seed, default=0, metavar="FIRST", help="seed of the first run (default: %(default)s)")
    add("--seconds", type=length, default=seconds_each, metavar="S", help="duration of a run (default: %(default)s)")
    add("-o", "--output", type=Path, default=output and Path(output), metavar="PATH",
        help=f"file of JSON lines, one per run, or folder for {ROWS} and figure (default: %(default)s)")  # fmt: skip
    add_workers(parser)


def add_workers(parser: argparse.ArgumentParser) -> None:
    """Add the arguments for the number of processes or the cluster."""
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--jobs", type=count, metavar="J", help="processes on this machine (default: one per processor)")
    where.add_argument("--scheduler", metavar="ADDRESS", help="address of a Dask cluster, e.g. tcp://127.0.0.1:8786")


def add_imperfections(parser: argparse.ArgumentParser, *more: str, default: str = "none") -> None:
    """Add the argument for the rig's imperfections: one of `CALIBRATION`, or of `more`."""
    parser.add_argument("--imperfections", choices=(*CALIBRATION, *more), default=default,
        help="imperfections of the rig, drawn by the seed (default: %(default)s)")  # fmt: skip


def of_kinds(kinds: Sequence[Any], task: Callable[[Any, int, argparse.Namespace], Task]) -> Draw[Task]:
    """A function that draws the requested number of runs of each kind, all kinds with the same seeds."""
    return lambda arguments: [
        task(kind, seed, arguments) for seed in seeds_of(arguments) for kind in kinds_of(arguments, kinds)
    ]


def kinds_of(arguments: argparse.Namespace, kinds: Sequence[str]) -> Sequence[Any]:
    """The kinds requested by `--kind`."""
    return kinds if arguments.kind == ALL else (arguments.kind,)


def seeds_of(arguments: argparse.Namespace) -> range:
    """The seeds requested by `--seed` and `--runs`."""
    return range(arguments.seed, arguments.seed + arguments.runs)


def result(row: type[Row], task: DataclassInstance, **measured: Any) -> Row:
    """The row of a task with these measured values."""
    return row(**{each.name: getattr(task, each.name) for each in fields(task)}, **measured)


def _key(of: DataclassInstance, tasks: Sequence[DataclassInstance]) -> Hashable:
    return tuple(getattr(of, each.name) for each in fields(tasks[0]))


def _attempted(run: Callable[[Task], Row], row: type[Row], task: Task) -> Row:
    try:
        return run(task)
    except Exception as error:
        return _failed(row, task, error)


def _failed(row: type[Row], task: DataclassInstance, error: BaseException) -> Row:
    return result(row, task, error=f"{type(error).__name__}: {error}")


# ----------------------------------------------------------------------------------------------------- workers


def workers(arguments: argparse.Namespace) -> Callable[[ExitStack], Executor]:
    """A function that starts local processes or connects to a cluster; it raises CliError without cluster or Dask."""
    address = getattr(arguments, "scheduler", None)
    if address is None:
        return lambda stack: stack.enter_context(runs.local(arguments.jobs or os.cpu_count() or 1))
    return lambda stack: _of_cluster(stack, address)


def _of_cluster(stack: ExitStack, address: str) -> Executor:
    try:
        return stack.enter_context(runs.cluster(address))
    except ModuleNotFoundError as error:
        raise_if_other("distributed", error)
        raise missing("--scheduler", "Dask", "studies") from None
    except (OSError, ValueError) as error:
        raise CliError(BAD_INPUT, f"no Dask scheduler at {address}: {error}") from None


@contextmanager
def terminable() -> Iterator[None]:
    """Treat SIGTERM as Ctrl-C."""
    before = signal.signal(signal.SIGTERM, _interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _interrupt(_signal: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt


# ----------------------------------------------------------------------------------------------------- the file


def as_line(row: DataclassInstance) -> Line:
    """The row as a JSON object of its fields; None for a number that is not finite."""
    values: dict[str, Any] = {each.name: getattr(row, each.name) for each in fields(row)}
    return {
        name: as_line(each) if hasattr(each, "__dataclass_fields__") else or_none(each) for name, each in values.items()
    }


def row_of(row: type[Row], line: Line) -> Row:
    """The inverse of `as_line` for a row of plain values; raises KeyError or TypeError for anything else."""
    names = {each.name for each in fields(row)}
    if names ^ line.keys():
        raise KeyError(*(names ^ line.keys()))
    return row(**{name: math.nan if value is None else value for name, value in line.items()})


def already_in(path: Path, row_from: Callable[[Line], Row]) -> list[Row]:
    """The rows in a file to resume, none if there is no file; CliError for any other file."""
    if not path.exists():
        return []
    try:
        lines = path.read_bytes().splitlines()
    except OSError as error:
        raise CliError(BAD_INPUT, f"{path}: cannot be read: {error.strerror or error}") from None
    rows = []
    for number, line in enumerate(lines, 1):
        try:
            rows.append(row_from(json.loads(line)))
        except (AttributeError, KeyError, TypeError, ValueError):
            mend = f"line {number} is not a run; remove it, or use another file"
            raise CliError(BAD_INPUT, f"{path}: is not a file of this study: {mend}") from None
    return rows


def writable(stack: ExitStack, path: Path, append: bool = False) -> TextIO:
    """Open the file, empty unless `append`, and create its folder; raises CliError if that fails."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return stack.enter_context(path.open("a" if append else "w", encoding="utf-8"))
    except OSError as error:
        raise CliError(BAD_INPUT, f"{path}: cannot be written: {error.strerror or error}") from None


def write(stream: TextIO, lines: Iterable[Line]) -> None:
    """Append lines and flush."""
    for line in lines:
        stream.write(json.dumps(line, allow_nan=False, ensure_ascii=False) + "\n")
    stream.flush()


def rewrite(path: Path, lines: Iterable[Line]) -> None:
    """Replace the file's lines atomically."""
    temporary = path.with_suffix(".tmp")
    with temporary.open("w", encoding="utf-8") as stream:
        write(stream, lines)
    temporary.replace(path)


def numbers(each: Iterable[int]) -> str:
    """Whole numbers as text; consecutive ones as first–last."""
    parts: list[list[int]] = []
    for number in sorted(set(each)):
        if parts and number == parts[-1][-1] + 1:
            parts[-1].append(number)
        else:
            parts.append([number])
    return ", ".join(str(part[0]) if len(part) == 1 else f"{part[0]}–{part[-1]}" for part in parts)
