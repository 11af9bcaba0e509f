"""Everybody on the same readings: errors against the truth, and time by step."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Protocol

import numpy as np

from palmd import observer
from palmd.events import Event, FloatArray, PadSample
from palmd.model import shape
from palmd.model.outputs import rig_inputs
from palmd.observer.bank import Bank
from palmd.observer.filters.shape_map import ShapeFilters
from palmd.score import score_outline
from palmd.system.description import RigDescription
from tools.studies.peers import generated, horizon, newton
from tools.studies.peers.filterpy_filters import FilterpyExtended, FilterpyUnscented
from tools.studies.peers.functions import functions
from tools.studies.peers.plain import PlainFilter
from tools.studies.peers.task import LostError, PeerReading, PeerStart, PeerTask, PeerTruth, blind, good

OWN, BANK = "palmd: one filter", "palmd: the bank"
_NORMALS = 360
_THETA: FloatArray = np.arange(_NORMALS, dtype=np.float64) * (math.tau / _NORMALS)
_GIVES_UP = (LostError, np.linalg.LinAlgError, ValueError)  # what linear algebra says of matrices gone wild

Tell = Callable[[int], None]


class Peer(Protocol):
    """One estimator on one run."""

    def step(self, reading: PeerReading) -> bool:
        """Predict to the reading and fuse it; False if this was not a whole step, and its time does not count."""

    def radii(self, reading: PeerReading) -> FloatArray:
        """(r1, r2) at the reading just taken (m)."""

    def outline(self) -> FloatArray | None:
        """Coefficients of h (m), None from a method without an outline."""


@dataclass(frozen=True, slots=True)
class PeerRow:
    """One line of the comparison; r_rms and e_h in m, NaN where there is none.

    us: the median step (µs of processor time). r_rms: over r1 and r2 in the last half. e_h: as in `score`, over the
    normals that were touched. ratio: to the step of `OWN` from the same start.
    """

    method: str
    start: str
    r_rms: float
    e_h: float
    us: float
    remark: str = ""
    ratio: float = math.nan


@dataclass(frozen=True, slots=True)
class Entry:
    """How to make one peer."""

    method: str
    make: Callable[[PeerStart], Peer]
    remark: Callable[[Peer], str] = field(default=lambda _peer: "")


def entries(task: PeerTask, truth: PeerTruth) -> tuple[Entry, ...]:
    """All of them but the bank; palmd's own comes first. Compiles and builds what they need when first made."""
    model, kernels, solver = cache(functions), cache(generated.library), cache(horizon.program)
    windows = cache(newton.window)
    rig = rig_inputs(task.rig)
    palms = task.palms
    first = np.array([*palms.angles, *palms.rates, *palms.accelerations])

    def newtons(form: newton.Form) -> Callable[[PeerStart], Peer]:
        return lambda start: newton.NewtonObserver(windows(form), start, first, rig, truth.mass)

    return (
        Entry(OWN, lambda start: generated.GeneratedFilter(kernels(), start), lambda _: "generated C"),
        Entry("NumPy EKF", PlainFilter, lambda _: "complex-step Jacobians"),
        Entry("filterpy EKF", lambda start: FilterpyExtended(model(), start), lambda _: "model: CasADi's VM"),
        Entry("filterpy UKF", lambda start: FilterpyUnscented(model(), start), lambda _: "model: CasADi's VM"),
        Entry(
            "CasADi/IPOPT MHE",
            lambda start: horizon.MovingHorizon(model(), solver(model()), start),
            lambda peer: peer.remark if isinstance(peer, horizon.MovingHorizon) else "",
        ),
        Entry("Newton window, v constant", newtons("constant"), lambda _: "ρ is that of the start"),
        Entry("Newton window, v eliminated", newtons("eliminated"), lambda _: "so is ρ; true mass, forces read"),
    )


def starts(task: PeerTask, truth: PeerTruth, seed: int) -> tuple[PeerStart, PeerStart]:
    """A good one and the blind one."""
    return good(task, truth, np.random.default_rng(seed)), blind(task)


