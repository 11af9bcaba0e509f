"""From messages to files: when a run begins and ends, what was lost, and what to do while nothing can be written.

Sockets and signals are `palmd.record.recorder`'s business. Times are Unix seconds.
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
from palmd.record import ANOTHER, LONG, SILENT, SUFFIX
from palmd.record.mcapfile import RawMessage
from palmd.record.mcapread import is_finished
from palmd.record.metadata import preface
from palmd.record.runfile import RunFile
from palmd.record.tables import flat
from palmd.topics import TOPICS
from palmd.yamlfile import ConfigError, recorded_config

log = logging.getLogger(__name__)

LONGEST_S = 3600.0  # of one file
SILENT_S = 5.0  # without a message from the daemon: its run is over
RETRY_S = 10.0
UNTOLD_S = 2.0  # of a daemon that tells no configuration; others tell it in their first tick, and each second
INTERRUPTED_S = 60.0  # since its last message, within which another recorder takes up a recording
NAMED = 5
DAY_S = 86_400.0
ROOTS = frozenset(topic.name.partition("/")[0] for topic in TOPICS)
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
        self._directory = config.record.directory
        self._hash = config_hash(config)
        self._kept: list[RawMessage] | None = None  # what is in the file, until the daemon has told its configuration
        self._ended = ended
        self._file: RunFile | None = None
        self._last = self._before = ""  # file of the daemon's present life, and the one before it
        self._first = True  # whether this process has begun no file yet
        self._gap_s = 0.0  # between the file before and the one in hand, where that one's recorder was killed
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
        if _is_daemons(topic):
            self._t_heard = t
            if self._file is None or t - self._t_begun >= LONGEST_S:
                self.finish(LONG)
                self._take_up(t, number)
                self._begin(t)
            self.lost += self._file is None
        if topic == CONFIG.name and fields.get("config_hash") != self._hash:
            self._learn(fields, t)
        if self._file is not None:
            message = RawMessage(topic, _ns(t, t), _ns(fields.get("timestamp"), t), number, frames[1])
            self._file.write(message)
            self._keep(message, t)

    def _keep(self, message: RawMessage, t: float) -> None:
        if self._kept is not None:
            self._kept.append(message)
            if message.topic == CONFIG.name or t - self._t_begun > UNTOLD_S:
                self._kept = None

    def _learn(self, told: Fields, t: float) -> None:
        """The daemon goes by another configuration than ours: from its first message on, the file is one of that."""
        self._hash = str(told.get("config_hash"))
        try:
            config = recorded_config(yaml.safe_load(str(told.get("yaml"))))
        except (ConfigError, yaml.YAMLError) as error:
            log.warning("the daemon's configuration cannot be used, and the recorder's own is kept: %s", error)
            return
        log.warning(
            "the daemon's configuration differs from the recorder's, and is the one that is kept: %s",
            ", ".join(differences(self._config, config)) or "in its hash",
        )
        self._config = config
        kept, file = self._kept, self._file
        if file is None:
            return
        if kept is None:  # too late for what is in the file
            self._gap_s = 0.0
            self.finish(ANOTHER)
            self._begin(t)
            return
        self._file = None
        file.abandon()
        file.path.unlink(missing_ok=True)
        self._last = self._before
        self._begin(self._t_begun)
        begun: RunFile | None = self._file  # none where the disk is full
        if begun is not None:
            for message in kept:
                begun.write(message)

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
                self.finish(SILENT)

    def fail(self, error: OSError, t: float) -> None:
        """Let go of the file, as it is, and begin another one later."""
        self._t_failed = t
        told, self.problem = self.problem, self._told(error)
        if self.problem != told:
            log.warning("%s; it is tried again every %g s", self.problem, RETRY_S)
        if self._file is not None:
            self._abandon(self._file)

    def finish(self, why: str = "") -> None:
        """End the file in hand; `why` as in `palmd.record`."""
        if self._file is None:
            return
        file = self._file
        try:
            file.finish(why)
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
        if number < expected and _is_daemons(topic):
            self.finish(ANOTHER)
            self._last = ""
            self._expected.clear()
        self._expected[topic] = number + 1

    def _take_up(self, t: float, number: int) -> None:
        """Name the recording of a killed recorder as the one before, where the daemon's run began before this one."""
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
        self._t_begun = t
        self._kept, self._before = [], self._last
        self._last = self._file.path.name
        if self._gap_s:
            log.warning("recording to %s, which goes on from another after %.1f s", self._file.path, self._gap_s)
        else:
            log.info("recording to %s", self._file.path)

    def _abandon(self, file: RunFile) -> None:
        self._file = None
        self.lost += file.pending
        file.abandon()
        self._ended(Ended(file.path, file.messages - file.pending, False))

    def _told(self, error: OSError) -> str:
        why = "the disk is full" if error.errno == errno.ENOSPC else error.strerror or str(error)
        return f"{self._directory}: {why}"


def _is_daemons(topic: str) -> bool:
    return topic.partition("/")[0] in ROOTS


def differences(ours: AnyConfig, theirs: AnyConfig) -> list[str]:
    """The keys, dotted, in which two configurations differ; a few of them."""
    mine, other = (dict(flat(each.model_dump(mode="json"))) for each in (ours, theirs))
    names = [name for name in {**mine, **other} if mine.get(name) != other.get(name)]
    return names if len(names) <= NAMED else [*names[:NAMED], f"and {len(names) - NAMED} more"]


def interrupted(directory: Path, t: float) -> tuple[str, float]:
    """The name of the recording in `directory` whose recorder was killed shortly before `t`, and how long before (s).

    Empty and 0 where there is none. Raises OSError.
    """
    found = sorted((path.stat().st_mtime, path) for path in directory.glob(f"*{SUFFIX}")) if directory.is_dir() else []
    recent = [(t_last, path) for t_last, path in found if 0.0 <= t - t_last <= INTERRUPTED_S and not is_finished(path)]
    return (recent[-1][1].name, t - recent[-1][0]) if recent else ("", 0.0)


def _ns(seconds: object, otherwise: float) -> int:
    """Unix time in nanoseconds; a stamp that is no time, or a day and more from its arrival, is that of its arrival."""
    if not isinstance(seconds, float) or not abs(seconds - otherwise) < DAY_S:
        seconds = otherwise
    return round(seconds * 1e9)
