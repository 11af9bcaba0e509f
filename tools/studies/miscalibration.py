"""Mis-calibration study: one property of the rig differs from its configuration; which runs are accepted or named.

Runs of 20 s (kinds friction and rig in turns) on an emulated rig with one wrong constant, or with corrupted readings.
The rest of the rig is exactly known and declared so (`exact`), or has residual calibration errors, as is assumed for a
log without a declaration (`calibrated`). Counted are accepted runs, their errors in 1σ, and which constants the result
names as contradicted. The first ten seconds of each run are reconstructed too: by then the cause of
a wrong outline should be named, if the readings determine it.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, get_args

import numpy as np

from palmd.events import Event, PadSample
from palmd.observer.reconstruct import reconstruct
from palmd.rig.imperfections import PERFECT, Imperfections, drawn
from palmd.rig.plant import PlantOptions
from palmd.rig.shapes import KINDS, Kind
from palmd.rig.simulate import PERFECTLY_KNOWN, simulate_log
from palmd.system.description import AS_CALIBRATED, CALIBRATION_KEYS, RigDescription
from palmd.system.rig_constants import RIG_NAMES
from tools.studies import harness
from tools.studies.cells import Cell, accepted, count, count_of, most, quantiles
from tools.studies.harness import Study, result
from tools.studies.scoring import FAR, outline_errors, truth_of
from tools.studies.simulated import log_of

TakenFor = Literal["exact", "calibrated"]
TAKEN_FOR: tuple[TakenFor, ...] = get_args(TakenFor)
# Unequal friction of the palms is not a matter of calibration: a log that declares its rig exact leaves it open.
_KNOWN: Mapping[TakenFor, Mapping[str, float]] = {
    "exact": {**PERFECTLY_KNOWN, "friction_sd": AS_CALIBRATED["friction_sd"]},
    "calibrated": AS_CALIBRATED,
}
NAMED_WITHIN_S = 10.0
_STREAM = 29  # random stream of the corrupted readings
_BATCH_S, _PACKET_S = 0.016, 0.00625  # period of a USB adapter, and of a pad's packets

Random = np.random.Generator
Spoil = Callable[[list[Event], Random], list[Event]]


@dataclass(frozen=True, slots=True)
class Miscalibration:
    """One mis-calibration: wrong rig constants by published name (SI), another law of the plant, or bad readings.

    as_well: constants that may be named too, because touch cannot distinguish them from the cause, or because they
    describe its effect; no other constant may be named. blind: touch determines it in part at most
    (docs/theory/limits.md), so that readings can hardly contradict a rig that is declared exact.
    """

    name: str
    constants: Mapping[str, float] = field(default_factory=dict)
    vibration: float = 0.0
    options: PlantOptions = field(default_factory=PlantOptions)
    spoil: Spoil | None = None
    as_well: tuple[str, ...] = ()
    blind: bool = False


def _batched(packet_s: float) -> Spoil:
    """Time stamps of a USB adapter that delivers in batches of 16 ms: the last packet gets the time of delivery.

    packet_s: by how much each packet is dated before the next; 0: all packets of a batch have one stamp.
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


MISCALIBRATIONS: tuple[Miscalibration, ...] = (
    Miscalibration("nothing"),
    Miscalibration("pad 1's zero 0.1 mm", {"pad1_zero_m": 1e-4}),
    Miscalibration("pad 1's zero 0.3 mm", {"pad1_zero_m": 3e-4}),
    Miscalibration("both zeros 0.3 mm", {"pad1_zero_m": 3e-4, "pad2_zero_m": 3e-4}),
    Miscalibration("pad 2's scale 1 %", {"pad2_scale": 0.01}, as_well=("pad1_scale",), blind=True),  # of their mean
    Miscalibration("φ1 0.3°", {"phi1_rad": math.radians(0.3)}),
    Miscalibration("gravity 0.5°", {"phi1_rad": math.radians(0.5)}),
    Miscalibration("φ2 0.3°", {"phi2_rad": math.radians(0.3)}),
    Miscalibration("φ2 1°", {"phi2_rad": math.radians(1.0)}),
    Miscalibration("pad 1 0.5 mm high", {"pad1_standoff_m": 5e-4}, blind=True),
    Miscalibration("pad 1 bowed 0.1 mm", {"pad1_sagitta_m": 1e-4}),
    Miscalibration("pad 1 bowed 0.3 mm", {"pad1_sagitta_m": 3e-4}),
    Miscalibration("pad 1 0.1 mm/N", {"pad1_force_m_per_n": 1e-4}),
    Miscalibration("pad 1 0.3 mm/N", {"pad1_force_m_per_n": 3e-4}),
    Miscalibration("μ1 = 2 μ2", {"friction_asymmetry": 1 / 3}),
    Miscalibration("μ1 = μ2 / 5", {"friction_asymmetry": -2 / 3}),
    Miscalibration("pad 2 15 ms late", {"pad2_lag_s": 0.015}),
    Miscalibration("stick-slip", options=PlantOptions(friction_law="coulomb")),
    Miscalibration("vibration 0.3 m/s²", vibration=0.3),
    Miscalibration("16 ms batches", spoil=_batched(_PACKET_S), as_well=("pad1_lag_s", "pad2_lag_s")),
    Miscalibration("16 ms batches of one stamp", spoil=_batched(0.0), as_well=("pad1_lag_s", "pad2_lag_s")),
    Miscalibration("5 % outliers", spoil=_each_reading(_outlier)),
    Miscalibration("30 % dropped", spoil=_each_reading(_dropped)),
    Miscalibration("Student's noise", spoil=_each_reading(_student)),
)
"""The mis-calibrations, with and without effect on estimates."""