def compete(entry: Entry, start: PeerStart, task: PeerTask, truth: PeerTruth, tell: Tell) -> PeerRow:
    """One peer through the whole run; `tell` hears how many readings are done."""
    peer = entry.make(start)
    times: list[float] = []
    errors: list[FloatArray] = []
    middle = (task.t_start + task.readings[-1].t) / 2
    with np.errstate(all="ignore"):
        for number, reading in enumerate(task.readings):
            tell(number)
            try:
                begun = time.thread_time()
                whole = peer.step(reading)
                took = time.thread_time() - begun
                off = peer.radii(reading) - truth.radii(reading.t)
                if not np.isfinite(off).all():
                    raise LostError("not finite")
            except _GIVES_UP as error:
                remark = f"lost after {reading.t - task.t_start:.2f} s: {str(error).splitlines()[0]}"
                return PeerRow(entry.method, start.name, math.nan, math.nan, _median_us(times), remark)
            if whole and len(reading.moves) == 1:
                times.append(took)
            if reading.t > middle:
                errors.append(off)
    e_h = _e_h(peer.outline(), truth)
    return PeerRow(entry.method, start.name, _rms(errors), e_h, _median_us(times), entry.remark(peer))


def bank_row(rig: RigDescription, events: Sequence[Event], task: PeerTask, truth: PeerTruth, tell: Tell) -> PeerRow:
    """The observer that the daemon runs, blind: its whole `feed` of a contact reading counts as a step."""
    watcher = observer.make("shape", rig)
    times: list[float] = []
    errors: list[FloatArray] = []
    middle = (task.t_start + task.readings[-1].t) / 2
    for number, event in enumerate(events):
        tell(number)
        begun = time.thread_time()
        watcher.feed(event)
        took = time.thread_time() - begun
        answer = watcher.estimate(event.t_sample)
        if isinstance(event, PadSample) and event.t_sample > middle:
            times.append(took)
            errors.append(np.array([answer.r1, answer.r2]) - truth.radii(event.t_sample))
    outline = watcher.shape(events[-1].t_sample)
    e_h = math.nan
    if outline is not None:
        coefficients: FloatArray = np.linalg.lstsq(shape.basis(outline.theta), outline.h, rcond=None)[0].astype(float)
        e_h = _e_h(coefficients, truth)
    remark = "as the daemon runs it: late events, fading, rivals"
    return PeerRow(BANK, "blind", _rms(errors), e_h, _median_us(times), remark)


def with_ratios(rows: Sequence[PeerRow]) -> Iterator[PeerRow]:
    """Each row with its step as a multiple of `OWN`'s from the same start."""
    own = {row.start: row.us for row in rows if row.method == OWN}
    for row in rows:
        yield replace(row, ratio=row.us / own[row.start])


@dataclass(frozen=True, slots=True)
class BankTick:
    """Medians: a tick of `size` filters (ms) as two predictions and two readings, and of it one filter's step (µs)."""

    size: int
    tick_ms: float
    step_us: float


def bank_tick(task: PeerTask, start: PeerStart, size: int = 64, ticks: int = 400) -> BankTick:
    """Time the bare bank on the run's own readings, every filter started alike."""
    bank: Bank = ShapeFilters(task.rig, size).bank
    bank.refill()
    bank.x[:], bank.P[:] = start.x, start.P
    times = []
    pairs = list(zip(task.readings[0::2], task.readings[1::2], strict=False))[:ticks]
    for pair in pairs:
        begun = time.thread_time()
        for reading in pair:
            u = reading.moves[-1]
            bank.predict(float(u[0]), u[1:])
            bank.update(f"update_s{reading.pad}", reading.value, reading.variance, *reading.palms[:2])
        times.append(time.thread_time() - begun)
    tick = float(np.median(times))
    return BankTick(size, tick * 1e3, tick * 1e6 / (2 * size))


def _e_h(coefficients: FloatArray | None, truth: PeerTruth) -> float:
    if coefficients is None or not np.isfinite(coefficients).all():
        return math.nan
    return score_outline(_THETA, shape.basis(_THETA) @ coefficients, truth.touched(_THETA), truth.h).e_h


def _rms(errors: Sequence[FloatArray]) -> float:
    return math.sqrt(float(np.mean(np.square(errors)))) if errors else math.nan


def _median_us(times: Sequence[float]) -> float:
    return (float(np.median(times)) - _clock_s()) * 1e6 if times else math.nan


@cache
def _clock_s() -> float:
    """What reading the processor's time costs itself: half a microsecond, a tenth of palmd's step."""
    stamps = [time.thread_time() for _ in range(10_001)]
    return float(np.median(np.diff(stamps)))
