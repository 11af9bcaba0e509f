"""From messages to files: when a run begins and ends, what was lost, and what to do while nothing can be written.

Sockets and signals are `palmd.record.recorder`'s business. Times are Unix seconds.
"""

from __future__ import annotations

import errno
import logging
import math
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from palmd.config.any_config import AnyConfig
from palmd.payload import FRAMES, unpacked
from palmd.record import SUFFIX
from palmd.record.mcapfile import RawMessage, is_finished
from palmd.record.metadata import preface
from palmd.record.runfile import RunFile

log = logging.getLogger(__name__)

LONGEST_S = 3600.0  # of one file
SILENT_S = 5.0  # without a message from the daemon: its run is over
RETRY_S = 10.0
INTERRUPTED_S = 60.0  # since its last message, within which another recorder takes up a recording
_LATEST_S = 1e10
DAEMON = "palm/"
"""What the topics of the daemon begin with; a file begins and ends with its messages, whoever else is heard."""


@dataclass(frozen=True, slots=True)
class Ended:
    """A file that nothing more will be written to: how many messages are in it, and whether it has got its end."""

    path: Path
    messages: int
    whole: bool


class Recording:
    """Keeps one file at a time. No method raises OSError: what is wrong is told by `problem`."""

    def __init__(self, config: AnyConfig, ended: Callable[[Ended], None]) -> None:
        """`ended` is told of each file that is closed."""
        self.problem = ""
        self.lost = 0
        self._config = config
        self._ended = ended
        self._file: RunFile | None = None
        self._last = ""  # file of the daemon's present life
        self._first = True  # whether this process has begun no file yet
        self._expected: dict[str, int] = {}
        self._t_begun = self._t_heard = self._t_failed = -math.inf

    @property
    def path(self) -> Path | None:
        """The file in hand."""
        return None if self._file is None else self._file.path

    @property
    def fd(self) -> int | None:
        """Its descriptor."""
        return None if self._file is None else self._file.fd

    @property
    def size_bytes(self) -> int:
        """Of it."""
        return self._file.size_bytes if self._file else 0

    @property
    def messages(self) -> int:
        """That are in it."""
        return self._file.messages if self._file else 0

    def take(self, frames: list[bytes], t: float) -> None:
        """Record what came at `t`; what is no message of two or three frames with a map is left out."""
        fields = unpacked(frames[1]) if len(frames) in FRAMES else None
        number = None if fields is None else fields.get("seq")
        if fields is None or not isinstance(number, int):
            return
        topic = frames[0].decode(errors="replace")
        self._count(topic, number)
        if topic.startswith(DAEMON):
            self._t_heard = t
            if self._file is None or t - self._t_begun >= LONGEST_S:
                self.finish()
                self._begin(t, number)
            self.lost += self._file is None
        if self._file is not None:
            published = _ns(fields.get("timestamp"), t)
            self._file.write(RawMessage(topic, _ns(t, t), published, number, frames[1]))

    def flush(self, t: float) -> None:
        """Hand over what has been taken, and end a run that has fallen silent by `t`."""
        if self._file is None:
            return
        try:
            self._file.flush()
        except OSError as error:
            self.fail(error, t)
        else:
            if t - self._t_heard > SILENT_S:
                self.finish()

    def fail(self, error: OSError, t: float) -> None:
        """Let go of the file, as it is, and begin another one later."""
        self._t_failed = t
        told, self.problem = self.problem, self._told(error)
        if self.problem != told:
            log.warning("%s; it is tried again every %g s", self.problem, RETRY_S)
        if self._file is not None:
            self._abandon(self._file)

    def finish(self) -> None:
        """End the file in hand."""
        if self._file is None:
            return
        file = self._file
        try:
            file.finish()
        except OSError as error:
            self.problem = self._told(error)
            self._abandon(file)
        else:
            self._file = None
            self._ended(Ended(file.path, file.messages, True))

    def _count(self, topic: str, number: int) -> None:
        """Count what is missing before this message; a number that has gone back is another life of the daemon."""
        expected = self._expected.get(topic, number)
        self.lost += max(0, number - expected)
        if number < expected and topic.startswith(DAEMON):
            self.finish()
            self._last = ""
            self._expected.clear()
        self._expected[topic] = number + 1

    def _begin(self, t: float, number: int) -> None:
        """A file from `t` on, whose first message has this number."""
        if t - self._t_failed < RETRY_S:
            return
        begin = datetime.fromtimestamp(t, UTC)
        try:
            gap_s = 0.0
            if self._first and number > 0 and not self._last:
                self._last, gap_s = interrupted(self._config.record.directory, t)
            before = preface(self._config, begin.isoformat(), self._last, gap_s)
            self._file = RunFile(self._config.record.directory, before, begin)
        except OSError as error:
            self.fail(error, t)
            return
        self.problem = ""
        self._first = False
        self._t_begun = t
        self._last = self._file.path.name
        if gap_s:
            log.warning("recording to %s, which goes on from another after %.1f s", self._file.path, gap_s)
        else:
            log.info("recording to %s", self._file.path)

    def _abandon(self, file: RunFile) -> None:
        self._file = None
        self.lost += file.pending
        file.abandon()
        self._ended(Ended(file.path, file.messages - file.pending, False))

    def _told(self, error: OSError) -> str:
        why = "the disk is full" if error.errno == errno.ENOSPC else error.strerror or str(error)
        return f"{self._config.record.directory}: {why}"


def interrupted(directory: Path, t: float) -> tuple[str, float]:
    """The name of the recording in `directory` whose recorder was killed shortly before `t`, and how long before (s).

    Empty and 0 where there is none. Raises OSError.
    """
    found = sorted((path.stat().st_mtime, path) for path in directory.glob(f"*{SUFFIX}")) if directory.is_dir() else []
    recent = [(t_last, path) for t_last, path in found if 0.0 <= t - t_last <= INTERRUPTED_S and not is_finished(path)]
    return (recent[-1][1].name, t - recent[-1][0]) if recent else ("", 0.0)


def _ns(seconds: object, otherwise: float) -> int:
    """Unix time in nanoseconds; what others send need not be a time."""
    if not isinstance(seconds, float) or not 0.0 <= seconds < _LATEST_S:
        seconds = otherwise
    return round(seconds * 1e9)
