"""Paths of the configurations, plans and service files shipped with palmd."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).parent.parent
_INSTALLED, _CHECKOUT = _PACKAGE / "data", _PACKAGE.parent.parent


def shipped(name: str) -> Path:
    """Return the path of a shipped configuration or plan: in the installed package, else in the checkout."""
    return (_INSTALLED if _INSTALLED.is_dir() else _CHECKOUT / "config") / name


def shipped_service(name: str) -> Path:
    """Return the path of a shipped file for systemd or udev, likewise."""
    return (_INSTALLED if _INSTALLED.is_dir() else _CHECKOUT) / "systemd" / name
