"""Builders of published messages: SI values of `palmd.events` become the fields of `palmd.quantities`.

A message is a flat map with string keys; values are numbers, booleans, strings and lists of these, and one nested map
`sd`. NaN means "no value". `stamp` adds `v timestamp mono_ns seq` to every map. Builders are safe in the loop.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import chain
from operator import attrgetter, itemgetter
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Generic, Literal, NamedTuple, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from palmd.aliases import with_former_names
from palmd.events import (
    Estimate,
    Event,
    FloatArray,
    Improvement,
    LiveEstimate,
    ObjectEstimate,
    PadLift,
    PadSample,
    PalmMotion,
    PalmSample,
    ShapeEstimate,
    Unexplained,
)
from palmd.faults import Fault
from palmd.jsonvalues import or_none
from palmd.quantities import ESTIMATE, EVENTS, IMPROVEMENT, LOG, RIG, SCHEMA, STATE, TICK, UNITS, Topic
from palmd.system.mechanism import JOINTS, NAMING, PALMS, SIDES
from palmd.system.naming import Naming
from palmd.system.reasons import Code
from palmd.system.rig_constants import RIG_NAMES, describe_rig_errors

if TYPE_CHECKING:
    from palmd.config.any_config import AnyConfig
    from palmd.config.two_palms import Config

Fields = dict[str, Any]
Answer = TypeVar("Answer")

_PLAIN = {q.name: q.source for q in ESTIMATE.quantities if q.source and not q.uncertain}
_UNCERTAIN = {q.name: q.source for q in ESTIMATE.quantities if q.uncertain}
_plain_values, _uncertain_values = attrgetter(*_PLAIN.values()), attrgetter(*_UNCERTAIN.values())
NAMED_STATE = tuple(q.source for q in ESTIMATE.quantities if q.role == "named")
"""Fields that must be finite, with their standard deviations, in a valid estimate."""

_SD_NAMES = {source: name for name, source in _UNCERTAIN.items()}


class MessageCodec(Protocol):
    """A system's module of messages: builders of the messages of every system, and the inverse for its events."""

    @property
    def events_fields(self) -> Callable[[float, Sequence[Event]], Fields]:
        """Fields of the events that an observer was fed in the tick at a time (s)."""

    @property
    def events_of(self) -> Callable[[Mapping[str, Any]], tuple[Event, ...]]:
        """The inverse of `events_fields`."""

    def estimate_fields(self, estimate: Any, /) -> Fields:
        """Fields of an estimate."""

    def estimate_summary(self, estimate: Any, /) -> Fields:
        """Fields of an estimate in the status."""

    def shape_fields(self, shape: ShapeEstimate, /) -> Fields:
        """Fields of an outline."""

    def info_fields(self, version: str, observer: str, config: Any, plans: Iterable[str], /) -> Fields:
        """Fields about the configured rig."""


def stamp(fields: Fields, timestamp: float, t: float, seq: int) -> Fields:
    """Add to `fields` what every message contains; `timestamp` is Unix time, `t` the tick's time (s)."""
    fields["v"] = SCHEMA
    fields["timestamp"] = timestamp
    fields["mono_ns"] = round(t * 1e9)
    fields["seq"] = seq
    return fields


def named_state_is_finite(estimate: LiveEstimate, named: Iterable[str] = NAMED_STATE) -> bool:
    """Whether all fields `named` and their standard deviations are finite, as they must be in a valid estimate."""
    sds = estimate.sd
    values = [value for each in named for value in (getattr(estimate, each), sds.get(each, math.nan))]
    return all(map(math.isfinite, values))


def estimate_fields(estimate: Estimate) -> Fields:
    """`palm/estimate`."""
    fields: Fields = dict(zip(_PLAIN, _plain_values(estimate), strict=True))
    fields["valid"] = bool(estimate.valid)
    fields["invalid_reasons"] = invalid_reasons(estimate)
    fields["sd"] = {_SD_NAMES[source]: sd for source, sd in estimate.sd.items()}
    fields.update(zip(_UNCERTAIN, _uncertain_values(estimate), strict=True))
    return fields


