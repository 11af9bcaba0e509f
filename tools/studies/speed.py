"""How fast palmd is on this machine, told as ratios: each figure beside a reference, in turns, within one run.

A machine that others keep busy halves its own speed from one second to the next, so that a time alone tells little.
Two things that take turns suffer alike. All times are of the processor, not of the clock.
"""

from __future__ import annotations

import math
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, partial

import numpy as np

from palmd import observer
from palmd.events import PadSample, PalmSample
from palmd.model import shape_map, smoothing
from palmd.model.compiled import LANES, Library
from palmd.model.outputs import rig_inputs
from palmd.model.shape_map import Z
from palmd.motion.rollout_predictor import Moves, RolloutPredictor
from palmd.observer.bank_observer import BankObserver
from palmd.observer.filters.shape_map import ShapeFilters
from palmd.observer.reconstruct import reconstruct
from palmd.observer.reduction import Compiled, ReadingRows, StepRows, Twin, arithmetic
from palmd.record.eventlog import EventLog
from palmd.record.replay import PERIOD_S, as_said, replay, texts
from palmd.rig.shapes import Kind
from palmd.system.description import RigDescription
from tools.studies.simulated import simulated

KIND: Kind = "rig"
SEED = 101
BANK = 64
LEAST_S = 0.01  # of processor time that one turn takes at least
_TICKS = 100.0  # of a record that begins
_SQUARE = 256  # numbers across, of the matrices that tell what a core can do
_WIDE = 1 << 22  # numbers, more than caches hold

Work = Callable[[], object]


@dataclass(frozen=True, slots=True)
class Contest:
    """A piece of palmd and its reference; of both, how much a call does (`amounts`): times are told for one of it.

    `theirs` may be a time (s) that is what it is, such as real time. `goal`: what the ratio theirs/ours is to be at
    least; None where there is no goal. `once`: a call takes so long that it is not repeated within a turn.
    """

    name: str
    beside: str
    ours: Work
    theirs: Work | float
    amounts: tuple[float, float] = (1.0, 1.0)
    goal: float | None = None
    once: bool = False


@dataclass(frozen=True, slots=True)
class Figure:
    """What came of a contest: both times (s, medians), the median of the ratios theirs/ours and the worst of them."""

    name: str
    beside: str
    ours: float
    theirs: float
    ratio: float
    worst: float
    goal: float | None

    @property
    def met(self) -> bool:
        """Whether the goal is."""
        return self.goal is None or self.ratio >= self.goal


def figure(contest: Contest, turns: int) -> Figure:
    """Let both take so many turns."""
    ours, theirs = (_timed(each, contest.once) for each in (contest.ours, contest.theirs))
    times = np.array([(ours() / contest.amounts[0], theirs() / contest.amounts[1]) for _ in range(turns)])
    ratios = times[:, 1] / times[:, 0]
    one, other = np.median(times, axis=0).tolist()
    middle, worst = float(np.median(ratios)), float(ratios.min())
    return Figure(contest.name, contest.beside, one, other, middle, worst, contest.goal)


def _timed(work: Work | float, once: bool) -> Callable[[], float]:
    """One turn of it: the processor time of a call (s)."""
    if isinstance(work, float):
        return lambda: work
    calls = 1
    if not once:
        work()  # what is paid but once
        calls = max(1, math.ceil(LEAST_S / max(_taken(work, 1), 1e-7)))
    return lambda: _taken(work, calls)


def _taken(work: Work, calls: int) -> float:
    begun = _processor_s()
    for _ in range(calls):
        work()
    return (_processor_s() - begun) / calls


def _processor_s() -> float:
    """Of this process and of those that it has waited for (s)."""
    return time.process_time() + sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2])


# ---- what is compared


