"""Reasons why an estimate is not valid or a run is not explained, of all systems: a code and a sentence. Pure.

Programs need codes that stay when the words improve; what finds a reason makes both.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Literal, Self


class Code(StrEnum):
    """The codes and what each means; two palms also publish those of contradicted wiring (`faults`).

    Any other code, as of a recording without codes, becomes `other`.
    """

    meaning: str

    def __new__(cls, value: str, meaning: str = "") -> Self:
        """A code with its `meaning`."""
        code = str.__new__(cls, value)
        code._value_, code.meaning = value, meaning
        return code

    @classmethod
    def _missing_(cls, value: object) -> Code:
        del value
        return cls.OTHER

    UNTOUCHED = "untouched", "a pad or palm that is needed reports no contact"
    NO_ARM_REPORTS = "no-arm-reports", "there is no recent report of the joints or of the pivot"
    JUST_TOUCHED = "just-touched", "contact has only just resumed"
    NO_FORCE = "no-force", "the pad gives no force, which is needed here"
    NO_HEIGHT = "no-height", "the pivot's height is not measured"
    NO_OBJECT = "no-object", "nothing has been found yet that explains the readings"
    RIG_UNKNOWN = "rig-unknown", "the rig's constants are not estimated yet"
    RIG_CONTRADICTED = "rig-contradicted", "the readings are explained only by a rig that differs from its description"
    ORIENTATION_UNKNOWN = "orientation-unknown", "it is not known yet how the body was put down"
    TOO_YOUNG = "too-young", "the object has been observed for too short a time"
    TOO_SHORT = "too-short", "no part of the run with reports of every pad and of the arm is long enough"
    UNEXPLORED = "unexplored", "the outline or surface has not been touched at the contact yet"
    LOW_COVERAGE = "low-coverage", "too few of the normals were touched: move so that the object rolls farther"
    UNDETERMINED = "undetermined", "the readings determine too little of the shape: move more"
    UNCONFIRMED = "unconfirmed", "a shape was found that more readings must confirm"
    NOT_SHARP = "not-sharp", "a standard deviation is too large"
    AMBIGUOUS = "ambiguous", "other hypotheses explain the readings as well"
    ONE_SIDE = "one-side", "only one side of the dead centre was touched"
    UNEXPLAINED = "unexplained", "no motion of the model explains the readings"
    INCONSISTENT = "inconsistent", "the readings contradict the prediction"
    OUTLIERS = "outliers", "too many readings are outliers"
    IMPOSSIBLE = "impossible", "only a hollow shape or an impossible inertia explains the readings"
    TOO_CONCAVE = "too-concave", "the palms are too concave for the object"
    PIVOT_MISPLACED = "pivot-misplaced", "the pivot would be outside the body or below the pad: check z"
    NOT_CONVERGED = "not-converged", "the iteration has not converged"
    CATCHING_UP = "catching-up", "the filter is still fusing the readings since the smoother's answer"
    NOT_SETTLED = "not-settled", "the outline is not convex, or the object's identity is not decided"
    NOT_FINITE = "not-finite", "a value is not a number"
    STICKS = "sticks", "the palms do not vibrate: friction may hold the object"
    OBSERVER_FAILED = "observer-failed", "the observer has failed"
    OTHER = "other", "see the reason in words"
    NO_ANSWER = "no-answer", "no reason is available"


class Reason(str):
    """A reason in words with the values, with its code; empty, and false, if there is none."""

    __slots__ = ("code",)
    code: Code | Literal[""]

    def __new__(cls, code: Code | Literal[""] = "", text: str = "") -> Self:
        """A reason with its code, in words."""
        reason = str.__new__(cls, text)
        reason.code = code
        return reason

    def __getnewargs__(self) -> tuple[Code | Literal[""], str]:  # type: ignore[override]
        """The arguments of `__new__`, for copies and for other processes."""
        return self.code, str(self)


NO_REASON = Reason()
