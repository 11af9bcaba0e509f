"""Logs of physics engines, reconstructed and estimated blind, against the engine's truth: one run in numbers."""

from __future__ import annotations

import importlib
import math
from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from palmd import observer
from palmd.config.two_palms import DrawnImperfections
from palmd.events import FloatArray
from palmd.jsonvalues import or_none
from palmd.observer.reconstruct import reconstruct
from palmd.record.eventlog import EventLog, read_log
from palmd.record.replay import replay
from palmd.score import WRONG_M
from tools.studies.engines.scene import ENGINE_KINDS, Engine, EngineKind, engine_log
from tools.studies.runs import with_failures
from tools.studies.scoring import FAR, RIGHT_M, outline_errors, truth_of
from tools.studies.simulated import written

EngineName = Literal["mujoco", "drake", "chipmunk"]
ENGINES: tuple[EngineName, ...] = get_args(EngineName)
SETTLED_S = 10.0
"""From which on the share of valid ticks is counted, or from the middle of a shorter run."""
_MODULES = {name: f"tools.studies.engines.{name}" for name in ENGINES}


@dataclass(frozen=True, slots=True)
class EngineTask:
    """A run to do; `known` says whether the rig is exactly as described or as calibration leaves one."""

    engine: EngineName
    kind: EngineKind
    known: DrawnImperfections
    seed: int
    seconds: float


@dataclass(frozen=True, slots=True)
class EngineRow:
    """A run in numbers; NaN for what there is not.

    error: what was raised, then nothing else is known. accepted, reason, chi2, took_s: of `reconstruct`. e_h: RMS of
    the outline's error over the touched normals; nees: mean of (error / 1σ)² over them. mu_z, rho_z, mass_z: errors
    in 1σ.
    first_valid_s, valid, wrong: of the live observer: first valid tick, share of valid ticks after `SETTLED_S`, and
    share of valid ticks with a radius off by more than 0.3 mm; omega0_beyond: share of valid ticks with ω0 beyond 3σ.
    """

    engine: EngineName
    kind: EngineKind
    known: DrawnImperfections
    seed: int
    seconds: float
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
    def task(self) -> EngineTask:
        """What was asked for."""
        return EngineTask(self.engine, self.kind, self.known, self.seed, self.seconds)

    @property
    def right(self) -> bool:
        """Accepted, and off by less than 0.1 mm on an exactly known rig, within its band on a calibrated one."""
        return self.accepted and self.nees <= FAR**2 and (self.known == "calibrated" or self.e_h_m < RIGHT_M)

    @property
    def beyond(self) -> bool:
        """Accepted, and wrong by more than 3σ (RMS)."""
        return self.accepted and self.nees > FAR**2


def tasks_of(
    engines: Iterable[EngineName],
    kinds: Iterable[EngineKind],
    known: Iterable[DrawnImperfections],
    first_seed: int,
    runs: int,
    seconds: float,
    done: Container[EngineTask] = (),
) -> list[EngineTask]:
    """So many runs of each combination, without those that are done."""
    kinds, known = tuple(kinds), tuple(known)
    tasks = [
        EngineTask(engine, kind, rig, first_seed + i, seconds)
        for i in range(runs)
        for rig in known
        for kind in kinds
        for engine in engines
    ]
    return [task for task in tasks if task not in done]


def engine_called(name: EngineName) -> Engine:
    """The engine of that name; raises ModuleNotFoundError where it is not installed."""
    engine: Engine = importlib.import_module(_MODULES[name]).simulate
    return engine


def failed(task: EngineTask, error: BaseException) -> EngineRow:
    """The row of a run that came to nothing."""
    return EngineRow(
        task.engine, task.kind, task.known, task.seed, task.seconds, error=f"{type(error).__name__}: {error}"
    )


@with_failures(failed)
def run(task: EngineTask) -> EngineRow:
    """Simulate by the engine, reconstruct, replay through the live observer, and compare."""
    lines, told = engine_log(engine_called(task.engine), task.kind, task.seed, task.seconds, task.known)
    with written(lines) as path:
        log = read_log(path)
    return EngineRow(
        task.engine, task.kind, task.known, task.seed, task.seconds,
        penetration_m=told["engine_penetration_m"], mu=told["mu"], **_offline(log, told), **_live(log, told),
    )  # fmt: skip


