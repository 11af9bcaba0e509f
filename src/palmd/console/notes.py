"""What commands show to people: text on standard error, and pages in their browser."""

from __future__ import annotations

import os
import sys
import webbrowser
from collections.abc import Iterable


def print_notes(notes: Iterable[str]) -> None:
    """Print one line per note."""
    for note in notes:
        print(note, file=sys.stderr)


def say(text: str) -> None:
    """Print a line now."""
    print(text, file=sys.stderr, flush=True)


def open_page(url: str) -> None:
    """Open a page if there is a display; a text browser would occupy the terminal."""
    if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        webbrowser.open(url)
