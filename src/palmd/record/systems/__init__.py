"""The systems whose event logs palmd understands: how each is read, estimated and reconstructed.

A system is a file here with a `SYSTEM`, and a row of `palmd.systems` by the name that line 1 of a log gives as
`rig.system`. Each is loaded when a log of it is read.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from palmd.record.logline import BadLineError, Line, shown
from palmd.record.logreader import LogForm, read_log_as
from palmd.systems import SYSTEMS, TWO_PALMS, load_part

if TYPE_CHECKING:
    from palmd.events import ObserverName
    from palmd.outlinefile import Outline
    from palmd.record.meshfile import Mesh
    from palmd.record.outline_curves import OutlineCurves
    from palmd.record.replay import Said


@dataclass(frozen=True, slots=True)
class Reconstructed:
    """What a whole log tells: `line` as `palmd reconstruct` writes it, and `told`, one line for people.

    curves: the outline for drawings under a given name, None where there is none; `reason`: then why. mesh: the surface
    of a body in space, None where there is none.
    """

    line: Line
    told: str
    curves: Callable[[str], OutlineCurves] | None
    reason: str
    mesh: Mesh | None = None


class System(LogForm, Protocol):
    """One system. Its logs are what its `log` makes; they have `rig`, `events` and `notes`."""

    @property
    def name(self) -> str: ...

    def known_to(self, log: Any, sds: Mapping[str, float]) -> Any:
        """The same log of a rig that is known as well as `sds` say, by the names of `CALIBRATION_KEYS`.

        Raises `NotYetError`.
        """
        ...

    def reconstruct(self, log: Any, seed: int, say: Callable[[str], None] | None = None) -> Reconstructed:
        """What the whole log tells; never raises for what its readings say.

        `say` is told how far a long search has come.
        """
        ...

    def tick_count(self, log: Any) -> int:
        """How many ticks `estimate` gives."""
        ...

    def estimate(self, log: Any, observer: ObserverName, outlines: Sequence[Outline]) -> Iterator[Said]:
        """What the observer says tick by tick, each from the events up to it only; raises `NotYetError`."""
        ...


class NotYetError(Exception):
    """A system cannot do this; the text is one clear sentence."""


def system_of(name: str | None) -> System:
    """The system that a log names; raises BadLineError."""
    if name is not None and (name == TWO_PALMS or name not in SYSTEMS):
        known = ", ".join(each for each in SYSTEMS if each != TWO_PALMS)
        raise BadLineError(
            f"rig.system is {shown(name)}, which this palmd does not know; it knows {known or 'no other'}, and two"
            " palms on a hinge where none is named"
        )
    system: System = load_part(SYSTEMS[name or TWO_PALMS].log)
    return system


def read_log_of_any(path: Path) -> tuple[System, Any]:
    """An event log of whichever system, and that system; raises LogError as `read_log_as` does."""
    found: list[System] = []

    def form_of(name: str | None) -> LogForm:
        found.append(system_of(name))
        return found[-1]

    log = read_log_as(path, form_of)[1]
    return found[-1], log
