"""What better parts would bring: the bound on the outline's error for rigs of other noise, play and rates.

The same simulated runs are looked at as if each rig had read them: the posterior Cramér–Rao bound asks only when there
were readings and how good they are. What motion hardly tells, above all how high the pads lie over the hinge line, is
in it; the flicker of single angles is not, for the palms' path is smooth.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from palmd.config.two_palms import Config, rig_description
from palmd.events import Event, PadLift, PalmSample
from palmd.observer.bound import cramer_rao
from palmd.rig.shapes import Kind
from palmd.system.description import RigDescription
from palmd.system.mechanism import PALMS
from tools.studies.scoring import truth_of
from tools.studies.simulated import simulated


@dataclass(frozen=True, slots=True)
class Parts:
    """One rig to look at, as far as it differs from the configured one; `every`: only each so many-th reading."""

    name: str
    noise_mm: float | None = None
    backlash_deg: float | None = None
    every: int = 1
    standoff_mm: float | None = None

    def described(self, config: Config) -> RigDescription:
        """What an observer of it is told."""
        rig = rig_description(config)
        if self.noise_mm is not None:
            rig = rig.with_pads(noise=self.noise_mm * 1e-3)
        if self.standoff_mm is not None:
            rig = rig.with_pads(standoff_sd=self.standoff_mm * 1e-3)
        if self.backlash_deg is not None:
            known, play = config.rig.angle_sd_deg, 0.5 * self.backlash_deg
            rig = replace(rig, angle_sd=math.radians(math.hypot(known, play)))
        return rig


LOOKED_AT: tuple[Parts, ...] = (
    Parts("as configured"),
    Parts("strips of 0.05 mm", noise_mm=0.05),
    Parts("strips of 0.1 mm", noise_mm=0.1),
    Parts("strips of 0.3 mm", noise_mm=0.3),
    Parts("no play", backlash_deg=0.0),
    Parts("play of 0.5°", backlash_deg=0.5),
    Parts("play of 1°", backlash_deg=1.0),
    Parts("half as many readings", every=2),
    Parts("a fifth of the readings", every=5),
    Parts("surfaces known to 0.05 mm", standoff_mm=0.05),
    Parts("that, strips of 0.05 mm, no play", noise_mm=0.05, backlash_deg=0.0, standoff_mm=0.05),
)


@dataclass(frozen=True, slots=True)
class PartsRow:
    """One run as one rig would have read it: RMS and largest bound of the outline where touched (m), of ρ (share)."""

    parts: Parts
    seed: int
    h_sd_m: float
    h_most_m: float
    rho_share: float


def rows(
    config: Config, kind: Kind, seeds: Sequence[int], seconds: float, looked_at: Sequence[Parts] = LOOKED_AT
) -> Iterator[PartsRow]:
    """Each run as each rig would have read it."""
    for seed in seeds:
        log, told = simulated(kind, seed, seconds)
        truth = truth_of(told)
        for parts in looked_at:
            rig = replace(parts.described(config), hinge=log.rig.hinge, base=log.rig.base)
            bound = cramer_rao(thinned(log.events, parts.every), rig, truth, truth.theta)
            best = float(np.min(bound.h_sd))
            touched = bound.h_sd[bound.h_sd < 2.0 * best]  # where nobody has been, only the prior is known
            rms = math.sqrt(float(np.mean(touched**2)))
            yield PartsRow(parts, seed, rms, float(np.max(touched)), bound.rho_sd / truth.rho)


def thinned(events: Sequence[Event], every: int) -> list[Event]:
    """Only each so many-th reading of each pad, and of the palms; lift-offs all."""
    count = dict.fromkeys((0, *PALMS), 0)
    kept: list[Event] = []
    for event in events:
        if isinstance(event, PadLift):
            kept.append(event)
            continue
        of = 0 if isinstance(event, PalmSample) else event.pad
        if count[of] % every == 0:
            kept.append(event)
        count[of] += 1
    return kept