def invalid_reasons(estimate: LiveEstimate) -> list[str]:
    """Codes of the reasons why an estimate is invalid."""
    return [] if estimate.valid else [*estimate.invalid_reasons] or [Code.NO_ANSWER]


def estimate_summary(estimate: Estimate) -> Fields:
    """The main fields of `palm/estimate`, as in the status; None for fields without a value."""
    return summary_fields(ESTIMATE, estimate_fields(estimate), "touched", "nis", "observability")


def summary_fields(topic: Topic, fields: Fields, *names: str) -> Fields:
    """The fields `names` of an estimate, and those marked `glance` in its `topic`."""
    shown = ("valid", "observer", "object", *names, *(each.name for each in topic.quantities if each.glance))
    summary = {name: or_none(fields[name]) for name in shown}
    return summary | {"sd": {name: sd for name, sd in fields["sd"].items() if name in summary and math.isfinite(sd)}}


def shape_fields(shape: ShapeEstimate, h: str = "h") -> Fields:
    """`palm/shape`, or that of another system whose support function is named `h`."""
    return {
        "theta_rad": shape.theta.tolist(),
        f"{h}_m": shape.h.tolist(),
        f"{h}_sd_m": shape.h_sd.tolist(),
        "touched": shape.touched.astype(np.int64).tolist(),
    }


def object_fields(estimate: ObjectEstimate) -> Fields:
    """`palm/object`."""
    return {
        "names": list(estimate.names),
        "probability": estimate.probability.tolist(),
        "none": estimate.none,
        "best": estimate.best,
        "object": estimate.object_count,
    }


class EventsCodec:
    """Converts the events fed to a system's observer in a tick to fields of its topic, and back."""

    def __init__(self, topic: Topic, naming: Naming) -> None:
        self._columns = tuple(quantity.name for quantity in topic.quantities if quantity is not TICK)
        self._joints, self._pads = len(naming.joints), naming.pads
        self._no_joints, self._reads_across = (math.nan,) * self._joints, bool(naming.across)

    def fields_of(self, t: float, events: Iterable[Event]) -> Fields:
        """Fields of the events fed to the observer in the tick at `t` (s), in their order; None becomes NaN."""
        rows = [self._row(event) for event in events]
        columns = zip(*rows, strict=True) if rows else ((),) * len(self._columns)
        return {"t_tick_s": t} | dict(zip(self._columns, map(list, columns), strict=True))

    def events_of(self, fields: Mapping[str, Any]) -> tuple[Event, ...]:
        """The events that `fields_of` was given, bit for bit; raises KeyError, ValueError for invalid fields."""
        return tuple(self._event(*row) for row in zip(*(fields[name] for name in self._columns), strict=True))

    def _row(self, event: Event) -> tuple[float, ...]:
        no_joints = self._no_joints
        no_reading = (math.nan,) * (2 + self._reads_across)
        if isinstance(event, PadSample):
            reading = (event.s, *((event.across,) if self._reads_across else ()), event.force)
            return (
                event.pad,
                event.t_sample,
                *(math.nan if each is None else each for each in reading),
                *no_joints * 3,
            )
        if isinstance(event, PadLift):
            return (-event.pad, event.t_sample, *no_reading, *no_joints * 3)
        planned = (*(event.rates or no_joints), *(event.accelerations or no_joints))
        return (0, event.t_sample, *no_reading, *event.angles, *planned)

    def _event(self, source: int, t: float, s: float, *values: float) -> Event:
        (*across, force), joint_values = values[: 1 + self._reads_across], values[1 + self._reads_across :]
        if source == 0:
            angles, *planned = (joint_values[i : i + self._joints] for i in range(0, len(joint_values), self._joints))
            return PalmSample(t, angles, *(None if any(map(math.isnan, each)) else each for each in planned))
        pad = abs(source)
        if pad not in self._pads:
            raise ValueError(
                f"source is {source}; it must be 0, or the number of a palm, negative if its contact has ended"
            )
        if source < 0:
            return PadLift(t, pad)
        return PadSample(t, pad, s, *(None if math.isnan(each) else each for each in (force, *across)))


