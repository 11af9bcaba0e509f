"""One property of the rig is not as configured: what is still accepted, how far off it is, and whether it is named.

Runs of 20 s (kinds friction and rig in turns) on an emulated rig of which one constant is off, or whose readings are
spoilt. The rest of the rig is either as described, and declared to be (`exact`), or as calibration leaves one, which is
what a log without a word about it is taken for (`calibrated`). Of each run the first ten seconds are reconstructed too:
by then what leads the outline astray should have a name, where the readings determine it.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, get_args

import numpy as np

from palmd import observer
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
from tools.studies import harness
from tools.studies.cells import Cell, among, count, count_of, most, quantiles
from tools.studies.harness import Study, result
from tools.studies.montecarlo import answers
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


def _batched(packet_s: float) -> Spoil:
    """A USB adapter hands over what came within 16 ms at once: the last packet has just ended, it seems.

    packet_s: by how much each packet is dated before the next; 0: all of a read have one stamp.
    """
    return lambda events, _: _in_batches(events, packet_s)


def _in_batches(events: list[Event], packet_s: float) -> list[Event]:
    moved: list[Event] = []
    batches: dict[tuple[int, int], list[PadSample]] = {}
    for event in events:
        if isinstance(event, PadSample):
            batches.setdefault((event.pad, math.ceil(event.t_sample / _BATCH_S)), []).append(event)
        else:
            moved.append(event)
    for (_, number), batch in batches.items():
        for k, sample in enumerate(reversed(batch)):
            moved.append(replace(sample, t_sample=number * _BATCH_S - k * packet_s))
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
    Off("16 ms batches", spoil=_batched(_PACKET_S), as_well=("pad1_lag_s", "pad2_lag_s")),
    Off("16 ms batches of one stamp", spoil=_batched(0.0), as_well=("pad1_lag_s", "pad2_lag_s")),
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
class OffRow(OffTask):
    """What came of it; NaN for what there is not.

    e_h, h_sd: RMS over the touched normals (m). z: of the constants that are off, the largest error in 1σ. named,
    named_early: constants contradicted by all readings, and by those of the first `NAMED_WITHIN_S`. ticks, valid,
    live_far, live_wrong: of a causal replay, those that are valid, and of these with r1 and r2 by RMS more than `FAR`
    1σ off, or either by more than `WRONG_M`.
    """

    error: str = ""
    accepted: bool = False
    reason: str = ""
    e_h_m: float = math.nan
    h_sd_m: float = math.nan
    z: float = math.nan
    named: tuple[str, ...] = ()
    named_early: tuple[str, ...] = ()
    ticks: int = 0
    valid: int = 0
    live_far: int = 0
    live_wrong: int = 0

    @property
    def far(self) -> bool:
        """Whether it is accepted, and wrong by more than its band allows."""
        return self.accepted and self.e_h_m > FAR * self.h_sd_m


def draw(arguments: argparse.Namespace) -> Sequence[OffTask]:
    """So many runs of each, the kinds `friction` and `rig` in turns."""
    kinds: tuple[Kind, Kind] = ("friction", "rig")
    return [
        OffTask(off, world, kinds[seed % 2], seed, arguments.seconds, arguments.live)
        for world in arguments.taken_for
        for off in arguments.only
        for seed in harness.seeds_of(arguments)
    ]


def run(task: OffTask) -> OffRow:
    """Simulate, spoil, reconstruct, compare."""
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
    row = result(
        OffRow, task, accepted=bool(answer.converged), reason=answer.reason,
        named=names(answer.contradicted), named_early=names(early.contradicted),
    )  # fmt: skip
    if task.live:
        row = _replayed(row, replace(log, events=tuple(events)), told)
    truth, true = truth_of(told), np.array([told["rig"][name] for name in RIG_NAMES])
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
            changed: dict[str, Any] = {fields_of[told]: value}
            pads[int(pad) - 1] = replace(pads[int(pad) - 1], **changed)
    return replace(off, angles=(angles[0], angles[1]), pads=tuple(pads))


def names(contradicted: Iterable[float]) -> tuple[str, ...]:
    """Which constants are contradicted."""
    return tuple(name for name, z in zip(RIG_NAMES, contradicted, strict=False) if z != 0.0)


# ---------------------------------------------------------------------------------------------------- the study


VERDICTS = ("right", "with others", "wrong", "none")
NAMES = [each.name for each in OFF]


def verdict(off: Off, named: Sequence[str]) -> str:
    """What is off is named alone (`right`) or `with others`; something else is (`wrong`), or nothing (`none`)."""
    if not named:
        return "none"
    right = {*off.constants, *off.as_well}
    if not right & set(named):
        return "wrong"
    return "right" if set(named) <= right else "with others"


def _early(what: str) -> Cell:
    return count(lambda row: verdict(of_name(row.off), row.named_early) == what)


def _of_accepted(cell: Cell) -> Cell:
    return among(lambda row: row.accepted, cell)


def _of_ticks(name: str) -> Callable[[OffRow], float]:
    return lambda row: getattr(row, name) / row.valid if row.valid else math.nan


COLUMNS: list[tuple[str, Cell]] = [
    ("accepted", count_of(lambda row: row.accepted)),
    ("µm", _of_accepted(quantiles(lambda row: row.e_h_m, 1e6))),
    ("error / sd: median", _of_accepted(quantiles(lambda row: row.e_h_m / row.h_sd_m))),
    ("most", _of_accepted(most(lambda row: row.e_h_m / row.h_sd_m))),
    ("> 3 sd", count(lambda row: row.far)),
    ("constant within 2 sd", _of_accepted(count(lambda row: row.z <= 2.0))),
    *((f"named: {what}", _early(what)) for what in VERDICTS),
    ("in the end: right", count(lambda row: verdict(of_name(row.off), row.named) == "right")),
    ("live: valid %", quantiles(lambda row: row.valid / row.ticks if row.ticks else math.nan, 100.0)),
    ("> 3 sd %", quantiles(_of_ticks("live_far"), 100.0)),
    ("> 0.3 mm %", quantiles(_of_ticks("live_wrong"), 100.0)),
]


def remarks(rows: Sequence[OffRow]) -> list[str]:
    """How many are accepted too sharply, in each world; then a line for each that is, or is not accepted."""
    said = []
    for world in dict.fromkeys(row.taken_for for row in rows):
        accepted = [row for row in rows if row.accepted and row.taken_for == world]
        plain = [row for row in accepted if not of_name(row.off).blind]
        said.append(
            f"{world}: {sum(row.far for row in accepted)} of {len(accepted)} accepted are more than {FAR:g} sd off, "
            f"{sum(row.far for row in plain)} of {len(plain)} where touch can determine all of what is off"
        )
    ticks, valid, far, wrong = (sum(getattr(row, name) for row in rows) for name in _TICKS)
    if ticks:
        said.append(
            f"live: {far} of {valid} valid ticks are more than {FAR:g} sd off, "
            f"{wrong} by more than {1e3 * WRONG_M:g} mm; valid are {valid / ticks:.0%}"
        )
    for row in rows:
        if row.error or not row.accepted:
            said.append(f"{row.off}, {row.kind} {row.seed}: {row.error or row.reason}")
        elif row.far:
            off, sd = 1e6 * row.e_h_m, 1e6 * row.h_sd_m
            said.append(f"{row.off}, {row.kind} {row.seed}: {off:.0f} µm off, sd {sd:.0f} µm")
    return said


_TICKS = ("ticks", "valid", "live_far", "live_wrong")

STUDY = Study(
    "one property off",
    draw,
    run,
    OffRow,
    order=lambda row: (TAKEN_FOR.index(row.taken_for), NAMES.index(row.off), row.seed),
    by=lambda row: f"{row.taken_for}: {row.off}",
    columns=COLUMNS,
    remarks=remarks,
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The study's arguments."""
    harness.add_arguments(parser, runs=4, seconds_each=20.0, output="off.jsonl", what="how many of each")
    add = parser.add_argument
    add("--taken-for", choices=TAKEN_FOR, nargs="+", default=TAKEN_FOR, metavar="WORLD",
        help=f"what the rest of the rig is: {', '.join(TAKEN_FOR)} (default: both)")  # fmt: skip
    add("--only", choices=NAMES, nargs="+", default=NAMES, metavar="WHAT",
        help=f"what is off: {'; '.join(NAMES)} (default: each of them)".replace("%", "%%"))  # fmt: skip
    add("--live", action="store_true",
        help="replay each log through the live observer too, as `palmd estimate` does")  # fmt: skip
