"""What keeps the page from being served."""

from __future__ import annotations


class ViewError(Exception):
    """An address or a port that cannot be had; says which, and what to do."""
