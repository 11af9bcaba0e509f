"""The systems whose event logs palmd can read, estimate and reconstruct.

Each system is a module here with an object `SYSTEM`, and a row of `palmd.systems` under the name that line 1 of a log
gives as `rig.system`. Modules are loaded when a log of their system is read.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

from palmd.record.logline import BadLineError, Line, shown
from palmd.record.logreader import LogParser, read_log_as
from palmd.systems import SYSTEMS, TWO_PALMS, load_part

if TYPE_CHECKING:
    from palmd.events import ObserverName
    from palmd.outlinefile import Outline
    from palmd.record.outline_files import OutlineCurves
    from palmd.record.replay import TickFields
    from palmd.record.surface import Mesh


@dataclass(frozen=True, slots=True)
class Reconstructed:
    """The reconstruction of a whole log: `line` as `palmd reconstruct` writes it, and `summary`, one line for people.

    curves: makes the outline's curves under a given name; None without an outline, `reason` then says why. mesh: the
    surface of a body in space, None if there is none.
    """

    line: Line
    summary: str
    curves: Callable[[str], OutlineCurves] | None
    reason: str
    mesh: Mesh | None = None


Rig = TypeVar("Rig")
LogEvent = TypeVar("LogEvent")


@dataclass(frozen=True, slots=True)
class SystemLog(Generic[Rig, LogEvent]):
    """A run of a system other than two palms: the rig, its events, and notes on omitted lines."""

    rig: Rig
    events: tuple[LogEvent, ...]
    notes: tuple[str, ...] = ()


class System(LogParser, Protocol):
    """One system. Its logs, built by `log`, have `rig`, `events` and `notes`."""

    @property
    def name(self) -> str: ...

    def known_to(self, log: Any, sds: Mapping[str, float]) -> Any:
        """The log with the rig's standard deviations replaced by `sds`, by the names of `CALIBRATION_KEYS`.

        Raises `NotYetError`.
        """
        ...

    def reconstruct(self, log: Any, seed: int, progress: Callable[[str], None] | None = None) -> Reconstructed:
        """Reconstruct from the whole log; never raises because of its readings.

        `progress` is called with the state of a long search.
        """
        ...

    def estimate(self, log: Any, observer: ObserverName, outlines: Sequence[Outline]) -> Iterator[TickFields]:
        """The observer's estimates for `replay.tick_count(log)` ticks, each from earlier events; raises `NotYetError`.

        Systems with a single observer ignore `observer`.
        """
        ...


class NotYetError(Exception):
    """The system does not support this; the text is one sentence."""


def system_of(name: str | None) -> System:
    """The system that a log names; raises BadLineError."""
    if name is not None and (name == TWO_PALMS or name not in SYSTEMS):
        known = ", ".join(each for each in SYSTEMS if each != TWO_PALMS)
        raise BadLineError(
            f"rig.system is {shown(name)}, which this palmd does not know; known systems: {known or 'none'}, and two"
            " palms on a hinge if rig.system is missing"
        )
    system: System = load_part(SYSTEMS[name or TWO_PALMS].log)
    return system


def read_log_of_any(path: Path) -> tuple[System, Any]:
    """Read an event log of any system; returns system and log, raises LogError as `read_log_as` does."""
    found: list[System] = []

    def parser_of(name: str | None) -> LogParser:
        found.append(system_of(name))
        return found[-1]

    log = read_log_as(path, parser_of)[1]
    return found[-1], log
