"""Codes of the reasons why an estimate of a pivoting grasp or of three palms is not valid.

Observers give a reason in words. Programs need codes that stay when the words improve: change the words here, too, but
not the codes. `{}` is a value. The reasons of two palms are in `observer.validity`.
"""

from __future__ import annotations

import re

COMMON = (
    ("the-observer-has-failed", "the observer has failed"),
    ("nothing-touches-the-pad", "nothing touches the pad"),
    ("the-fit-did-not-converge-to-a-minimum", "the fit did not converge to a minimum"),
)
PIVOT = (
    ("no-outline-is-known-yet", "no outline is known yet"),
    ("the-orientation-in-which-the-body-was-put-down-is-not-known-yet",
     "the orientation in which the body was put down is not known yet"),
    ("the-readings-contradict-the-estimated-outline", "the readings contradict the estimated outline"),
    ("the-pivot-is-above-the-contact-or-the-height-contradicts-the-outline",
     "the pivot is above the contact, or the height contradicts the outline"),
    ("the-outline-has-not-been-touched-here-yet", "the outline has not been touched here yet"),
    ("an-outline-was-found-it-is-accepted-once-more-readings-confirm-it",
     "an outline was found; it is accepted once more readings confirm it"),
    ("the-outline-s-standard-deviation-is-mm-mm-is-accepted",
     "the outline's standard deviation is {} mm; {} mm is accepted"),
    ("only-one-side-of-the-dead-centre-was-touched-touch-both-sides-so-that-the-force-relates-them",
     "only one side of the dead centre was touched: touch both sides, so that the force relates them"),
    ("the-pad-gives-no-force-which-is-needed-to-relate-both-sides-of-the-dead-centre",
     "the pad gives no force, which is needed to relate both sides of the dead centre"),
    ("no-motion-of-a-body-explains-the-readings", "no motion of a body explains the readings"),
    ("another-outline-explains-the-readings-as-well", "another outline explains the readings as well"),
    ("only-a-hollow-outline-explains-the-readings", "only a hollow outline explains the readings"),
    ("the-readings-determine-too-little-of-the-outline", "the readings determine too little of the outline"),
    ("the-iteration-has-not-converged", "the iteration has not converged"),
    ("of-the-readings-are-outliers", "{} of the readings are outliers"),
    ("z-or-force-contradict-the-readings-or-the-body-is-not-rigid-chi-of-the-heights-of-the-forces",
     "z or force contradict the readings, or the body is not rigid: chi2 {}, of the heights {}, of the forces {}"),
    ("the-pivot-would-lie-outside-the-body-z-contradicts-the-readings",
     "the pivot would lie outside the body: z contradicts the readings"),
    ("the-pivot-would-be-mm-below-the-pad-s-surface-check-z",
     "the pivot would be {} mm below the pad's surface: check z"),
    ("the-pivot-s-height-hardly-changes-mm-dragging-alone-does-not-determine-the-outline",
     "the pivot's height hardly changes ({} mm): dragging alone does not determine the outline"),
    ("the-pivot-s-height-is-not-measured-which-is-needed-for-the-size-of-the-outline",
     "the pivot's height is not measured, which is needed for the size of the outline"),
    ("the-arm-hardly-moves-mm-without-rolling-the-outline-is-not-observable",
     "the arm hardly moves ({} mm): without rolling the outline is not observable"),
    ("the-arm-hardly-reports-the-pivot-s-position", "the arm hardly reports the pivot's position"),
    ("the-pad-is-never-touched-for-long-enough", "the pad is never touched for long enough"),
)  # fmt: skip
THREE_PALMS = (
    ("nothing-touches-palm", "nothing touches palm {}"),
    ("the-joints-are-not-reported", "the joints are not reported"),
    ("no-motion-found-yet-that-explains-the-readings", "no motion found yet that explains the readings"),
    ("the-motion-no-longer-explains-the-readings", "the motion no longer explains the readings"),
    ("the-motion-that-explains-the-first-readings-fails-after-s",
     "the motion that explains the first readings fails after {} s"),
    ("the-readings-are-not-explained-to-their-noise", "the readings are not explained to their noise"),
    ("the-readings-are-not-explained-to-their-noise-and-restarts-are-pending",
     "the readings are not explained to their noise, and restarts are pending"),
    ("no-motion-that-satisfies-the-equations-of-motion-explains-the-readings",
     "no motion that satisfies the equations of motion explains the readings"),
    ("another-motion-explains-the-readings-as-well", "another motion explains the readings as well"),
    ("the-motion-is-not-yet-confirmed-by-an-independent-restart",
     "the motion is not yet confirmed by an independent restart"),
    ("only-an-impossible-inertia-explains-the-readings", "only an impossible inertia explains the readings"),
    ("only-a-hollow-body-explains-the-readings", "only a hollow body explains the readings"),
    ("the-readings-determine-too-little-of-the-shape", "the readings determine too little of the shape"),
    ("the-body-rolls-onto-surface-that-has-not-been-touched-yet",
     "the body rolls onto surface that has not been touched yet"),
    ("the-readings-contradict-the-estimated-motion", "the readings contradict the estimated motion"),
    ("the-filter-is-catching-up-with-the-readings-since-the-smoother-s-answer",
     "the filter is catching up with the readings since the smoother's answer"),
    ("the-filter-has-diverged", "the filter has diverged"),
)  # fmt: skip
_CODES = {words: code for code, words in (*COMMON, *PIVOT, *THREE_PALMS)}
_WITH_VALUES = [
    (re.compile(re.escape(words).replace(r"\{\}", ".+")), code) for words, code in _CODES.items() if "{}" in words
]


def code_of(words: str) -> str:
    """The code of a reason; of one that is not in the tables, for example in an old recording, made from its words."""
    if words in _CODES:
        return _CODES[words]
    found = next((code for pattern, code in _WITH_VALUES if pattern.fullmatch(words)), "")
    return found or "-".join(re.findall("[a-z]+", words.lower()))
