"""Reproducibility check: feed a run's events to the same observer again and compare the estimates bit for bit.

An observer is a function of the events, the tick times and the smoother's answers, and a run holds all of them. On the
same machine with the same versions the estimates are identical to the last bit.
"""

from __future__ import annotations

import math
import platform
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import version

import msgpack

from palmd import __version__
from palmd.blas import one_thread
from palmd.messages import Fields
from palmd.quantities import LOOP
from palmd.record.run import AnyRun, RunError
from palmd.record.tables import flat


@dataclass(frozen=True, slots=True)
class Difference:
    """A field of a tick's estimate that differs; `sigmas` is the difference in recorded standard deviations."""

    number: int
    name: str
    recorded: object
    now: object
    sigmas: float


@dataclass(frozen=True, slots=True)
class CheckedTick:
    """The result for one tick: its differing fields, empty if every bit agrees."""

    number: int
    differences: tuple[Difference, ...]


class Recheck:
    """Feeds a run to the observer it was made with, a new one for each start of the daemon."""

    def __init__(self, run: AnyRun) -> None:
        """Raises RunError for a run without events or estimates; takes seconds if C must be compiled."""
        run.require(run.topics.events, run.topics.estimate)
        self._run, self._observer = run, run.observer()

    def ticks(self) -> Iterator[CheckedTick]:
        """Check every tick from number 0 to the first missing one; raises RunError if there is no tick 0."""
        estimates = (message.fields for message in self._run.messages(self._run.topics.estimate.name))
        recorded = next(estimates, None)
        expected: int | None = None
        begins, started = -1, False
        for tick in self._run.ticks():
            if begins < 0:
                begins = tick.number
            if tick.number == 0:
                self._observer = self._run.observer() if started else self._observer
                expected, started = 0, True
            if tick.number != expected:
                expected = None
                continue
            expected += 1
            with one_thread():
                for event in tick.events:
                    self._observer.feed(event)
                self._observer.improve(tick.t)
                estimate = self._observer.estimate(tick.t)
            now = self._run.codec.estimate_fields(estimate)
            t_ns = round(tick.t * 1e9)
            while recorded is not None and recorded["mono_ns"] < t_ns:
                recorded = next(estimates, None)
            if recorded is not None and recorded["mono_ns"] == t_ns:
                yield CheckedTick(tick.number, tuple(differences(tick.number, recorded, now)))
        if not started:
            raise RunError(f"{self._run.path}: begins with tick {begins}; the observer's state before is not recorded")

    def environment_differences(self) -> list[str]:
        """Differences in versions, machine and backend between the recording and now; they may change the last bits."""
        here = {
            "palmd": __version__,
            "python": platform.python_version(),
            "numpy": version("numpy"),
            "casadi": version("casadi"),
            "machine": platform.machine(),
        }
        recorded = dict(self._run.metadata)
        loop = next(iter(self._run.messages(LOOP.name)), None)
        if loop is not None:
            recorded["backend"], here["backend"] = str(loop.fields.get("backend")), self._observer.backend
        return [f"{name} {recorded[name]}, here {now}" for name, now in here.items() if recorded.get(name, now) != now]


def differences(number: int, recorded: Fields, now: Fields) -> Iterator[Difference]:
    """The fields of a tick's `palm/estimate` in which `now` differs from `recorded` in any bit.

    The daemon may invalidate an estimate that the observer calls valid, for example while the pads are swapped; such a
    recorded `valid` of False is not a difference.
    """
    before_by_name = dict(flat(recorded))
    for name, value in flat(now):
        before = before_by_name.get(name)
        withheld = name == "valid" and before is False
        if not withheld and msgpack.packb(before) != msgpack.packb(value):
            yield Difference(number, name, before, value, _sigmas(before_by_name.get(f"sd.{name}"), before, value))


def _sigmas(sd: object, before: object, value: object) -> float:
    if isinstance(sd, float) and isinstance(before, float) and isinstance(value, float) and sd > 0.0:
        return abs(value - before) / sd
    return math.nan
