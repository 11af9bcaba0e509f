"""Random objects in random motion, reconstructed blind, scored against their truth and the Cramér–Rao bound.

Each run simulates a log of rocking palms from its kind and seed, and compares the result of `palmd reconstruct` with
the truth: errors of outline, motion and parameters, relative to their 1σ and to the posterior Cramér–Rao bound. The
same log is replayed through the daemon's observer, unless --no-causal: after what time do its estimates stay within
0.3 mm (radii) and 0.2 mm (outline)? Exit status 1 if an accepted outline is wrong by more than 0.3 mm.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from palmd.config.two_palms import DrawnImperfections
from palmd.events import FloatArray
from palmd.observer.reconstruct import reconstruct
from palmd.observer.reconstruction import Reconstruction
from palmd.rig.shapes import KINDS, Kind
from palmd.score import WRONG_M
from tools.studies import harness
from tools.studies.bound import Bound, Truth, cramer_rao
from tools.studies.cells import Cell, Value, among, count, errors, number, quantiles, runs, share, shares
from tools.studies.harness import Goal, Study
from tools.studies.scoring import RIGHT_M, Causal, OutlineErrors, causal_of, outline_errors, replayed, rms, truth_of
from tools.studies.simulated import simulated

CAUSAL_GOAL_S = 6.0
MEDIAN_P90_P95 = (0.5, 0.9, 0.95)


@dataclass(frozen=True, slots=True)
class MonteCarloTask:
    """One run: arguments of `simulated`, and whether to replay it through the live observer too."""

    kind: Kind
    seed: int
    seconds: float = 10.0
    live: bool = True
    imperfections: DrawnImperfections = "none"


@dataclass(frozen=True, slots=True)
class Scalar:
    """One parameter: its true value, the estimate's error and 1σ, and the lower bound of 1σ."""

    true: float = math.nan
    error: float = math.nan
    sd: float = math.nan
    bound: float = math.nan

    @property
    def relative_error(self) -> float:
        """|error| over the true value, NaN where that is 0."""
        return abs(self.error) / self.true if self.true else math.nan


@dataclass(frozen=True, slots=True)
class MonteCarloRow(MonteCarloTask):
    """The results of one run; NaN for missing values.

    error: the exception, without any other result. converged, reason, chi2, took_s: from `reconstruct`. e_h_m,
    max_error_m: over the touched normals after the best rotation; touched: their share. h_bound_m: RMS of the posterior
    Cramér–Rao bound over the same normals, efficiency: h_bound_m / e_h_m. nees_h: their mean of (error / 1σ)².
    psi_rms_rad: without the constant gauge.
    """

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
    took_s: float = math.nan
    causal: Causal | None = None

    @property
    def right(self) -> bool:
        """Whether the outline's error is below `RIGHT_M`, accepted or not."""
        return self.e_h_m < RIGHT_M

    @property
    def wrong(self) -> bool:
        """Whether the outline is accepted and its error exceeds `WRONG_M`."""
        return self.converged and self.e_h_m > WRONG_M


def run(task: MonteCarloTask) -> MonteCarloRow:
    """Simulate, reconstruct, replay and score."""
    log, truth_line = simulated(task.kind, task.seed, task.seconds, imperfections=task.imperfections)
    truth = truth_of(truth_line)
    # the estimators' seeds stay at their defaults, so that the commands give the same results for the same log
    answer = reconstruct(log.events, log.rig)
    outline = outline_errors(answer, truth)
    bound = cramer_rao(log.events, log.rig, truth, truth.theta if outline is None else outline.true_theta)
    causal = causal_of(replayed(log, truth_line)) if task.live else None
    return row_of(task, truth, answer, outline, bound, causal)


def row_of(
    task: MonteCarloTask,
    truth: Truth,
    answer: Reconstruction,
    outline: OutlineErrors | None,
    bound: Bound,
    causal: Causal | None,
) -> MonteCarloRow:
    """The row of a run; `bound.h_sd` is for the normals `outline.true_theta`."""
    row = harness.result(
        MonteCarloRow,
        task,
        converged=bool(answer.converged),
        reason=answer.reason,
        chi2=float(answer.chi2),
        mean_radius_m=float(np.mean(truth.h)),
        rho_m=_scalar(truth.rho, answer.rho, answer.rho_sd, bound.rho_sd),
        mu=_scalar(truth.mu, answer.mu, answer.mu_sd, bound.mu_sd),
        mass_kg=_scalar(truth.mass, answer.mass, answer.mass_sd, bound.mass_sd),
        took_s=float(answer.seconds),
        causal=causal,
    )
    if len(answer.t):
        turn = CubicHermiteSpline(truth.t, truth.psi, truth.omega0)  # linear interpolation errs by 0.3 mrad
        psi, omega0 = turn(answer.t), turn(answer.t, 1)
        row = replace(
            row, psi_rms_rad=rms(_without_gauge(answer.psi - psi)), omega0_rms_rad_s=rms(answer.omega0 - omega0)
        )
    if outline is None:
        return row
    h_bound = rms(bound.h_sd[outline.touched])
    return replace(
        row,
        e_h_m=outline.score.e_h,
        max_error_m=outline.score.max_error,
        touched=outline.score.touched,
        h_bound_m=h_bound,
        efficiency=h_bound / outline.score.e_h,
        nees_h=outline.nees,
    )


