"""Errors of estimates: reconstructed outlines, and the live observer tick by tick. Pure."""

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
FAR = 3.0  # RMS error over the touched normals in 1σ, above which an accepted estimate is wrong on any rig
CAUSAL_OUTLINE_M, CAUSAL_R_M = 2e-4, 3e-4  # limits for convergence of the live observer

Line = dict[str, Any]
Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Causal:
    """Results of the daemon's `shape` observer on the same run; NaN for missing values.

    converged_after_s: time from the first event to the tick from which on all ticks are valid, with errors of r1 and r2
    below `CAUSAL_R_M` and e_h of the latest outline below `CAUSAL_OUTLINE_M`. first_valid_s: to the first valid tick.
    r_rms_m, nees_r (1 if the standard deviations are right): of r1 and r2 together, over the valid ticks of the last
    `LAST_S`.
    """

    converged_after_s: float
    first_valid_s: float
    r_rms_m: float
    nees_r: float


def truth_of(line: Line) -> Truth:
    """The `Truth` from a simulator's truth as a JSON object."""
    columns = ("theta_rad", "h_m", "t", "psi_rad", "omega0_rad_s")
    theta, h, t, psi, omega0 = (np.array(line[name], dtype=np.float64) for name in columns)
    return Truth(
        rho=line["rho_m"],
        mu=line["mu"],
        mass=line["mass_kg"],
        dither=line["dither_m_s"],
        damping=line["damping_m2_s"],
        theta=theta,
        h=h,
        t=t,
        psi=psi,
        omega0=omega0,
    )


# ------------------------------------------------------------------------------------------ reconstructed


@dataclass(frozen=True, slots=True)
class OutlineErrors:
    """Errors of a reconstructed outline, on the estimate's normals.

    true_theta: the same normals in the truth's gauge (rad). error, h_sd: in m.
    """

    score: OutlineScore
    touched: Bools
    true_theta: FloatArray
    error: FloatArray
    h_sd: FloatArray


def outline_errors(answer: Reconstruction, truth: Truth) -> OutlineErrors | None:
    """Errors after the best rotation; None without an outline or without touched normals."""
    if answer.h is None or answer.h_sd is None or answer.touched is None:
        return None
    score = score_where_known(answer.theta, answer.h, answer.touched, truth.h)
    if score is None:
        return None
    true_theta = np.mod(answer.theta + score.rotation, math.tau)
    return OutlineErrors(score, answer.touched, true_theta, answer.h - support_at(truth.h, true_theta), answer.h_sd)


def score_where_known(theta: FloatArray, h: FloatArray, touched: Bools, true_h: FloatArray) -> OutlineScore | None:
    """As `score_outline`; None if no normal was touched or h is not finite on the touched ones."""
    if not touched.any() or not np.isfinite(h[touched]).all():
        return None
    return score_outline(theta, h, touched, true_h)


def rms(values: FloatArray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


# ------------------------------------------------------------------------------------------------- causal


@dataclass(frozen=True, slots=True)
class ObserverAnswers:
    """A live observer's estimates, one per tick: t (s) from the first event, r_error and r_sd (n, 2) in m.

    e_h (m): of the latest outline, NaN while there is none with touched normals.
    """

    t: FloatArray
    valid: Bools
    r_error: FloatArray
    r_sd: FloatArray
    e_h: FloatArray

    @property
    def wrong(self) -> Bools:
        """Ticks that are valid with an error of a radius above 0.3 mm."""
        return self.valid & (np.abs(self.r_error) > WRONG_M).any(axis=1)


def causal_of(answers: ObserverAnswers) -> Causal:
    """The results of a causal replay."""
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
    """The first time from which on all ticks are good, NaN if the last one is not."""
    if not good[-1]:
        return math.nan
    bad = np.flatnonzero(~good)
    return float(t[bad[-1] + 1 if len(bad) else 0])
