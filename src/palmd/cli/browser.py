"""Opens the user's browser."""

from __future__ import annotations

import os
import webbrowser


def open_page(url: str) -> None:
    """Open a page if there is a display; a text browser would occupy the terminal."""
    if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        webbrowser.open(url)
