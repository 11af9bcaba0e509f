"""One daemon's long life in virtual time: calm or with mischief all the time, and what it holds meanwhile."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass

from tools.studies.simulation.happenings import CALM_S, TROUBLE_S, Happening, Restart, Scenario, drawn
from tools.studies.simulation.held import EVERY_S, Holdings, Leak
from tools.studies.simulation.run import Simulation, quiet
from tools.studies.simulation.standstill import LIVELY
from tools.studies.simulation.watch import Breach

BLOCK_S = TROUBLE_S + CALM_S
_TINY_S = 1e-6


@dataclass(frozen=True, slots=True)
class Life:
    """How long it was (h), how often the motion was held, what was broken, what the daemon holds, and who leaks."""

    hours: float
    holds: int
    breach: Breach | None
    held: Leak
    leaks: tuple[Leak, ...]


def calm(hours: float, seed: int) -> Scenario:
    """So long nothing happens."""
    return Scenario(seed, LIVELY, False, 0.2, (0.001,) * 3, (), (), trouble_s=hours * 3600.0)


def troubled(hours: float, seed: int) -> Scenario:
    """So long what happens in the runs of one seed after the other, but that the daemon is never begun anew."""
    blocks = max(1, round(hours * 3600.0 / BLOCK_S))
    happenings = tuple(each for number in range(blocks) for each in _moved(drawn(seed + number), number * BLOCK_S))
    return dataclasses.replace(
        calm(hours, seed), happenings=happenings, kept=tuple(range(len(happenings))), trouble_s=blocks * BLOCK_S
    )


def _moved(scenario: Scenario, by_s: float) -> Iterator[Happening]:
    for each in scenario.happenings:
        if not isinstance(each, Restart):
            yield dataclasses.replace(each, t=each.t + by_s)


def live(scenario: Scenario, every_s: float = EVERY_S) -> Life:
    """Live through it, looking every so many seconds at what is held."""
    with quiet():
        simulation = Simulation(scenario)
        clock, watch = simulation.machine.clock, simulation.watch
        holdings, t_look = Holdings(), every_s
        while clock.now < scenario.trouble_s and watch.breach is None:
            simulation.step()
            if clock.now >= t_look - _TINY_S:
                t_look += every_s
                holdings.sample(simulation.loop, clock.now)
    holds = watch.sometimes["tracking -> hold"] + watch.sometimes["tracking -> fault"]
    return Life(clock.now / 3600.0, holds, watch.breach, holdings.together(), tuple(holdings.leaks()))
