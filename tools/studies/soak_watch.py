"""Collects messages of daemon and rig and the processes' resources during a soak, in the form that is judged."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

from tools.studies.soak_findings import Numbers, ProcessSeries, Second


class WatchedMessage(Protocol):
    """One message of daemon or rig."""

    @property
    def topic(self) -> str:
        """The message's topic."""

    @property
    def fields(self) -> dict[str, Any]:
        """The message's fields."""


@dataclass(frozen=True, slots=True)
class Process:
    """Resources of a process: resident memory (MB), open descriptors, threads."""

    rss_mb: float
    descriptors: int
    threads: int


@dataclass(slots=True)
class SoakWatch:
    """See the module. `last_state`: the last `palm/state`; `loop`: the last `palm/loop`."""

    seconds: list[Second] = field(default_factory=list)
    processes: dict[str, ProcessSeries] = field(default_factory=dict)
    numbers: dict[str, Numbers] = field(default_factory=dict)
    last_state: dict[str, Any] = field(default_factory=dict)
    loop: dict[str, Any] = field(default_factory=dict)
    on_palms: bool = True

    @property
    def state(self) -> str:
        """The last state, empty before the first."""
        return str(self.last_state.get("state", ""))

    @property
    def t_loop(self) -> float:
        """Time of the last `palm/loop` (s)."""
        return float(self.loop.get("mono_ns", 0)) * 1e-9

    def take(self, message: WatchedMessage) -> None:
        """Take one message."""
        fields = message.fields
        self._number(message.topic, fields["seq"])
        if message.topic == "palm/state":
            self.last_state = fields
        elif message.topic == "palm/loop":
            self.loop = fields
            self.seconds.append(Second(self.t_loop, fields["ticks"], fields["overruns"], tuple(fields["lateness_ms"])))

    def sample(self, name: str, t: float, process: Process) -> None:
        """Add the resources of a process at `t` (s)."""
        series = self.processes.setdefault(name, ProcessSeries())
        series.t.append(t)
        series.rss_mb.append(process.rss_mb)
        series.descriptors.append(process.descriptors)
        series.threads.append(process.threads)

    def _number(self, topic: str, number: int) -> None:
        known = self.numbers.get(topic)
        if known is None:
            self.numbers[topic] = Numbers(number, number)
            return
        known.missing += max(0, number - known.last - 1)
        known.last = number
