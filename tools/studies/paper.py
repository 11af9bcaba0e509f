"""The runs behind the figures of CMU-CS-01-107, chapter 3, by the paper's method and by palmd's.

The paper's simulation (section 3.4) has an object that is always in balance, with exact readings. Its experiment
(section 3.5) has an object with friction and noisy, irregular readings, here from the emulated plant or from any log
with its truth. Columns: RMS errors of the touched outline (absolute, relative to the mean radius), of r1 and r2, and of
ψ; touched share. The paper's own figures are in the same table.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palmd.cli.logs import read
from palmd.console.columns import aligned
from palmd.console.errors import BAD_INPUT, CliError
from palmd.events import FloatArray
from palmd.observer.quasistatic import QuasistaticObserver
from palmd.observer.reconstruct import reconstruct
from palmd.record.eventlog import EventLog
from palmd.record.replay import replay
from palmd.rig.shapes import Kind
from tools.studies import harness
from tools.studies.cells import NOTHING
from tools.studies.harness import Line, Study, result
from tools.studies.paper_runs import paper_simulation, psi_error, relative_radius_error
from tools.studies.scoring import Bools, rms, score_where_known
from tools.studies.simulated import simulated

PUBLISHED_RADIUS, PUBLISHED_PSI_RAD = 0.06, 0.078
"""Errors taken from figures 3.10 and 3.11, as the paper prints none: of r1, r2 over their RMS, and of ψ."""
HARDWARE_RMS_M, HARDWARE_RADIUS_M, HARDWARE_TOUCHED, HARDWARE_PSI_RAD = 1.9e-3, 41e-3, 0.54, 0.27
"""From figure 3.15: distance of points from the true outline, its radius, touched share, ψ against the camera's."""
SIMULATED: tuple[tuple[Kind, int], ...] = (("friction", 401), ("friction", 405), ("rig", 401), ("rig", 404))
TRUTH = ("t", "psi_rad", "r1_m", "r2_m", "theta_rad", "h_m")
HEAD = ("method", "outline e_h", "of the radius", "r1, r2", "ψ", "touched")


@dataclass(frozen=True, slots=True)
class Errors:
    """RMS errors of a method: touched outline (m; over mean radius), radii (m), ψ without gauge (rad)."""

    e_h_m: float = math.nan
    of_radius: float = math.nan
    r_m: float = math.nan
    psi_rad: float = math.nan
    touched: float = math.nan


@dataclass(frozen=True, slots=True)
class PaperTask:
    """A log file with its truth beside it, or a simulated run by kind, seed and duration (s)."""

    log: str
    kind: Kind
    seed: int
    seconds: float


@dataclass(frozen=True, slots=True)
class PaperRow(PaperTask):
    """Errors of the paper's quasistatic observer and of `reconstruct`; psi_still: of assuming constant ψ (rad)."""

    error: str = ""
    psi_still: float = math.nan
    quasistatic: Errors = Errors()
    smoother: Errors = Errors()

    @property
    def name(self) -> str:
        """The name in the table."""
        return Path(self.log).stem if self.log else f"{self.kind} {self.seed}"


def run(task: PaperTask) -> PaperRow:
    """Score both methods on one run."""
    if task.log:
        path = Path(task.log)
        log, truth = read(path), truth_beside(path)
    else:
        log, truth = simulated(task.kind, task.seed, task.seconds)
    still = float(np.std(truth["psi_rad"]))
    return result(PaperRow, task, psi_still=still, quasistatic=_quasistatic(log, truth), smoother=_smoother(log, truth))


def _quasistatic(log: EventLog, truth: Line) -> Errors:
    observer = QuasistaticObserver(log.rig)
    ticks = [tick.estimate for tick in replay(log, observer)]
    outline = observer.shape(ticks[-1].t)
    valid = [e for e in ticks if e.valid]
    if outline is None or not valid:
        return Errors()
    t, r1, r2, psi = np.array([(e.t, e.r1, e.r2, e.psi) for e in valid]).T
    return _errors(t, r1, r2, psi, outline.theta, outline.h, outline.touched, truth)


def _smoother(log: EventLog, truth: Line) -> Errors:
    answer = reconstruct(log.events, log.rig)
    if not answer.converged or answer.h is None or answer.touched is None:
        return Errors()
    r1, r2 = answer.radii
    return _errors(answer.t, r1, r2, answer.psi, answer.theta, answer.h, answer.touched, truth)