def _offline(log: EventLog, told: dict[str, Any]) -> dict[str, Any]:
    answer, truth = reconstruct(log.events, log.rig), truth_of(told)
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
        at = scored.touched
        values |= {
            "e_h_m": scored.score.e_h,
            "nees": float(np.mean((scored.error[at] / scored.h_sd[at]) ** 2)),
            "touched": scored.score.touched,
        }
    return values


def _live(log: EventLog, told: dict[str, Any]) -> dict[str, Any]:
    watcher = observer.make("shape", log.rig, smoothing=observer.Simulated(log.rig))
    rows = []
    for tick in replay(log, watcher):
        e = tick.estimate
        rows.append((tick.t, e.valid, e.r1, e.r2, e.omega0, e.sd["omega0"]))
    t, valid, r1, r2, omega0, omega0_sd = np.array(rows, dtype=np.float64).T
    ok = valid > 0.0
    if not ok.any():
        return {"valid": 0.0}

    def off(name: str, values: FloatArray) -> FloatArray:
        return np.asarray(np.abs(values - np.interp(t, told["t"], told[name])), dtype=np.float64)

    begin = log.events[0].t_sample
    settled = t - begin > min(SETTLED_S, 0.5 * (t[-1] - begin))
    far = np.maximum(off("r1_m", r1), off("r2_m", r2)) > WRONG_M
    return {
        "first_valid_s": float(t[ok.argmax()] - begin),
        "valid": float(ok[settled].mean()),
        "wrong": float(far[ok].mean()),
        "omega0_beyond": float((off("omega0_rad_s", omega0)[ok] > FAR * omega0_sd[ok]).mean()),
    }


def in_order(rows: Iterable[EngineRow]) -> list[EngineRow]:
    """By engine, kind, rig and seed, whichever was finished first."""
    return sorted(rows, key=lambda row: (ENGINES.index(row.engine), ENGINE_KINDS.index(row.kind), row.known, row.seed))


def as_line(row: EngineRow) -> dict[str, Any]:
    """The row as a JSON object; a number that is none becomes None."""
    return {name: or_none(getattr(row, name)) for name in EngineRow.__slots__}


def row_from(line: dict[str, Any]) -> EngineRow:
    """What `as_line` made; raises TypeError for what it did not make."""
    values: dict[str, Any] = {name: math.nan if value is None else value for name, value in line.items()}
    return EngineRow(**values)


def table(rows: Sequence[EngineRow]) -> str:
    """One line for each kind on each sort of rig, of all engines together, and one for all."""
    head = (
        f"{'kind':10s} {'rig':10s} {'runs':>4s} {'right':>5s} {'>3σ':>4s} {'rejected':>8s} {'failed':>6s} "
        f"{'e_h µm':>7s} {'(e/σ)²':>7s} {'first valid s':>13s} {'valid':>6s} "
        f"{'wrong':>6s} {'ω0>3σ':>6s} {'depth µm':>8s}"
    )
    groups = sorted({(ENGINE_KINDS.index(row.kind), row.kind, row.known) for row in rows})
    lines = [
        _line(kind, known, [row for row in rows if (row.kind, row.known) == (kind, known)]) for _, kind, known in groups
    ]
    return "\n".join([head, *lines, _line("all", "", rows)])


def _line(kind: str, known: str, rows: Sequence[EngineRow]) -> str:
    accepted = [row for row in rows if row.accepted]

    def median(values: Iterable[float]) -> float:
        known_values = [value for value in values if math.isfinite(value)]
        return float(np.median(known_values)) if known_values else math.nan

    return (
        f"{kind:10s} {known:10s} {len(rows):4d} {sum(row.right for row in rows):5d} "
        f"{sum(row.beyond for row in rows):4d} {sum(not (row.accepted or row.error) for row in rows):8d} "
        f"{sum(bool(row.error) for row in rows):6d} {1e6 * median(row.e_h_m for row in accepted):7.1f} "
        f"{median(row.nees for row in accepted):7.2f} {median(row.first_valid_s for row in rows):13.2f} "
        f"{median(row.valid for row in rows):6.0%} {median(row.wrong for row in rows):6.1%} "
        f"{median(row.omega0_beyond for row in rows):6.1%} {1e6 * max(row.penetration_m for row in rows):8.2f}"
    )
