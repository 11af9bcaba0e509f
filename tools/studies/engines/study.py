"""Comparison with physics engines: bodies on vibrating palms in MuJoCo, Drake and Chipmunk, estimated blind.

Each run draws a body, a motion, friction and a vibration, simulates it in an engine with the engine's friction model,
writes an event log, and compares `reconstruct` and the live observer with the engine's truth. A file with runs is
resumed: the same command does the missing runs and reports all.
"""

from __future__ import annotations

import argparse
import importlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from palmd.config.two_palms import DrawnImperfections
from palmd.console.extras import require
from palmd.observer.reconstruct import reconstruct
from palmd.record.eventlog import EventLog
from palmd.rig.simulate import CALIBRATION
from tools.studies import harness
from tools.studies.cells import accepted, count, errors, most, quantiles, runs
from tools.studies.engines.scene import ENGINE_KINDS, Engine, EngineKind, engine_log
from tools.studies.harness import ALL, Study, result
from tools.studies.scoring import FAR, RIGHT_M, outline_errors, replayed, truth_of
from tools.studies.simulated import log_of

EngineName = Literal["mujoco", "drake", "chipmunk"]
ENGINES: tuple[EngineName, ...] = get_args(EngineName)
PACKAGES: dict[EngineName, str] = {"mujoco": "mujoco", "drake": "pydrake", "chipmunk": "pymunk"}
SETTLED_S = 10.0
"""The share of valid ticks is counted from this time (s) on, or from the middle of a shorter run."""


@dataclass(frozen=True, slots=True)
class EngineTask:
    """One run; `known`: whether the rig is exactly known or has residual calibration errors."""

    engine: EngineName
    kind: EngineKind
    known: DrawnImperfections
    seed: int
    seconds: float


@dataclass(frozen=True, slots=True)
class EngineRow(EngineTask):
    """The results of one run; NaN for missing values.

    error: the exception, without any other result. accepted, reason, chi2, took_s: from `reconstruct`. e_h: RMS of the
    outline's error over the touched normals; nees: mean of (error / 1σ)² over them. mu_z, rho_z, mass_z: errors in 1σ.
    first_valid_s, valid, wrong: of the live observer: first valid tick, share of valid ticks after `SETTLED_S`, and
    share of valid ticks with an error of a radius above 0.3 mm; omega0_beyond: share of valid ticks with ω0 beyond 3σ.
    """

    error: str = ""
    accepted: bool = False
    reason: str = ""
    chi2: float = math.nan
    took_s: float = math.nan
    mu: float = math.nan
    e_h_m: float = math.nan
    nees: float = math.nan
    touched: float = math.nan
    mu_z: float = math.nan
    rho_z: float = math.nan
    mass_z: float = math.nan
    first_valid_s: float = math.nan
    valid: float = math.nan
    wrong: float = math.nan
    omega0_beyond: float = math.nan
    penetration_m: float = math.nan

    @property
    def right(self) -> bool:
        """Whether it is accepted, with an error below 0.1 mm on an exactly known rig, within its band on a calibrated
        one.
        """
        return self.accepted and self.nees <= FAR**2 and (self.known == "calibrated" or self.e_h_m < RIGHT_M)

    @property
    def beyond(self) -> bool:
        """Whether it is accepted and wrong by more than 3σ (RMS)."""
        return self.accepted and self.nees > FAR**2


def engine_called(name: EngineName) -> Engine:
    """The engine of that name; raises ModuleNotFoundError if it is not installed."""
    engine: Engine = importlib.import_module(f"tools.studies.engines.{name}").simulate
    return engine


def run(task: EngineTask) -> EngineRow:
    """Simulate by the engine, reconstruct, replay through the live observer, and compare."""
    lines, truth_fields = engine_log(engine_called(task.engine), task.kind, task.seed, task.seconds, task.known)
    log = log_of(lines)
    measured = {"penetration_m": truth_fields["engine_penetration_m"], "mu": truth_fields["mu"]}
    return result(EngineRow, task, **measured, **_offline(log, truth_fields), **_live(log, truth_fields))


