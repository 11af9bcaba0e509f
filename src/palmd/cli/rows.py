"""The rows of a study in a file of JSON lines: each as soon as it is there, all in order in the end."""

from __future__ import annotations

import json
import signal
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import FrameType
from typing import Any, TextIO

from palmd.cli.errors import BAD_INPUT, CliError

ROWS = "runs.jsonl"


def writable(stack: ExitStack, path: Path) -> TextIO:
    """The file, empty, in a folder that is made; CliError when that cannot be."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return stack.enter_context(path.open("w", encoding="utf-8"))
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