_EVENTS = EventsCodec(EVENTS, NAMING)
events_fields, events_of = _EVENTS.fields_of, _EVENTS.events_of


class AnswerCodec(Generic[Answer]):
    """Converts a smoother's answer to fields of a topic and back; a quantity's `source` is the attribute's name."""

    def __init__(
        self,
        topic: Topic,
        construct: Callable[..., Answer],
        *,
        absent: Mapping[str, Any] = MappingProxyType({}),
        plain_first: bool = False,
        vectors: bool = False,
    ) -> None:
        """`construct` constructs an answer from its attributes, with flattened arrays.

        absent: default values of fields that older recordings do not have. plain_first: arrays follow the other fields,
        instead of the topic's order. vectors: arrays remain arrays, which are packed faster; otherwise they become
        lists, and `touched` integers.
        """
        columns = [(each.name, each.source, each.kind == "numbers") for each in topic.quantities if each.source]
        self._columns = sorted(columns, key=itemgetter(2)) if plain_first else columns
        self._topic, self._construct, self._absent, self._vectors = topic.name, construct, absent, vectors

    def fields_of(self, t: float, answer: Answer) -> Fields:
        """Fields of an answer received in the tick at `t` (s)."""
        fields: Fields = {TICK.name: t}
        for name, source, is_array in self._columns:
            value = getattr(answer, source)
            fields[name] = self._listed(name, value) if is_array else value
        return with_former_names(self._topic, fields)

    def answer_of(self, fields: Mapping[str, Any]) -> Answer:
        """The answer that `fields_of` was given, bit for bit; raises KeyError, ValueError for invalid fields."""
        known = {**self._absent, **fields}
        values = ((source, known[name], is_array) for name, source, is_array in self._columns)
        return self._construct(**{source: _array(value) if is_array else value for source, value, is_array in values})

    def packed(self, answer: Answer) -> list[Any]:
        """The answer as a list for a message between processes; arrays become bytes."""
        values = ((getattr(answer, source), is_array) for _, source, is_array in self._columns)
        return [np.asarray(value, np.float64).tobytes() if is_array else value for value, is_array in values]

    def unpacked(self, *values: Any) -> Answer:
        """The answer that `packed` was given."""
        each = zip(self._columns, values, strict=True)
        return self._construct(
            **{source: np.frombuffer(value) if is_array else value for (_, source, is_array), value in each}
        )

    def _listed(self, name: str, value: npt.NDArray[Any]) -> Any:
        flat = value.ravel()
        if self._vectors:
            return flat
        return (flat.astype(int) if name == "touched" else flat).tolist()


def _improvement(
    *,
    P: FloatArray,  # noqa: N803 -- the attribute's name
    touched: FloatArray,
    spread: FloatArray,
    **others: Any,
) -> Improvement:
    return Improvement(
        **others,
        P=P.reshape(len(others["x"]), -1),
        touched=touched.astype(np.bool_),
        spread=spread.reshape(-1, len(others["rig"])),
    )


IMPROVEMENTS = AnswerCodec(IMPROVEMENT, _improvement, absent={"rig_sd": (), "contradicted": ()})
improvement_fields, improvement_of = IMPROVEMENTS.fields_of, IMPROVEMENTS.answer_of
"""`palm/improvement`, and the inverse."""


def _array(values: Sequence[float]) -> FloatArray:
    return np.array(values, dtype=np.float64)


def unexplained_fields(t_tick: float, answer: Unexplained) -> Fields:
    """`palm/unexplained`, received in the tick at `t_tick` (s)."""
    return {"t_tick_s": t_tick, "t_s": answer.t}