def _errors(
    t: FloatArray, r1: FloatArray, r2: FloatArray, psi: FloatArray,
    theta: FloatArray, h: FloatArray, touched: Bools, truth: Line,
) -> Errors:  # fmt: skip
    true_h = np.array(truth["h_m"])
    score = score_where_known(theta, h, touched, true_h)
    if score is None:
        return Errors()
    true1, true2, true_psi = (np.interp(t, truth["t"], truth[name]) for name in ("r1_m", "r2_m", "psi_rad"))
    r_error = rms(np.stack([r1 - true1, r2 - true2]))
    return Errors(score.e_h, score.e_h / float(np.mean(true_h)), r_error, float(np.std(psi - true_psi)), score.touched)


def truth_beside(log: Path) -> Line:
    """The truth beside a log; raises CliError if it is missing or invalid."""
    path = log.with_suffix(".truth.json")
    try:
        truth: Line = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise CliError(BAD_INPUT, f"{path}: {error.strerror or error}; the study needs each log's truth") from None
    except ValueError as error:
        raise CliError(BAD_INPUT, f"{path}: not JSON: {error}") from None
    missing = [name for name in TRUTH if not (isinstance(truth, dict) and isinstance(truth.get(name), list))]
    if missing:
        raise CliError(BAD_INPUT, f"{path}: not a truth file: {', '.join(missing)} missing")
    return truth


# ---------------------------------------------------------------------------------------------------- the study


def draw(arguments: argparse.Namespace) -> Sequence[PaperTask]:
    """The given logs, or four simulated runs; raises CliError for a log that cannot be used."""
    for path in arguments.logs:
        read(path)
        truth_beside(path)
    given = [PaperTask(str(path), "rig", 0, arguments.seconds) for path in arguments.logs]
    return given or [PaperTask("", kind, seed, arguments.seconds) for kind, seed in SIMULATED]


def report(rows: Sequence[PaperRow]) -> str:
    """The paper's errors, beside those of the same runs here."""
    simulation = paper_simulation()
    run = simulation.run
    lines: list[tuple[str, Sequence[str]]] = [
        ("", HEAD),
        ("the paper's simulation", _cells("the paper's", r=f"{PUBLISHED_RADIUS:.0%}", psi=PUBLISHED_PSI_RAD)),
        ("the same here, exact", _cells("only e_f, e_c", r="any mean radius fits")),
    ]
    for start, trace in (
        ("mean radius wrong by 6 %", simulation.wrong_radius),
        ("with the conflict", simulation.found),
    ):
        error = f"{relative_radius_error(run, trace):.2%}"
        lines.append(("the same here, exact", _cells(start, r=error, psi=psi_error(run, trace))))
    hardware = Errors(HARDWARE_RMS_M, HARDWARE_RMS_M / HARDWARE_RADIUS_M, math.nan, HARDWARE_PSI_RAD, HARDWARE_TOUCHED)
    lines.append(("the paper's experiment", _of(hardware, "the paper's")))
    for row in rows:
        lines.append((row.name, _cells("it does not turn", psi=row.psi_still)))
        lines += [(row.name, _of(each, name)) for name, each in methods(row)]
    return aligned(lines)


def methods(row: PaperRow) -> Sequence[tuple[str, Errors]]:
    """Both methods by name."""
    return ("quasistatic", row.quasistatic), ("reconstruct", row.smoother)


def _of(errors: Errors, method: str) -> Sequence[str]:
    if math.isnan(errors.e_h_m):
        return (method, "no estimate", *[NOTHING] * 4)
    r = NOTHING if math.isnan(errors.r_m) else f"{errors.r_m * 1e3:.3f} mm"
    outline = f"{errors.e_h_m * 1e3:.3f} mm", f"{errors.of_radius:.2%}"
    return (method, *outline, r, f"{errors.psi_rad:.4f} rad", f"{errors.touched:.0%}")


def _cells(method: str, *, r: str = NOTHING, psi: float = math.nan) -> Sequence[str]:
    return (method, NOTHING, NOTHING, r, NOTHING if math.isnan(psi) else f"{psi:.4f} rad", NOTHING)


STUDY = Study(
    "both methods",
    draw,
    run,
    PaperRow,
    order=lambda row: row.name,
    report=report,
    title=lambda row: row.name,
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The study's arguments."""
    add = parser.add_argument
    add("logs", nargs="*", type=Path, default=[], metavar="LOG",
        help="event logs with their truth in *.truth.json beside them (default: four simulated runs)")  # fmt: skip
    add("--seconds", type=float, default=10.0, metavar="S", help="duration of simulated runs (default: %(default)g)")
    add("-o", "--output", type=Path, metavar="FILE", help="file of JSON lines, one for each run")
    harness.add_workers(parser)
