"""Recording of messages into files: when a file begins and ends, lost messages, and handling of write errors.

Sockets and signals are handled by `palmd.record.recorder`. Times are Unix seconds.
"""

from __future__ import annotations

import contextlib
import errno
import logging
import math
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import yaml

from palmd.config.any_config import AnyConfig, config_hash
from palmd.messages import Fields
from palmd.payload import FRAMES, unpacked
from palmd.quantities import CONFIG
from palmd.record import DAEMON_RESTARTED, DAEMON_SILENT, LENGTH_LIMIT, SUFFIX
from palmd.record.mcapfile import RawMessage
from palmd.record.mcapread import is_finished
from palmd.record.metadata import preface
from palmd.record.runfile import RunFile
from palmd.record.tables import flat
from palmd.topics import TOPICS
from palmd.yamlfile import ConfigError, recorded_config

log = logging.getLogger(__name__)

MAX_FILE_S = 3600.0  # longest duration of one file
SILENT_S = 5.0  # without a message from the daemon the run has ended
RETRY_S = 10.0  # wait after a write error before the next file is tried
CONFIG_WAIT_S = 2.0  # longest wait for the daemon's configuration, which it publishes in its first tick and each second
RESUME_S = 60.0  # age of an unfinished recording up to which a new one continues it
MAX_NAMED_KEYS = 5  # most configuration keys listed in a warning
DAY_S = 86_400.0
TOPIC_ROOTS = frozenset(topic.name.partition("/")[0] for topic in TOPICS)
"""First parts of the daemon's topic names; only the daemon's messages begin and end a file, not those of a rig."""


@dataclass(frozen=True, slots=True)
class ClosedFile:
    """A closed file: number of messages, and whether it is finished (`whole`)."""

    path: Path
    messages: int
    whole: bool