def rig_fields(values: FloatArray, sds: FloatArray, priors: FloatArray, contradicted: FloatArray) -> Fields:
    """`palm/rig` of the rig constants, each in the order of `RIG_TABLE`.

    Their estimates, posterior and prior standard deviations, and by how many σ they contradict the description.
    """
    fields = {
        **dict(zip(RIG_NAMES, values.tolist(), strict=True)),
        "sd": dict(zip(RIG_NAMES, sds.tolist(), strict=True)),
        "prior_sd": priors.tolist(),
        "contradictions": describe_rig_errors(values, sds, priors, contradicted),
    }
    return with_former_names(RIG.name, fields)


class PadView(NamedTuple):
    """Published state of a pad: s, across (m) and age (s), NaN for none."""

    s: float = math.nan
    pressure: float = math.nan
    age: float = math.nan
    touch: bool = False
    batch: bool = False
    across: float = math.nan


def contact_fields(pads: Sequence[PadView], arm_age: float, naming: Naming = NAMING) -> Fields:
    """`palm/contact` of a system's pads; `arm_age` in s, NaN for none."""
    values = [
        *[view.s for view in pads],
        *([view.across for view in pads] if naming.across else ()),
        *[view.pressure for view in pads],
        *[view.age * 1e3 for view in pads],
        arm_age * 1e3,
        *[view.touch for view in pads],
        *[view.batch for view in pads],
    ]
    return dict(zip(_contact_names(naming), values, strict=True))


@cache
def _contact_names(naming: Naming) -> tuple[str, ...]:
    """Names in the order of the values in `contact_fields`."""
    across = [f"{naming.across}{pad}_m" for pad in naming.pads] if naming.across else []
    return (
        *(f"{naming.along}{pad}_m" for pad in naming.pads),
        *across,
        *(f"pressure{pad}" for pad in naming.pads),
        *(f"age{pad}_ms" for pad in naming.pads),
        "arm_age_ms",
        *(f"touch{pad}" for pad in naming.pads),
        *(f"batch{pad}" for pad in naming.pads),
    )


def motion_fields(
    commanded: PalmMotion | None,
    actual: PalmMotion | None,
    plan: str,
    segment: int,
    progress: float,
    arm_state: str,
    naming: Naming = NAMING,
    following_errors: Sequence[float] = (),
    following_limits: Sequence[float] = (),
) -> Fields:
    """`palm/motion` of a system's joints; following errors and their limits are NaN if not given."""
    none = (math.nan,) * len(naming.joints)
    error, limit = naming.following
    angles = (none if each is None else each.angles for each in (commanded, actual))
    return {
        **dict(zip(_joint_names(naming), chain.from_iterable(angles), strict=True)),
        "plan": plan,
        "segment": segment,
        "progress": progress,
        "arm_state": arm_state,
        error: [*(following_errors or none)],
        limit: [*(following_limits or none)],
    }


@cache
def _joint_names(naming: Naming) -> tuple[str, ...]:
    return naming.commanded + naming.measured


def note_fields(t: float, text: str) -> Fields:
    """`palm/note`, written at `t` (s)."""
    return {"t_s": t, "text": text}


@dataclass(frozen=True, slots=True)
class Explored:
    """Progress of an exploration: fractions of normals as in `palm/state`, NaN for none."""

    running: bool = False
    seconds: float = math.nan
    coverage: float = math.nan
    goal: float = math.nan
    reachable: float = math.nan
    reason: str = ""


def state_fields(
    state: str,
    faults: Iterable[Fault],
    cause: str = "",
    requested_state: str = "",
    since_s: float = 0.0,
    running: bool = False,
    explored: Explored = Explored(),
    control: str = "",
    unattended: bool = False,
) -> Fields:
    """`palm/state`; `cause` led to the state `since_s` seconds ago; `control` is the client in control."""
    faults = tuple(faults)
    fields = {
        "state": state,
        "faults": [fault.code for fault in faults],
        "severities": [str(fault.severity) for fault in faults],
        "hints": [fault.hint for fault in faults],
        "texts": [fault.text for fault in faults],
        "cause": cause,
        "requested_state": requested_state,
        "control": control,
        "unattended": unattended,
        "since_s": since_s,
        "running": running,
        "exploring": explored.running,
        "explored_s": explored.seconds,
        "coverage": explored.coverage,
        "coverage_goal": explored.goal,
        "reachable": explored.reachable,
        "reason": explored.reason,
    }
    return with_former_names(STATE.name, fields)


