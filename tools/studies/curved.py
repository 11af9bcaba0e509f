"""Logs of curved palms, reconstructed blind: right, refused or wrong, and how honest the error bars are."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from palmd.console.columns import aligned
from palmd.observer.reconstruct import reconstruct
from palmd.record.eventlog import read_log
from palmd.rig.simulate_curved import CurvedKind, simulate_curved_log
from palmd.score import score_outline
from tools.studies.montecarlo_summary import quantile
from tools.studies.runs import with_failures
from tools.studies.scoring import RIGHT_M
from tools.studies.simulated import written


@dataclass(frozen=True, slots=True)
class LogTask:
    """One log to reconstruct."""

    kind: CurvedKind
    seed: int
    seconds: float


@dataclass(frozen=True, slots=True)
class LogRow:
    """What came of it; NaN for what there is not. error: what was raised. z: RMS of error over sd where touched."""

    kind: CurvedKind
    seed: int
    error: str = ""
    converged: bool = False
    reason: str = ""
    e_h_m: float = math.nan
    z: float = math.nan
    touched: float = math.nan
    chi2: float = math.nan
    seconds: float = math.nan


def log_failed(task: LogTask, error: BaseException) -> LogRow:
    """The row of a run that came to nothing."""
    return LogRow(task.kind, task.seed, f"{type(error).__name__}: {error}")


@with_failures(log_failed)
def reconstructed(task: LogTask) -> LogRow:
    """Simulate, reconstruct and judge one log; what raises becomes a row that says so."""
    lines, truth = simulate_curved_log(task.kind, task.seed, task.seconds)
    with written(lines) as path:
        log = read_log(path)
    begun = time.process_time()
    answer = reconstruct(log.events, log.rig)
    seconds = time.process_time() - begun
    row = LogRow(task.kind, task.seed, "", answer.converged, answer.reason, chi2=answer.chi2, seconds=seconds)
    if answer.h is None or answer.h_sd is None or answer.touched is None:
        return row
    true_h = np.array(truth["h_m"])
    score = score_outline(answer.theta, answer.h, answer.touched, true_h)
    there = np.interp(answer.theta + score.rotation, np.array(truth["theta_rad"]), true_h, period=math.tau)
    z = ((answer.h - there) / answer.h_sd)[answer.touched]
    return LogRow(
        task.kind, task.seed, "", answer.converged, answer.reason, score.e_h, float(np.sqrt(np.mean(z**2))),
        score.touched, answer.chi2, seconds,
    )  # fmt: skip


def log_table(rows: Sequence[LogRow]) -> str:
    """Per kind: how many were right, refused, wrong though claimed, and how good and how honest those claimed are."""
    head = ("", ("runs", "right", "refused", "wrong", "e_h median", "e_h most", "error/sd", "touched", "CPU s"))
    lines = [head, *(_log_line(kind, [row for row in rows if row.kind == kind]) for kind in _kinds(rows))]
    if len(lines) > 2:
        lines.append(_log_line("all", rows))
    return aligned(lines)


def _kinds(rows: Iterable[LogRow]) -> list[CurvedKind]:
    return list(dict.fromkeys(row.kind for row in rows))


def _log_line(name: str, rows: Sequence[LogRow]) -> tuple[str, Sequence[str]]:
    claimed = [row for row in rows if row.converged]
    right = sum(row.e_h_m < RIGHT_M for row in claimed)
    um = [row.e_h_m * 1e6 for row in claimed]

    def told(values: Sequence[float], q: float, form: str) -> str:
        return format(quantile(values, q), form) if values else "–"

    return name, (
        str(len(rows)), str(right), str(len(rows) - len(claimed)), str(len(claimed) - right),
        told(um, 0.5, ".1f") + " µm", told(um, 1.0, ".0f") + " µm",
        told([row.z for row in claimed], 0.5, ".2f"), told([row.touched for row in claimed], 0.5, ".2f"),
        told([row.seconds for row in rows if not row.error], 0.5, ".1f"),
    )  # fmt: skip
