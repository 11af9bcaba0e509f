"""A fault that needs a broken observer, in a run without wires: the daemon itself has no place to put one in."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Literal

import msgpack

from palmd import observer
from palmd.config.two_palms import Config, PlanSpec, rig_description
from palmd.harness.wireless import Instant, Wireless
from palmd.messages import Fields, stamp
from palmd.record.recording import Ended, Recording
from palmd.rig.world import default_config
from tools.studies.fault_reaction import Reaction, ReactionWatch
from tools.studies.fault_rows import FaultRow
from tools.studies.fault_why import ask, asked_at
from tools.studies.silent_observer import Breakable

BREAKS_AFTER_S = 3.0
WATCHED_S = 1.0


def provoke(row: FaultRow, how: Literal["raises", "nan"], spec: PlanSpec, seed: int, folder: Path) -> Reaction:
    """Run the plan, break the observer while the palms turn, look on, and ask the recording in `folder` why."""
    config = default_config()
    config = config.model_copy(update={"record": config.record.model_copy(update={"directory": folder})})
    breakable = Breakable(observer.make("shape", rig_description(config), seed))
    run = Wireless(config, spec, seed, estimator=breakable)
    run.start()
    recorder = WirelessRecorder(config)
    for instant in run.run(BREAKS_AFTER_S):
        recorder.take(instant)
    watch = ReactionWatch()
    t_cause = run.t
    breakable.how = how
    while run.t < t_cause + WATCHED_S:
        instant = run.tick()
        recorder.take(instant)
        stamped = {"mono_ns": instant.t * 1e9}
        watch.take("rig/truth", instant.truth | stamped)
        if "palm/state" in instant.messages:
            watch.take("palm/state", dict(instant.messages["palm/state"]) | stamped)
    seen = watch.reaction(row, t_cause)
    t_asked = asked_at(row, t_cause, seen.noticed_s, seen.came_s)
    return replace(seen, why=ask(row, recorder.finish(), t_cause, t_asked))


class WirelessRecorder:
    """Records a run without wires as the recorder would."""

    def __init__(self, config: Config) -> None:
        self._ended: list[Ended] = []
        self._recording = Recording(config, self._ended.append)
        self._numbers: Counter[str] = Counter()
        self._t_begun = time.time()

    def take(self, instant: Instant) -> None:
        """All that was published in a tick."""
        for topic, fields in instant.messages.items():
            self.publish(topic, fields, instant.t)

    def publish(self, topic: str, fields: Fields, t: float) -> None:
        """One message of the tick at `t` (s)."""
        now = self._t_begun + t
        payload = msgpack.packb(stamp(dict(fields), now, t, self._numbers[topic]))
        self._numbers[topic] += 1
        self._recording.take([topic.encode(), payload, b""], now)

    def finish(self) -> Path:
        """The recording."""
        self._recording.finish()
        return self._ended[-1].path
