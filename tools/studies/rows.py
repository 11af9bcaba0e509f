"""A study's runs, and their rows in a file of JSON lines: each as soon as it is there, all in order in the end."""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any, Generic, TextIO, TypeVar

from palmd.cli import INTERRUPTED
from palmd.console.errors import BAD_INPUT, CliError
from palmd.console.progress import Progress
from tools.studies import runs

ROWS = "runs.jsonl"

Task = TypeVar("Task")
Row = TypeVar("Row")


@dataclass(frozen=True)
class Sink(Generic[Row]):
    """Where each row goes as soon as it is finished: a study takes hours. `append`: after those that are there."""

    path: Path
    as_line: Callable[[Row], dict[str, Any]]
    append: bool = False


def collected(
    what: str,
    tasks: Sequence[Task],
    work: Callable[[Task], Row],
    failed: Callable[[Task, BaseException], Row],
    workers: Callable[[ExitStack], Executor],
    sink: Sink[Row] | None = None,
) -> tuple[list[Row], int]:
    """The rows of a study's runs as they are finished, and the exit status: interrupted, those until then.

    The workers come first, so that rows of an earlier study outlive a wrong address. Raises what `workers` raises, and
    CliError when the rows cannot be written.
    """
    finished: list[Row] = []
    try:
        with terminable(), ExitStack() as stack:
            executor = workers(stack)
            stream = None if sink is None else writable(stack, sink.path, sink.append)
            progress = stack.enter_context(Progress(what, len(tasks), "runs"))
            for row in runs.finished(executor, work, failed, tasks):
                if sink is not None and stream is not None:
                    write(stream, [sink.as_line(row)])
                finished.append(row)
                progress.at(len(finished))
    except KeyboardInterrupt:
        print(f"interrupted: {len(finished)} of {len(tasks)} runs are finished", file=sys.stderr)
        return finished, INTERRUPTED
    return finished, 0


def already_in(path: Path, row_from: Callable[[dict[str, Any]], Row]) -> list[Row]:
    """The rows that a file to go on with has, none where there is no file.

    `row_from` raises AttributeError, KeyError, TypeError or ValueError for a line of another study; CliError then, and
    for a file that cannot be read.
    """
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
            mend = f"line {number} is no run; remove it, or take another file"
            raise CliError(BAD_INPUT, f"{path}: is no file of this study: {mend}") from None
    return rows


def on_this_machine(jobs: int | None) -> Callable[[ExitStack], Executor]:
    """Workers for `collected`: so many processes, by default one a processor."""
    return lambda stack: stack.enter_context(runs.local(jobs or os.cpu_count() or 1))


def writable(stack: ExitStack, path: Path, append: bool = False) -> TextIO:
    """The file, empty unless it is to `append` to, in a folder that is made; CliError when that cannot be."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return stack.enter_context(path.open("a" if append else "w", encoding="utf-8"))
    except OSError as error:
        raise CliError(BAD_INPUT, f"{path}: cannot be written: {error.strerror or error}") from None


def write(stream: TextIO, lines: Iterable[dict[str, Any]]) -> None:
    """Append them, and see that they are there."""
    for line in lines:
        stream.write(json.dumps(line, allow_nan=False, ensure_ascii=False) + "\n")
    stream.flush()


def rewrite(path: Path, lines: Iterable[dict[str, Any]]) -> None:
    """Put these in the place of the file's lines, all at once."""
    beside = path.with_suffix(".tmp")
    with beside.open("w", encoding="utf-8") as stream:
        write(stream, lines)
    beside.replace(path)


@contextmanager
def terminable() -> Iterator[None]:
    """A termination does what Ctrl-C does."""
    before = signal.signal(signal.SIGTERM, _interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _interrupt(_signal: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt
