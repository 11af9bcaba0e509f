"""Curved palms: logs of cradles and domes reconstructed blind. `explore --config` explores on curved palms."""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palmd.observer.reconstruct import reconstruct
from palmd.record.eventlog import read_log
from palmd.score import score_outline
from tools.studies import harness
from tools.studies.cells import Cell, among, count, most, quantiles, runs
from tools.studies.harness import Study, result
from tools.studies.scoring import RIGHT_M, rms
from tools.studies.simulate_curved import CURVED_KINDS, CurvedKind, simulate_curved_log
from tools.studies.simulated import written


@dataclass(frozen=True, slots=True)
class LogTask:
    """One log to reconstruct."""

    kind: CurvedKind
    seed: int
    seconds: float


@dataclass(frozen=True, slots=True)
class LogRow(LogTask):
    """The result of one log; NaN for missing values. z: RMS of error over 1σ where touched; took_s: processor time."""

    error: str = ""
    accepted: bool = False
    reason: str = ""
    chi2: float = math.nan
    took_s: float = math.nan
    e_h_m: float = math.nan
    z: float = math.nan
    touched: float = math.nan

    @property
    def right(self) -> bool:
        """Whether the estimate is accepted and its RMS error is below `RIGHT_M`."""
        return self.accepted and self.e_h_m < RIGHT_M


def run(task: LogTask) -> LogRow:
    """Simulate, reconstruct and score one log."""
    lines, truth = simulate_curved_log(task.kind, task.seed, task.seconds)
    with written(lines) as path:
        log = read_log(path)
    start = time.process_time()
    answer = reconstruct(log.events, log.rig)
    how = {"accepted": answer.converged, "reason": answer.reason, "chi2": answer.chi2}
    took_s = time.process_time() - start
    if answer.h is None or answer.h_sd is None or answer.touched is None:
        return result(LogRow, task, **how, took_s=took_s)
    true_h = np.array(truth["h_m"])
    score = score_outline(answer.theta, answer.h, answer.touched, true_h)
    true_h_there = np.interp(answer.theta + score.rotation, np.array(truth["theta_rad"]), true_h, period=math.tau)
    z = rms(((answer.h - true_h_there) / answer.h_sd)[answer.touched])
    return result(LogRow, task, **how, took_s=took_s, e_h_m=score.e_h, z=z, touched=score.touched)


# -------------------------------------------------------------------------------------------------- the studies


def draw(arguments: argparse.Namespace) -> Sequence[LogTask]:
    """The requested number of logs of each kind."""
    return [LogTask(kind, seed, arguments.seconds) for seed in harness.seeds_of(arguments) for kind in CURVED_KINDS]


def remarks(rows: Sequence[LogRow]) -> list[str]:
    """A line for each rejected log."""
    return [f"{row.kind} {row.seed}: {row.error or row.reason}" for row in rows if not row.accepted]


def _accepted(cell: Cell) -> Cell:
    return among(lambda row: row.accepted, cell)


STUDY = Study(
    "curved",
    draw,
    run,
    LogRow,
    order=lambda row: (CURVED_KINDS.index(row.kind), row.seed),
    by=lambda row: row.kind,
    whole="all",
    columns=[
        ("runs", runs),
        ("right", count(lambda row: row.right)),
        ("rejected", count(lambda row: not row.accepted)),
        ("wrong", count(lambda row: row.accepted and not row.right)),
        ("e_h median (µm)", _accepted(quantiles(lambda row: row.e_h_m, 1e6))),
        ("e_h most (µm)", _accepted(most(lambda row: row.e_h_m, 1e6))),
        ("error/sd", _accepted(quantiles(lambda row: row.z))),
        ("touched", _accepted(quantiles(lambda row: row.touched))),
        ("CPU s", quantiles(lambda row: row.took_s)),
    ],
    remarks=remarks,
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The study's arguments."""
    harness.add_arguments(parser, runs=34, seconds_each=10.0, output=None, what="logs of each kind")
