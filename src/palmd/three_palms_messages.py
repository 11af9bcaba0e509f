"""Build the messages that palmd publishes about three palms in space; tables: `three_palms_quantities`. Loop-safe."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from palmd import messages
from palmd.events import ShapeEstimate
from palmd.messages import AnswerCodec, EventsCodec, Fields
from palmd.system.three_palms import HALVINGS, JOINTS, MECHANISM, NAMING, PALMS, SYSTEM, BodyAnswer, BodyEstimate
from palmd.three_palms_quantities import PALM3, PALM3_ANSWER, PALM3_EVENTS

if TYPE_CHECKING:
    from palmd.config.three_palms import ThreePalmsConfig

VALUES = (*(each.name for each in PALM3.quantities if each.kind == "number" and each.unit), "mu")
"""The fields of `palm3/estimate` that are in an estimate's `values`."""
_UNKNOWN = dict.fromkeys(VALUES, math.nan)


def estimate_fields(estimate: BodyEstimate) -> Fields:
    """`palm3/estimate`."""
    return {
        "valid": estimate.valid,
        "invalid_reasons": messages.invalid_reasons(estimate),
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


def estimate_summary(estimate: BodyEstimate) -> Fields:
    """Fields of `palm3/estimate` for the status display; None for no value."""
    return messages.summary_fields(PALM3, estimate_fields(estimate), "touched", "nis", "hypotheses", "reason")


def shape_fields(shape: ShapeEstimate, object_count: int = 0, valid: bool = False) -> Fields:
    """`palm3/shape`: a surface in all directions of the icosphere."""
    return {
        "halvings": HALVINGS,
        "h_m": shape.h.tolist(),
        "h_sd_m": shape.h_sd.tolist(),
        "touched": shape.touched.astype(int).tolist(),
        "object": object_count,
        "valid": valid,
    }


_EVENTS = EventsCodec(PALM3_EVENTS, NAMING)
events_fields, events_of = _EVENTS.fields_of, _EVENTS.events_of
"""`palm3/events`: fields of events, and events of fields."""


def _answer_from_flat(**values: Any) -> BodyAnswer:
    """Answer from values whose matrices are flat."""
    width = math.isqrt(values["covariance"].size)
    square = {"R": values["R"].reshape(-1, 3), "covariance": values["covariance"].reshape(width, width)}
    return BodyAnswer(**values | square)


_ABSENT = {"unexplained_sd_m": 0.0, "reason_code": ""}
ANSWERS = AnswerCodec(PALM3_ANSWER, _answer_from_flat, absent=_ABSENT, plain_first=True, vectors=True)
answer_fields, answer_of = ANSWERS.fields_of, ANSWERS.answer_of
"""`palm3/answer`: fields of an answer, and the answer of fields."""


def info_fields(version: str, observer: str, config: ThreePalmsConfig, plans: Iterable[str]) -> Fields:
    """`palm3/info`: version and observer, and the rig as configured, for displays."""
    from palmd.config.guards import pad_force_limits

    pads = tuple(zip(PALMS, config.pads.planes, strict=True))
    return messages.runtime_fields(version, observer, config, SYSTEM) | {
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
