"""One run of the study in numbers: an estimator's answers against the truth. Pure."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicHermiteSpline

from palmd.events import FloatArray
from palmd.jsonvalues import or_none
from palmd.observer.bound import Bound, Truth
from palmd.observer.reconstruction import Reconstruction
from palmd.rig.shapes import Kind
from palmd.score import LAST_S, WRONG_M, OutlineScore, score_outline, support_at

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

RIGHT_M = 1e-4
FAR = 3.0  # one-sigmas, by RMS over the touched normals: more, and what is claimed is wrong on any rig
CAUSAL_OUTLINE_M, CAUSAL_R_M = 2e-4, 3e-4

Line = dict[str, Any]
Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Scalar:
    """One parameter: its true value, the estimate's error and one-sigma, and the least one-sigma possible."""

    true: float = math.nan
    error: float = math.nan
    sd: float = math.nan
    bound: float = math.nan

    @property
    def relative_error(self) -> float:
        """|error| over the true value, NaN where that is 0."""
        return abs(self.error) / self.true if self.true else math.nan


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


@dataclass(frozen=True, slots=True)
class MonteCarloRow:
    """A run in numbers; NaN for what there is not.

    error: what was raised, then nothing else is known. converged, reason, chi2, seconds: as `reconstruct` says.
    e_h, max_error: over the touched normals after the best rotation; touched: their share. h_bound: RMS of the
    posterior Cramér–Rao bound over the same normals, efficiency: h_bound / e_h. nees_h: mean over them of
    (error / sd)². psi_rms: without the constant that is gauge.
    """

    kind: Kind
    seed: int
    error: str = ""
    converged: bool = False
    reason: str = ""
    chi2: float = math.nan
    e_h_m: float = math.nan
    max_error_m: float = math.nan
    mean_radius_m: float = math.nan
    touched: float = math.nan
    h_bound_m: float = math.nan
    efficiency: float = math.nan
    nees_h: float = math.nan
    rho_m: Scalar = Scalar()
    mu: Scalar = Scalar()
    mass_kg: Scalar = Scalar()
    psi_rms_rad: float = math.nan
    omega0_rms_rad_s: float = math.nan
    seconds: float = math.nan
    causal: Causal | None = None

    @property
    def right(self) -> bool:
        """Whether the outline is right to `RIGHT_M`, whatever is claimed."""
        return self.e_h_m < RIGHT_M

    @property
    def wrong(self) -> bool:
        """Whether it claims to have converged, and the outline is off by more than `WRONG_M`."""
        return self.converged and self.e_h_m > WRONG_M


def as_line(row: DataclassInstance) -> Line:
    """The row as a JSON object; a number that is none becomes None."""
    line: Line = or_none(asdict(row))
    return line


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


def row_of(
    kind: Kind,
    seed: int,
    truth: Truth,
    answer: Reconstruction,
    outline: OutlineErrors | None,
    bound: Bound,
    causal: Causal | None,
) -> MonteCarloRow:
    """The row of a run; `bound.h_sd` is for the normals `outline.true_theta`."""
    row = MonteCarloRow(
        kind=kind,
        seed=seed,
        converged=bool(answer.converged),
        reason=answer.reason,
        chi2=float(answer.chi2),
        mean_radius_m=float(np.mean(truth.h)),
        rho_m=_scalar(truth.rho, answer.rho, answer.rho_sd, bound.rho_sd),
        mu=_scalar(truth.mu, answer.mu, answer.mu_sd, bound.mu_sd),
        mass_kg=_scalar(truth.mass, answer.mass, answer.mass_sd, bound.mass_sd),
        seconds=float(answer.seconds),
        causal=causal,
    )
    if len(answer.t):
        turn = CubicHermiteSpline(truth.t, truth.psi, truth.omega0)  # a straight line would be off by 0.3 mrad
        psi, omega0 = turn(answer.t), turn(answer.t, 1)
        row = replace(
            row, psi_rms_rad=_rms(_without_gauge(answer.psi - psi)), omega0_rms_rad_s=_rms(answer.omega0 - omega0)
        )
    if outline is None:
        return row
    touched = outline.touched
    h_bound = _rms(bound.h_sd[touched])
    return replace(
        row,
        e_h_m=outline.score.e_h,
        max_error_m=outline.score.max_error,
        touched=outline.score.touched,
        h_bound_m=h_bound,
        efficiency=h_bound / outline.score.e_h,
        nees_h=float(np.mean((outline.error[touched] / outline.h_sd[touched]) ** 2)),
    )


def _scalar(true: float, value: float, sd: float, bound: float) -> Scalar:
    return Scalar(float(true), float(value - true), float(sd), float(bound))


def _without_gauge(angle: FloatArray) -> FloatArray:
    """The angles about their own mean, on whichever branch they were given (rad)."""
    centred = np.angle(np.exp(1j * (angle - np.angle(np.mean(np.exp(1j * angle))))))
    return np.asarray(centred - np.mean(centred))


def _rms(values: FloatArray) -> float:
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
        r_rms_m=_rms(error) if late.any() else math.nan,
        nees_r=float(np.mean((error / sd) ** 2)) if late.any() else math.nan,
    )


def _lasting_from(t: FloatArray, good: Bools) -> float:
    """The first time from which on all is good to the end, NaN when the end is not."""
    if not good[-1]:
        return math.nan
    bad = np.flatnonzero(~good)
    return float(t[bad[-1] + 1 if len(bad) else 0])
