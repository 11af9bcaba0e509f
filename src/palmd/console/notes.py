"""What whoever reads an input should know of it: on standard error, once."""

from __future__ import annotations

import sys
from collections.abc import Iterable


def print_notes(notes: Iterable[str]) -> None:
    """A line each."""
    for note in notes:
        print(note, file=sys.stderr)
