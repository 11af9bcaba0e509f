"""The person's browser."""

from __future__ import annotations

import os
import webbrowser


def open_page(url: str) -> None:
    """Show a page where there is a screen; a browser in the terminal would take the terminal away."""
    if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        webbrowser.open(url)
