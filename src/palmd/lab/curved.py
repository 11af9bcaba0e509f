"""Curved palms: what `reconstruct` makes of their logs, and how much more of an outline they touch than flat ones do.

The second is a question of chapter 5 of CMU-CS-01-107. Every curvature has the same objects on it and the same motion:
sines about where a middling object is opened by 100°, each palm with the same amplitude.
"""

from __future__ import annotations

import io
import json
import math
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palmd.events import PalmMotion
from palmd.lab.montecarlo_summary import quantile
from palmd.lab.scoring import RIGHT_M
from palmd.lab.table import aligned
from palmd.observer.reconstruct import reconstruct
from palmd.record.eventlog import read_log
from palmd.rig.curved_plant import CurvedPlant, stable_on_arcs, widest
from palmd.rig.plant import PAD_LENGTH, FrictionSurface, Hinge
from palmd.rig.shapes import random_body
from palmd.rig.simulate import Rock, Rocking
from palmd.rig.simulate_curved import CurvedKind, simulate_curved_log
from palmd.score import score_outline
from palmd.system.arcs import MOST_LYING, joints_of

BINS = 72
STEP_S = 5e-4
MARGIN_M = 3e-3  # of the pads' ends, where a contact counts as lost
OPENING = math.radians(100.0)
FREQUENCIES = (0.31, 0.23)
SURFACE = FrictionSurface(damping=5e-4)
SETTLED_S = 1.0  # after which a lost contact counts: then the motion is all there


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


@dataclass(frozen=True, slots=True)
class CoverageTask:
    """One object on palms of one curvature (1/m), rocked by one amplitude (rad)."""

    curvature: float
    amplitude: float
    seed: int
    seconds: float


@dataclass(frozen=True, slots=True)
class CoverageRow:
    """The share of normals touched and how far the contacts' normals swung (rad), NaN where a contact was lost."""

    curvature: float
    amplitude: float
    seed: int
    error: str = ""
    touched: float = math.nan
    swing: float = math.nan
    lost: bool = False


def reconstructed(task: LogTask) -> LogRow:
    """Simulate, reconstruct and judge one log; what raises becomes a row that says so."""
    try:
        return _reconstructed(task)
    except Exception as error:
        return log_failed(task, error)


def log_failed(task: LogTask, error: BaseException) -> LogRow:
    """The row of a run that came to nothing."""
    return LogRow(task.kind, task.seed, f"{type(error).__name__}: {error}")


def _reconstructed(task: LogTask) -> LogRow:
    lines, truth = simulate_curved_log(task.kind, task.seed, task.seconds)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.jsonl"
        path.write_text("".join(json.dumps(line) + "\n" for line in lines), encoding="utf-8")
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


def rocked(task: CoverageTask) -> CoverageRow:
    """Rock one object; what raises becomes a row that says so."""
    try:
        return _rocked(task)
    except Exception as error:
        return coverage_failed(task, error)


def coverage_failed(task: CoverageTask, error: BaseException) -> CoverageRow:
    """The row of a run that came to nothing."""
    return CoverageRow(task.curvature, task.amplitude, task.seed, f"{type(error).__name__}: {error}")


