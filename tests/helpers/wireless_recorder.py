"""Records a run without wires, as the recorder would."""

from __future__ import annotations

import time
from collections import Counter
from pathlib import Path

import msgpack

from palmd.config.two_palms import Config
from palmd.messages import Fields, stamp
from palmd.record.recording import ClosedFile, Recording
from tools.closed_loop import Instant


class WirelessRecorder:
    """Recorder of one run; see the module."""

    def __init__(self, config: Config) -> None:
        self._ended: list[ClosedFile] = []
        self._recording = Recording(config, self._ended.append)
        self._numbers: Counter[str] = Counter()
        self._t_begun = time.time()

    def take(self, instant: Instant) -> None:
        """Records all messages of a tick."""
        for topic, fields in instant.messages.items():
            self.publish(topic, fields, instant.t)

    def publish(self, topic: str, fields: Fields, t: float) -> None:
        """Records one message of the tick at `t` (s)."""
        now = self._t_begun + t
        payload = msgpack.packb(stamp(dict(fields), now, t, self._numbers[topic]))
        self._numbers[topic] += 1
        self._recording.take([topic.encode(), payload, b""], now)

    def finish(self) -> Path:
        """The finished recording."""
        self._recording.finish()
        return self._ended[-1].path
