"""Simulated runs as an observer receives them, with their truth."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from palmd.events import Event, PadSample, PalmSample
from palmd.observer.observer import LiveObserver
from palmd.record.eventlog import read_log
from palmd.rig.imperfections import PERFECT, Imperfections
from palmd.rig.plant import AS_ASSUMED, PlantOptions
from palmd.rig.shapes import Body, random_body
from palmd.rig.simulate import simulate_log
from palmd.system.description import RigDescription
from palmd.system.vibration import AVERAGED, Vibration
from tools.studies.bound import Truth
from tools.studies.simulated import written

TICK_S = 0.01


@dataclass(frozen=True)
class Run:
    events: tuple[Event, ...]
    rig: RigDescription
    truth: Truth
    palms: np.ndarray  # φ1, φ2 at the truth's times


@cache
def simulated(
    kind: str,
    seed: int,
    seconds: float,
    options: PlantOptions = AS_ASSUMED,
    rests: tuple[tuple[float, float], ...] = (),
    absences: tuple[tuple[float, float], ...] = (),
    body: Body | None = None,
    imperfections: Imperfections = PERFECT,
    vibration: Vibration = AVERAGED,
) -> Run:
    """A run whose rig is described as exactly known."""
    lines, truth = simulate_log(
        kind, seed, seconds, options, body, rests=rests, absences=absences, imperfections=imperfections,
        vibration=vibration,
    )  # fmt: skip
    with written(lines) as path:
        log = read_log(path)
    columns = (np.array(truth[name]) for name in ("theta_rad", "h_m", "t", "psi_rad", "omega0_rad_s"))
    constants = (truth[name] for name in ("rho_m", "mu", "mass_kg", "dither_m_s", "damping_m2_s"))
    palms = np.column_stack([truth["phi1_rad"], truth["phi2_rad"]])
    return Run(log.events, log.rig, Truth(*constants, *columns), palms)


def swapped(kind: str, seed: int, at: float, gap: float, seconds: float) -> tuple[Run, Run, tuple[Event, ...]]:
    """Runs of two objects under the same palm motion; events of the first up to `at`, of the second from `gap` (s)."""
    random = np.random.default_rng([seed, 7])
    first, second = (simulated(kind, seed, seconds, body=random_body(kind, random)) for _ in range(2))
    assert np.allclose(first.palms, second.palms), "a contact was lost and the motion redrawn: use another seed"
    late = [event for event in second.events if is_pad(event) and event.t_sample >= at + gap]
    early = [event for event in first.events if not is_pad(event) or event.t_sample < at]
    return first, second, tuple(sorted([*early, *late], key=lambda event: event.t_sample))


def watched(
    watcher: LiveObserver, events: Sequence[Event], until: float | None = None, since: float = 0.0
) -> Iterator[Any]:
    """Estimates every 10 ms of an observer that receives the events in time order, to the last or until `until` (s)."""
    waiting = deque(events)
    for tick in range(1, round(((events[-1].t_sample if until is None else until) - since) / TICK_S) + 1):
        t = since + tick * TICK_S
        while waiting and waiting[0].t_sample <= t + 1e-9:
            watcher.feed(waiting.popleft())
        watcher.improve(t)
        yield watcher.estimate(t)
    for event in waiting if until is None else ():
        watcher.feed(event)


def is_pad(event: Event) -> bool:
    return isinstance(event, PadSample)


def pads_changed(events: Iterable[Event], change: Callable[[PadSample], PadSample]) -> list[Event]:
    return [change(event) if isinstance(event, PadSample) else event for event in events]


def palms_changed(events: Iterable[Event], change: Callable[[PalmSample], PalmSample]) -> list[Event]:
    return [change(event) if isinstance(event, PalmSample) else event for event in events]