def _rocked(task: CoverageTask) -> CoverageRow:
    body = random_body("nominal", np.random.default_rng([task.seed, BINS]))
    lost = CoverageRow(task.curvature, task.amplitude, task.seed, lost=True)
    curvatures = (task.curvature, task.curvature)
    if task.curvature * widest(body) >= MOST_LYING:
        return lost
    joints = joints_of(body.support.at(0.0)[0], ((math.pi - OPENING) / 2, OPENING), curvatures)
    one, two = (
        Rock(angle, task.amplitude, frequency, phase)
        for angle, frequency, phase in zip(joints, FREQUENCIES, (0.0, 1.0), strict=True)
    )
    motion = Rocking(one, two)
    plant = CurvedPlant(body, Hinge("fixed", base=(0.0, 0.0)), SURFACE, curvatures)
    plant.place(motion.at(0.0), stable_on_arcs(body, motion.at(0.0), curvatures)[0])
    marks = np.zeros(BINS, dtype=np.bool_)
    normals = []
    for k in range(round(task.seconds / STEP_S)):
        t = k * STEP_S
        middle: PalmMotion = motion.at(t + STEP_S / 2)
        plant.advance(middle, motion.at(t + STEP_S), STEP_S)
        contacts = plant.contacts()
        if not all(each.touching and MARGIN_M < each.s < PAD_LENGTH - MARGIN_M for each in contacts):
            return lost
        if k % 10 == 0:
            beta = plant.tangents()
            theta = np.array(beta) - plant.state.psi + [-math.pi / 2, math.pi / 2]
            marks[(theta / math.tau * BINS).astype(np.intp) % BINS] = True
            normals.append(beta)
    swing = float(np.ptp(np.array(normals), axis=0).mean()) / 2
    return CoverageRow(task.curvature, task.amplitude, task.seed, "", float(marks.mean()), swing)


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


def coverage_table(rows: Sequence[CoverageRow]) -> str:
    """Per amplitude and curvature: mean share touched, swing of the normals, and how many kept both contacts."""
    amplitudes = sorted({row.amplitude for row in rows})
    head = ("palms", [cell for each in amplitudes for cell in (f"touched {each:g}", "swing", "kept")])
    lines = [head]
    for curvature in sorted({row.curvature for row in rows}, reverse=True):
        cells = []
        for amplitude in amplitudes:
            some = [row for row in rows if row.curvature == curvature and row.amplitude == amplitude and not row.error]
            kept = [row for row in some if not row.lost]
            cells += [
                _mean(kept, lambda row: row.touched, ".2f"),
                _mean(kept, lambda row: math.degrees(row.swing), ".0f") + "°",
                f"{len(kept)} of {len(some)}",
            ]
        lines.append((radius_words(curvature), cells))
    return aligned(lines)


def _mean(rows: Sequence[CoverageRow], value: Callable[[CoverageRow], float], form: str) -> str:
    return format(float(np.mean([value(row) for row in rows])), form) if rows else "–"


def radius_words(curvature: float) -> str:
    """A palm of that curvature (1/m) in words."""
    if not curvature:
        return "flat"
    return f"{'cradle' if curvature > 0 else 'dome'} R {1e3 / abs(curvature):.0f} mm"


def figure(rows: Sequence[CoverageRow], path: Path) -> None:
    """Touched share against curvature, one line for each amplitude; needs matplotlib."""
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context({"svg.hashsalt": "palmd", "font.size": 9.0, "axes.grid": True, "grid.alpha": 0.3}):
        drawn = Figure(figsize=(7.0, 4.0), layout="constrained")
        axes = drawn.subplots()
        for amplitude in sorted({row.amplitude for row in rows}):
            some = [row for row in rows if row.amplitude == amplitude and not row.error]
            curvatures = sorted({row.curvature for row in some})
            of = {
                kappa: [row.touched for row in some if row.curvature == kappa and not row.lost] for kappa in curvatures
            }
            drawable = [kappa for kappa in curvatures if of[kappa]]
            means = [float(np.mean(of[kappa])) for kappa in drawable]
            axes.plot(drawable, means, "o-", label=f"palms ± {amplitude:g} rad")
            for kappa, mean in zip(drawable, means, strict=True):
                count = sum(row.curvature == kappa for row in some)
                axes.annotate(
                    f"{len(of[kappa])}/{count}", (kappa, mean), (0, 6), textcoords="offset points", ha="center"
                )
        axes.set(xlabel="curvature of both palms (1/m): < 0 dome, > 0 cradle", ylabel="share of the normals touched")
        axes.set(ylim=(0.0, None), title="The same motion; beside each point how many kept both contacts")
        axes.legend()
        stream = io.BytesIO()
        drawn.savefig(stream, format="svg", metadata={"Date": None})
    path.write_bytes(stream.getvalue())
