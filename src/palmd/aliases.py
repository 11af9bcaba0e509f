"""Former names of published fields, results, requests, options and attributes, which work until 2.0.

Former names were private words; the standard ones are the terms of docs/reference/glossary.md. palmd publishes and
writes both, accepts either, and uses only the standard name internally. Pure; safe in the loop.
"""

from __future__ import annotations

from typing import Any, NamedTuple


class Alias(NamedTuple):
    """A name that has changed: where it stands, both names, and why this is the standard one."""

    where: str
    standard: str
    former: str
    reason: str


STATE, RIG = "palm/state", "palm/rig"
PIVOT_ANSWER, PALM3_ANSWER = "palm/pivot_answer", "palm3/answer"
STATUS = "result of the request `status`"
RESULT, SHAPE_CLASS = "result of `palmd reconstruct`", "`shape_class` in it"
PIVOT_RESULT = "result of `palmd reconstruct` for a pivoting grasp"
SELF_CALIBRATION = "`found` in the file of `palmd calibrate self`"
LIBRARY = "result of `palmd.reconstruct`"
RIG_STATUS = "emulated rig: result of its request `status`"
RIG_REQUESTS, RIG_OPTIONS = "emulated rig: requests", "`palmd demo rig`"

_ACCEPTED = "the opposite of rejected, as in the verdict of a result"
_REQUESTED = "hold or stop as a client requested it, not necessarily reached"
_SHAPE_CLASS = "the classification of the outline as a simple shape"

ALIASES = (
    Alias(STATE, "requested_state", "wish", _REQUESTED),
    Alias(STATUS, "requested_state", "wish", _REQUESTED),
    Alias(RIG, "contradictions", "off", "the constants that the readings contradict, by the test of criticism"),
    Alias(PIVOT_ANSWER, "accepted", "claimed", _ACCEPTED),
    Alias(PALM3_ANSWER, "accepted", "claimed", _ACCEPTED),
    Alias(PALM3_ANSWER, "record_start_s", "begun_s", "says what starts at this time: the smoother's record"),
    Alias(PALM3_ANSWER, "unexplained_sd_m", "rough_m", "a standard deviation, not a property of the surface"),
    Alias(RESULT, "shape_class", "looks_like", _SHAPE_CLASS),
    Alias(SHAPE_CLASS, "text", "said", "the name of texts for people in all messages"),
    Alias(SHAPE_CLASS, "orientation_determined", "orientation_told", "readings determine a value"),
    Alias(PIVOT_RESULT, "unobservable", "not_told", "the term for quantities that readings cannot determine"),
    Alias(SELF_CALIBRATION, "determined", "told", "readings determine a value"),
    Alias(LIBRARY, "results", "told", "all results, under the names of the command's result"),
    Alias(LIBRARY, "shape_class", "looks_like", _SHAPE_CLASS),
    Alias(RIG_STATUS, "injected_faults", "mischief", "the term is fault injection"),
    Alias(RIG_REQUESTS, "inject", "mischief", "the term is fault injection"),
    Alias(RIG_REQUESTS, "clear", "calm", "faults are cleared"),
    Alias(RIG_REQUESTS, "faults", "tricks", "the term is fault injection"),
    Alias(RIG_OPTIONS, "--inject", "--mischief", "as the emulated rig's request"),
)
"""No configuration key, plan key or key of an event log was a private word."""

_BY_PLACE = {place: tuple(each for each in ALIASES if each.where == place) for place, *_ in ALIASES}


def aliases_of(where: str) -> tuple[Alias, ...]:
    """The names that have changed there, none for an unknown place."""
    return _BY_PLACE.get(where, ())


def with_former_names(where: str, fields: dict[str, Any]) -> dict[str, Any]:
    """Add the former names to `fields` to be published or written; returns `fields`."""
    for _, standard, former, _ in aliases_of(where):
        fields[former] = fields[standard]
    return fields


def with_standard_names(where: str, fields: dict[str, Any]) -> dict[str, Any]:
    """Add the standard names to `fields` that an earlier release has published; returns `fields`."""
    for _, standard, former, _ in aliases_of(where):
        if standard not in fields and former in fields:
            fields[standard] = fields[former]
    return fields


def standard_name(where: str, name: str) -> str:
    """The standard name for a name that may be a former one."""
    return next((each.standard for each in aliases_of(where) if each.former == name), name)
