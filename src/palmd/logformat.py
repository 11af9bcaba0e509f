"""Format of log lines: plain on a terminal, with priorities if the journal reads them."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping

STDERR = 2

_PRIORITIES = ((logging.CRITICAL, 2), (logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6))
_DEBUG_PRIORITY = 7


def formatter(fd: int = STDERR) -> logging.Formatter:
    """The formatter for lines to this file descriptor."""
    if is_journal(os.environ, fd):
        return JournalFormatter()
    return logging.Formatter("%(levelname)s %(message)s")


def is_journal(environment: Mapping[str, str], fd: int) -> bool:
    """Whether the file descriptor leads to the journal, according to JOURNAL_STREAM (device:inode)."""
    try:
        status = os.fstat(fd)
    except OSError:
        return False
    return environment.get("JOURNAL_STREAM") == f"{status.st_dev}:{status.st_ino}"


class JournalFormatter(logging.Formatter):
    """Begins each line with its priority in angle brackets, as specified in sd-daemon(3)."""

    def format(self, record: logging.LogRecord) -> str:
        """The record as lines for the journal."""
        mark = next((n for level, n in _PRIORITIES if record.levelno >= level), _DEBUG_PRIORITY)
        return "\n".join(f"<{mark}>{line}" for line in super().format(record).splitlines())
