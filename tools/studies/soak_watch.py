"""Collects what daemon, rig and the system say during a soak, in the form that it is judged in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from palmd.system.mechanism import PALMS
from tools.studies.fault_reaction import ToldState
from tools.studies.soak_behaviour import Counted, GivenCommand, PossibleCause
from tools.studies.soak_lateness import Second
from tools.studies.soak_slopes import ProcessSeries

FELT_N = 0.1  # a pad needs a closing force


class Heard(Protocol):
    """One message of daemon or rig."""

    @property
    def topic(self) -> str:
        """Its name."""

    @property
    def fields(self) -> dict[str, Any]:
        """Its map."""


@dataclass(frozen=True, slots=True)
class Process:
    """What a process takes: resident memory (MB), open descriptors, threads."""

    rss_mb: float
    descriptors: int
    threads: int


@dataclass(slots=True)
class Numbers:
    """The numbers that the messages of one topic had: the first, the last, how many were missing between."""

    first: int
    last: int
    missing: int = 0


@dataclass(slots=True)
class SoakWatch:
    """See the module. `lengths_m` are those of the pads; `told` is the last palm/state, `loop` the last palm/loop."""

    lengths_m: Mapping[str, float]
    seconds: list[Second] = field(default_factory=list)
    states: list[ToldState] = field(default_factory=list)
    causes: list[PossibleCause] = field(default_factory=list)
    commands: list[GivenCommand] = field(default_factory=list)
    sent: list[Counted] = field(default_factory=list)
    accepted: list[Counted] = field(default_factory=list)
    processes: dict[str, ProcessSeries] = field(default_factory=dict)
    numbers: dict[str, Numbers] = field(default_factory=dict)
    told: dict[str, Any] = field(default_factory=dict)
    motion: dict[str, Any] = field(default_factory=dict)
    loop: dict[str, Any] = field(default_factory=dict)
    on_palms: bool = True
    _parted: dict[str, float] = field(default_factory=dict)
    _stalls: int = 0
    _t_rig: float = 0.0

    @property
    def state(self) -> str:
        """The last one told, empty before."""
        return str(self.told.get("state", ""))

    @property
    def t_loop(self) -> float:
        """The tick of the last palm/loop (s)."""
        return float(self.loop.get("mono_ns", 0)) * 1e-9

    def take(self, message: Heard) -> None:
        """One message."""
        fields = message.fields
        t = fields["mono_ns"] * 1e-9
        self._number(message.topic, fields["seq"])
        match message.topic:
            case "palm/state":
                self._state(fields, t)
            case "palm/motion":
                self.motion = fields
            case "palm/loop":
                before, self.loop = self.loop or fields, fields
                for pad in self.lengths_m:
                    if fields[f"{pad}_batches"] > before[f"{pad}_batches"]:
                        self.causes.append(PossibleCause("batch", pad, before["mono_ns"] * 1e-9, t))
                late = tuple(fields["lateness_ms"])
                self.seconds.append(Second(t, fields["ticks"], fields["overruns"], late))
                self.sent.append(Counted(t, fields["arm_setpoints"]))
            case "rig/truth":
                for number in PALMS:
                    self._contact(f"pad{number}", fields, number, t)

    def rig(self, status: Mapping[str, Any], t: float) -> None:
        """The rig's own counts, asked at `t` (s)."""
        self.accepted.append(Counted(status["clock_s"], status["accepted"]))
        self.on_palms = status["on_palms"]
        if status["stalls"] > self._stalls:
            self.causes.append(PossibleCause("stall", None, self._t_rig, t))
        self._stalls, self._t_rig = status["stalls"], t

    def waited(self, total_ms: float) -> None:
        """For how long the loop has had to wait for a processor by its last palm/loop, since the start."""
        self.seconds[-1] = replace(self.seconds[-1], waited_ms=total_ms)

    def sample(self, name: str, t: float, process: Process) -> None:
        """What a process takes at `t` (s)."""
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

    def _state(self, fields: dict[str, Any], t: float) -> None:
        self.told = fields
        now = ToldState.heard(fields, t)
        if not self.states or (self.states[-1].state, self.states[-1].faults) != (now.state, now.faults):
            self.states.append(now)

    def _contact(self, pad: str, truth: dict[str, Any], number: int, t: float) -> None:
        """Remember from when to when nothing that a pad can feel touched it."""
        on_pad = 0.0 < truth[f"s{number}_m"] < self.lengths_m[pad]
        felt = truth[f"contact{number}"] and truth[f"f{number}_n"] > FELT_N and on_pad
        if not felt:
            self._parted.setdefault(pad, t)
        elif pad in self._parted:
            self.causes.append(PossibleCause("parted", pad, self._parted.pop(pad), t))

    def so_far(self) -> list[PossibleCause]:
        """The causes, and what still goes on."""
        open_ones = [PossibleCause("parted", pad, t, float("inf")) for pad, t in self._parted.items()]
        return self.causes + open_ones
