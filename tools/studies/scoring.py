"""An estimator's answers against the truth: outlines, and the live observer tick by tick. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.observer.reconstruction import Reconstruction
from palmd.score import LAST_S, WRONG_M, OutlineScore, score_outline, support_at
from tools.studies.bound import Truth

RIGHT_M = 1e-4
FAR = 3.0  # one-sigmas, by RMS over the touched normals: more, and what is claimed is wrong on any rig
CAUSAL_OUTLINE_M, CAUSAL_R_M = 2e-4, 3e-4

Line = dict[str, Any]
Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Causal:
    """The daemon's `shape` observer on the same run; NaN for what there is not.

    converged_after: from the first event to the tick from which on to the end every tick is valid with r1 and r2
    within `CAUSAL_R_M` and the latest outline has e_h below `CAUSAL_OUTLINE_M` (s). first_valid: to the first
    valid tick (s). r_rms (m) and nees_r (1 when the error bars are honest): of r1 and r2 together, over the valid
    ticks of the last `LAST_S`.
    """

    converged_after_s: float
    first_valid_s: float
    r_rms_m: float
    nees_r: float


def truth_of(told: Line) -> Truth:
    """What a simulator told of the truth, as the bound wants it."""
    columns = ("theta_rad", "h_m", "t", "psi_rad", "omega0_rad_s")
    theta, h, t, psi, omega0 = (np.array(told[name], dtype=np.float64) for name in columns)
    return Truth(
        rho=told["rho_m"],
        mu=told["mu"],
        mass=told["mass_kg"],
        dither=told["dither_m_s"],
        damping=told["damping_m2_s"],
        theta=theta,
        h=h,
        t=t,
        psi=psi,
        omega0=omega0,
    )


# ------------------------------------------------------------------------------------------ reconstructed


@dataclass(frozen=True, slots=True)
class OutlineErrors:
    """A reconstructed outline against the true one, on the estimate's normals.

    true_theta: the same normals as the truth names them (rad). error, h_sd: in m.
    """

    score: OutlineScore
    touched: Bools
    true_theta: FloatArray
    error: FloatArray
    h_sd: FloatArray


def outline_errors(answer: Reconstruction, truth: Truth) -> OutlineErrors | None:
    """The outline after the best rotation, None when there is none or nothing of it was touched."""
    if answer.h is None or answer.h_sd is None or answer.touched is None:
        return None
    score = score_where_known(answer.theta, answer.h, answer.touched, truth.h)
    if score is None:
        return None
    true_theta = np.mod(answer.theta + score.rotation, math.tau)
    return OutlineErrors(score, answer.touched, true_theta, answer.h - support_at(truth.h, true_theta), answer.h_sd)


def score_where_known(theta: FloatArray, h: FloatArray, touched: Bools, true_h: FloatArray) -> OutlineScore | None:
    """As `score_outline`, None when nothing was touched or what was is not known."""
    if not touched.any() or not np.isfinite(h[touched]).all():
        return None
    return score_outline(theta, h, touched, true_h)


def rms(values: FloatArray) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


# ------------------------------------------------------------------------------------------------- causal


@dataclass(frozen=True, slots=True)
class ObserverAnswers:
    """A causal observer's answers, one a tick: t (s) from the first event, r_error and r_sd (n, 2) in m.

    e_h (m): of the latest outline, NaN while there is none of which anything was touched.
    """

    t: FloatArray
    valid: Bools
    r_error: FloatArray
    r_sd: FloatArray
    e_h: FloatArray

    @property
    def wrong(self) -> Bools:
        """Where they are valid, and a radius is off by more than 0.3 mm."""
        return self.valid & (np.abs(self.r_error) > WRONG_M).any(axis=1)


def causal_of(answers: ObserverAnswers) -> Causal:
    """What came of a causal replay."""
    close = (np.abs(answers.r_error) < CAUSAL_R_M).all(axis=1)
    good = answers.valid & close & (answers.e_h < CAUSAL_OUTLINE_M)
    late = answers.valid & (answers.t > answers.t[-1] - LAST_S)
    error, sd = answers.r_error[late], answers.r_sd[late]
    return Causal(
        converged_after_s=_lasting_from(answers.t, good),
        first_valid_s=float(answers.t[answers.valid.argmax()]) if answers.valid.any() else math.nan,
        r_rms_m=rms(error) if late.any() else math.nan,
        nees_r=float(np.mean((error / sd) ** 2)) if late.any() else math.nan,
    )


def _lasting_from(t: FloatArray, good: Bools) -> float:
    """The first time from which on all is good to the end, NaN when the end is not."""
    if not good[-1]:
        return math.nan
    bad = np.flatnonzero(~good)
    return float(t[bad[-1] + 1 if len(bad) else 0])
