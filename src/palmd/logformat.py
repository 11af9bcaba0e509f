"""How log lines look: plain on a terminal, with the journal's priorities where it is the journal that reads them."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping

STDERR = 2

_PRIORITIES = ((logging.CRITICAL, 2), (logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6))
_DEBUG_PRIORITY = 7


def formatter(fd: int = STDERR) -> logging.Formatter:
    """What formats the lines that go to this file descriptor."""
    if is_journal(os.environ, fd):
        return JournalFormatter()
    return logging.Formatter("%(levelname)s %(message)s")


def is_journal(environment: Mapping[str, str], fd: int) -> bool:
    """Whether the file descriptor leads to the journal, as JOURNAL_STREAM (device:inode) tells."""
    try:
        status = os.fstat(fd)
    except OSError:
        return False
    return environment.get("JOURNAL_STREAM") == f"{status.st_dev}:{status.st_ino}"


class JournalFormatter(logging.Formatter):
    """Each line begins with its priority in angle brackets, as sd-daemon(3) has it."""

    def format(self, record: logging.LogRecord) -> str:
        """The record as lines for the journal."""
        mark = next((n for level, n in _PRIORITIES if record.levelno >= level), _DEBUG_PRIORITY)
        return "\n".join(f"<{mark}>{line}" for line in super().format(record).splitlines())
