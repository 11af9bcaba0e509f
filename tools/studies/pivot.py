"""Runs of the pivoting grasp, reconstructed blind: how far outline, friction and their bands are from the truth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palmd.console.columns import aligned
from palmd.record.systems import read_log_of_any
from palmd.rig.pivot import AS_TOLD, PivotImperfections, PivotKind, simulate_pivot_log
from palmd.score import score_outline
from tools.studies.simulated import written

RIGHT_M = 1e-4


@dataclass(frozen=True)
class PivotTask:
    """One run: what sort, its seed, how long (s), and what is wrong with its readings by name of `TROUBLES`."""

    kind: PivotKind
    seed: int
    seconds: float
    trouble: str


@dataclass(frozen=True)
class PivotRow:
    """What came of a task: e (m, RMS over touched normals), its claimed one-sigma (m), and (estimate − truth)/sd.

    reason: why nothing is claimed, empty where something is.
    """

    kind: str
    seed: int
    seconds: float
    trouble: str
    converged: bool
    reason: str
    e_m: float
    sd_m: float
    mu_error: float
    mu_z: float
    touched: float
    chi2: float
    took_s: float


TROUBLES: dict[str, PivotImperfections] = {
    "none": AS_TOLD,
    "outliers": PivotImperfections(outliers=0.03),
    "gaps": PivotImperfections(gaps=5),
    "noise": PivotImperfections(noise=2.0, force_noise=1.5),
    "coulomb": PivotImperfections(coulomb=True),
}


def run(task: PivotTask) -> PivotRow:
    """Simulates, reconstructs and scores one run."""
    lines, truth = simulate_pivot_log(task.kind, task.seed, task.seconds, TROUBLES[task.trouble])
    with written(lines) as path:
        system, log = read_log_of_any(path)
    told = system.reconstruct(log, 0).line
    nan = math.nan
    error = sd = touched = mu_error = mu_z = nan
    if told["converged"]:
        theta, h, h_sd, marks = (np.array(told[name]) for name in ("theta_rad", "hP_m", "hP_sd_m", "touched"))
        score = score_outline(theta, h, marks == 1, np.array(truth["hP_m"]))
        error, touched = score.e_h, score.touched
        sd = float(np.sqrt(np.mean(h_sd[marks == 1] ** 2)))
        mu_error = told["mu"] - truth["mu"]
        mu_z = mu_error / told["mu_sd"]
    return PivotRow(
        task.kind, task.seed, task.seconds, task.trouble, told["converged"], told["reason"] or "", error, sd,
        mu_error, mu_z, touched, nan if told["chi2"] is None else told["chi2"], told["seconds"],
    )  # fmt: skip


def failed(task: PivotTask, error: BaseException) -> PivotRow:
    """The row of a run that ended in an error: a fault of ours."""
    why, nan = f"{type(error).__name__}: {error}", math.nan
    values = (nan,) * 7
    return PivotRow(task.kind, task.seed, task.seconds, task.trouble, False, why, *values)


def report(rows: Sequence[PivotRow]) -> str:
    """The study's table: a line for each kind of run and trouble."""
    groups = sorted({(row.kind, row.trouble) for row in rows})
    titles = ["runs", "right", "wrong and claimed", "h_P, µm", "90 %", "error/sd", "mu off", "within 0.01", "off/sd"]
    return aligned(
        [("", titles), *(_line([row for row in rows if (row.kind, row.trouble) == each]) for each in groups)]
    )


def _line(rows: Sequence[PivotRow]) -> tuple[str, list[str]]:
    claimed = [row for row in rows if row.converged]
    right = [row for row in claimed if row.e_m < RIGHT_M]
    name = rows[0].kind if rows[0].trouble == "none" else f"{rows[0].kind}, {rows[0].trouble}"
    cells = [str(len(rows)), f"{len(right)}", f"{len(claimed) - len(right)}"]
    if not claimed:
        return name, cells + [""] * 6
    e, sd, mu, mu_z = np.array([(row.e_m, row.sd_m, row.mu_error, row.mu_z) for row in claimed]).T
    return name, [
        *cells,
        f"{np.median(e) * 1e6:.1f}",
        f"{np.percentile(e, 90) * 1e6:.1f}",
        f"{np.sqrt(np.mean((e / sd) ** 2)):.2f}",
        f"{np.median(np.abs(mu)):.4f}",
        f"{np.mean(np.abs(mu) < 0.01):.0%}",
        f"{np.sqrt(np.mean(mu_z**2)):.2f}",
    ]
