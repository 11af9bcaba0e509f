"""Folders that are made when they are needed: whether that will succeed can be told before."""

from __future__ import annotations

import os
from pathlib import Path


def nearest(folder: Path) -> Path:
    """The folder, or the nearest of its parents that is there, be it a link that leads nowhere.

    Raises OSError when that cannot be found out: a name that is too long, a parent that lets nobody look.
    """
    return next(each for each in (folder, *folder.absolute().parents) if each.exists() or each.is_symlink())


def takes_files(folder: Path) -> bool:
    """Whether it is a folder in which we may make files and folders."""
    return folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)