def kernels() -> Iterator[Contest]:
    """Filters side by side against one alone, and against what a core can do."""
    library, side_by_side = shape_map.library(), (float(LANES), 1.0)
    for name, goal in (("predict", 2.0), ("update_s1", 1.5)):
        both = (_bound(library, f"{name}_block", LANES), _bound(library, name, 1))
        yield Contest(f"{name} of a filter, {LANES} side by side", "one alone", *both, side_by_side, goal)
    square = np.random.default_rng(SEED).standard_normal((_SQUARE, _SQUARE))
    flops = 2.0 * _SQUARE**3
    operations = _operations()
    if operations:
        yield Contest(
            "a sum or product in `predict`", "one in a product of matrices", _bound(library, "predict_block", LANES),
            lambda: square @ square, (operations * LANES, flops),
        )  # fmt: skip
    steps = (_bound(smoothing.library(), "step_batch", LANES), _bound(library, "predict_block", LANES))
    yield Contest("a step of the smoother, Jacobian too", "`predict`", *steps, (float(LANES), float(LANES)))


def routines() -> Iterator[Contest]:
    """What is C by hand against its twin in NumPy."""
    yield Contest(f"a reading in a bank of {BANK}, prediction too", "its twin", _fusing(True), _fusing(False), goal=1.1)
    yield Contest("a reading in the filter that leads", "its twin", _fusing(True, 1), _fusing(False, 1), goal=3.0)
    wide, copy = np.ones(_WIDE), np.empty(_WIDE)
    bank = ShapeFilters(RigDescription(), BANK).bank
    past = bank.blank()
    numbers = (BANK * (bank.n**2 + bank.n + 2.0), float(_WIDE))
    both = (partial(bank.remember, past), partial(np.copyto, copy, wide))
    yield Contest("a number of a bank remembered", "one of a large array copied", *both, numbers)
    compiled = arithmetic()
    if isinstance(compiled, Compiled):
        work = (_reduced(compiled), _reduced(Twin()))
        yield Contest("the smoother's equations of 4 s: assembled, reduced", "their twin", *work, goal=2.0)
    yield Contest("64 rollouts of 1.2 s", "their twin", _rolling(True), _rolling(False), goal=1.2)


def ticks() -> Iterator[Contest]:
    """Ticks of the loop's observer, by what carries the object, with everything that they do in Python."""
    both = (_looking(True), _looking(False))
    yield Contest("a tick that looks for the object", "its twin", *both, (_TICKS, _TICKS), goal=1.5)


def starts() -> Iterator[Contest]:
    """Processes, up to where they can begin."""
    yield Contest("the daemon's modules", "NumPy's", _importing("palmd.daemon.app"), _importing("numpy"), once=True)
    offline = "palmd.cli.reconstruct, palmd.observer.reconstruct, palmd.record.systems.two_palms, palmd.record.result"
    yield Contest("modules of `palmd reconstruct`", "NumPy's", _importing(offline), _importing("numpy"), once=True)


def records(lengths: Sequence[float]) -> Iterator[Contest]:
    """Whole records against their own time: how many times faster than real time they are worked off."""
    for seconds in lengths:
        work, per = partial(estimated, seconds), (seconds, 1.0)
        yield Contest(f"estimate with the smoother, of {seconds:g} s", "real time", work, 1.0, per, 20.0, once=True)
    seconds = lengths[0]
    log = record(seconds)

    def whole() -> object:
        return reconstruct(log.events, log.rig, SEED)

    yield Contest(f"reconstruct, of {seconds:g} s", "real time", whole, 1.0, (seconds, 1.0), 25.0, once=True)


@cache
def record(seconds: float) -> EventLog:
    """A simulated run of so many seconds, always the same."""
    return simulated(KIND, SEED, seconds)[0]


def estimated(seconds: float) -> None:
    """What `palmd estimate` does with it, but read and write files."""
    log = record(seconds)
    watcher = observer.make("shape", log.rig, smoothing=observer.Simulated(log.rig))
    for said in map(as_said, replay(log, watcher)):
        for _ in texts(said):
            pass


