"""Builders of what palmd publishes of a pivoting grasp, by the tables of `palmd.quantities`; safe in the loop."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from palmd.config import config_hash
from palmd.events import Event, PadLift, PadSample, PalmMotion, PalmSample, ShapeEstimate
from palmd.messages import Fields, PadView
from palmd.pivot_config import PivotConfig
from palmd.quantities import PIVOT, PIVOT_EVENTS, SCHEMA, TICK, UNITS
from palmd.system.pivot import AXES, PAD, SYSTEM, PivotAnswer, PivotEstimate

_NONE = (math.nan,) * len(AXES)
_TOLD = tuple((each.name, each.source) for each in PIVOT.quantities if each.source)
_NAMED = tuple(each.source for each in PIVOT.quantities if each.role == "named")
_NAMES = {each.source: each.name for each in PIVOT.quantities if each.uncertain}
_COLUMNS = tuple(each.name for each in PIVOT_EVENTS.quantities if each is not TICK)
_COMMANDED, _ACTUAL = ([f"{axis}{end}" for axis in AXES] for end in ("_cmd_m", "_m"))


def sound(estimate: PivotEstimate) -> bool:
    """Whether everything is finite that must be when an estimate says `valid`."""
    return all(
        math.isfinite(getattr(estimate, name)) and math.isfinite(estimate.sd.get(name, math.nan)) for name in _NAMED
    )


def estimate_fields(estimate: PivotEstimate) -> Fields:
    """`palm/pivot`."""
    fields: Fields = {name: getattr(estimate, source) for name, source in _TOLD}
    return fields | {"sd": {_NAMES[source]: sd for source, sd in estimate.sd.items()}}


def at_a_glance(estimate: PivotEstimate) -> Fields:
    """Of `palm/pivot` what people look at first, as the status tells it; None for what has no value."""
    fields = estimate_fields(estimate)
    names = ["valid", "observer", "object", "side", "touched", "nis", "reason"]
    names += [each.name for each in PIVOT.quantities if each.glance]
    told = {name: None if isinstance(v := fields[name], float) and not math.isfinite(v) else v for name in names}
    return told | {"sd": {name: sd for name, sd in fields["sd"].items() if name in told and math.isfinite(sd)}}


def shape_fields(shape: ShapeEstimate) -> Fields:
    """`palm/pivot_shape` of an outline about the pivot."""
    return {
        "theta_rad": shape.theta.tolist(),
        "hP_m": shape.h.tolist(),
        "hP_sd_m": shape.h_sd.tolist(),
        "touched": [int(touched) for touched in shape.touched],
    }


def contact_fields(pad: PadView, arm_age: float) -> Fields:
    """`palm/pivot_contact`; `arm_age` in s, NaN for none."""
    return {
        "s1_m": pad.s,
        "pressure1": pad.pressure,
        "age1_ms": pad.age * 1e3,
        "arm_age_ms": arm_age * 1e3,
        "touch1": pad.touch,
        "batch1": pad.batch,
    }


def motion_fields(commanded: PalmMotion | None, actual: PalmMotion | None, place: Fields) -> Fields:
    """`palm/pivot_motion`; `place` is what it says of plan and arm."""
    return {
        **dict(zip(_COMMANDED, _NONE if commanded is None else commanded.angles, strict=True)),
        **dict(zip(_ACTUAL, _NONE if actual is None else actual.angles, strict=True)),
        **place,
    }


def events_fields(t: float, events: Iterable[Event]) -> Fields:
    """`palm/pivot_events`: what the observer was fed in the tick at `t` (s), in this order; None becomes NaN."""
    rows = [_row(event) for event in events]
    columns = zip(*rows, strict=True) if rows else ((),) * len(_COLUMNS)
    return {"t_tick_s": t} | dict(zip(_COLUMNS, map(list, columns), strict=True))


def events_of(fields: Mapping[str, Any]) -> tuple[Event, ...]:
    """The events that `events_fields` was given, bit for bit; raises KeyError, ValueError for other fields."""
    return tuple(_event(*row) for row in zip(*(fields[name] for name in _COLUMNS), strict=True))


def _row(event: Event) -> tuple[float, ...]:
    if isinstance(event, PadSample):
        return (PAD, event.t_sample, event.s, math.nan if event.force is None else event.force, *_NONE * 3)
    if isinstance(event, PadLift):
        return (-PAD, event.t_sample, math.nan, math.nan, *_NONE * 3)
    planned = (*(event.rates or _NONE), *(event.accelerations or _NONE))
    return (0, event.t_sample, math.nan, math.nan, *event.angles, *planned)


def _event(source: int, t: float, s: float, force: float, *gripper: float) -> Event:
    if source == 0:
        place, *planned = (gripper[i : i + len(AXES)] for i in range(0, len(gripper), len(AXES)))
        return PalmSample(t, place, *(None if any(map(math.isnan, each)) else each for each in planned))
    if abs(source) != PAD:
        raise ValueError(f"source is {source}; it is 0, 1 for a reading, -1 where the contact has ended")
    return PadLift(t, PAD) if source < 0 else PadSample(t, PAD, s, None if math.isnan(force) else force)


def answer_fields(t_tick: float, answer: PivotAnswer) -> Fields:
    """`palm/pivot_answer`, heard in the tick at `t_tick` (s)."""
    return {
        "t_tick_s": t_tick,
        "t_s": answer.t,
        "claimed": answer.claimed,
        "reason": answer.reason,
        "psi_rad": answer.psi,
        "p": answer.p.tolist(),
        "covariance": answer.covariance.ravel().tolist(),
        "hP_sd_m": answer.h_sd.tolist(),
        "touched": answer.touched.astype(int).tolist(),
    }


def answer_of(fields: Mapping[str, Any]) -> PivotAnswer:
    """The answer that `answer_fields` was given, bit for bit; raises KeyError, ValueError for other fields."""
    p, h_sd, touched = (np.array(fields[name], dtype=np.float64) for name in ("p", "hP_sd_m", "touched"))
    covariance = np.array(fields["covariance"], dtype=np.float64).reshape(len(p), len(p))
    return PivotAnswer(
        fields["t_s"], fields["claimed"], fields["reason"], fields["psi_rad"], p, covariance, h_sd, touched
    )


def info_fields(version: str, observer: str, config: PivotConfig, plans: Iterable[str]) -> Fields:
    """`palm/pivot_info`: who runs, and the rig as configured, for whoever draws it."""
    return {
        "version": version,
        "schema": SCHEMA,
        "system": SYSTEM,
        "config_hash": config_hash(config),
        "observer": observer,
        "rate_hz": config.loop.rate_hz,
        "units": UNITS,
        "gravity_m_s2": config.rig.gravity_m_s2,
        "pad1_length_m": config.pads.palm1.length_mm * 1e-3,
        **{
            f"{axis}_limits_m": [end * 1e-3 for end in ends]
            for axis, ends in zip(AXES, config.limits.ranges_mm, strict=True)
        },
        "force_limit_n": config.limits.force_n,
        "plans": list(plans),
    }
