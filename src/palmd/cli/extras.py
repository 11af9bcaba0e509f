"""Packages that palmd works without: what belongs to its optional extras."""

from __future__ import annotations


def only_without(package: str, error: ModuleNotFoundError) -> None:
    """Raises the error again when it is about anything else than the missing `package`."""
    if (error.name or "").partition(".")[0] != package:
        raise error