def _scalar(true: float, value: float, sd: float, bound: float) -> Scalar:
    return Scalar(float(true), float(value - true), float(sd), float(bound))


def _without_gauge(angle: FloatArray) -> FloatArray:
    """The angles minus their circular mean (rad), whatever their branch."""
    centred = np.angle(np.exp(1j * (angle - np.angle(np.mean(np.exp(1j * angle))))))
    return np.asarray(centred - np.mean(centred))


# ---------------------------------------------------------------------------------------------------- the study


def _parameter(name: str, of: Callable[[Any], Scalar]) -> list[tuple[str, Cell]]:
    def within(rows: Sequence[Any]) -> str:
        finite = [each for each in map(of, rows) if math.isfinite(each.error + each.sd)]
        return shares(lambda each: abs(each.error) <= 2.0 * each.sd)(finite)

    return [
        (f"{name}: |error|, median (%)", quantiles(lambda row: of(row).relative_error, 100.0)),
        (f"{name}: within 2 sd (%)", within),
        (f"{name}: sd / bound, median", quantiles(lambda row: of(row).sd / (of(row).bound or math.nan))),
    ]


def _causal(value: Value, unit: float = 1.0, *, worst: bool = False) -> Cell:
    """Quantiles over the replayed runs; worst: a run without the value counts as infinite."""
    qs = MEDIAN_P90_P95 if worst else (0.5,)
    return among(lambda row: row.causal is not None, quantiles(lambda row: value(row.causal), unit, qs, worst=worst))


def _within_goal(rows: Sequence[MonteCarloRow]) -> str:
    done = [row.causal for row in rows if row.causal is not None]
    return number(share(each.converged_after_s <= CAUSAL_GOAL_S for each in done), 100.0)


COLUMNS: list[tuple[str, Cell]] = [
    ("runs", runs),
    ("ended in an error", errors),
    ("right: e_h < 0.1 mm (%)", shares(lambda row: row.right)),
    ("converged (%)", shares(lambda row: row.converged)),
    ("accepted but wrong: e_h > 0.3 mm", count(lambda row: row.wrong)),
    ("e_h, median / p90 / p95 (µm)", quantiles(lambda row: row.e_h_m, 1e6, MEDIAN_P90_P95, worst=True)),
    ("largest error, median / p90 / p95 (µm)", quantiles(lambda row: row.max_error_m, 1e6, MEDIAN_P90_P95, worst=True)),
    ("touched normals, median (%)", quantiles(lambda row: row.touched, 100.0)),
    ("efficiency: bound / e_h, median", quantiles(lambda row: row.efficiency)),
    ("(error / sd)² of h, median", quantiles(lambda row: row.nees_h)),
    ("ψ RMS, median (mrad)", quantiles(lambda row: row.psi_rms_rad, 1e3)),
    ("ω0 RMS, median (mrad/s)", quantiles(lambda row: row.omega0_rms_rad_s, 1e3)),
    *_parameter("ρ", lambda row: row.rho_m),
    *_parameter("μ", lambda row: row.mu),
    *_parameter("mass", lambda row: row.mass_kg),
    ("reconstruct, median / p90 / p95 (s)", quantiles(lambda row: row.took_s, 1.0, MEDIAN_P90_P95)),
    ("live: converged after, median / p90 / p95 (s)", _causal(lambda each: each.converged_after_s, worst=True)),
    (f"live: within {CAUSAL_GOAL_S:g} s (%)", _within_goal),
    ("live: first valid after, median (s)", _causal(lambda each: each.first_valid_s)),
    ("live: r1, r2 RMS in the last 5 s, median (µm)", _causal(lambda each: each.r_rms_m, 1e6)),
    ("live: (error / sd)² of r1, r2, median", _causal(lambda each: each.nees_r)),
]


def _converged_after(row: MonteCarloRow) -> float:
    return row.causal.converged_after_s if row.causal else math.nan


STUDY = Study(
    "montecarlo",
    harness.of_kinds(KINDS, lambda kind, seed, of: MonteCarloTask(kind, seed, of.seconds, of.causal, of.imperfections)),
    run,
    MonteCarloRow,
    order=lambda row: (KINDS.index(row.kind), row.seed),
    by=lambda row: row.kind,
    columns=COLUMNS,
    across=True,
    remark=lambda row: f"accepted but wrong by {row.e_h_m * 1e6:.0f} µm" if row.wrong else "",
    goals=[Goal("no accepted outline is wrong by more than 0.3 mm", lambda rows: not any(row.wrong for row in rows))],
    panels=[
        ("error of the outline e_h (µm)", lambda row: row.e_h_m, 1e6, (1e6 * RIGHT_M, 1e6 * WRONG_M), True),
        ("efficiency: Cramér–Rao bound / e_h", lambda row: row.efficiency, 1.0, (1.0,), False),
        ("mean (error / sd)² of the outline; calibrated at 1", lambda row: row.nees_h, 1.0, (1.0,), True),
        ("live: converged after (s)", _converged_after, 1.0, (CAUSAL_GOAL_S,), False),
    ],
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The study's arguments."""
    harness.add_arguments(parser, runs=100, seconds_each=10.0, output="montecarlo", kinds=KINDS)
    harness.add_imperfections(parser)
    parser.add_argument("--causal", action=argparse.BooleanOptionalAction, default=True,
        help="also through the daemon's observer")  # fmt: skip
