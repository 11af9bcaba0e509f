"""Summary of a recording for lists of runs: start, duration, object, accuracy, faults, notes."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from palmd.messages import Fields
from palmd.quantities import OBJECT, STATE
from palmd.record import RunError
from palmd.record.damage import damage_text
from palmd.record.index import RunSummary
from palmd.record.mcapfile import RawMessage
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
        return replace(_summary(run), damage=damage_text(run.damage, run.layout.begin_ns))
    except RunError as error:
        return RunSummary(problem=str(error).removeprefix(f"{path}: "))
    except OSError as error:
        return RunSummary(problem=error.strerror or str(error))


def _summary(run: AnyRun) -> RunSummary:
    """The summary without damage; only the necessary payloads are decoded."""
    shape_topic, estimate_topic, motion_topic = (
        topic.name for topic in (run.topics.shape, run.topics.estimate, run.topics.motion)
    )
    plans: dict[str, None] = {}
    faults: dict[str, None] = {}
    notes: dict[str, None] = {}
    last: dict[str, RawMessage] = {}
    losses: set[int] = set()  # numbers of log entries; each entry is published repeatedly
    last_valid: Fields = {}
    valid, state = False, ""
    begin_ns = end_ns = 0
    for message in run.messages():
        topic, due = message.topic, message.sequence % _STRIDE == 0
        begin_ns, end_ns = begin_ns or message.log_time_ns, message.log_time_ns
        if topic == OBJECT.name or (topic == shape_topic and (valid or not last_valid)):
            last[topic] = message  # the last shape with a valid estimate
        elif topic == STATE.name:
            fields = message.fields
            state = fields.get("state", "")
            severities = zip(fields.get("faults", ()), fields.get("severities", ()), strict=False)
            faults |= {code: None for code, severity in severities if severity in _SEVERE}
        elif topic == LOG:
            fields = message.fields
            kinds, names = fields.get("kind", ()), fields.get("name", ())
            entries = zip(kinds, names, fields.get("text", ()), strict=False)
            notes |= {text: None for kind, name, text in entries if NOTE in (kind, name)}
            numbered = zip(fields.get("number", ()), kinds, names, strict=False)
            losses |= {int(number) for number, kind, name in numbered if (kind, name) == ("object", "lost")}
        elif topic == motion_topic and due:
            plan = message.fields.get("plan")
            plans |= {plan: None} if plan else {}
        elif topic == estimate_topic and due:
            fields = message.fields
            valid = bool(fields.get("valid"))
            last_valid = fields if valid else last_valid
    shape, recognised = (last[each].fields if each in last else {} for each in (shape_topic, OBJECT.name))
    sds = np.array([each for each in shape.get(run.sd_field, ()) if math.isfinite(each)])
    return RunSummary(
        started=run.metadata.get("started", ""),
        seconds=(end_ns - begin_ns) * 1e-9,
        complete=run.complete,
        plans=tuple(plans),
        object=recognised.get("best") or (NONE_OF_THESE if recognised.get("none", 0.0) > 0.5 else ""),
        objects=int(last_valid.get("object", 0)),
        touched=float(np.mean(shape["touched"])) if shape.get("touched") else math.nan,
        sd_m=float(np.median(sds)) if len(sds) else math.nan,
        worst_sd_m=float(sds.max()) if len(sds) else math.nan,
        mass_kg=float(last_valid.get("mass_kg", math.nan)),
        state=state,
        valid=valid,
        lost=len(losses),
        faults=tuple(faults),
        notes=tuple(notes),
    )
