"""Text for people on standard error."""

from __future__ import annotations

import sys
from collections.abc import Iterable


def print_notes(notes: Iterable[str]) -> None:
    """Print one line per note."""
    for note in notes:
        print(note, file=sys.stderr)


def say(text: str) -> None:
    """Print a line now."""
    print(text, file=sys.stderr, flush=True)
