"""What palmd publishes: one table of topics with their fields and units, and builders for them.

A message is a flat map with string keys; values are numbers, booleans, strings and lists of these, and the one
nested map `sd`. NaN means "no value". Every map gets `v timestamp mono_ns seq` from `stamp`. The builders turn
SI values of `palmd.events` into fields whose names carry the unit; they are safe in the loop.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from palmd.events import (
    DECIDED,
    Estimate,
    Event,
    Improvement,
    ObjectEstimate,
    PadLift,
    PadSample,
    PalmMotion,
    PalmSample,
    ShapeEstimate,
)
from palmd.faults import Fault

SCHEMA = 1

Fields = dict[str, Any]
Kind = Literal["number", "bool", "text", "numbers", "texts", "sds"]


@dataclass(frozen=True, slots=True)
class Field:
    """One field: `unit` is empty for what has none; a name that ends in `*` stands for every name so begun."""

    name: str
    kind: Kind
    unit: str
    meaning: str


@dataclass(frozen=True, slots=True)
class Topic:
    """One topic: how often it comes, and its fields beyond those of `STAMP`."""

    name: str
    rate: str
    fields: tuple[Field, ...]

    @property
    def frame(self) -> bytes:
        """The first frame of its messages."""
        return self.name.encode()


STAMP = (
    Field("v", "number", "", "schema version"),
    Field("timestamp", "number", "s", "Unix time when it was sent"),
    Field("mono_ns", "number", "ns", "CLOCK_MONOTONIC of the tick that the values hold for"),
    Field("seq", "number", "", "counts up by one with every message of the topic"),
)

_PUBLISHED_AS: dict[str, tuple[str, str, str]] = {
    "r1": ("r1_m", "m", "distance of palm 1 from the centre of mass"),
    "r2": ("r2_m", "m", "distance of palm 2 from the centre of mass"),
    "omega0": ("omega0_rad_s", "rad/s", "angular rate of the object"),
    "s1": ("s1_m", "m", "contact on palm 1, from the hinge"),
    "s2": ("s2_m", "m", "contact on palm 2, from the hinge"),
    "phi1": ("phi1_rad", "rad", "palm 1 from the world X axis"),
    "omega1": ("omega1_rad_s", "rad/s", "rate of phi1"),
    "phi2": ("phi2_rad", "rad", "palm 2 from palm 1"),
    "omega2": ("omega2_rad_s", "rad/s", "rate of phi2"),
    "rho": ("rho_m", "m", "radius of gyration"),
    "psi": (
        "psi_rad",
        "rad",
        "turn of the object since the first fused measurement, or from a stored outline",
    ),
    "v1": ("v1_m", "m", "radius of curvature of the outline at contact 1"),
    "v2": ("v2_m", "m", "radius of curvature of the outline at contact 2"),
    "mu": ("mu", "", "friction"),
    "mass": ("mass_kg", "kg", "mass of the object"),
    "f1": ("f1_n", "N", "normal force of contact 1"),
    "f2": ("f2_n", "N", "normal force of contact 2"),
    "com_x": ("com_x_m", "m", "centre of mass, world frame"),
    "com_y": ("com_y_m", "m", "centre of mass, world frame"),
}
"""Fields of `Estimate` that have a one-sigma: published name, unit, meaning."""

NAMED_STATE = ("r1", "r2", "omega0", "s1", "s2", "phi1", "omega1", "phi2", "omega2", "rho", "psi")
"""What must be finite, one-sigma included, in an estimate that says `valid`."""

_ESTIMATE_NAMES = tuple((name, published) for name, (published, _, _) in _PUBLISHED_AS.items())
_SD_NAMES = dict(_ESTIMATE_NAMES)

ESTIMATE = Topic(
    "palm/estimate",
    "every tick",
    (
        Field("valid", "bool", "", "whether to trust it: settled, consistent, finite"),
        Field("observer", "text", "", "which observer it comes from"),
        Field("object", "number", "", "counts up when a new object is begun"),
        *(Field(name, "number", unit, meaning) for name, unit, meaning in _PUBLISHED_AS.values()),
        Field("sd", "sds", "", "one-sigma of each field that it names, in that field's unit"),
        Field("nis", "number", "", "normalised innovation squared, running mean"),
        Field("observability", "number", "", "smallest singular value, scaled"),
        Field("touched", "number", "", "fraction of normals that have been in contact"),
        Field("e_f_m", "number", "m", "error of balance (3.36), of the quasistatic observer"),
        Field("e_c_m", "number", "m", "error of contact (3.37), of the quasistatic observer"),
    ),
)
SHAPE = Topic(
    "palm/shape",
    "at most 10 Hz",
    (
        Field("theta_rad", "numbers", "rad", "direction of the outward normal in the object's frame"),
        Field("h_m", "numbers", "m", "support function about the centre of mass"),
        Field("h_sd_m", "numbers", "m", "one-sigma of h"),
        Field("touched", "numbers", "", "1 where a palm has been in contact, else 0"),
    ),
)
OBJECT = Topic(
    "palm/object",
    "at most 10 Hz, only with stored outlines",
    (
        Field("names", "texts", "", "of the stored outlines"),
        Field("probability", "numbers", "", "that it is the object of that name, one for each"),
        Field("none", "number", "", "probability that it is none of them"),
        Field("best", "text", "", f"the name whose probability is at least {DECIDED:g}, empty when none is"),
        Field("object", "number", "", "as in palm/estimate"),
    ),
)
CONTACT = Topic(
    "palm/contact",
    "every tick",
    (
        Field("s1_m", "number", "m", "last reading of pad 1, from the hinge; none while untouched"),
        Field("s2_m", "number", "m", "last reading of pad 2, from the hinge; none while untouched"),
        Field("pressure1", "number", "", "last pressure of pad 1, counts"),
        Field("pressure2", "number", "", "last pressure of pad 2, counts"),
        Field("age1_ms", "number", "ms", "age of pad 1's last packet"),
        Field("age2_ms", "number", "ms", "age of pad 2's last packet"),
        Field("arm_age_ms", "number", "ms", "age of the arm's last report"),
        Field("touch1", "bool", "", "whether pad 1 is touched"),
        Field("touch2", "bool", "", "whether pad 2 is touched"),
        Field("batch1", "bool", "", "whether pad 1's last packet came with others in one read"),
        Field("batch2", "bool", "", "whether pad 2's last packet came with others in one read"),
    ),
)
MOTION = Topic(
    "palm/motion",
    "every tick",
    (
        Field("phi1_cmd_rad", "number", "rad", "commanded; none unless tracking"),
        Field("phi2_cmd_rad", "number", "rad", "commanded; none unless tracking"),
        Field("phi1_rad", "number", "rad", "actual, from the arm's last report"),
        Field("phi2_rad", "number", "rad", "actual, from the arm's last report"),
        Field("plan", "text", "", "name of the plan, empty without one"),
        Field("segment", "number", "", "number of the plan's segment from 0; -1 when no plan is being run"),
        Field(
            "progress",
            "number",
            "",
            "of the plan, 0 to 1; of the round when it runs forever, of touching when it explores",
        ),
        Field("arm_state", "text", "", "the controller's state letter, empty while unknown"),
    ),
)
STATE = Topic(
    "palm/state",
    "10 Hz and on change",
    (
        Field("state", "text", "", "idle, ready, tracking, hold or fault"),
        Field("faults", "texts", "", "codes of the faults that stand, latched ones included"),
        Field("severities", "texts", "", "note, degrade, hold or stop, one for each fault"),
        Field("hints", "texts", "", "what to do, one for each fault"),
    ),
)
LOOP = Topic(
    "palm/loop",
    "1 Hz",
    (
        Field("ticks", "number", "", "ticks since the start"),
        Field("overruns", "number", "", "ticks skipped since the start because another one took too long"),
        *(
            Field(f"{what}_{part}_ms", "number", "ms", f"{meaning}, {words} of the last second")
            for what, meaning in (("lateness", "how late a tick began"), ("work", "how long a tick took"))
            for part, words in (("p50", "median"), ("p99", "99th percentile"), ("max", "largest"))
        ),
        Field("lateness_ms", "numbers", "ms", "how late each tick of the last second began, in their order"),
        *(
            Field(f"{port}_*", "number", "", f"what has passed on the {port} port since the start, by cause")
            for port in ("pad1", "pad2", "arm")
        ),
        Field("bus_*", "number", "", "what has passed on the bus since the start"),
        Field("lag_ms", "number", "ms", "by how much the arm follows its set-points, estimated"),
        Field("late_dropped", "number", "", "samples too late for the observer since the start"),
        Field(
            "smoother_*", "number", "", "since the start: improvements taken in, starts of its process, readings lost"
        ),
        Field("explorer_*", "number", "", "since the start: starts of its process, decisions that came too late"),
        Field("rss_mb", "number", "MB", "resident memory"),
        Field("backend", "text", "", "what runs the models: c, vm or numpy"),
    ),
)
INFO = Topic(
    "palm/info",
    "1 Hz",
    (
        Field("version", "text", "", "of palmd"),
        Field("schema", "number", "", "of these messages"),
        Field("config_hash", "text", "", "sha256 of the effective configuration"),
        Field("observer", "text", "", "the observer that runs"),
        Field("rate_hz", "number", "Hz", "of the ticks"),
        Field("units", "text", "", "where the units are"),
    ),
)
_TICK = Field("t_tick_s", "number", "s", "the tick's time, CLOCK_MONOTONIC, to the last bit")
EVENTS = Topic(
    "palm/events",
    "every tick",
    (
        _TICK,
        Field(
            "source",
            "numbers",
            "",
            "of each event that the observer was fed, in this order: 1 or 2 a reading of that pad, -1 or -2 the end "
            "of its contact, 0 the palms",
        ),
        Field("t_sample_s", "numbers", "s", "when it was true, CLOCK_MONOTONIC"),
        Field("s_m", "numbers", "m", "of a reading: contact, from the hinge"),
        Field("force_n", "numbers", "N", "of a reading: normal force"),
        *(Field(f"phi{i}_rad", "numbers", "rad", f"of the palms: phi{i} as measured") for i in (1, 2)),
        *(Field(f"omega{i}_rad_s", "numbers", "rad/s", f"of the palms: rate of phi{i}, planned") for i in (1, 2)),
        *(
            Field(f"alpha{i}_rad_s2", "numbers", "rad/s²", f"of the palms: acceleration of phi{i}, planned")
            for i in (1, 2)
        ),
    ),
)
IMPROVEMENT = Topic(
    "palm/improvement",
    "when the smoother beside the loop has answered",
    (
        _TICK,
        Field("t_s", "number", "s", "what instant the answer is about, CLOCK_MONOTONIC"),
        Field("x", "numbers", "SI", "mean of the shape map's state"),
        Field("covariance", "numbers", "SI", "of that state, were `rig` right, row after row"),
        Field("frame", "number", "", "another when the outline has another gauge than in the answer before"),
        Field("established", "bool", "", "whether it has proved true for so long that no rival is kept"),
        Field("touched", "numbers", "", "0 or 1 for each of 72 bins of outward normals, the first beginning at 0"),
        Field("rig", "numbers", "SI", "what the rig's constants are off by, in the order of a result's `rig`"),
        Field("spread", "numbers", "SI", "the state's covariance is larger by spread·spreadᵀ, since `rig` is not sure"),
    ),
)
TOPICS: tuple[Topic, ...] = (ESTIMATE, SHAPE, OBJECT, CONTACT, MOTION, STATE, LOOP, INFO, EVENTS, IMPROVEMENT)
_EVENT_COLUMNS = tuple(field.name for field in EVENTS.fields if field is not _TICK)
UNITS = "SI; each name ends in its unit: _m _rad _rad_s _kg _n _s _ms _ns _hz _mb"


def stamp(fields: Fields, timestamp: float, t: float, seq: int) -> Fields:
    """Add to `fields` what every message carries; `timestamp` is Unix time, `t` the tick's time (s)."""
    fields["v"] = SCHEMA
    fields["timestamp"] = timestamp
    fields["mono_ns"] = round(t * 1e9)
    fields["seq"] = seq
    return fields