def _bound(library: Library, name: str, columns: int) -> Work:
    told = library.signatures[name]
    random = np.random.default_rng(SEED)
    counts = [1 if i in told.shared or not told.columns else columns for i in range(len(told.inputs))]
    inputs = [random.uniform(0.2, 0.9, count * size) for count, (_, size) in zip(counts, told.inputs, strict=True)]
    return library.bind(name, inputs, [np.zeros(columns * size) for _, size in told.outputs])


def _operations() -> int:
    """How many arithmetic operations `predict` takes for a filter; 0 without CasADi, which knows."""
    try:
        from palmd.model.kernels import densified

        function = densified(shape_map.predict_function())
    except ImportError:
        return 0
    return int(function.n_instructions())


def _fusing(compiled: bool, size: int = BANK) -> Work:
    filters = ShapeFilters(RigDescription(), size, compiled=compiled)
    bank, palms = filters.bank, filters.tracker(2e-4)
    for k in range(3):
        palms.feed(PalmSample(0.016 * k, (0.8, 1.6), (0.1, 0.0), (0.0, 0.0)))
    x = np.zeros((bank.size, bank.n))
    x[:, Z.LN_RHO], x[:, Z.MU], x[:, Z.LN_DITHER] = math.log(0.012), 0.1, math.log(0.02)
    x[:, Z.SHAPE] = 0.02
    covariance = 1e-6 * np.eye(bank.n)
    sample = PadSample(0.037, 1, 0.02, 1.0)

    def work() -> None:
        bank.x[:], bank.P[:] = x, covariance
        filters.carry(0.032, 0.037, palms, 1.0)
        filters.fuse_pad(sample, 1e-8, palms, 1.0)

    return work


def _looking(compiled: bool) -> Work:
    """`_TICKS` ticks of a blind start, one after the other."""
    log = record(_TICKS * PERIOD_S)
    filters = ShapeFilters(log.rig, observer.SHAPE_BANK, compiled=compiled)
    watcher = BankObserver(filters, log.rig)

    def work() -> None:
        watcher.reset()
        for _ in replay(log, watcher):
            pass

    return work


def _residuals(seconds: float = 4.0) -> tuple[StepRows, list[ReadingRows]]:
    """Of the smoother's equations, of random numbers: as many as in so much of a record."""
    random, count, constants = np.random.default_rng(SEED), round(100 * seconds), smoothing.CONSTANTS
    x = random.standard_normal((count + 1, smoothing.NODE))
    jacobian = 0.1 * random.standard_normal((count, smoothing.NODE + constants, smoothing.NODE))
    steps = StepRows(x, x[1:] + 1e-3, jacobian, np.ones((count, smoothing.NODE)))
    kinds = []
    for _ in range(2):
        step = np.sort(random.integers(0, count, 2 * count))
        gradient = random.standard_normal((len(step), 2 * smoothing.NODE + constants))
        kinds.append(ReadingRows(step, gradient, random.standard_normal(len(step)), np.ones(len(step))))
    return steps, kinds


def _reduced(does: Compiled | Twin) -> Work:
    steps, readings = _residuals()

    def work() -> None:
        made = does.assembled(steps, readings)
        does.reduced(made.banded, np.full(smoothing.NODE, 1e-3), made.rows, made.corner)

    return work


def _rolling(compiled: bool) -> Work:
    predictor = RolloutPredictor(rig_inputs(RigDescription()), compiled=compiled)
    random = np.random.default_rng(SEED)
    state = np.zeros(shape_map.N)
    state[Z.LN_RHO], state[Z.MU], state[Z.LN_DITHER], state[Z.SHAPE] = math.log(0.012), 0.1, math.log(0.02), 0.02
    start = np.radians((45.0, 90.0))
    ends = start + 0.1 * random.standard_normal((64, 2, 2))
    moves = Moves(start, ends, np.full((64, 2), 0.6))
    return lambda: predictor.of(state, moves)


def _importing(modules: str) -> Work:
    command = [sys.executable, "-c", f"import {modules}"]
    keeping = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return lambda: subprocess.run(command, check=True, env=keeping)