def of_name(name: str) -> Miscalibration:
    """The entry of `MISCALIBRATIONS` with this name."""
    return next(each for each in MISCALIBRATIONS if each.name == name)


@dataclass(frozen=True, slots=True)
class MiscalibrationTask:
    """One run; `off`: name in `MISCALIBRATIONS`; `taken_for`: the rest of the rig; `seconds`: duration."""

    off: str
    taken_for: TakenFor
    kind: Kind
    seed: int
    seconds: float = 20.0


@dataclass(frozen=True, slots=True)
class MiscalibrationRow(MiscalibrationTask):
    """The results of one run; NaN for missing values.

    e_h_m, h_sd_m: RMS over the touched normals. z: largest error of the wrong constants, in 1σ. named, named_early:
    constants contradicted by all readings, and by those of the first `NAMED_WITHIN_S`.
    """

    error: str = ""
    accepted: bool = False
    reason: str = ""
    e_h_m: float = math.nan
    h_sd_m: float = math.nan
    z: float = math.nan
    named: tuple[str, ...] = ()
    named_early: tuple[str, ...] = ()

    @property
    def far(self) -> bool:
        """Whether it is accepted and its error exceeds `FAR` 1σ."""
        return self.accepted and self.e_h_m > FAR * self.h_sd_m


def draw(arguments: argparse.Namespace) -> Sequence[MiscalibrationTask]:
    """The requested number of runs of each, with kinds `friction` and `rig` in turns."""
    kinds: tuple[Kind, Kind] = ("friction", "rig")
    return [
        MiscalibrationTask(off, world, kinds[seed % 2], seed, arguments.seconds)
        for world in arguments.taken_for
        for off in arguments.only
        for seed in harness.seeds_of(arguments)
    ]


def run(task: MiscalibrationTask) -> MiscalibrationRow:
    """Simulate, corrupt the readings, reconstruct, compare."""
    miscalibration = of_name(task.off)
    known = RigDescription().known_to(_KNOWN[task.taken_for])
    stream = KINDS.index(task.kind), task.seed
    rest = PERFECT if task.taken_for == "exact" else drawn(known, *stream)
    lines, truth_line = simulate_log(
        task.kind, task.seed, task.seconds, miscalibration.options,
        imperfections=replace(with_constants(rest, miscalibration.constants), vibration=miscalibration.vibration),
        calibration_sd=_KNOWN[task.taken_for],
    )  # fmt: skip
    log = log_of(lines)
    events: list[Event] = list(log.events)
    if miscalibration.spoil is not None:
        events = miscalibration.spoil(events, np.random.default_rng([*stream, _STREAM]))
    first = [event for event in events if event.t_sample < NAMED_WITHIN_S]
    early = reconstruct(first, log.rig)
    answer = early if len(first) == len(events) else reconstruct(events, log.rig)
    row = result(
        MiscalibrationRow, task, accepted=bool(answer.converged), reason=answer.reason,
        named=names(answer.contradicted), named_early=names(early.contradicted),
    )  # fmt: skip
    truth, true = truth_of(truth_line), np.array([truth_line["rig"][name] for name in RIG_NAMES])
    scored = outline_errors(answer, truth)
    if scored is None:
        return row
    z = np.abs(true - answer.rig) / answer.rig_sd
    which = [RIG_NAMES.index(name) for name in miscalibration.constants]
    return replace(
        row,
        e_h_m=scored.score.e_h,
        h_sd_m=scored.sd,
        z=float(z[which].max()) if which else math.nan,
    )


