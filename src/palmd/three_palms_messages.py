"""Builders of what palmd publishes of three palms in space, by the tables of `palmd.quantities`; safe in the loop."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from palmd import messages
from palmd.events import FloatArray, ShapeEstimate
from palmd.messages import EventsForm, Fields
from palmd.quantities import SCHEMA, UNITS
from palmd.system.three_palms import HALVINGS, JOINTS, MECHANISM, NAMING, PALMS, SYSTEM, BodyAnswer, BodyEstimate
from palmd.three_palms_quantities import PALM3, PALM3_EVENTS

if TYPE_CHECKING:
    from palmd.config.three_palms import ThreePalmsConfig

VALUES = (*(each.name for each in PALM3.quantities if each.kind == "number" and each.unit), "mu")
"""The fields of `palm3/estimate` that are in an estimate's `values`."""
_UNKNOWN = dict.fromkeys(VALUES, math.nan)


def estimate_fields(estimate: BodyEstimate) -> Fields:
    """`palm3/estimate`."""
    return {
        "valid": estimate.valid,
        "invalid_reasons": messages.invalid_reasons(estimate, estimate.reason),
        "observer": estimate.observer,
        "object": estimate.object_count,
        "quat_xyzw": list(estimate.quaternion),
        "attitude_sd_rad": list(estimate.attitude_sd),
        **_UNKNOWN,
        **estimate.values,
        "sd": dict(estimate.sd),
        "nis": estimate.nis,
        "touched": estimate.touched,
        "hypotheses": estimate.hypotheses,
        "reason": estimate.reason,
    }


def estimate_at_a_glance(estimate: BodyEstimate) -> Fields:
    """Of `palm3/estimate` what people look at first, as the status tells it; None for what has no value."""
    return messages.at_a_glance(PALM3, estimate_fields(estimate), "touched", "nis", "hypotheses", "reason")


def shape_fields(shape: ShapeEstimate, object_count: int, valid: bool) -> Fields:
    """`palm3/shape` of a surface in all directions of the icosphere."""
    return {
        "halvings": HALVINGS,
        "h_m": shape.h.tolist(),
        "h_sd_m": shape.h_sd.tolist(),
        "touched": shape.touched.astype(int).tolist(),
        "object": object_count,
        "valid": valid,
    }


_EVENTS = EventsForm(PALM3_EVENTS, NAMING)
events_fields, events_of = _EVENTS.fields_of, _EVENTS.events_of
"""`palm3/events`, there and back."""

_ARRAYS = {
    "R": "R",
    "omega_rad_s": "omega",
    "p": "p",
    "covariance": "covariance",
    "h_m": "h",
    "h_sd_m": "h_sd",
    "touched": "touched",
    "inertia_sd_m2": "inertia_sd",
}
_PLAIN = {
    "t_s": "t",
    "begun_s": "begun",
    "claimed": "claimed",
    "reason": "reason",
    "hypotheses": "hypotheses",
    "mass_kg": "mass",
    "mass_sd_kg": "mass_sd",
    "rough_m": "rough",
}


def answer_fields(t_tick: float, answer: BodyAnswer) -> Fields:
    """`palm3/answer`, heard in the tick at `t_tick` (s); lists of numbers are vectors, which are packed sooner."""
    return (
        {"t_tick_s": t_tick}
        | {name: getattr(answer, attribute) for name, attribute in _PLAIN.items()}
        | {name: getattr(answer, attribute).ravel() for name, attribute in _ARRAYS.items()}
    )


def answer_of(fields: Mapping[str, Any]) -> BodyAnswer:
    """The answer that `answer_fields` was given, bit for bit; raises KeyError, ValueError for other fields.

    Without `rough_m`, as older recordings are, readings are taken to be missed by their noise alone.
    """
    arrays: dict[str, FloatArray] = {
        attribute: np.array(fields[name], dtype=np.float64) for name, attribute in _ARRAYS.items()
    }
    plain = {"rough_m": 0.0, **fields}
    return shaped(**{attribute: plain[name] for name, attribute in _PLAIN.items()}, **arrays)


def shaped(**told: Any) -> BodyAnswer:
    """An answer whose matrices have been laid flat."""
    width = math.isqrt(told["covariance"].size)
    square = {"R": told["R"].reshape(-1, 3), "covariance": told["covariance"].reshape(width, width)}
    return BodyAnswer(**told | square)


def info_fields(version: str, observer: str, config: ThreePalmsConfig, plans: Iterable[str]) -> Fields:
    """`palm3/info`: who runs, and the rig as configured, for whoever draws it."""
    from palmd.config.any_config import config_hash  # of the pydantic models, which nothing else here needs
    from palmd.config.guards import pad_force_limits

    pads = tuple(zip(PALMS, config.pads.planes, strict=True))
    return {
        "version": version,
        "schema": SCHEMA,
        "system": SYSTEM,
        "config_hash": config_hash(config),
        "observer": observer,
        "rate_hz": config.loop.rate_hz,
        "units": UNITS,
        "mechanism": MECHANISM,
        "joints": list(JOINTS),
        "palms": list(PALMS),
        "gravity_m_s2": config.rig.gravity_m_s2,
        "pad_side_m": config.pads.palm1.length_mm * 1e-3,
        **{f"pad{n}_centre_m": [pad.across_zero_mm * 1e-3, pad.zero_mm * 1e-3] for n, pad in pads},
        **{
            f"{joint}_limits_rad": [math.radians(end) for end in ends]
            for joint, ends in zip(JOINTS, config.limits.ranges_deg, strict=True)
        },
        "rate_limit_rad_s": math.radians(config.limits.rate_deg_s),
        "acceleration_limit_rad_s2": math.radians(config.limits.acceleration_deg_s2),
        "force_limit_n": list(pad_force_limits(config.limits.force_n, dict(pads))),
        "plans": list(plans),
    }
