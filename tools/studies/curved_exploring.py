"""Unknown objects explored on cradles, and on flat palms at the same rates: the same objects, rig without wires."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from palmd.config.two_palms import Config, LimitsConfig
from palmd.console.columns import aligned
from palmd.motion.rollout_predictor import MOST_FORCE
from palmd.rig.curved_plant import MOST_LYING, widest
from palmd.rig.shapes import KINDS, Body, Kind, random_body
from palmd.rig.world import default_config
from tools.studies import exploring
from tools.studies.exploring import ExploringRow, ExploringTask
from tools.studies.exploring_plans import Strategy
from tools.studies.montecarlo_summary import number, percent, quantile
from tools.studies.runs import with_failures
from tools.studies.scoring import as_line as scored_line

RADII_M = (0.06, 0.09)
CRADLE = LimitsConfig(phi1_deg=(-10.0, 110.0), phi2_deg=(88.0, 165.0), rate_deg_s=90.0, acceleration_deg_s2=600.0)
"""As in config/cradle.yaml."""
FLAT = LimitsConfig(rate_deg_s=CRADLE.rate_deg_s, acceleration_deg_s2=CRADLE.acceleration_deg_s2)
MOST_S, PLAN_S = 60.0, 10.0
_STREAM = 0x6372
_DIGITS = 3  # of a configured curvature


@dataclass(frozen=True, slots=True)
class CradleTask:
    """One run: kind and seed of the object, whether on a cradle or on flat palms, for how long (s), how it is moved."""

    kind: Kind
    seed: int
    curved: bool
    seconds: float
    strategy: Strategy = "explore"

    @property
    def exploring(self) -> ExploringTask:
        """The same for `exploring`."""
        return ExploringTask(self.kind, self.seed, self.strategy, self.seconds)


@dataclass(frozen=True, slots=True)
class CradleRow:
    """What came of it, and on which curvatures (1/m)."""

    curvatures: tuple[float, ...]
    explored: ExploringRow


def tasks_of(first_seed: int, count: int, seconds: float) -> list[CradleTask]:
    """So many objects, of all kinds in turn, on both sorts of palms."""
    return [
        CradleTask(KINDS[number % len(KINDS)], first_seed + number, curved, seconds)
        for number in range(count)
        for curved in (True, False)
    ]


def plans_of(first_seed: int, count: int, seconds: float) -> list[CradleTask]:
    """So many objects, of all kinds in turn, each on a cradle that knows nothing of it and moves at random."""
    return [
        CradleTask(KINDS[number % len(KINDS)], first_seed + number, True, seconds, "random") for number in range(count)
    ]


def failed(task: CradleTask, error: BaseException) -> CradleRow:
    """The row of a run that came to nothing."""
    told = exploring.failed(task.exploring, error)
    return CradleRow((math.nan,) if task.curved else (0.0,), told)


@with_failures(failed)
def run(task: CradleTask) -> CradleRow:
    """Explore and judge; what raises becomes a row that says so."""
    curvatures, body = _drawn(task)
    config = _config(curvatures if task.curved else None)
    told = exploring.explored(task.exploring, config, body)
    return CradleRow(config.rig.curvatures_per_m, told)


def _drawn(task: CradleTask) -> tuple[tuple[float, float], Body]:
    """Curvatures of both palms, and an object that lies on them rather than in them."""
    random = np.random.default_rng([_STREAM, KINDS.index(task.kind), task.seed])
    one, two = (round(1.0 / each, _DIGITS) for each in random.uniform(*RADII_M, 2).tolist())
    while True:
        body = random_body(task.kind, random)
        if max(one, two) * widest(body) <= MOST_LYING:
            return (one, two), body


def _config(curvatures: tuple[float, float] | None) -> Config:
    config = default_config()
    if curvatures is None:
        return config.model_copy(update={"limits": FLAT})
    one, two = curvatures
    rig = config.rig.model_copy(update={"palm1_curvature_per_m": one, "palm2_curvature_per_m": two})
    return config.model_copy(update={"limits": CRADLE, "rig": rig})


def plan_table(rows: Sequence[CradleRow]) -> str:
    """What became of the objects under plans, in one column."""
    told = [row.explored for row in rows]
    return aligned([("", ["cradle"]), *((name, [show(told)]) for name, show in _HELD_LINES)])


def table(rows: Sequence[CradleRow]) -> str:
    """A column a sort of palms; ∞ where too many runs have no such number."""
    sorts = [[row.explored for row in rows if any(row.curvatures) == curved] for curved in (True, False)]
    lines = [(name, [show(column) if column else "" for column in sorts]) for name, show in _LINES]
    return aligned([("", ["cradle", "flat"]), *lines])


def remarks(rows: Sequence[CradleRow]) -> list[str]:
    """The runs to look at: errors, what was not touched in time, contacts lost."""
    told = []
    for row in rows:
        each, palms = row.explored, "cradle" if any(row.curvatures) else "flat"
        text = each.error or ", ".join(
            [f"touched {each.coverage:.0%} ({each.reason})"]
            * (each.strategy == "explore" and math.isnan(each.enough_s))
            + [f"contact lost {each.losses} times, at a pad's end {each.edge_s:.2f} s"] * each.mishap
            + [f"wedged {each.wedged_s:.2f} s"] * (each.wedged_s > 0.0)
            + [f"pressed with up to {each.most_force_m_s2:.0f} m/s²"] * (each.pressed_s > 0.0)
        )
        told += [f"{palms} {each.kind} {each.seed}: {text}"] if text else []
    return told


def as_line(row: CradleRow) -> dict[str, Any]:
    """The row for a file of JSON lines."""
    return {"curvatures_per_m": row.curvatures, **scored_line(row.explored)}


def _quantiles(value: Callable[[ExploringRow], float], unit: float = 1.0) -> Callable[[Sequence[ExploringRow]], str]:
    """Median and 90th percentile, a run without the number counting as infinite."""

    def show(rows: Sequence[ExploringRow]) -> str:
        values = [each if math.isfinite(each) else math.inf for each in map(value, rows)]
        return " / ".join(number(quantile(values, q), unit) for q in (0.5, 0.9))

    return show


def _count(marks: Callable[[ExploringRow], bool]) -> Callable[[Sequence[ExploringRow]], str]:
    return lambda rows: f"{sum(map(marks, rows))} of {len(rows)}"


def _most_force(rows: Sequence[ExploringRow]) -> str:
    return number(max((row.most_force_m_s2 for row in rows if not row.error), default=math.nan), 1.0)


_Lines = tuple[tuple[str, Callable[[Sequence[ExploringRow]], str]], ...]

_HELD_LINES: _Lines = (
    ("wedged", _count(lambda row: row.wedged_s > 0.0)),
    (f"pressed with more than {MOST_FORCE:g} m/s²", _count(lambda row: row.pressed_s > 0.0)),
    ("lifted off", _count(lambda row: row.parted_s > 0.0)),
    ("any of these and not noticed in time", _count(lambda row: row.unnoticed > 0)),
    ("largest force of all (m/s²)", _most_force),
)

_LINES: _Lines = (
    ("95 % of what can be reached touched in time", _count(lambda row: math.isfinite(row.enough_s))),
    ("after, median / p90 (s)", _quantiles(lambda row: row.enough_s)),
    ("valid after, median / p90 (s)", _quantiles(lambda row: row.valid_s)),
    ("touched of all normals in the end, median (%)", lambda rows: percent(quantile([r.of_all for r in rows], 0.5))),
    ("outline, RMS, median / p90 (µm)", _quantiles(lambda row: row.e_h_m, 1e6)),
    ("contact lost or pad's end reached", _count(lambda row: row.mishap)),
    *_HELD_LINES,
    ("lost or at an end, not recovered", _count(lambda row: row.mishap and not row.recovered)),
    ("limits violated", _count(lambda row: row.outside + row.refused > 0)),
    ("ended in an error", _count(lambda row: bool(row.error))),
    ("processor time, median / p90 (s)", _quantiles(lambda row: row.seconds)),
)
