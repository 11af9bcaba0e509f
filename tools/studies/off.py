"""One thing about the rig, or about its readings, is not as described: a run reconstructed blind, and what is named.

The rest of the rig is either as described, and declared to be (`exact`), or as calibration leaves one, which is what a
log without a word about it is taken for (`calibrated`). Of each run the first ten seconds are reconstructed too: by
then what leads the outline astray should have a name, where the readings tell it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np

from palmd import observer
from palmd.console.columns import aligned
from palmd.events import Event, PadSample
from palmd.observer.reconstruct import reconstruct
from palmd.record.eventlog import EventLog, read_log
from palmd.rig.imperfections import PERFECT, Imperfections, drawn
from palmd.rig.plant import PlantOptions
from palmd.rig.shapes import KINDS, Kind
from palmd.rig.simulate import PERFECTLY_KNOWN, simulate_log
from palmd.score import WRONG_M
from palmd.system.description import AS_CALIBRATED, CALIBRATION_KEYS, RigDescription
from palmd.system.rig_constants import RIG_NAMES
from tools.studies.montecarlo import answers
from tools.studies.off_telling import Telling, telling
from tools.studies.runs import with_failures
from tools.studies.scoring import FAR, Line, outline_errors, truth_of
from tools.studies.simulated import written

TakenFor = Literal["exact", "calibrated"]
TAKEN_FOR: tuple[TakenFor, ...] = get_args(TakenFor)
# How alike the palms rub is no matter of calibration: a log that declares its rig exact leaves it open.
_KNOWN: Mapping[TakenFor, Mapping[str, float]] = {
    "exact": {**PERFECTLY_KNOWN, "friction_sd": AS_CALIBRATED["friction_sd"]},
    "calibrated": AS_CALIBRATED,
}
NAMED_WITHIN_S = 10.0
_STREAM = 29  # of a seed's random numbers: what is done to the readings
_BATCH_S, _PACKET_S = 0.016, 0.00625

Random = np.random.Generator
Spoil = Callable[[list[Event], Random], list[Event]]


@dataclass(frozen=True, slots=True)
class Off:
    """What is off: constants of the rig by their published names (SI), other laws of the plant, or the readings.

    Where no constant is, none may be named but `as_well`: those whose name is as right, because touch cannot tell them
    from what is off, or because that is what it comes to. blind: touch tells it in part at most
    (docs/theory/limits.md), so that to declare it exact is what few readings can contradict.
    """

    name: str
    constants: Mapping[str, float] = field(default_factory=dict)
    vibration: float = 0.0
    options: PlantOptions = field(default_factory=PlantOptions)
    spoil: Spoil | None = None
    as_well: tuple[str, ...] = ()
    blind: bool = False


def _batched(events: list[Event], _random: Random) -> list[Event]:
    """A USB adapter hands over what came within 16 ms at once: the last packet has just ended, it seems."""
    moved: list[Event] = []
    batches: dict[tuple[int, int], list[PadSample]] = {}
    for event in events:
        if isinstance(event, PadSample):
            batches.setdefault((event.pad, math.ceil(event.t_sample / _BATCH_S)), []).append(event)
        else:
            moved.append(event)
    for (_, number), batch in batches.items():
        for k, sample in enumerate(reversed(batch)):
            moved.append(replace(sample, t_sample=number * _BATCH_S - k * _PACKET_S))
    return sorted(moved, key=lambda event: event.t_sample)


def _each_reading(change: Callable[[PadSample, Random], PadSample | None]) -> Spoil:
    def spoil(events: list[Event], random: Random) -> list[Event]:
        changed = [change(event, random) if isinstance(event, PadSample) else event for event in events]
        return [event for event in changed if event is not None]

    return spoil


def _outlier(sample: PadSample, random: Random) -> PadSample:
    return replace(sample, s=float(random.uniform(0.0, 0.0555))) if random.random() < 0.05 else sample


def _dropped(sample: PadSample, random: Random) -> PadSample | None:
    return None if random.random() < 0.3 else sample


def _student(sample: PadSample, random: Random) -> PadSample:
    return replace(sample, s=sample.s + 1e-4 * float(random.standard_t(3)))


OFF: tuple[Off, ...] = (
    Off("nothing"),
    Off("pad 1's zero 0.1 mm", {"pad1_zero_m": 1e-4}),
    Off("pad 1's zero 0.3 mm", {"pad1_zero_m": 3e-4}),
    Off("both zeros 0.3 mm", {"pad1_zero_m": 3e-4, "pad2_zero_m": 3e-4}),
    Off("pad 2's scale 1 %", {"pad2_scale": 0.01}, as_well=("pad1_scale",), blind=True),  # of their mean
    Off("φ1 0.3°", {"phi1_rad": math.radians(0.3)}),
    Off("gravity 0.5°", {"phi1_rad": math.radians(0.5)}),
    Off("φ2 0.3°", {"phi2_rad": math.radians(0.3)}),
    Off("φ2 1°", {"phi2_rad": math.radians(1.0)}),
    Off("pad 1 0.5 mm high", {"pad1_standoff_m": 5e-4}, blind=True),
    Off("pad 1 bowed 0.1 mm", {"pad1_sagitta_m": 1e-4}),
    Off("pad 1 bowed 0.3 mm", {"pad1_sagitta_m": 3e-4}),
    Off("pad 1 0.1 mm/N", {"pad1_force_m_per_n": 1e-4}),
    Off("pad 1 0.3 mm/N", {"pad1_force_m_per_n": 3e-4}),
    Off("μ1 = 2 μ2", {"friction_asymmetry": 1 / 3}),
    Off("μ1 = μ2 / 5", {"friction_asymmetry": -2 / 3}),
    Off("pad 2 15 ms late", {"pad2_lag_s": 0.015}),
    Off("stick-slip", options=PlantOptions(friction_law="coulomb")),
    Off("vibration 0.3 m/s²", vibration=0.3),
    Off("16 ms batches", spoil=_batched, as_well=("pad1_lag_s", "pad2_lag_s")),
    Off("5 % outliers", spoil=_each_reading(_outlier)),
    Off("30 % dropped", spoil=_each_reading(_dropped)),
    Off("Student's noise", spoil=_each_reading(_student)),
)
"""Issue by issue what has been seen to lead estimates astray, and what has not."""


def of_name(name: str) -> Off:
    """The one of `OFF` that is called so."""
    return next(each for each in OFF if each.name == name)


@dataclass(frozen=True, slots=True)
class OffTask:
    """One run: which of `OFF`, what the rest of the rig is, kind, seed, and how long (s)."""

    off: str
    taken_for: TakenFor
    kind: Kind
    seed: int
    seconds: float = 20.0
    live: bool = False


@dataclass(frozen=True, slots=True)
class OffRow:
    """What came of it; NaN for what there is not.

    e_h, h_sd: RMS over the touched normals (m). z: of the constants that are off, the largest error in one-sigmas.
    named, named_early: constants contradicted by all readings, and by those of the first `NAMED_WITHIN_S`. bias,
    sigmas, apart: of the latter, as `Telling` has them. ticks, valid, live_far, live_wrong: of a causal replay, those
    that are valid, and of these with r1 and r2 by RMS more than `FAR` one-sigmas off, or either by more than `WRONG_M`.
    """

    off: str
    taken_for: TakenFor
    kind: Kind
    seed: int
    error: str = ""
    claimed: bool = False
    reason: str = ""
    e_h_m: float = math.nan
    h_sd_m: float = math.nan
    z: float = math.nan
    named: tuple[str, ...] = ()
    named_early: tuple[str, ...] = ()
    bias: float = math.nan
    sigmas: float = math.nan
    apart: float = math.nan
    ticks: int = 0
    valid: int = 0
    live_far: int = 0
    live_wrong: int = 0

    @property
    def astray(self) -> bool:
        """Whether what is off leads the outline astray by more than three one-sigmas before it should be named."""
        return self.bias > FAR

    @property
    def told(self) -> bool:
        """Whether the readings tell by then what it is."""
        return Telling(self.bias, self.sigmas, self.apart).told

    @property
    def far(self) -> bool:
        """Whether it is claimed, and wrong by more than its band allows."""
        return self.claimed and self.e_h_m > FAR * self.h_sd_m


def tasks_of(
    offs: Iterable[str], taken_for: Iterable[TakenFor], first: int, runs: int, seconds: float, live: bool = False
) -> list[OffTask]:
    """So many runs of each, the kinds `friction` and `rig` in turns."""
    kinds: tuple[Kind, Kind] = ("friction", "rig")
    worlds, names = tuple(taken_for), tuple(offs)
    return [
        OffTask(off, world, kinds[seed % 2], seed, seconds, live)
        for world in worlds
        for off in names
        for seed in range(first, first + runs)
    ]


def failed(task: OffTask, error: BaseException) -> OffRow:
    """The row of a run that came to nothing."""
    return OffRow(task.off, task.taken_for, task.kind, task.seed, error=f"{type(error).__name__}: {error}")


@with_failures(failed)
def run(task: OffTask) -> OffRow:
    """Simulate, spoil, reconstruct, compare; what raises becomes a row that says so."""
    off = of_name(task.off)
    known = RigDescription().known_to(_KNOWN[task.taken_for])
    stream = KINDS.index(task.kind), task.seed
    rest = PERFECT if task.taken_for == "exact" else drawn(known, *stream)
    lines, told = simulate_log(
        task.kind, task.seed, task.seconds, off.options,
        imperfections=replace(with_constants(rest, off.constants), vibration=off.vibration),
        calibration_sd=_KNOWN[task.taken_for],
    )  # fmt: skip
    with written(lines) as path:
        log = read_log(path)
    events: list[Event] = list(log.events)
    if off.spoil is not None:
        events = off.spoil(events, np.random.default_rng([*stream, _STREAM]))
    first = [event for event in events if event.t_sample < NAMED_WITHIN_S]
    early = reconstruct(first, log.rig)
    answer = early if len(first) == len(events) else reconstruct(events, log.rig)
    row = OffRow(
        task.off, task.taken_for, task.kind, task.seed, claimed=bool(answer.converged), reason=answer.reason,
        named=names(answer.contradicted), named_early=names(early.contradicted),
    )  # fmt: skip
    if task.live:
        row = _replayed(row, replace(log, events=tuple(events)), told)
    truth, true = truth_of(told), np.array([told["rig"][name] for name in RIG_NAMES])
    if off.constants:
        best = telling(first, log.rig, truth, true, [*off.constants, *off.as_well])
        row = replace(row, bias=best.bias, sigmas=best.sigmas, apart=best.apart)
    scored = outline_errors(answer, truth)
    if scored is None:
        return row
    at = scored.touched
    z = np.abs(true - answer.rig) / answer.rig_sd
    which = [RIG_NAMES.index(name) for name in off.constants]
    return replace(
        row,
        e_h_m=scored.score.e_h,
        h_sd_m=float(np.sqrt(np.mean(scored.h_sd[at] ** 2))),
        z=float(z[which].max()) if which else math.nan,
    )


def _replayed(row: OffRow, log: EventLog, told: Line) -> OffRow:
    """With what the live observer says of the run, tick by tick, the smoother beside it simulated."""
    live = answers(log, told, observer.make("shape", log.rig, smoothing=observer.Simulated(log.rig)))
    error, sd = live.r_error[live.valid], live.r_sd[live.valid]
    far = np.mean((error / sd) ** 2, axis=1) > FAR**2
    return replace(row, ticks=len(live.t), valid=len(error), live_far=int(far.sum()), live_wrong=int(live.wrong.sum()))


def with_constants(rest: Imperfections, values: Mapping[str, float]) -> Imperfections:
    """These constants of the rig as given, by their published names; the others as in `rest`."""
    fields_of = {told: name.removesuffix("_sd") for name, told in CALIBRATION_KEYS.items()}
    angles, pads = list(rest.angles), list(rest.pads)
    off = rest
    for name, value in values.items():
        if name == "phi1_rad":
            angles[0] = value - rest.gravity
        elif name == "phi2_rad":
            angles[1] = value
        elif name == "friction_asymmetry":
            off = replace(off, friction=value)
        else:
            pad, told = name.removeprefix("pad").split("_", 1)
            pads[int(pad) - 1] = replace(pads[int(pad) - 1], **{fields_of[told]: value})
    return replace(off, angles=(angles[0], angles[1]), pads=tuple(pads))


def names(contradicted: Iterable[float]) -> tuple[str, ...]:
    """Which constants are contradicted."""
    return tuple(name for name, z in zip(RIG_NAMES, contradicted, strict=False) if z != 0.0)


# ------------------------------------------------------------------------------------------------------ told


VERDICTS = ("right", "with others", "wrong", "none")
HEAD = (
    "claimed",
    "µm",
    "error / sd: median",
    "most",
    "> 3 sd",
    "told, 2 sd",
    "named: right",
    "with others",
    "wrong",
    "none",
    "in the end: right",
    "with others",
    "live: valid",
    "> 3 sd",
    "> 0.3 mm",
)


def report(rows: Sequence[OffRow]) -> str:
    """A line for each thing that is off, in each world; then what is claimed too sharply, by seeds."""
    parts = []
    for world in TAKEN_FOR:
        of_world = [row for row in rows if row.taken_for == world]
        if not of_world:
            continue
        lines: list[tuple[str, Sequence[str]]] = [(f"taken for {world}", HEAD)]
        lines += [
            (off.name, _cells(off, mine)) for off in OFF if (mine := [row for row in of_world if row.off == off.name])
        ]
        parts.append(aligned(lines))
        blind = {off.name for off in OFF if off.blind}
        claimed = [row for row in of_world if row.claimed]
        plain = [row for row in claimed if row.off not in blind]
        parts.append(
            f"{sum(row.far for row in claimed)} of {len(claimed)} claims are more than {FAR:g} sd off, "
            f"{sum(row.far for row in plain)} of {len(plain)} where touch can tell all of what is off"
        )
        if any(row.ticks for row in of_world):
            valid, far, wrong = (
                sum(getattr(row, name) for row in of_world) for name in ("valid", "live_far", "live_wrong")
            )
            parts.append(
                f"live: {far} of {valid} valid ticks are more than {FAR:g} sd off, "
                f"{wrong} by more than {1e3 * WRONG_M:g} mm; valid are {valid / sum(row.ticks for row in of_world):.0%}"
            )
        astray = [row for row in of_world if row.astray]
        parts.append(
            f"by {NAMED_WITHIN_S:g} s, of {_counted(astray)} led astray by more than {FAR:g} sd of the clean run\n"
            f"of {_counted([row for row in astray if row.told])} whose readings tell then what it is"
        )
        parts.append("\n".join(_remarks(of_world)))
    return "\n\n".join(filter(None, parts))


def _cells(off: Off, rows: Sequence[OffRow]) -> Sequence[str]:
    claimed = [row for row in rows if row.claimed]
    ratios = [row.e_h_m / row.h_sd_m for row in claimed]
    verdicts = [verdict(off, row.named_early) for row in rows]
    in_the_end = [verdict(off, row.named) for row in rows]
    told = sum(row.z <= 2.0 for row in claimed)
    return (
        f"{len(claimed)} of {len(rows)}",
        f"{1e6 * np.median([row.e_h_m for row in claimed]):.0f}" if claimed else "–",
        f"{np.median(ratios):.1f}" if claimed else "–",
        f"{max(ratios):.1f}" if claimed else "–",
        str(sum(row.far for row in claimed)),
        f"{told} of {len(claimed)}" if off.constants else "–",
        *(str(verdicts.count(each)) for each in VERDICTS),
        *(str(in_the_end.count(each)) for each in VERDICTS[:2]),
        *_live_cells(rows),
    )


def _live_cells(rows: Sequence[OffRow]) -> Sequence[str]:
    ticks, valid = sum(row.ticks for row in rows), sum(row.valid for row in rows)
    if not ticks:
        return "–", "–", "–"
    shares = (sum(row.live_far for row in rows), sum(row.live_wrong for row in rows))
    return f"{valid / ticks:.0%}", *(f"{share / max(valid, 1):.1%}" for share in shares)


def _counted(rows: Sequence[OffRow]) -> str:
    verdicts = [verdict(of_name(row.off), row.named_early) for row in rows]
    named = ", ".join(f"{verdicts.count(each)} {each}" for each in VERDICTS)
    return f"{len(rows)} ({named})"


def verdict(off: Off, named: Sequence[str]) -> str:
    """What is off is named alone (`right`) or `with others`; something else is (`wrong`), or nothing (`none`)."""
    if not named:
        return "none"
    right = {*off.constants, *off.as_well}
    if not right & set(named):
        return "wrong"
    return "right" if set(named) <= right else "with others"


def _remarks(rows: Iterable[OffRow]) -> Iterable[str]:
    for row in rows:
        if row.error or not row.claimed:
            yield f"{row.off}, {row.kind} {row.seed}: {row.error or row.reason}"
        elif row.far:
            yield f"{row.off}, {row.kind} {row.seed}: {1e6 * row.e_h_m:.0f} µm off, sd {1e6 * row.h_sd_m:.0f} µm"
