"""Codes of the reasons why an estimate is not valid, of all systems.

Programs need codes that stay when the words improve. Two palms give codes (`observer.validity`); observers of pivots
and of three palms give a reason in words, which has its code here. `{}` is a value.
"""

from __future__ import annotations

import re
from functools import lru_cache

MEANINGS = {
    "untouched": "a pad or palm that is needed reports no contact",
    "no-arm-reports": "there is no recent report of the joints or of the pivot",
    "just-touched": "contact has only just resumed",
    "no-force": "the pad gives no force, which is needed here",
    "no-height": "the pivot's height is not measured",
    "no-object": "nothing has been found yet that explains the readings",
    "rig-unknown": "the rig's constants are not estimated yet",
    "orientation-unknown": "it is not known yet how the body was put down",
    "too-young": "the object has been observed for too short a time",
    "unexplored": "the outline or surface has not been touched at the contact yet",
    "undetermined": "the readings determine too little of the shape: move more",
    "unconfirmed": "a shape was found that more readings must confirm",
    "not-sharp": "a standard deviation is too large",
    "ambiguous": "other hypotheses explain the readings as well",
    "one-side": "only one side of the dead centre was touched",
    "unexplained": "no motion of the model explains the readings",
    "inconsistent": "the readings contradict the prediction",
    "outliers": "too many readings are outliers",
    "impossible": "only a hollow shape or an impossible inertia explains the readings",
    "pivot-misplaced": "the pivot would be outside the body or below the pad: check z",
    "not-converged": "the iteration has not converged",
    "catching-up": "the filter is still fusing the readings since the smoother's answer",
    "not-settled": "the outline is not convex, or the object's identity is not decided",
    "not-finite": "a value is not a number",
    "sticks": "the palms do not vibrate: friction may hold the object",
    "observer-failed": "the observer has failed",
    "other": "see the reason in words",
    "no-answer": "no reason is available",
}
"""What each code means; two palms also give the codes of contradicted wiring (`faults`)."""

_WORDS = {
    "observer-failed": ("the observer has failed",),
    "untouched": (
        "nothing touches the pad",
        "the pad is never touched for long enough",
        "nothing touches palm {}",
    ),
    "no-arm-reports": (
        "the arm hardly reports the pivot's position",
        "the joints are not reported",
    ),
    "no-force": ("the pad gives no force, which is needed to relate both sides of the dead centre",),
    "no-height": ("the pivot's height is not measured, which is needed for the size of the outline",),
    "no-object": (
        "no outline is known yet",
        "no motion found yet that explains the readings",
    ),
    "orientation-unknown": ("the orientation in which the body was put down is not known yet",),
    "unexplored": (
        "the outline has not been touched here yet",
        "the body rolls onto surface that has not been touched yet",
    ),
    "undetermined": (
        "the readings determine too little of the outline",
        "the pivot's height hardly changes ({} mm): dragging alone does not determine the outline",
        "the arm hardly moves ({} mm): without rolling the outline is not observable",
        "the readings determine too little of the shape",
    ),
    "unconfirmed": (
        "an outline was found; it is accepted once more readings confirm it",
        "the motion is not yet confirmed by an independent restart",
    ),
    "not-sharp": ("the outline's standard deviation is {} mm; {} mm is accepted",),
    "ambiguous": (
        "another outline explains the readings as well",
        "another motion explains the readings as well",
    ),
    "one-side": ("only one side of the dead centre was touched: touch both sides, so that the force relates them",),
    "unexplained": (
        "no motion of a body explains the readings",
        "z or force contradict the readings, or the body is not rigid: chi2 {}, of the heights {}, of the forces {}",
        "the motion no longer explains the readings",
        "the motion that explains the first readings fails after {} s",
        "the readings are not explained to their noise",
        "the readings are not explained to their noise, and restarts are pending",
        "no motion that satisfies the equations of motion explains the readings",
    ),
    "inconsistent": (
        "the readings contradict the estimated outline",
        "the pivot is above the contact, or the height contradicts the outline",
        "the readings contradict the estimated motion",
        "the filter has diverged",
    ),
    "outliers": ("{} of the readings are outliers",),
    "impossible": (
        "only a hollow outline explains the readings",
        "only an impossible inertia explains the readings",
        "only a hollow body explains the readings",
    ),
    "pivot-misplaced": (
        "the pivot would lie outside the body: z contradicts the readings",
        "the pivot would be {} mm below the pad's surface: check z",
    ),
    "not-converged": (
        "the fit did not converge to a minimum",
        "the iteration has not converged",
    ),
    "catching-up": ("the filter is catching up with the readings since the smoother's answer",),
}
CODES = {words: code for code, sentences in _WORDS.items() for words in sentences}
"""The code of each reason in words."""
_WITH_VALUES = [
    (re.compile(re.escape(words).replace(r"\{\}", ".+")), code) for words, code in CODES.items() if "{}" in words
]


@lru_cache(maxsize=64)  # an invalid estimate asks at each tick, mostly about the same words
def code_of(words: str) -> str:
    """The code of a reason; `other` for one that is not in the table; empty for none."""
    if not words or words in CODES:
        return CODES.get(words, "")
    return next((code for pattern, code in _WITH_VALUES if pattern.fullmatch(words)), "other")