def _offline(log: EventLog, truth_fields: dict[str, Any]) -> dict[str, Any]:
    answer, truth = reconstruct(log.events, log.rig), truth_of(truth_fields)
    scored = outline_errors(answer, truth)
    values: dict[str, Any] = {
        "accepted": bool(answer.converged),
        "reason": answer.reason,
        "chi2": float(answer.chi2),
        "took_s": float(answer.seconds),
        "mu_z": (answer.mu - truth.mu) / answer.mu_sd,
        "rho_z": (answer.rho - truth.rho) / answer.rho_sd,
        "mass_z": (answer.mass - truth.mass) / answer.mass_sd,
    }
    if scored is not None:
        values |= {"e_h_m": scored.score.e_h, "nees": scored.nees, "touched": scored.score.touched}
    return values


def _live(log: EventLog, truth_fields: dict[str, Any]) -> dict[str, Any]:
    live = replayed(log, truth_fields)
    ok = live.valid
    if not ok.any():
        return {"valid": 0.0}
    settled = live.t > min(SETTLED_S, 0.5 * live.t[-1])
    return {
        "first_valid_s": float(live.t[ok.argmax()]),
        "valid": float(ok[settled].mean()),
        "wrong": float(live.wrong[ok].mean()),
        "omega0_beyond": float((np.abs(live.omega0_z[ok]) > FAR).mean()),
    }


def draw(arguments: argparse.Namespace) -> Sequence[EngineTask]:
    """The requested number of runs of each combination; raises CliError if an engine is not installed."""
    engines = ENGINES if arguments.engine == ALL else (arguments.engine,)
    for engine in engines:
        require(f"--engine {engine}", PACKAGES[engine], "engines")
    return [
        EngineTask(engine, kind, rig, seed, arguments.seconds)
        for seed in harness.seeds_of(arguments)
        for rig in (tuple(CALIBRATION) if arguments.imperfections == ALL else (arguments.imperfections,))
        for kind in harness.kinds_of(arguments, ENGINE_KINDS)
        for engine in engines
    ]


STUDY = Study(
    "engines",
    draw,
    run,
    EngineRow,
    order=lambda row: (ENGINES.index(row.engine), ENGINE_KINDS.index(row.kind), row.known, row.seed),
    by=lambda row: f"{row.kind}, {row.known}",
    title=lambda row: f"{row.engine} {row.kind} {row.seed}",
    columns=[
        ("runs", runs),
        ("right", count(lambda row: row.right)),
        ("beyond 3σ", count(lambda row: row.beyond)),
        ("rejected", count(lambda row: not (row.accepted or row.error))),
        ("errors", errors),
        ("e_h (µm)", accepted(quantiles(lambda row: row.e_h_m, 1e6))),
        ("(e_h/σ)²", accepted(quantiles(lambda row: row.nees))),
        ("first valid (s)", quantiles(lambda row: row.first_valid_s)),
        ("valid (%)", quantiles(lambda row: row.valid, 100.0)),
        ("wrong (%)", quantiles(lambda row: row.wrong, 100.0)),
        ("ω0 beyond 3σ (%)", quantiles(lambda row: row.omega0_beyond, 100.0)),
        ("penetration (µm)", most(lambda row: row.penetration_m, 1e6)),
    ],
    whole="all",
    resumes=True,
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The study's arguments."""
    harness.add_arguments(
        parser, runs=2, seconds_each=10.0, output="engines.jsonl", kinds=ENGINE_KINDS, what="of each combination"
    )
    harness.add_imperfections(parser, ALL, default=ALL)
    parser.add_argument("--engine", choices=(*ENGINES, ALL), default=ALL, help="physics engine (default: %(default)s)")
