"""How soon the arm stands after a cause, in simulated time: the campaign's causes one at a time, many times each."""

from __future__ import annotations

import math
import random
from collections.abc import Iterator
from dataclasses import dataclass

from palmd.events import Joints
from palmd.rig.fault_injection import PADS
from tools.studies.simulation.happenings import Broken, Happening, Scenario, Trick
from tools.studies.simulation.light_rig import LightRig
from tools.studies.simulation.run import Simulation, quiet

STANDS_RAD_S = math.radians(0.5)
LIVELY = 1
EARLIEST_S, WATCHED_S = 5.0, 1.2
LASTS_S = 2.0
FOR_GOOD_S = 0.1  # of standing: later somebody may have started it again

CAUSES: tuple[tuple[str, Happening], ...] = (
    *(
        (f"{pad}-{name}", Trick(0.0, trick, pad, strength, LASTS_S))
        for pad in PADS
        for name, trick, strength in (
            ("dead", "unplug", 1.0),
            ("late", "late", 0.2),
            ("mute", "mute", 1.0),
            ("foreign", "misbaud", 1.0),
        )
    ),
    ("object-lifted", Trick(0.0, "lift", None, 1.0, LASTS_S)),
    ("arm-dead", Trick(0.0, "unplug", "arm", 1.0, LASTS_S)),
    ("arm-garbled", Trick(0.0, "garble", "arm", 0.2, LASTS_S)),
    ("arm-mute", Trick(0.0, "mute", "arm", 1.0, LASTS_S)),
    ("arm-foreign", Trick(0.0, "misbaud", "arm", 1.0, LASTS_S)),
    ("controller-break", Trick(0.0, "break", "arm", 1.0, LASTS_S)),
    ("controller-estop", Trick(0.0, "estop", "arm", 1.0, LASTS_S)),
    ("controller-power-off", Trick(0.0, "power_off", "arm", 1.0, LASTS_S)),
    ("observer-raises", Broken(0.0, "raises", LASTS_S)),
    ("observer-nan", Broken(0.0, "nan", LASTS_S)),
)
"""Of the fault campaign those that stop the arm while the host lives, and that nobody at the arm goes on with."""


@dataclass(frozen=True, slots=True)
class Standstill:
    """From the cause to the arm standing for good (s), NaN when it does not, and by how much a palm turned (rad)."""

    name: str
    seed: int
    still_s: float
    turned_rad: float


def standstills(times: int, seed: int) -> Iterator[Standstill]:
    """Every cause, `times` times, at another moment of a lively motion each."""
    for number in range(times):
        rng = random.Random(seed + number)
        for name, cause in CAUSES:
            t = EARLIEST_S + rng.uniform(0.0, 8.0)
            yield _one(name, _moved(cause, t), seed + number)


def _moved(cause: Happening, t: float) -> Happening:
    match cause:
        case Trick():
            return Trick(t, cause.name, cause.port, cause.strength, cause.for_s)
        case Broken():
            return Broken(t, cause.how, cause.for_s)
    raise ValueError(cause)


class _Look:
    """At the palms' true rates, at every step of the rig."""

    def __init__(self, rig: LightRig, t_cause: float) -> None:
        self.still_s = self.turned_rad = math.nan
        self.for_good = False
        self._rig, self._t_cause = rig, t_cause
        self._start: Joints = ()
        rig.lived = self._at

    def _at(self, t: float) -> None:
        palms, after_s = self._rig.palms(), t - self._t_cause
        if after_s < 0.0:
            self._start = palms.angles
        elif max(map(abs, palms.rates)) > STANDS_RAD_S:
            self.still_s = math.nan
        elif math.isnan(self.still_s):
            self.still_s = after_s
            self.turned_rad = max(abs(a - b) for a, b in zip(palms.angles, self._start, strict=True))
        else:
            self.for_good |= after_s > self.still_s + FOR_GOOD_S


def _one(name: str, cause: Happening, seed: int) -> Standstill:
    with quiet():
        simulation = Simulation(Scenario(seed, LIVELY, False, 0.2, (0.001,) * 3, (cause,), (0,)))
        assert isinstance(simulation.rig, LightRig)
        look = _Look(simulation.rig, cause.t)
        while simulation.machine.clock.now < cause.t + WATCHED_S and not look.for_good:
            simulation.step()
    return Standstill(name, seed, look.still_s, look.turned_rad)
