"""Errors of estimates: reconstructed outlines, and the live observer tick by tick. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray, ShapeEstimate
from palmd.observer import Observer, Simulated, make
from palmd.observer.reconstruction import Reconstruction
from palmd.record.eventlog import EventLog
from palmd.record.replay import replay
from palmd.score import LAST_S, WRONG_M, OutlineScore, score_outline, support_at
from tools.studies.bound import Truth

RIGHT_M = 1e-4
TICKS_PER_SHAPE = 10
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
    constants = (line[name] for name in ("rho_m", "mu", "mass_kg", "dither_m_s", "damping_m2_s"))
    columns = (np.array(line[name], np.float64) for name in ("theta_rad", "h_m", "t", "psi_rad", "omega0_rad_s"))
    return Truth(*constants, *columns)


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

    @property
    def sd(self) -> float:
        """RMS of 1σ over the touched normals (m)."""
        return rms(self.h_sd[self.touched])

    @property
    def nees(self) -> float:
        """Mean of (error / 1σ)² over the touched normals; 1 if the standard deviations are right."""
        return float(np.mean((self.error[self.touched] / self.h_sd[self.touched]) ** 2))


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
    """A live observer's estimates, one per tick: t (s) from the first event, errors with their 1σ.

    r_error, r_sd: (n, 2) in m. e_h (m): of the latest outline, NaN while there is none with touched normals. omega0_z:
    error of ω0 in 1σ.
    """

    t: FloatArray
    valid: Bools
    r_error: FloatArray
    r_sd: FloatArray
    e_h: FloatArray = field(default_factory=lambda: np.empty(0))
    omega0_z: FloatArray = field(default_factory=lambda: np.empty(0))

    @property
    def wrong(self) -> Bools:
        """Ticks that are valid with an error of a radius above 0.3 mm."""
        return self.valid & (np.abs(self.r_error) > WRONG_M).any(axis=1)


def replayed(log: EventLog, truth: Line, observer: Observer | None = None) -> ObserverAnswers:
    """A live observer's estimates of a run with their errors; by default the daemon's, with a simulated smoother."""
    observer = observer or make("shape", log.rig, smoothing=Simulated(log.rig))
    true_h, rows, e_h = np.array(truth["h_m"]), list[tuple[float, ...]](), math.nan
    for tick in replay(log, observer):
        if tick.number % TICKS_PER_SHAPE == 0:
            e_h = _e_h(observer.shape(tick.t), true_h)
        now = tick.estimate
        rows.append((tick.t, now.valid, now.r1, now.r2, now.sd["r1"], now.sd["r2"], e_h, now.omega0, now.sd["omega0"]))
    t, valid, r1, r2, r1_sd, r2_sd, all_e_h, omega0, omega0_sd = np.array(rows, dtype=np.float64).T
    true = {name: np.interp(t, truth["t"], truth[name]) for name in ("r1_m", "r2_m", "omega0_rad_s")}
    return ObserverAnswers(
        t=t - log.events[0].t_sample,
        valid=valid > 0.0,
        r_error=np.column_stack([r1 - true["r1_m"], r2 - true["r2_m"]]),
        r_sd=np.column_stack([r1_sd, r2_sd]),
        e_h=all_e_h,
        omega0_z=(omega0 - true["omega0_rad_s"]) / omega0_sd,
    )


def _e_h(shape: ShapeEstimate | None, true_h: FloatArray) -> float:
    score = shape and score_where_known(shape.theta, shape.h, shape.touched, true_h)
    return score.e_h if score else math.nan


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
