"""The configurations and plans that palmd ships."""

from __future__ import annotations

from pathlib import Path


def shipped(name: str) -> Path:
    """The path of one of them: in the installed package, else in the checkout that palmd runs from."""
    package = Path(__file__).parent.parent
    installed = package / "data"
    return (installed if installed.is_dir() else package.parent.parent / "config") / name
