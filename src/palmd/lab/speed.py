"""How fast palmd is on this machine, told as ratios: each figure beside a reference, in turns, within one run.

A machine that others keep busy halves its own speed from one second to the next, so that a time alone tells little.
Two things that take turns suffer alike. All times are of the processor, not of the clock.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from palmd.lab.simulated import simulated
from palmd.model import shape_map, smoothing
from palmd.model.compiled import LANES, Library
from palmd.observer.reconstruct import reconstruct
from palmd.observer.reduction import Compiled, Twin, arithmetic
from palmd.record.eventlog import EventLog

KIND, SEED = "rig", 101
BANK, STATES = 64, shape_map.N
LEAST_S = 0.02  # of processor time that one turn takes at least
_WIDE = 1 << 22  # numbers, more than a cache holds
_ACROSS = 384  # of the square matrices that tell what a core can do

Work = Callable[[], object]


@dataclass(frozen=True, slots=True)
class Contest:
    """Something and what it is compared with: `unit` and `scale` tell both times, `of` how often each does it a call.

    `goal` is what the ratio theirs/ours is to be at least; None where there is no goal.
    """

    name: str
    beside: str
    ours: Work
    theirs: Work
    unit: str = "µs"
    of: tuple[float, float] = (1.0, 1.0)
    goal: float | None = None


@dataclass(frozen=True, slots=True)
class Figure:
    """What came of a contest: both figures in `unit` (medians), and the median and the lower quartile of the ratios."""

    name: str
    beside: str
    unit: str
    ours: float
    theirs: float
    ratio: float
    low: float
    goal: float | None

    @property
    def met(self) -> bool:
        """Whether the goal is."""
        return self.goal is None or self.ratio >= self.goal


def figure(contest: Contest, turns: int) -> Figure:
    """Let both take so many turns."""
    calls = [_calls(work) for work in (contest.ours, contest.theirs)]
    times = np.array(
        [
            [_time(work, n) / of for work, n, of in zip((contest.ours, contest.theirs), calls, contest.of, strict=True)]
            for _ in range(turns)
        ]
    )
    ratios = times[:, 1] / times[:, 0]
    ours, theirs = np.median(times, axis=0) * {"µs": 1e6, "ms": 1e3, "s": 1.0}[contest.unit]
    low, middle = np.quantile(ratios, [0.25, 0.5])
    return Figure(
        contest.name, contest.beside, contest.unit, float(ours), float(theirs), float(middle), float(low), contest.goal
    )


def _calls(work: Work) -> int:
    work()  # what is paid once
    once = _time(work, 1)
    return max(1, round(LEAST_S / max(once, 1e-7)))


def _time(work: Work, calls: int) -> float:
    begun = time.process_time()
    for _ in range(calls):
        work()
    return (time.process_time() - begun) / calls


# ---- what is compared


def kernels() -> Iterator[Contest]:
    """Filters side by side against one alone, and against what a core can do."""
    library = shape_map.library()
    for name, goal in (("predict", 2.5), ("update_s1", 2.0)):
        yield Contest(
            f"{name} of one filter, {LANES} side by side", "alone", _bound(library, f"{name}_block", LANES),
            _bound(library, name, 1), of=(LANES, 1), goal=goal,
        )  # fmt: skip
    step = smoothing.library()
    yield Contest(
        "a step of the smoother with its Jacobian", "a filter's prediction", _bound(step, "step_batch", LANES),
        _bound(library, "predict_block", LANES), of=(LANES, LANES),
    )  # fmt: skip


def routines() -> Iterator[Contest]:
    """What is C by hand against its twin in NumPy."""
    both = [_fusing(compiled) for compiled in (True, False)]
    yield Contest(f"a reading in a bank of {BANK}, with its prediction", "twin", *both, goal=1.5)
    ticks = [_ticking(compiled, 0.6) for compiled in (True, False)]
    yield Contest("a tick while it looks for the object: 0.6 s of record", "twin", *ticks, unit="ms", goal=2.0)
    steps, readings = _residuals()

    def reduced(does: Compiled | Twin) -> Work:
        def work() -> object:
            made = does.assembled(steps, readings)
            return does.reduced(made.banded, np.ones(2), made.rows, made.corner)

        return work

    compiled = arithmetic()
    if isinstance(compiled, Compiled):
        yield Contest(
            "the smoother's equations, 4 s: assembled, reduced", "twin", reduced(compiled), reduced(Twin()),
            unit="ms", goal=3.0,
        )  # fmt: skip
    yield Contest("256 rollouts of 1.2 s", "twin", _rolling(True), _rolling(False), unit="ms", goal=1.5)


def records(lengths: Sequence[float]) -> Iterator[Contest]:
    """Whole records against their own time: the ratio is how many times faster than real time."""
    for seconds in lengths:
        log = record(seconds)
        yield Contest(
            f"`estimate` with the smoother, {seconds:g} s", "real time", lambda log=log: _estimated(log), _nothing,
            unit="s", goal=20.0,
        )  # fmt: skip
    log = record(lengths[0])
    yield Contest(
        f"`reconstruct`, {lengths[0]:g} s", "real time", lambda: reconstruct(log.events, log.rig, SEED), _nothing,
        unit="s", goal=25.0,
    )  # fmt: skip


def _nothing() -> None:
    """Real time, which takes none of the processor's."""


@cache
def record(seconds: float) -> EventLog:
    """A simulated run of so many seconds, always the same."""
    return simulated(KIND, SEED, seconds)[0]


def _bound(library: Library, name: str, columns: int) -> Work:
    told = library.signatures[name]
    random = np.random.default_rng(SEED)
    counts = [1 if i in told.shared or not told.columns else columns for i in range(len(told.inputs))]
    inputs = [random.uniform(0.2, 0.9, count * size) for count, (_, size) in zip(counts, told.inputs, strict=True)]
    return library.bind(name, inputs, [np.zeros(columns * size) for _, size in told.outputs])