def sound(estimate: Estimate) -> bool:
    """Whether everything is finite that must be when an estimate says `valid`."""
    return all(
        math.isfinite(getattr(estimate, name)) and math.isfinite(estimate.sd.get(name, math.nan))
        for name in NAMED_STATE
    )


def estimate_fields(estimate: Estimate) -> Fields:
    """`palm/estimate`."""
    fields: Fields = {
        "valid": bool(estimate.valid),
        "observer": estimate.observer,
        "object": estimate.object_count,
        "nis": estimate.nis,
        "observability": estimate.observability,
        "touched": estimate.touched,
        "e_f_m": estimate.e_f,
        "e_c_m": estimate.e_c,
        "sd": {_SD_NAMES[name]: sd for name, sd in estimate.sd.items()},
    }
    for name, published in _ESTIMATE_NAMES:
        fields[published] = getattr(estimate, name)
    return fields


def shape_fields(shape: ShapeEstimate) -> Fields:
    """`palm/shape`."""
    return {
        "theta_rad": shape.theta.tolist(),
        "h_m": shape.h.tolist(),
        "h_sd_m": shape.h_sd.tolist(),
        "touched": [int(touched) for touched in shape.touched],
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


_NONE = (math.nan,) * 8


def events_fields(t: float, events: Iterable[Event]) -> Fields:
    """`palm/events`: what the observer was fed in the tick at `t` (s), in this order; None becomes NaN."""
    rows = [_event_row(event) for event in events]
    columns = zip(*rows, strict=True) if rows else ((),) * len(_EVENT_COLUMNS)
    return {"t_tick_s": t} | dict(zip(_EVENT_COLUMNS, map(list, columns), strict=True))


def events_of(fields: Mapping[str, Any]) -> tuple[Event, ...]:
    """The events that `events_fields` was given, bit for bit; raises KeyError, ValueError for other fields."""
    return tuple(_event(*row) for row in zip(*(fields[name] for name in _EVENT_COLUMNS), strict=True))


def _event_row(event: Event) -> tuple[float, ...]:
    if isinstance(event, PadSample):
        force = math.nan if event.force is None else event.force
        return (event.pad, event.t_sample, event.s, force, *_NONE[:6])
    if isinstance(event, PadLift):
        return (-event.pad, event.t_sample, *_NONE)
    planned = (event.omega1, event.omega2, event.alpha1, event.alpha2)
    rates = [math.nan if value is None else value for value in planned]
    return (0, event.t_sample, *_NONE[:2], event.phi1, event.phi2, *rates)


def _event(source: int, t: float, s: float, force: float, phi1: float, phi2: float, *rates: float) -> Event:
    if source == 0:
        return PalmSample(t, phi1, phi2, *(None if math.isnan(rate) else rate for rate in rates))
    if abs(source) not in (1, 2):
        raise ValueError(f"source is {source}; it is 0, 1, 2, -1 or -2")
    pad: Literal[1, 2] = 1 if abs(source) == 1 else 2
    return PadLift(t, pad) if source < 0 else PadSample(t, pad, s, None if math.isnan(force) else force)


def improvement_fields(t_tick: float, answer: Improvement) -> Fields:
    """`palm/improvement`, heard in the tick at `t_tick` (s)."""
    return {
        "t_tick_s": t_tick,
        "t_s": answer.t,
        "x": answer.x.tolist(),
        "covariance": answer.P.ravel().tolist(),
        "frame": answer.frame,
        "established": answer.established,
        "touched": answer.touched.astype(int).tolist(),
        "rig": answer.rig.tolist(),
        "spread": answer.spread.ravel().tolist(),
    }


@dataclass(frozen=True, slots=True)
class PadView:
    """What is to be told of one pad: s (m) and age (s), NaN for none."""

    s: float = math.nan
    pressure: float = math.nan
    age: float = math.nan
    touch: bool = False
    batch: bool = False


def contact_fields(pad1: PadView, pad2: PadView, arm_age: float) -> Fields:
    """`palm/contact`; `arm_age` in s, NaN for none."""
    return {
        "s1_m": pad1.s,
        "s2_m": pad2.s,
        "pressure1": pad1.pressure,
        "pressure2": pad2.pressure,
        "age1_ms": pad1.age * 1e3,
        "age2_ms": pad2.age * 1e3,
        "arm_age_ms": arm_age * 1e3,
        "touch1": pad1.touch,
        "touch2": pad2.touch,
        "batch1": pad1.batch,
        "batch2": pad2.batch,
    }


def motion_fields(
    commanded: PalmMotion | None,
    actual: PalmMotion | None,
    plan: str,
    segment: int,
    progress: float,
    arm_state: str,
) -> Fields:
    """`palm/motion`."""
    return {
        "phi1_cmd_rad": math.nan if commanded is None else commanded.phi1,
        "phi2_cmd_rad": math.nan if commanded is None else commanded.phi2,
        "phi1_rad": math.nan if actual is None else actual.phi1,
        "phi2_rad": math.nan if actual is None else actual.phi2,
        "plan": plan,
        "segment": segment,
        "progress": progress,
        "arm_state": arm_state,
    }


def state_fields(state: str, faults: Iterable[Fault]) -> Fields:
    """`palm/state`."""
    faults = tuple(faults)
    return {
        "state": state,
        "faults": [fault.code for fault in faults],
        "severities": [str(fault.severity) for fault in faults],
        "hints": [fault.hint for fault in faults],
    }


def info_fields(version: str, config_hash: str, observer: str, rate_hz: float) -> Fields:
    """`palm/info`."""
    return {
        "version": version,
        "schema": SCHEMA,
        "config_hash": config_hash,
        "observer": observer,
        "rate_hz": rate_hz,
        "units": UNITS,
    }


# ------------------------------------------------------------------------------------------------- validation


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_list(of: Callable[[object], bool]) -> Callable[[object], bool]:
    return lambda value: isinstance(value, list) and all(map(of, value))


def _is_text(value: object) -> bool:
    return isinstance(value, str)


def _is_sds(value: object) -> bool:
    return isinstance(value, dict) and all(name in _SD_NAMES.values() and _is_number(sd) for name, sd in value.items())


_CHECKS: dict[Kind, Callable[[object], bool]] = {
    "number": _is_number,
    "bool": lambda value: isinstance(value, bool),
    "text": _is_text,
    "numbers": _is_list(_is_number),
    "texts": _is_list(_is_text),
    "sds": _is_sds,
}


def validate(topic: Topic, fields: Mapping[str, object]) -> list[str]:
    """What is wrong with a stamped message of `topic`, in words; empty when nothing is. Not for the loop."""
    expected = {field.name: field for field in (*STAMP, *topic.fields)}
    families = [field for name, field in expected.items() if name.endswith("*")]
    errors = [f"{topic.name}: {name} is missing" for name in expected if name not in fields and not name.endswith("*")]
    for name, value in fields.items():
        family = next((f for f in families if name.startswith(f.name[:-1])), None)
        field = expected.get(name, family)
        if field is None:
            errors.append(f"{topic.name}: {name} is not in the table")
        elif not _CHECKS[field.kind](value):
            errors.append(f"{topic.name}: {name} must be {field.kind}, not {value!r}")
    return errors
