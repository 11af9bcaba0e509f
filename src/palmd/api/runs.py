"""A recorded run or an event log, as arrays."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from palmd.api.errors import PalmdError, as_palmd_error
from palmd.api.outline import OutlineData, last_of, outline_of
from palmd.api.table import DataTable, table_of
from palmd.events import Event, FloatArray, PadLift
from palmd.messages import Fields
from palmd.quantities import CONTACT, ESTIMATE, SHAPE
from palmd.record import is_recording
from palmd.record.eventlog import EventLog, event_line
from palmd.record.systems import System, read_log_of_any, system_of

if TYPE_CHECKING:
    from palmd.record.run import Run


@dataclass(frozen=True, slots=True)
class Events:
    """Measured events of pads and palms; `t_s` is the time of measurement on the log's clock.

    pads: `t_s pad s_m force_n`, one row per reading; s_m is NaN where the object left the pad. palms: `t_s`, the palms'
    measured angles, and the rates and accelerations of the plan.
    """

    pads: DataTable
    palms: DataTable


class RunData:
    """A run in a file; each table is read on first access and cached."""

    def __init__(self, path: Path) -> None:
        """Raises PalmdError for a file that is neither a recorded run nor an event log."""
        self.path = path
        with as_palmd_error():
            self._recording: Run | None = None
            self._system: System = system_of(None)
            self._log: Any = None
            if is_recording(path):
                from palmd.record.run import read_run  # slow to load

                self._recording = read_run(path)
            else:
                self._system, self._log = read_log_of_any(path)

    def __repr__(self) -> str:
        return f"<palmd.RunData {self.path}>"

    @property
    def system(self) -> System:
        """The system of the run."""
        return self._system

    @cached_property
    def log(self) -> Any:
        """The rig and the events as the system's observers take them; PalmdError for a recording without events."""
        with as_palmd_error():
            return self._log or self._recorded().event_log()

    @property
    def rig(self) -> Any:
        """The rig as the observer knows it: a `RigDescription` of two palms, or another system's description."""
        return self.log.rig if self._recording is None else self._recording.rig

    @property
    def metadata(self) -> Mapping[str, str]:
        """Versions, the configuration's hash, and which run it continues; empty for an event log."""
        return {} if self._recording is None else self._recording.metadata

    @cached_property
    def topics(self) -> Mapping[str, int]:
        """Number of messages per topic; empty for an event log."""
        if self._recording is None:
            return {}
        with as_palmd_error():
            return {topic: survey.count for topic, survey in self._recording.survey().items()}

    def table(self, topic: str) -> DataTable:
        """All messages of a topic, with `t_s`: the time they refer to (s), on the clock of the events.

        Raises PalmdError if there are none.
        """
        with as_palmd_error():
            table = table_of(
                {"t_s": fields["mono_ns"] * 1e-9} | fields
                for fields in (message.fields for message in self._recorded(topic).messages(topic))
            )
        if not table:
            raise PalmdError(f"{self.path}: holds no {topic}; its topics are {', '.join(self.topics)}")
        return table

    @cached_property
    def estimates(self) -> DataTable:
        """The daemon's estimates, tick by tick: the fields of `palm/estimate`."""
        return self.table(ESTIMATE.name)

    @cached_property
    def contacts(self) -> DataTable:
        """The pads' last readings, tick by tick: the fields of `palm/contact`."""
        return self.table(CONTACT.name)

    @cached_property
    def outlines(self) -> tuple[OutlineData, ...]:
        """All outlines that the daemon published, in order of time."""
        with as_palmd_error():
            messages = self._recorded(SHAPE.name).messages(SHAPE.name)
            return tuple(outline_of(fields, fields["mono_ns"] * 1e-9) for fields in (each.fields for each in messages))

    @property
    def outline(self) -> OutlineData:
        """The last outline; PalmdError if there is none."""
        return last_of(self.outlines, str(self.path))

    def outline_xy(self) -> FloatArray:
        """Points (361, 2) of the last outline in m, closed, in the object's frame about its centre of mass."""
        return self.outline.xy()

    @cached_property
    def events(self) -> Events:
        """The measured events."""
        if not isinstance(self.log, EventLog):
            raise PalmdError(f"{self.path}: is a log of the system {self.system.name}; its events are in .log.events")
        rows = [_row(event) for event in self.log.events]
        return Events(*(table_of(row for row in rows if ("pad" in row) is of_pads) for of_pads in (True, False)))

    def _recorded(self, topic: str = "") -> Run:
        if self._recording is None:
            raise PalmdError(
                f"{self.path}: is an event log and holds no {topic}; .events has its readings, palmd.estimate(…) and"
                " palmd.reconstruct(…) compute estimates"
            )
        return self._recording


def open(path: str | os.PathLike[str]) -> RunData:
    """The recorded run (MCAP) or event log (JSON lines) in a file; its first bytes show which it is.

    Raises PalmdError for an unusable file. Fast: tables are read when they are accessed.
    """
    return RunData(Path(path))


def _row(event: Event) -> Fields:
    """An event as a flat map, under the names of the event log."""
    line: Fields = {"pad": event.pad} if isinstance(event, PadLift) else event_line(event) or {}
    fields = {name: value for name, value in (line | line.get("palms", {})).items() if name not in ("t", "palms")}
    return {"t_s": event.t_sample} | fields
