"""Summary of a recording for lists of runs: start, duration, object, accuracy, faults, notes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from palmd.messages import Fields
from palmd.quantities import OBJECT, STATE
from palmd.record import RunError
from palmd.record.damage import damage_text
from palmd.record.index import RunSummary
from palmd.record.recognition import NONE_OF_THESE
from palmd.record.run import AnyRun, read_any_run

LOG = "palm/log"
NOTE = "note"
_SEVERE = ("hold", "stop")
_STRIDE = 10  # every tenth message is read of the topics that are published each tick


def summary_of(path: Path) -> RunSummary:
    """Read a recording once and summarise it; `problem` says why it cannot be used."""
    try:
        run = read_any_run(path)
        reader = _SummaryReader(run)
        for message in run.messages():
            reader.take(message.topic, message.log_time_ns, message.sequence, message)
        summary = reader.summary(run.metadata.get("started", ""), complete=run.complete)
        return replace(summary, damage=damage_text(run.damage, run.layout.begin_ns))
    except RunError as error:
        return RunSummary(problem=str(error).removeprefix(f"{path}: "))
    except OSError as error:
        return RunSummary(problem=error.strerror or str(error))


class _SummaryReader:
    """Collects a summary message by message."""

    def __init__(self, run: AnyRun) -> None:
        self._topics, self._sd_field = run.topics, run.sd_field
        self._begin_ns = self._end_ns = 0
        self._plans: dict[str, None] = {}
        self._faults: dict[str, None] = {}
        self._notes: dict[str, None] = {}
        self._last: dict[str, Any] = {}
        self._valid: Fields = {}
        self._is_valid = False
        self._state = ""
        self._losses: set[int] = set()  # numbers of log entries; each entry is published repeatedly

    def take(self, topic: str, t_ns: int, number: int, message: Any) -> None:
        """Read one message; only the necessary payloads are decoded."""
        self._begin_ns, self._end_ns = self._begin_ns or t_ns, t_ns
        if topic == self._topics.shape.name and self._valid and not self._is_valid:
            return  # keep the last shape with a valid estimate
        if topic in (self._topics.shape.name, OBJECT.name):
            self._last[topic] = message
        elif topic == STATE.name:
            fields = message.fields
            self._state = fields.get("state", "")
            severities = zip(fields.get("faults", ()), fields.get("severities", ()), strict=False)
            self._faults |= {code: None for code, severity in severities if severity in _SEVERE}
        elif topic == LOG:
            self._take_log(message.fields)
        elif number % _STRIDE == 0 and topic == self._topics.motion.name:
            plan = message.fields.get("plan")
            self._plans |= {plan: None} if plan else {}
        elif number % _STRIDE == 0 and topic == self._topics.estimate.name:
            fields = message.fields
            self._is_valid = bool(fields.get("valid"))
            self._valid = fields if self._is_valid else self._valid

    def _take_log(self, log: Mapping[str, Any]) -> None:
        kinds, names = log.get("kind", ()), log.get("name", ())
        for kind, name, text in zip(kinds, names, log.get("text", ()), strict=False):
            if NOTE in (kind, name):
                self._notes[text] = None
        for number, kind, name in zip(log.get("number", ()), kinds, names, strict=False):
            if (kind, name) == ("object", "lost"):
                self._losses.add(int(number))

    def summary(self, started: str, *, complete: bool) -> RunSummary:
        """The summary of all messages read."""
        shape, recognised = (
            self._last[each].fields if each in self._last else {} for each in (self._topics.shape.name, OBJECT.name)
        )
        sds = np.array([each for each in shape.get(self._sd_field, ()) if math.isfinite(each)])
        return RunSummary(
            started=started,
            seconds=(self._end_ns - self._begin_ns) * 1e-9,
            complete=complete,
            plans=tuple(self._plans),
            object=recognised.get("best") or (NONE_OF_THESE if recognised.get("none", 0.0) > 0.5 else ""),
            objects=int(self._valid.get("object", 0)),
            touched=float(np.mean(shape["touched"])) if shape.get("touched") else math.nan,
            sd_m=float(np.median(sds)) if len(sds) else math.nan,
            worst_sd_m=float(sds.max()) if len(sds) else math.nan,
            mass_kg=float(self._valid.get("mass_kg", math.nan)),
            state=self._state,
            valid=self._is_valid,
            lost=len(self._losses),
            faults=tuple(self._faults),
            notes=tuple(self._notes),
        )
