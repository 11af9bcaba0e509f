"""Errors and exit statuses of commands."""

from __future__ import annotations

BAD_INPUT = 1
USAGE = 2
RIG_FAILED = 3


class CliError(Exception):
    """Ends the command with this exit status; the text goes to standard error, one line per error."""

    def __init__(self, status: int, text: str) -> None:
        super().__init__(text)
        self.status = status
