"""One of the rig's constants is off while an unknown object is explored: when it leads the outline astray, when named.

Without wires, the smoother beside the loop simulated; the rest of the rig is exactly as described, and declared so.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from palmd.config.plans import ExploreGoal
from palmd.config.two_palms import Config, ImperfectionsConfig, rig_description
from palmd.events import FloatArray, Improvement, Unexplained
from palmd.harness.wireless import Wireless
from palmd.model import shape
from palmd.model.shape_map import Z
from palmd.model.smoothing import R
from palmd.observer import Simulated
from palmd.observer.coverage import NORMAL_BINS
from palmd.rig.shapes import Kind
from palmd.rig.world import default_config
from palmd.system.description import AS_CALIBRATED, RigDescription
from palmd.system.rig_constants import RIG_NAMES
from tools.studies.exploring_plans import plan
from tools.studies.off import NAMED_WITHIN_S, OFF, VERDICTS, names, of_name, verdict
from tools.studies.runs import with_failures
from tools.studies.scoring import FAR

_SHOWN = (("_m_per_n", "_mm_per_n", 1e3), ("_m", "_mm", 1e3), ("_s", "_ms", 1e3), ("_rad", "_deg", math.degrees(1)))
CAN_BE_OFF = [off.name for off in OFF if off.constants or off.name == "nothing"]


@dataclass(frozen=True, slots=True)
class ExploredTask:
    """One run: which of `CAN_BE_OFF`, the object's kind and seed, and how long it is explored (s)."""

    off: str
    kind: Kind
    seed: int
    seconds: float = 20.0


@dataclass(frozen=True, slots=True)
class ExploredRow:
    """What came of it; NaN for what did not happen.

    astray: when, from the start (s), what is off would first lead the outline astray by more than `FAR` one-sigmas of
    what the readings tell of it; named: when it, and nothing else, was first named. verdicts: of all answers, in the
    order of `VERDICTS`, how many. last: what the last one named.
    """

    off: str
    kind: Kind
    seed: int
    error: str = ""
    astray_s: float = math.nan
    named_s: float = math.nan
    verdicts: tuple[int, ...] = ()
    last: tuple[str, ...] = ()

    @property
    def in_time(self) -> bool:
        """Whether it was named soon enough after it had led the outline astray."""
        return self.named_s <= self.astray_s + NAMED_WITHIN_S


def tasks_of(offs: Iterable[str], first: int, runs: int, seconds: float) -> list[ExploredTask]:
    """So many runs of each, the kinds `friction` and `rig` in turns."""
    kinds: tuple[Kind, Kind] = ("friction", "rig")
    seeds = range(first, first + runs)
    return [ExploredTask(off, kinds[seed % 2], seed, seconds) for off in offs for seed in seeds]


def failed(task: ExploredTask, error: BaseException) -> ExploredRow:
    """The row of a run that came to nothing."""
    return ExploredRow(task.off, task.kind, task.seed, error=f"{type(error).__name__}: {error}")


@with_failures(failed)
def run(task: ExploredTask) -> ExploredRow:
    """Explore, and see what the smoother's answers name; what raises becomes a row that says so."""
    off = of_name(task.off)
    config = _configured(off.constants)
    smoothing = _Kept(rig_description(config))
    spec = plan("explore", config, ExploreGoal(coverage=1.0, time_limit_s=task.seconds), task.seed)
    wireless = Wireless(config, spec, task.seed, kind=task.kind, smoothing=smoothing)
    wireless.start()
    begun = wireless.t
    for _ in wireless.run(task.seconds):
        pass
    true = np.array([off.constants.get(name, 0.0) for name in RIG_NAMES])
    true[R.FRICTION] = 0.0  # never taken for exact
    row = ExploredRow(task.off, task.kind, task.seed)
    said = []
    for t, answer in smoothing.answers:
        named = names(answer.contradicted)
        said.append(verdict(off, named))
        if math.isnan(row.astray_s) and answer.established and led_astray(answer, true) > FAR:
            row = replace(row, astray_s=t - begun)
        if math.isnan(row.named_s) and said[-1] == "right":
            row = replace(row, named_s=t - begun)
        row = replace(row, last=named)
    return replace(row, verdicts=tuple(said.count(each) for each in VERDICTS))


def led_astray(answer: Improvement, true: FloatArray) -> float:
    """By how many one-sigmas of itself, RMS where touched, an outline would be off that takes constants for 0."""
    n = len(answer.x)
    by_rig = np.linalg.solve(answer.spread[n:].T, answer.spread[:n].T).T[Z.SHAPE :]
    middles = (np.arange(NORMAL_BINS, dtype=np.float64) + 0.5) * (math.tau / NORMAL_BINS)
    touched = middles[answer.touched]
    turned = shape.gauge_free_basis(touched, touched, answer.x[Z.SHAPE :])
    variance = ((turned @ answer.P[Z.SHAPE :, Z.SHAPE :]) * turned).sum(axis=1)
    return float(np.sqrt(np.mean((turned @ (by_rig @ true)) ** 2) / np.mean(variance)))


class _Kept(Simulated):
    """Keeps its answers, each with when it came (s)."""

    def __init__(self, rig: RigDescription) -> None:
        super().__init__(rig)
        self.answers: list[tuple[float, Improvement]] = []

    def collect(self, t: float) -> Improvement | Unexplained | None:
        answer = super().collect(t)
        if isinstance(answer, Improvement):
            self.answers.append((t, answer))
        return answer


def _configured(constants: Mapping[str, float]) -> Config:
    """An emulated rig that is off by these, by their published names; its description says that it is exact."""
    off: dict[str, dict[str, float] | float] = {"palm1": {}, "palm2": {}}
    for name, value in constants.items():
        ends = (each for each in _SHOWN if name.endswith(each[0]))
        old, new, factor = next(ends, ("", "", 1.0))
        key = name.removesuffix(old) + new
        if key.startswith("pad"):
            of_pad = off[f"palm{key[len('pad')]}"]
            assert isinstance(of_pad, dict)
            of_pad[key.split("_", 1)[1]] = value * factor
        else:
            off[key] = value * factor
    config = default_config("none")
    changed = {
        "imperfections": ImperfectionsConfig.model_validate(off),
        "friction_asymmetry_sd": AS_CALIBRATED["friction_sd"],
    }
    return config.model_copy(update={"rig": config.rig.model_copy(update=changed)})


def report(rows: Sequence[ExploredRow]) -> str:
    """A line for each run, and how many were named in time."""
    lines = [
        f"{row.off}, {row.kind} {row.seed}: "
        + (row.error or f"astray after {row.astray_s:.1f} s, named after {row.named_s:.1f} s; of its answers "
           + ", ".join(f"{count} {each}" for each, count in zip(VERDICTS, row.verdicts, strict=True)))
        for row in rows
    ]  # fmt: skip
    astray = [row for row in rows if not math.isnan(row.astray_s)]
    clean = [row for row in rows if not of_name(row.off).constants and not row.error]
    wrong = VERDICTS.index("wrong")
    return "\n".join([
        *lines,
        f"{sum(row.in_time for row in astray)} of {len(astray)} led astray by more than {FAR:g} sd have the right name,"
        + f" alone, within {NAMED_WITHIN_S:g} s of that",
        f"{sum(row.verdicts[wrong] > 0 for row in clean)} of {len(clean)} with nothing off have a name at some time",
    ])  # fmt: skip
