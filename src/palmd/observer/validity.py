"""When an estimate is valid: one rule for every observer, from evidence to judgement. Pure.

An estimate is valid when it is `settled`, its outline is convex, and it is decided which object it is of: none was
expected, or the hypothesis that it is a known one was accepted (`identified`, where outlines are stored).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from palmd.events import DECIDED

NIS_RANGE = (0.2, 2.0)  # of the running mean, to be called consistent
RESUMED_FOR_S = 0.05  # of readings after a silence, by which it shows whether they are of the same object
SURE = 0.99  # the probability from which on an object is identified, until it falls below `DECIDED`
LOST_NIS = 3.0
# RMS of the outline's one-sigma where touched, were the rig known, above which there is no outline to speak of.
SHARP_M = 1.5e-4
# The same, above which a smoother vouches for nothing: what weighs all readings at once knows more than a filter,
# whatever one-sigma that has. Seen on simulated lumps and ellipses: valid, and 0.3 to 1 mm off, with 0.1 to 0.2 mm.
VOUCHED_M = 2e-4
SURE_M = 1e-4  # the same, below which what is no disc by the readings of both palms together need not be felt to roll
VAGUE_M = 5e-4  # of what is told of a radius, surprises counted: above it a vouched answer has been contradicted
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


def settled(evidence: Evidence, least: Thresholds) -> bool:
    """Whether the numbers can be taken at their word, whichever object they are of."""
    believable = evidence.finite and evidence.consistent and evidence.rig_known and evidence.explained
    felt = evidence.touching and evidence.palms_known and evidence.resumed_for_s > RESUMED_FOR_S
    sharp = evidence.radius_sd_m < least.radius_sd_m and evidence.disagreement_m < least.disagreement_m
    return bool(believable and felt and sharp and evidence.age_s > least.age_s)


def unmet(evidence: Evidence, least: Thresholds, nis: float) -> list[str]:
    """Each condition of `settled` that fails, in words with its value and limit; `nis` is the running mean."""
    (low, high), resumed_s = NIS_RANGE, evidence.resumed_for_s
    checks = (
        (evidence.touching, "not both pads report a contact"),
        (evidence.palms_known, "no recent report of the palm angles"),
        (resumed_s > RESUMED_FOR_S, f"contact resumed {resumed_s:.2f} s ago (limit {RESUMED_FOR_S:.2f} s)"),
        (evidence.finite, "a value is not finite"),
        (consistent(nis), f"NIS {nis:.2f} (limits {low:g} to {high:g})"),
        (evidence.consistent or not consistent(nis), "the contacts lie outside the pads"),
        (evidence.rig_known, "the rig's constants are not estimated yet"),
        (evidence.explained, "the smoother rejects a smooth outline: a flat side, a corner or a second object?"),
        (evidence.radius_sd_m < least.radius_sd_m, _over("1σ of a radius", evidence.radius_sd_m, least.radius_sd_m)),
        (evidence.disagreement_m < least.disagreement_m,
         _over("disagreement between hypotheses", evidence.disagreement_m, least.disagreement_m)),
        (evidence.age_s > least.age_s, f"object observed for {evidence.age_s:.1f} s (limit {least.age_s:.1f} s)"),
    )  # fmt: skip
    return [text for holds, text in checks if not holds]


def _over(what: str, value_m: float, limit_m: float) -> str:
    return f"{what} {value_m * 1e3:.2f} mm (limit {limit_m * 1e3:.2f} mm)"


def reasons(evidence: Evidence, least: Thresholds) -> tuple[str, ...]:
    """The codes of what speaks against an answer; `not-settled` where none of the evidence does."""
    against = {
        "untouched": not evidence.touching,
        "no-arm-reports": not evidence.palms_known,
        "just-touched": not evidence.resumed_for_s > RESUMED_FOR_S,
        "not-finite": not evidence.finite,
        "inconsistent": not evidence.consistent,
        "rig-unknown": not evidence.rig_known,
        "unexplained": not evidence.explained,
        "too-young": not evidence.age_s > least.age_s,
        "not-sharp": not evidence.radius_sd_m < least.radius_sd_m,
        "ambiguous": not evidence.disagreement_m < least.disagreement_m,
    }
    return tuple(code for code, holds in against.items() if holds) or ("not-settled",)


def consistent(nis: float) -> bool:
    """Whether a filter's running mean of the normalised innovation squared is that of a right model."""
    return bool(NIS_RANGE[0] < nis < NIS_RANGE[1])


def surprised(nis: float) -> bool:
    """Whether the readings are beyond what any filter foresees."""
    return bool(nis > NIS_RANGE[1])


def identified(probability: float, before: bool) -> bool:
    """Whether an object of this probability is the one, given whether it was `before`: with hysteresis."""
    return probability >= (DECIDED if before else SURE)


def predictable(finite: bool, read_lately: bool, age_s: float, radius_sd_m: float) -> bool:
    """Whether an answer that may not be valid yet is known well enough to foresee what a motion will do."""
    return bool(finite and read_lately and age_s > PREDICTABLE_AGE_S and radius_sd_m < PREDICTABLE_SD_M)
