"""Whether the observer says again what it said: a run's events through the same observer, compared bit for bit.

An observer is a function of the events, the ticks' times and the smoother's answers, all of which a run holds. On the
same machine with the same versions nothing may differ, not even the last bit.
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
    """A field of a tick's estimate that is another now; `sigmas` is by how much, in its recorded one-sigma."""

    number: int
    name: str
    recorded: object
    now: object
    sigmas: float


@dataclass(frozen=True, slots=True)
class Checked:
    """What one tick has come to: its differences, none when every bit agrees."""

    number: int
    differences: tuple[Difference, ...]


class Recheck:
    """The observer that a run was made with, given the same again: a new one for each start of the daemon."""

    def __init__(self, run: AnyRun) -> None:
        """Raises RunError for a run without events or estimates; takes seconds when C has to be compiled."""
        run.require(run.topics.events, run.topics.estimate)
        self._run, self._observer = run, run.observer()

    def ticks(self) -> Iterator[Checked]:
        """Every recorded tick from a first one up to a missing one; raises RunError when no first one is there."""
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
                said = self._observer.estimate(tick.t)
            now = self._run.said(said)
            t_ns = round(tick.t * 1e9)
            while recorded is not None and recorded["mono_ns"] < t_ns:
                recorded = next(estimates, None)
            if recorded is not None and recorded["mono_ns"] == t_ns:
                yield Checked(tick.number, tuple(differences(tick.number, recorded, now)))
        if not started:
            raise RunError(f"{self._run.path}: begins with tick {begins}; what the observer knew by then is not in it")

    def elsewhere(self) -> list[str]:
        """In what the run's making, as far as that is known, differs from here, so that last bits may differ too."""
        here = {
            "palmd": __version__,
            "python": platform.python_version(),
            "numpy": version("numpy"),
            "casadi": version("casadi"),
            "machine": platform.machine(),
        }
        told = dict(self._run.metadata)
        loop = next(iter(self._run.messages(LOOP.name)), None)
        if loop is not None:
            told["backend"], here["backend"] = str(loop.fields.get("backend")), self._observer.backend
        return [f"{name} {told[name]}, here {now}" for name, now in here.items() if told.get(name, now) != now]


def differences(number: int, recorded: Fields, now: Fields) -> Iterator[Difference]:
    """The fields of a tick's `palm/estimate` in which `now` is another than `recorded`, to the last bit.

    The daemon may withhold an estimate that the observer calls valid, as while the pads are swapped: a `valid` that
    it has lowered is no difference.
    """
    told = dict(flat(recorded))
    for name, value in flat(now):
        before = told.get(name)
        withheld = name == "valid" and before is False
        if not withheld and msgpack.packb(before) != msgpack.packb(value):
            yield Difference(number, name, before, value, _sigmas(told.get(f"sd.{name}"), before, value))


def _sigmas(sd: object, before: object, value: object) -> float:
    if isinstance(sd, float) and isinstance(before, float) and isinstance(value, float) and sd > 0.0:
        return abs(value - before) / sd
    return math.nan
