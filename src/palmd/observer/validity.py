"""The rule by which an estimate is valid, for every observer. Pure.

An estimate is valid if it is `settled`, its outline is convex, and the object's identity is decided: no known object
was expected, or the hypothesis that it is one was accepted (`identified`, if outlines are stored).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from palmd.events import DECIDED
from palmd.system.reasons import Code

MOST_NIS = 2.0  # largest running mean NIS of a consistent estimate; overestimated noise is no reason to reject
RESUMED_FOR_S = 0.05  # s of readings after a silence, enough to show whether they are of the same object
SURE = 0.99  # probability from which an object is identified, until it falls below `DECIDED`
LOST_NIS = 3.0  # running mean NIS above which a track is being lost
# Largest RMS 1σ of the touched outline, given the rig's constants, of an estimate that is used at all.
SHARP_M = 1.5e-4
# The same for a smoother's outline to count as confirmed. The smoother uses all readings at once and knows more than a
# filter, whatever 1σ that has: on simulated lumps and ellipses filters with 0.1 to 0.2 mm were valid and wrong by 0.3
# to 1 mm.
CONFIRMED_M = 2e-4
PRECISE_M = 1e-4  # the same for an outline that is accepted if only both palms' readings together contradict a disc
CONTRADICTED_M = 5e-4  # inflated 1σ of a radius above which a confirmed estimate has been contradicted
PREDICTABLE_SD_M, PREDICTABLE_AGE_S = 3e-3, 0.6  # largest 1σ of the radii and least age (s) for planning motions


class Evidence(NamedTuple):
    """The facts that decide about one estimate; a tuple, since a frozen dataclass takes several times as long to make.

    touching: both pads confirm a contact, since `resumed_for_s`. palms_known: there are recent reports of the palms.
    finite: all values are. consistent: the readings are as predicted. age_s: since the object was started. radius_sd_m:
    the largest 1σ of a radius. disagreement_m: among rival hypotheses, or of the readings about one outline. rig_known:
    the standard deviations include the uncertainty of the rig's constants, or that is negligible. explained: the
    smoother's last result was not a rejection, and the object was not lost a short while ago without lift-off.
    """

    touching: bool
    palms_known: bool
    resumed_for_s: float
    finite: bool
    consistent: bool
    age_s: float
    radius_sd_m: float
    disagreement_m: float
    rig_known: bool
    explained: bool


@dataclass(frozen=True, slots=True)
class Thresholds:
    """Least age, largest 1σ of a radius and largest disagreement of a valid estimate of an observer."""

    age_s: float
    radius_sd_m: float
    disagreement_m: float


class _Condition(NamedTuple):
    """A condition for a valid estimate: its code, a test, and a text with value and limit for when it fails.

    `words` also gets the running mean of the NIS.
    """

    code: Code
    holds: Callable[[Evidence, Thresholds], bool]
    words: Callable[[Evidence, Thresholds, float], str]


def _over(what: str, value_m: float, limit_m: float) -> str:
    return f"{what} {value_m * 1e3:.2f} mm (limit {limit_m * 1e3:.2f} mm)"


def _inconsistent(_evidence: Evidence, _least: Thresholds, nis: float) -> str:
    return "the contacts lie outside the pads" if consistent(nis) else f"NIS {nis:.2f} (limit {MOST_NIS:g})"


_CONDITIONS = (
    _Condition(Code.UNTOUCHED, lambda e, _: e.touching, lambda *_: "not both pads report a contact"),
    _Condition(Code.NO_ARM_REPORTS, lambda e, _: e.palms_known, lambda *_: "no recent report of the palm angles"),
    _Condition(
        Code.JUST_TOUCHED,
        lambda e, _: e.resumed_for_s > RESUMED_FOR_S,
        lambda e, *_: f"contact resumed {e.resumed_for_s:.2f} s ago (limit {RESUMED_FOR_S:.2f} s)",
    ),
    _Condition(Code.NOT_FINITE, lambda e, _: e.finite, lambda *_: "a value is not finite"),
    _Condition(Code.INCONSISTENT, lambda e, _: e.consistent, _inconsistent),
    _Condition(Code.RIG_UNKNOWN, lambda e, _: e.rig_known, lambda *_: "the rig's constants are not estimated yet"),
    _Condition(
        Code.UNEXPLAINED,
        lambda e, _: e.explained,
        lambda *_: "the smoother rejects a smooth outline: a flat side, a corner or a second object?",
    ),
    _Condition(
        Code.TOO_YOUNG,
        lambda e, least: e.age_s > least.age_s,
        lambda e, least, _: f"object observed for {e.age_s:.1f} s (limit {least.age_s:.1f} s)",
    ),
    _Condition(
        Code.NOT_SHARP,
        lambda e, least: e.radius_sd_m < least.radius_sd_m,
        lambda e, least, _: _over("1σ of a radius", e.radius_sd_m, least.radius_sd_m),
    ),
    _Condition(
        Code.AMBIGUOUS,
        lambda e, least: e.disagreement_m < least.disagreement_m,
        lambda e, least, _: _over("disagreement between hypotheses", e.disagreement_m, least.disagreement_m),
    ),
)


def settled(evidence: Evidence, least: Thresholds) -> bool:
    """Whether all conditions hold, apart from convexity and the object's identity."""
    return all(condition.holds(evidence, least) for condition in _CONDITIONS)


def reasons(evidence: Evidence, least: Thresholds) -> tuple[str, ...]:
    """The codes of the conditions that fail; `not-settled` if none fails."""
    failed = tuple(condition.code for condition in _CONDITIONS if not condition.holds(evidence, least))
    return failed or (Code.NOT_SETTLED,)


def unmet(evidence: Evidence, least: Thresholds, nis: float) -> list[str]:
    """Each condition that fails, in words with its value and limit; `nis` is the running mean."""
    return [each.words(evidence, least, nis) for each in _CONDITIONS if not each.holds(evidence, least)]


def consistent(nis: float) -> bool:
    """Whether a filter's running mean NIS is consistent with a correct model."""
    return bool(nis < MOST_NIS)


def fails_innovation_test(nis: float) -> bool:
    """Whether the best filter's running mean NIS shows that no filter predicts the readings."""
    return bool(nis > MOST_NIS)


def identified(probability: float, before: bool) -> bool:
    """Whether an object of this probability is identified, with hysteresis: `before` is the previous result."""
    return probability >= (DECIDED if before else SURE)


def predictable(finite: bool, read_lately: bool, age_s: float, radius_sd_m: float) -> bool:
    """Whether an estimate that may not be valid yet is good enough to predict the effect of a motion."""
    return bool(finite and read_lately and age_s > PREDICTABLE_AGE_S and radius_sd_m < PREDICTABLE_SD_M)