class Recording:
    """Writes one file at a time. No method raises OSError; `problem` describes the current write error."""

    def __init__(self, config: AnyConfig, ended: Callable[[ClosedFile], None]) -> None:
        """`ended` is called with each closed file."""
        self.problem = ""
        self.lost = 0
        self._config = config
        self._directory = config.record.directory
        self._hash = config_hash(config)
        self._replayable: list[RawMessage] | None = (
            None  # the file's messages until the daemon's configuration is known
        )
        self._ended = ended
        self._file: RunFile | None = None
        self._last = self._predecessor = ""  # names of the last file of this daemon run, and of the one before it
        self._first = True  # whether this process has not begun a file yet
        self._gap_s = 0.0  # unrecorded time after the previous file if its recorder was killed
        self._expected: dict[str, int] = {}
        self._t_begin = self._t_received = self._t_failed = -math.inf

    @property
    def path(self) -> Path | None:
        """Path of the current file."""
        return None if self._file is None else self._file.path

    @property
    def fd(self) -> int | None:
        """Descriptor of the current file."""
        return None if self._file is None else self._file.fd

    @property
    def size_bytes(self) -> int:
        """Size of the current file."""
        return self._file.size_bytes if self._file else 0

    @property
    def messages(self) -> int:
        """Number of messages in the current file."""
        return self._file.messages if self._file else 0

    def take(self, frames: list[bytes], t: float) -> None:
        """Record a message received at `t`; anything but two or three frames with a map is ignored."""
        fields = unpacked(frames[1]) if len(frames) in FRAMES else None
        number = None if fields is None else fields.get("seq")
        if fields is None or not isinstance(number, int):
            return
        topic = frames[0].decode(errors="replace")
        self._count_lost(topic, number)
        if _is_daemons(topic):
            self._t_received = t
            if self._file is None or t - self._t_begin >= MAX_FILE_S:
                self.finish(LENGTH_LIMIT)
                self._find_predecessor(t, number)
                self._begin(t)
            self.lost += self._file is None
        if topic == CONFIG.name and fields.get("config_hash") != self._hash:
            self._adopt_config(fields, t)
        if self._file is not None:
            message = RawMessage(topic, _ns(t, t), _ns(fields.get("timestamp"), t), number, frames[1])
            self._file.write(message)
            if self._replayable is not None:
                self._replayable.append(message)
                if topic == CONFIG.name or t - self._t_begin > CONFIG_WAIT_S:
                    self._replayable = None

    def _adopt_config(self, published: Fields, t: float) -> None:
        """Adopt the differing configuration of the daemon, for the whole current file if possible."""
        self._hash = str(published.get("config_hash"))
        try:
            config = recorded_config(yaml.safe_load(str(published.get("yaml"))))
        except (ConfigError, yaml.YAMLError) as error:
            log.warning("the daemon's configuration is invalid; the recorder's own is recorded instead: %s", error)
            return
        log.warning(
            "the daemon's configuration differs from the recorder's; the daemon's is recorded. Differences: %s",
            ", ".join(differences(self._config, config)) or "only the hash",
        )
        self._config = config
        replayable, file = self._replayable, self._file
        if file is None:
            return
        if replayable is None:  # too late to change the current file
            self._gap_s = 0.0
            self.finish(DAEMON_RESTARTED)
            self._begin(t)
            return
        self._file = None
        file.abandon()
        file.path.unlink(missing_ok=True)
        self._last = self._predecessor
        self._begin(self._t_begin)
        restarted: RunFile | None = self._file  # None if the disk is full
        if restarted is not None:
            for message in replayable:
                restarted.write(message)

    def flush(self, t: float) -> None:
        """Write the received messages to the operating system, and finish the file if the daemon is silent at `t`."""
        if self._file is None:
            return
        try:
            self._file.flush()
        except OSError as error:
            self.fail(error, t)
        else:
            if t - self._t_received > SILENT_S:
                self.finish(DAEMON_SILENT)

    def fail(self, error: OSError, t: float) -> None:
        """Abandon the file as it is after a write error; another one is begun later."""
        self._t_failed = t
        previous, self.problem = self.problem, self._error_text(error)
        if self.problem != previous:
            log.warning("%s; retrying every %g s", self.problem, RETRY_S)
        if self._file is not None:
            self._abandon(self._file)

    def finish(self, why: str = "") -> None:
        """Finish the current file; `why` is one of the codes in `palmd.record`."""
        if self._file is None:
            return
        file = self._file
        try:
            file.finish(why)
        except OSError as error:
            self.problem = self._error_text(error)
            self._abandon(file)
        else:
            self._file = None
            self._ended(ClosedFile(file.path, file.messages, True))

    def _count_lost(self, topic: str, number: int) -> None:
        """Count the messages missing before this one; a decreasing sequence number means the daemon was restarted."""
        expected = self._expected.get(topic, number)
        self.lost += max(0, number - expected)
        if number < expected and _is_daemons(topic):
            self.finish(DAEMON_RESTARTED)
            self._last = ""
            self._expected.clear()
        self._expected[topic] = number + 1

    def _find_predecessor(self, t: float, number: int) -> None:
        """Find the file of a killed recorder that the first file continues, if the daemon ran before this recorder."""
        self._gap_s = 0.0
        if self._first and number > 0 and not self._last:
            with contextlib.suppress(OSError):
                self._last, self._gap_s = interrupted(self._directory, t)

    def _begin(self, t: float) -> None:
        if t - self._t_failed < RETRY_S:
            return
        begin = datetime.fromtimestamp(t, UTC)
        try:
            before = preface(self._config, begin.isoformat(), self._last, self._gap_s)
            self._file = RunFile(self._directory, before, begin)
        except OSError as error:
            self.fail(error, t)
            return
        self.problem = ""
        self._first = False
        self._t_begin = t
        self._replayable, self._predecessor = [], self._last
        self._last = self._file.path.name
        if self._gap_s:
            log.warning("recording to %s, which continues another recording after %.1f s", self._file.path, self._gap_s)
        else:
            log.info("recording to %s", self._file.path)

    def _abandon(self, file: RunFile) -> None:
        self._file = None
        self.lost += file.pending
        file.abandon()
        self._ended(ClosedFile(file.path, file.messages - file.pending, False))

    def _error_text(self, error: OSError) -> str:
        reason = "the disk is full" if error.errno == errno.ENOSPC else error.strerror or str(error)
        return f"{self._directory}: {reason}"


def _is_daemons(topic: str) -> bool:
    return topic.partition("/")[0] in TOPIC_ROOTS


def differences(ours: AnyConfig, theirs: AnyConfig) -> list[str]:
    """The dotted keys in which two configurations differ; at most `MAX_NAMED_KEYS`, and the number of others."""
    mine, other = (dict(flat(each.model_dump(mode="json"))) for each in (ours, theirs))
    names = [name for name in {**mine, **other} if mine.get(name) != other.get(name)]
    return (
        names if len(names) <= MAX_NAMED_KEYS else [*names[:MAX_NAMED_KEYS], f"and {len(names) - MAX_NAMED_KEYS} more"]
    )


def interrupted(directory: Path, t: float) -> tuple[str, float]:
    """The latest unfinished recording in `directory` that ended shortly before `t`: its name, and how long before (s).

    Empty and 0 if there is none. Raises OSError.
    """
    found = sorted((path.stat().st_mtime, path) for path in directory.glob(f"*{SUFFIX}")) if directory.is_dir() else []
    recent = [(t_last, path) for t_last, path in found if 0.0 <= t - t_last <= RESUME_S and not is_finished(path)]
    return (recent[-1][1].name, t - recent[-1][0]) if recent else ("", 0.0)


def _ns(seconds: object, otherwise: float) -> int:
    """Unix time in ns; `otherwise` (the arrival, s) replaces a stamp that is no float or differs by a day or more."""
    if not isinstance(seconds, float) or not abs(seconds - otherwise) < DAY_S:
        seconds = otherwise
    return round(seconds * 1e9)
