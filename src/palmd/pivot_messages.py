"""Build the messages that palmd publishes about a pivoting grasp; tables: `pivot_quantities`. Safe in the loop."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from palmd import messages
from palmd.events import FloatArray, ShapeEstimate
from palmd.messages import AnswerCodec, EventsCodec, Fields
from palmd.pivot_quantities import PIVOT, PIVOT_ANSWER, PIVOT_EVENTS
from palmd.system.pivot import AXES, NAMING, SYSTEM, PivotAnswer, PivotEstimate

if TYPE_CHECKING:
    from palmd.config.pivot import PivotConfig

_FIELDS = tuple((each.name, each.source) for each in PIVOT.quantities if each.source)
_NAMES = {each.source: each.name for each in PIVOT.quantities if each.uncertain}


def estimate_fields(estimate: PivotEstimate) -> Fields:
    """`palm/pivot`."""
    fields: Fields = {name: getattr(estimate, source) for name, source in _FIELDS}
    fields["invalid_reasons"] = messages.invalid_reasons(estimate)
    return fields | {"sd": {_NAMES[source]: sd for source, sd in estimate.sd.items()}}


def estimate_summary(estimate: PivotEstimate) -> Fields:
    """Fields of `palm/pivot` for the status display; None for no value."""
    return messages.summary_fields(PIVOT, estimate_fields(estimate), "side", "touched", "nis", "reason")


def shape_fields(shape: ShapeEstimate) -> Fields:
    """`palm/pivot_shape`: the outline about the pivot."""
    return messages.shape_fields(shape, "hP")


_EVENTS = EventsCodec(PIVOT_EVENTS, NAMING)
events_fields, events_of = _EVENTS.fields_of, _EVENTS.events_of
"""`palm/pivot_events`: fields of events, and events of fields."""


def _answer_from_flat(covariance: FloatArray, **others: Any) -> PivotAnswer:
    width = len(others["p"])
    return PivotAnswer(**others, covariance=covariance.reshape(width, width))


ANSWERS = AnswerCodec(PIVOT_ANSWER, _answer_from_flat, absent={"reason_code": ""})
answer_fields, answer_of = ANSWERS.fields_of, ANSWERS.answer_of
"""`palm/pivot_answer`: fields of an answer, and the answer of fields."""


def info_fields(version: str, observer: str, config: PivotConfig, plans: Iterable[str]) -> Fields:
    """`palm/pivot_info`: version and observer, and the rig as configured, for displays."""
    return messages.runtime_fields(version, observer, config, SYSTEM) | {
        "gravity_m_s2": config.rig.gravity_m_s2,
        "pad1_length_m": config.pads.palm1.length_mm * 1e-3,
        **{
            f"{axis}_limits_m": [end * 1e-3 for end in ends]
            for axis, ends in zip(AXES, config.limits.ranges_mm, strict=True)
        },
        "force_limit_n": config.limits.force_n,
        "plans": list(plans),
    }