def with_constants(rest: Imperfections, values: Mapping[str, float]) -> Imperfections:
    """Imperfections with these constants, by their published names; the others as in `rest`."""
    fields_of = {key: name.removesuffix("_sd") for name, key in CALIBRATION_KEYS.items()}
    angles, pads = list(rest.angles), list(rest.pads)
    imperfections = rest
    for name, value in values.items():
        if name == "phi1_rad":
            angles[0] = value - rest.gravity
        elif name == "phi2_rad":
            angles[1] = value
        elif name == "friction_asymmetry":
            imperfections = replace(imperfections, friction=value)
        else:
            pad, key = name.removeprefix("pad").split("_", 1)
            changed: dict[str, Any] = {fields_of[key]: value}
            pads[int(pad) - 1] = replace(pads[int(pad) - 1], **changed)
    return replace(imperfections, angles=(angles[0], angles[1]), pads=tuple(pads))


def names(contradicted: Iterable[float]) -> tuple[str, ...]:
    """Names of the contradicted constants."""
    return tuple(name for name, z in zip(RIG_NAMES, contradicted, strict=False) if z != 0.0)


# ---------------------------------------------------------------------------------------------------- the study


VERDICTS = ("right", "with others", "wrong", "none")
NAMES = [each.name for each in MISCALIBRATIONS]


def verdict(miscalibration: Miscalibration, named: Sequence[str]) -> str:
    """`right`: only the wrong constants are named; `with others`: others too; `wrong`: only others; `none`: nothing."""
    if not named:
        return "none"
    right = {*miscalibration.constants, *miscalibration.as_well}
    if not right & set(named):
        return "wrong"
    return "right" if set(named) <= right else "with others"


def _early(what: str) -> Cell:
    return count(lambda row: verdict(of_name(row.off), row.named_early) == what)


COLUMNS: list[tuple[str, Cell]] = [
    ("accepted", count_of(lambda row: row.accepted)),
    ("µm", accepted(quantiles(lambda row: row.e_h_m, 1e6))),
    ("error / sd: median", accepted(quantiles(lambda row: row.e_h_m / row.h_sd_m))),
    ("most", accepted(most(lambda row: row.e_h_m / row.h_sd_m))),
    ("> 3 sd", count(lambda row: row.far)),
    ("constant within 2 sd", accepted(count(lambda row: row.z <= 2.0))),
    *((f"named: {what}", _early(what)) for what in VERDICTS),
    ("in the end: right", count(lambda row: verdict(of_name(row.off), row.named) == "right")),
]


def totals(rows: Sequence[MiscalibrationRow]) -> list[str]:
    """Numbers of overconfident accepted runs by kind of rig."""
    lines = []
    for world in dict.fromkeys(row.taken_for for row in rows):
        some = [row for row in rows if row.accepted and row.taken_for == world]
        plain = [row for row in some if not of_name(row.off).blind]
        lines.append(
            f"{world}: {sum(row.far for row in some)} of {len(some)} accepted have errors above {FAR:g} sd, "
            f"{sum(row.far for row in plain)} of {len(plain)} where touch can determine the whole mis-calibration"
        )
    return lines


def remark(row: MiscalibrationRow) -> str:
    """On rejected and on overconfident runs."""
    overconfident = f"error {1e6 * row.e_h_m:.0f} µm, sd {1e6 * row.h_sd_m:.0f} µm" if row.far else ""
    return overconfident if row.accepted else row.reason


STUDY = Study(
    "mis-calibration",
    draw,
    run,
    MiscalibrationRow,
    order=lambda row: (TAKEN_FOR.index(row.taken_for), NAMES.index(row.off), row.seed),
    by=lambda row: f"{row.taken_for}: {row.off}",
    columns=COLUMNS,
    totals=totals,
    title=lambda row: f"{row.off}, {row.kind} {row.seed}",
    remark=remark,
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The study's arguments."""
    harness.add_arguments(
        parser, runs=4, seconds_each=20.0, output="miscalibration.jsonl", what="how many runs of each"
    )
    add = parser.add_argument
    add("--taken-for", choices=TAKEN_FOR, nargs="+", default=TAKEN_FOR, metavar="WORLD",
        help=f"the rest of the rig: {', '.join(TAKEN_FOR)} (default: both)")  # fmt: skip
    add("--only", choices=NAMES, nargs="+", default=NAMES, metavar="WHAT",
        help=f"mis-calibrations: {'; '.join(NAMES)} (default: all)".replace("%", "%%"))  # fmt: skip
