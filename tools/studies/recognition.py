"""Recognition among similar outlines: one run, by its kind and seed, and what many runs come to.

In every run `COUNT` siblings (`siblings`) are stored, with the errors of a good measurement. One of them lies on
the palms, or in every fifth run another sibling, which is none of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from palmd import observer
from palmd.console.columns import aligned
from palmd.events import Estimate, FloatArray, ObjectEstimate
from palmd.record.recognition import NONE_OF_THESE, verdict
from palmd.record.replay import replay
from palmd.rig.shapes import KINDS, Kind
from palmd.score import score_outline
from tools.studies.montecarlo_summary import quantile
from tools.studies.runs import with_failures
from tools.studies.siblings import as_stored, siblings
from tools.studies.simulated import simulated

COUNT = 20
NONE_EVERY = 5
_STREAM = 7  # keeps the libraries' random numbers apart from those of the motion
_NORMALS = 360


@dataclass(frozen=True, slots=True)
class RecognitionTask:
    """One run to do: its kind and seed, and how long it lasts (s)."""

    kind: Kind
    seed: int
    seconds: float


@dataclass(frozen=True, slots=True)
class RecognitionRow:
    """A run in numbers; NaN for what there is not.

    error: what was raised, then nothing else is known. true: the object's name, or `NONE_OF_THESE`. said: the verdict,
    empty while undecided. probability: what the truth was given at the end; brier: Σ (p − truth)² over all hypotheses.
    decided: since when the verdict stood (s). psi_rms: of the absolute orientation over the valid ticks (rad).
    """

    kind: Kind
    seed: int
    error: str = ""
    true: str = ""
    said: str = ""
    probability: float = math.nan
    brier: float = math.nan
    decided: float = math.nan
    psi_rms: float = math.nan


def tasks_of(kinds: Iterable[Kind], first_seed: int, count: int, seconds: float) -> list[RecognitionTask]:
    """So many runs of each kind, all kinds with the same seeds."""
    return [RecognitionTask(kind, first_seed + i, seconds) for i in range(count) for kind in kinds]


def failed(task: RecognitionTask, error: BaseException) -> RecognitionRow:
    """The row of a run that came to nothing."""
    return RecognitionRow(task.kind, task.seed, error=f"{type(error).__name__}: {error}")


@with_failures(failed)
def run(task: RecognitionTask) -> RecognitionRow:
    """Simulate, recognise and score; what raises becomes a row that says so."""
    random = np.random.default_rng([_STREAM, KINDS.index(task.kind), task.seed])
    bodies = siblings(task.kind, COUNT + 1, random)
    outlines = [as_stored(body, f"sibling {i + 1}", random) for i, body in enumerate(bodies[:COUNT])]
    none = task.seed % NONE_EVERY == NONE_EVERY - 1
    chosen = COUNT if none else int(random.integers(COUNT))
    log, told = simulated(task.kind, task.seed, task.seconds, bodies[chosen])
    recogniser = observer.make("shape", log.rig, outlines=outlines)
    estimates: list[ObjectEstimate] = []
    valid: list[Estimate] = []
    for tick in replay(log, recogniser):
        estimate = recogniser.identify(tick.t)
        if estimate is not None:
            estimates.append(estimate)
        if tick.estimate.valid:
            valid.append(tick.estimate)
    found = verdict(estimates)
    if found is None:
        raise ValueError("nothing was felt")
    true = NONE_OF_THESE if none else outlines[chosen].name
    given = np.append(found.probability, found.none)
    theta: FloatArray = np.arange(_NORMALS, dtype=np.float64) * (math.tau / _NORMALS)
    own = bodies[chosen].support.sample(theta)
    # the truth's frame is turned so that ψ begins at 0
    turn = score_outline(theta, own, None, np.array(told["h_m"])).rotation
    return RecognitionRow(
        kind=task.kind,
        seed=task.seed,
        true=true,
        said=found.said,
        probability=float(given[chosen]),
        brier=float(np.sum((given - np.eye(COUNT + 1)[chosen]) ** 2)),
        decided=found.decided,
        psi_rms=math.nan if none else _psi_rms(valid, np.array(told["t"]), np.array(told["psi_rad"]) + turn),
    )


def _psi_rms(valid: Sequence[Estimate], t: FloatArray, psi: FloatArray) -> float:
    if not valid:
        return math.nan
    off = np.array([estimate.psi for estimate in valid]) - np.interp([estimate.t for estimate in valid], t, psi)
    return float(np.sqrt(np.mean((np.remainder(off + math.pi, math.tau) - math.pi) ** 2)))


# ------------------------------------------------------------------------------------------------- shown


def table(rows: Sequence[RecognitionRow]) -> str:
    """A line for each number, a column for each kind of which there are runs."""
    columns = [[row for row in rows if row.kind == kind] for kind in KINDS]
    columns = [column for column in columns if column]
    lines: list[tuple[str, list[str]]] = [("", [column[0].kind for column in columns])]
    lines += [(name, [show([row for row in column if not row.error]) for column in columns]) for name, show in _LINES]
    lines.append(("ended in an error", [str(sum(bool(row.error) for row in column)) for column in columns]))
    return aligned(lines)


def remarks(rows: Sequence[RecognitionRow]) -> list[str]:
    """The runs to look at: a line for each that is wrong, undecided, or came to nothing."""
    return [f"{row.kind} {row.seed}: {row.error or _remark(row)}" for row in rows if row.error or row.said != row.true]


def _remark(row: RecognitionRow) -> str:
    return f"{row.true}, said: {row.said or 'undecided'} (p = {row.probability:.2g})"


def _stored(rows: Sequence[RecognitionRow]) -> list[RecognitionRow]:
    return [row for row in rows if row.true != NONE_OF_THESE]


def _strange(rows: Sequence[RecognitionRow]) -> list[RecognitionRow]:
    return [row for row in rows if row.true == NONE_OF_THESE]


def _of(count: int, rows: Sequence[RecognitionRow]) -> str:
    return f"{count} of {len(rows)}"


def _quantiles(values: Iterable[float], digits: int) -> str:
    known = [value for value in values if math.isfinite(value)]
    return " / ".join(f"{quantile(known, q):.{digits}f}" for q in (0.5, 0.95)) if known else "–"


_LINES: list[tuple[str, Callable[[Sequence[RecognitionRow]], str]]] = [
    ("stored: right", lambda rows: _of(sum(row.said == row.true for row in _stored(rows)), _stored(rows))),
    (
        "stored: another one said",
        lambda rows: _of(sum(row.said not in ("", NONE_OF_THESE, row.true) for row in _stored(rows)), _stored(rows)),
    ),
    ("stored: none said", lambda rows: _of(sum(row.said == NONE_OF_THESE for row in _stored(rows)), _stored(rows))),
    ("stored: undecided", lambda rows: _of(sum(not row.said for row in _stored(rows)), _stored(rows))),
    ("none of them: right", lambda rows: _of(sum(row.said == row.true for row in _strange(rows)), _strange(rows))),
    ("none of them: undecided", lambda rows: _of(sum(not row.said for row in _strange(rows)), _strange(rows))),
    (
        "decided after, median / p95 (s)",
        lambda rows: _quantiles((row.decided for row in rows if row.said == row.true), 2),
    ),
    ("ψ absolute, RMS, median / p95 (mrad)", lambda rows: _quantiles((1e3 * row.psi_rms for row in rows), 1)),
    ("Brier score, mean", lambda rows: f"{np.mean([row.brier for row in rows]):.3f}" if rows else "–"),
]
