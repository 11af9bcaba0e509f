"""When an estimate is valid: one rule for every observer, from evidence to judgement. Pure.

An estimate is valid when it is `settled`, its outline is convex, and it is decided which object it is of: none was
expected, or the hypothesis that it is a known one was accepted (`identified`, where outlines are stored).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from palmd.events import DECIDED

MOST_NIS = 2.0  # of the running mean, to be called consistent; noise that does not show is no reason for doubt
RESUMED_FOR_S = 0.05  # of readings after a silence, by which it shows whether they are of the same object
SURE = 0.99  # the probability from which on an object is identified, until it falls below `DECIDED`
LOST_NIS = 3.0
# RMS of the outline's one-sigma where touched, were the rig known, above which there is no outline to speak of.
SHARP_M = 1.5e-4
# The same, above which a smoother vouches for nothing: what weighs all readings at once knows more than a filter,
# whatever one-sigma that has. Seen on simulated lumps and ellipses: valid, and 0.3 to 1 mm off, with 0.1 to 0.2 mm.
CONFIRMED_M = 2e-4
PRECISE_M = (
    1e-4  # the same, below which what is no disc by the readings of both palms together need not be felt to roll
)
CONTRADICTED_M = 5e-4  # of what is told of a radius, surprises counted: above it a vouched answer has been contradicted
PREDICTABLE_SD_M, PREDICTABLE_AGE_S = 3e-3, 0.6  # of the radii


class Evidence(NamedTuple):
    """What one estimate rests on; a tuple, as a frozen dataclass takes several times as long to make.

    touching: both pads vouch for a contact, since `resumed_for_s`. palms_known: so do reports of the palms. finite: of
    all values. consistent: the readings are as the model predicts. age_s: since the object was begun. radius_sd_m: the
    largest of the radii's. disagreement_m: among rival hypotheses, or of the readings about one outline. rig_known: the
    one-sigmas have what the rig's constants leave open, or these leave nothing open. explained: no smoother has said
    last that nothing explains the readings, and they are not of what the model has lost where it lay, a while ago.
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
    """How old, how sharp and how much agreed on an observer's answer has to be."""

    age_s: float
    radius_sd_m: float
    disagreement_m: float


class _Condition(NamedTuple):
    """What a valid estimate needs: a code, whether it holds, and in words with value and limit why it does not.

    `words` are given the running mean of the NIS, too.
    """

    code: str
    holds: Callable[[Evidence, Thresholds], bool]
    words: Callable[[Evidence, Thresholds, float], str]


def _over(what: str, value_m: float, limit_m: float) -> str:
    return f"{what} {value_m * 1e3:.2f} mm (limit {limit_m * 1e3:.2f} mm)"


def _inconsistent(_evidence: Evidence, _least: Thresholds, nis: float) -> str:
    return "the contacts lie outside the pads" if consistent(nis) else f"NIS {nis:.2f} (limit {MOST_NIS:g})"


_CONDITIONS = (
    _Condition("untouched", lambda e, _: e.touching, lambda *_: "not both pads report a contact"),
    _Condition("no-arm-reports", lambda e, _: e.palms_known, lambda *_: "no recent report of the palm angles"),
    _Condition(
        "just-touched",
        lambda e, _: e.resumed_for_s > RESUMED_FOR_S,
        lambda e, *_: f"contact resumed {e.resumed_for_s:.2f} s ago (limit {RESUMED_FOR_S:.2f} s)",
    ),
    _Condition("not-finite", lambda e, _: e.finite, lambda *_: "a value is not finite"),
    _Condition("inconsistent", lambda e, _: e.consistent, _inconsistent),
    _Condition("rig-unknown", lambda e, _: e.rig_known, lambda *_: "the rig's constants are not estimated yet"),
    _Condition(
        "unexplained",
        lambda e, _: e.explained,
        lambda *_: "the smoother rejects a smooth outline: a flat side, a corner or a second object?",
    ),
    _Condition(
        "too-young",
        lambda e, least: e.age_s > least.age_s,
        lambda e, least, _: f"object observed for {e.age_s:.1f} s (limit {least.age_s:.1f} s)",
    ),
    _Condition(
        "not-sharp",
        lambda e, least: e.radius_sd_m < least.radius_sd_m,
        lambda e, least, _: _over("1σ of a radius", e.radius_sd_m, least.radius_sd_m),
    ),
    _Condition(
        "ambiguous",
        lambda e, least: e.disagreement_m < least.disagreement_m,
        lambda e, least, _: _over("disagreement between hypotheses", e.disagreement_m, least.disagreement_m),
    ),
)


def settled(evidence: Evidence, least: Thresholds) -> bool:
    """Whether the numbers can be taken at their word, whichever object they are of."""
    return all(condition.holds(evidence, least) for condition in _CONDITIONS)


def reasons(evidence: Evidence, least: Thresholds) -> tuple[str, ...]:
    """The codes of the conditions that fail; `not-settled` where none of them does."""
    failed = tuple(condition.code for condition in _CONDITIONS if not condition.holds(evidence, least))
    return failed or ("not-settled",)


def unmet(evidence: Evidence, least: Thresholds, nis: float) -> list[str]:
    """Each condition that fails, in words with its value and limit; `nis` is the running mean."""
    return [each.words(evidence, least, nis) for each in _CONDITIONS if not each.holds(evidence, least)]


def consistent(nis: float) -> bool:
    """Whether a filter's running mean of the normalised innovation squared is that of a right model."""
    return bool(nis < MOST_NIS)


def surprised(nis: float) -> bool:
    """Whether the readings are beyond what any filter foresees."""
    return bool(nis > MOST_NIS)


def identified(probability: float, before: bool) -> bool:
    """Whether an object of this probability is the one, given whether it was `before`: with hysteresis."""
    return probability >= (DECIDED if before else SURE)


def predictable(finite: bool, read_lately: bool, age_s: float, radius_sd_m: float) -> bool:
    """Whether an answer that may not be valid yet is known well enough to foresee what a motion will do."""
    return bool(finite and read_lately and age_s > PREDICTABLE_AGE_S and radius_sd_m < PREDICTABLE_SD_M)
