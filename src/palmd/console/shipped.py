"""The configurations and plans that palmd ships, and what makes services of it."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).parent.parent
_INSTALLED, _CHECKOUT = _PACKAGE / "data", _PACKAGE.parent.parent


def shipped(name: str) -> Path:
    """The path of one of them: in the installed package, else in the checkout that palmd runs from."""
    return (_INSTALLED if _INSTALLED.is_dir() else _CHECKOUT / "config") / name


def shipped_service(name: str) -> Path:
    """The path of a file for the service manager and its neighbours, likewise."""
    return (_INSTALLED if _INSTALLED.is_dir() else _CHECKOUT) / "systemd" / name
