"""Builders of what palmd publishes: SI values of `palmd.events` become the fields of `palmd.quantities`.

A message is a flat map with string keys; values are numbers, booleans, strings and lists of these, and the one
nested map `sd`. NaN means "no value". Every map gets `v timestamp mono_ns seq` from `stamp`. Builders are safe in the
loop.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from palmd.config import Config, config_hash
from palmd.events import (
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
from palmd.quantities import ESTIMATE, EVENTS, SCHEMA, STAMP, TICK, UNITS, Kind, Topic

Fields = dict[str, Any]

_TOLD = tuple((q.name, q.source) for q in ESTIMATE.quantities if q.source and not q.uncertain)
_UNCERTAIN = tuple((q.name, q.source) for q in ESTIMATE.quantities if q.uncertain)
NAMED_STATE = tuple(q.source for q in ESTIMATE.quantities if q.role == "named")
"""What must be finite, one-sigma included, in an estimate that says `valid`."""

_SD_NAMES = {source: name for name, source in _UNCERTAIN}
_EVENT_COLUMNS = tuple(quantity.name for quantity in EVENTS.quantities if quantity is not TICK)


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
        math.isfinite(getattr(estimate, source)) and math.isfinite(estimate.sd.get(source, math.nan))
        for source in NAMED_STATE
    )


def estimate_fields(estimate: Estimate) -> Fields:
    """`palm/estimate`."""
    fields: Fields = {name: getattr(estimate, source) for name, source in _TOLD}
    fields["valid"] = bool(estimate.valid)
    fields["sd"] = {_SD_NAMES[source]: sd for source, sd in estimate.sd.items()}
    for name, source in _UNCERTAIN:
        fields[name] = getattr(estimate, source)
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


def info_fields(version: str, observer: str, config: Config) -> Fields:
    """`palm/info`: who runs, and the rig as configured, lengths and limits included, for whoever draws it."""
    rig, limits = config.rig, config.limits
    pads = (config.pads.palm1, config.pads.palm2)
    lengths_mm = {"palm1": rig.palm1_length_mm, "palm2": rig.palm2_length_mm}
    lengths_mm |= {f"pad{i}": pad.length_mm for i, pad in enumerate(pads, 1)}
    ranges_deg = {"phi1": limits.phi1_deg, "phi2": limits.phi2_deg}
    return {
        "version": version,
        "schema": SCHEMA,
        "config_hash": config_hash(config),
        "observer": observer,
        "rate_hz": config.loop.rate_hz,
        "units": UNITS,
        "hinge": rig.hinge,
        "gravity_m_s2": rig.gravity_m_s2,
        "base_m": [place * 1e-3 for place in rig.base_mm],
        **{f"{name}_length_m": length * 1e-3 for name, length in lengths_mm.items()},
        **{f"{name}_limits_rad": [math.radians(angle) for angle in ends] for name, ends in ranges_deg.items()},
        "rate_limit_rad_s": math.radians(limits.rate_deg_s),
        "acceleration_limit_rad_s2": math.radians(limits.acceleration_deg_s2),
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
    expected = {field.name: field for field in (*STAMP, *topic.quantities)}
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
