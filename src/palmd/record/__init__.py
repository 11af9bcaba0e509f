"""Runs on disk: event logs, and their causal replay through the daemon's observer."""

from __future__ import annotations

from pathlib import Path

SUFFIX = ".mcap"
"""Of a recording's file."""
MAGIC = b"\x89MCAP0\r\n"
"""What it begins with."""


METADATA = "palmd"
"""The name of what it says of itself."""


END = "palmd-end"
"""The name of what a finished file says of its end: `why`, one of those below."""
SILENT, ANOTHER, LONG, ASKED, STARTER_GONE = "silent", "another", "long", "asked", "starter-gone"
"""The daemon was silent, or another one began; the file was long enough; the recorder was asked to end, or whoever had
started it, which is the daemon, was gone."""


class RunError(Exception):
    """A recording that cannot be used; its text is one line `file: what`."""


def is_recording(path: Path) -> bool:
    """Whether a file is a recorded run, by its first bytes or else by its name; also when it cannot be read."""
    if path.suffix == SUFFIX:
        return True
    try:
        with path.open("rb") as stream:
            return stream.read(len(MAGIC)) == MAGIC
    except OSError:
        return False  # whoever reads it tells why
