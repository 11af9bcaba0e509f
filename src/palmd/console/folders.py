"""Folders that are made when they are needed: whether that will succeed can be told before; and short ones."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

SOCKET_PATH_BYTES = 107
"""Of the path of a UNIX socket, at most."""


def nearest(folder: Path) -> Path:
    """The folder, or the nearest of its parents that is there, be it a link that leads nowhere.

    Raises OSError when that cannot be found out: a name that is too long, a parent that lets nobody look.
    """
    return next(each for each in (folder, *folder.absolute().parents) if each.exists() or each.is_symlink())


def takes_files(folder: Path) -> bool:
    """Whether it is a folder in which we may make files and folders."""
    return folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)


def for_sockets(prefix: str, name: str) -> tempfile.TemporaryDirectory[str]:
    """A temporary folder of this user's alone, its path short enough for a socket `name` in it."""
    folder = tempfile.TemporaryDirectory(prefix=prefix)
    if len(os.fsencode(Path(folder.name) / name)) <= SOCKET_PATH_BYTES:
        return folder
    folder.cleanup()
    return tempfile.TemporaryDirectory(prefix=prefix, dir="/tmp")
