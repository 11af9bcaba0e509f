"""Errors and exit statuses of commands."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

BAD_INPUT = 1
USAGE = 2
RIG_FAILED = 3


class CliError(Exception):
    """Ends the command with this exit status; the text goes to standard error, one line per error."""

    def __init__(self, status: int, text: str) -> None:
        super().__init__(text)
        self.status = status


@contextmanager
def as_cli_error(*kinds: type[Exception], status: int = BAD_INPUT, before: str = "") -> Iterator[None]:
    """Context in which an exception of these kinds becomes a CliError with its text, behind `before`."""
    try:
        yield
    except kinds as error:
        raise CliError(status, f"{before}{error}") from None


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Context in which an OSError becomes a CliError: the file cannot be written."""
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        raise CliError(BAD_INPUT, f"{path}: cannot be written: {error.strerror or error}") from None