LogKind = Literal["palmd", "state", "fault", "command", "control", "plan", "exploration", "object", "rig", "recorder"]


@dataclass(frozen=True, slots=True)
class LogEntry:
    """One event at `t_s` (s), with the columns of `palm/log`; `lasted_s` is NaN for events without duration."""

    number: int
    t_s: float
    kind: LogKind
    name: str
    severity: str
    who: str
    lasted_s: float
    text: str
    code: str = ""

    @property
    def line(self) -> str:
        """The entry in one line, without its time."""
        head = {"state": "", "fault": f"{self.name}: ", "command": f"{self.name}, by {self.who}: "}
        return head.get(self.kind, f"{self.kind}: ") + self.text


_LOG_COLUMNS = tuple(quantity.name for quantity in LOG.quantities)


def log_fields(entries: Iterable[LogEntry]) -> Fields:
    """`palm/log`."""
    rows = tuple(entries)
    return {name: [getattr(entry, name) for entry in rows] for name in _LOG_COLUMNS}


def entries_of(fields: Mapping[str, Any]) -> tuple[LogEntry, ...]:
    """The entries that `log_fields` was given; raises KeyError, ValueError for invalid fields."""
    known = {"code": [""] * len(fields["number"]), **fields}  # earlier recordings have no codes
    return tuple(LogEntry(*row) for row in zip(*(known[name] for name in _LOG_COLUMNS), strict=True))


def runtime_fields(version: str, observer: str, config: AnyConfig, system: str = "") -> Fields:
    """The first fields of a system's info; `system` is its name, which two palms omit."""
    from palmd.config.any_config import config_hash  # imported here: it needs the pydantic models

    return {
        "version": version,
        "schema": SCHEMA,
        **({"system": system} if system else {}),
        "config_hash": config_hash(config),
        "observer": observer,
        "rate_hz": config.loop.rate_hz,
        "units": UNITS,
    }


def info_fields(version: str, observer: str, config: Config, plans: Iterable[str] = ()) -> Fields:
    """`palm/info`: version and observer, and the configured rig, with lengths and limits for displays."""
    from palmd.config.guards import pad_force_limits

    rig, limits = config.rig, config.limits
    lengths_mm = {f"palm{palm}": length for palm, length in zip(PALMS, rig.palm_lengths_mm, strict=True)}
    lengths_mm |= {f"pad{palm}": pad.length_mm for palm, pad in zip(PALMS, config.pads.each(), strict=True)}
    ranges_deg = dict(zip(JOINTS, limits.angles_deg, strict=True))
    return runtime_fields(version, observer, config) | {
        "hinge": rig.hinge,
        "gravity_m_s2": rig.gravity_m_s2,
        "base_m": [place * 1e-3 for place in rig.base_mm],
        **{f"{name}_length_m": length * 1e-3 for name, length in lengths_mm.items()},
        **{f"palm{palm}_curvature_per_m": kappa for palm, kappa in zip(PALMS, rig.curvatures_per_m, strict=True)},
        **{f"{name}_limits_rad": [math.radians(angle) for angle in ends] for name, ends in ranges_deg.items()},
        "rate_limit_rad_s": math.radians(limits.rate_deg_s),
        "acceleration_limit_rad_s2": math.radians(limits.acceleration_deg_s2),
        "force_limit_n": list(pad_force_limits(limits.force_n, dict(zip(PALMS, config.pads.each(), strict=True)))),
        "palms": list(PALMS),
        "joints": list(JOINTS),
        "sides": list(SIDES),
        "plans": list(plans),
    }
