"""Checks of folders that are created later, and temporary folders for sockets."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

SOCKET_PATH_BYTES = 107
"""Maximum length of the path of a UNIX socket."""


def nearest(folder: Path) -> Path:
    """Return the folder or its nearest existing parent (dangling links count as existing).

    Raises OSError if that cannot be determined: too long a name, no permission.
    """
    return next(each for each in (folder, *folder.absolute().parents) if each.exists() or each.is_symlink())


def is_writable_folder(folder: Path) -> bool:
    """Whether it is a folder in which this user may create files."""
    return folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)


def socket_folder(prefix: str, name: str) -> tempfile.TemporaryDirectory[str]:
    """Create a private temporary folder whose path is short enough for a socket `name` in it."""
    folder = tempfile.TemporaryDirectory(prefix=prefix)
    if len(os.fsencode(Path(folder.name) / name)) <= SOCKET_PATH_BYTES:
        return folder
    folder.cleanup()
    return tempfile.TemporaryDirectory(prefix=prefix, dir="/tmp")
