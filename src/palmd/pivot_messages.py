"""Builders of what palmd publishes of a pivoting grasp, by the tables of `palmd.quantities`; safe in the loop."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from palmd import messages
from palmd.events import ShapeEstimate
from palmd.messages import EventsForm, Fields
from palmd.pivot_quantities import PIVOT, PIVOT_EVENTS
from palmd.quantities import SCHEMA, UNITS
from palmd.system.pivot import AXES, NAMING, SYSTEM, PivotAnswer, PivotEstimate

if TYPE_CHECKING:
    from palmd.config.pivot import PivotConfig

_TOLD = tuple((each.name, each.source) for each in PIVOT.quantities if each.source)
_NAMES = {each.source: each.name for each in PIVOT.quantities if each.uncertain}


def estimate_fields(estimate: PivotEstimate) -> Fields:
    """`palm/pivot`."""
    fields: Fields = {name: getattr(estimate, source) for name, source in _TOLD}
    fields["invalid_reasons"] = messages.invalid_reasons(estimate, estimate.reason)
    return fields | {"sd": {_NAMES[source]: sd for source, sd in estimate.sd.items()}}


def estimate_at_a_glance(estimate: PivotEstimate) -> Fields:
    """Of `palm/pivot` what people look at first, as the status tells it; None for what has no value."""
    return messages.at_a_glance(PIVOT, estimate_fields(estimate), "side", "touched", "nis", "reason")


def shape_fields(shape: ShapeEstimate) -> Fields:
    """`palm/pivot_shape` of an outline about the pivot."""
    return messages.shape_fields(shape, "hP")


_EVENTS = EventsForm(PIVOT_EVENTS, NAMING)
events_fields, events_of = _EVENTS.fields_of, _EVENTS.events_of
"""`palm/pivot_events`, there and back."""


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
    from palmd.config.any_config import config_hash  # of the pydantic models, which nothing else here needs

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
