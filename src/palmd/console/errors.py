"""How a command ends that cannot do what it was asked."""

from __future__ import annotations

BAD_INPUT = 1
USAGE = 2
RIG_FAILED = 3


class CliError(Exception):
    """Ends the command with this status; the text goes to standard error, one clear line a fault."""

    def __init__(self, status: int, text: str) -> None:
        super().__init__(text)
        self.status = status
