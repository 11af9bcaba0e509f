"""Recordings (MCAP files) and event logs: writing, reading, replay through the observer, export."""

from __future__ import annotations

from pathlib import Path

SUFFIX = ".mcap"
"""File suffix of a recording."""
MAGIC = b"\x89MCAP0\r\n"
"""First and last bytes of an MCAP file."""

METADATA = "palmd"
"""Name of the metadata record with versions, configuration hash and start time."""

END = "palmd-end"
"""Name of the metadata record at the end of a finished file; its `why` is one of the codes below."""
DAEMON_SILENT, DAEMON_RESTARTED, LENGTH_LIMIT, REQUESTED, PARENT_GONE = (
    "silent",
    "another",
    "long",
    "asked",
    "starter-gone",
)
"""Why the recorder ended a file: no message from the daemon; another daemon or configuration began; the file reached
its maximum length; the recorder was requested to end; the process that started the recorder (the daemon) was gone."""


class RunError(Exception):
    """A recording that cannot be used; the text is one line `file: what is wrong`."""


def is_recording(path: Path) -> bool:
    """Whether a file has a recording's suffix or first bytes; False for other files that cannot be read."""
    if path.suffix == SUFFIX:
        return True
    try:
        with path.open("rb") as stream:
            return stream.read(len(MAGIC)) == MAGIC
    except OSError:
        return False  # the reader reports why
