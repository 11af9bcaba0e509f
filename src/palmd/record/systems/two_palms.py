"""Two palms on a hinge: the system of logs without `rig.system`."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from palmd.events import ObserverName
from palmd.outlinefile import Outline
from palmd.record import verdict
from palmd.record.eventlog import EventLog, TwoPalmsLogParser
from palmd.record.outline_files import curves_factory
from palmd.record.systems import NotYetError, Reconstructed
from palmd.systems import TWO_PALMS

if TYPE_CHECKING:
    from palmd.observer.reconstruction import Reconstruction
    from palmd.record.replay import TickFields


class TwoPalms(TwoPalmsLogParser):
    """See `palmd.record.systems.System`; `estimate` and `reconstruct` import only the modules that each needs."""

    name = TWO_PALMS

    def known_to(self, log: EventLog, sds: Mapping[str, float]) -> EventLog:
        return replace(log, rig=log.rig.known_to(sds))

    def reconstruct(self, log: EventLog, seed: int, progress: Callable[[str], None] | None = None) -> Reconstructed:
        from palmd.observer.reconstruct import reconstruct
        from palmd.observer.static_mass import mass_at_rest
        from palmd.record.result import as_line

        answer = reconstruct(log.events, log.rig, seed, progress)
        at_rest = mass_at_rest(log.events, log.rig)
        line = as_line(answer, at_rest)
        text = verdict.in_one_line(line, summary(answer) if answer.converged else "")
        if math.isfinite(at_rest.value):
            text += f"; at rest {at_rest.value * 1e3:.1f} ± {at_rest.sd * 1e3:.1f} g"
        curves = curves_factory(
            answer.theta, answer.h, answer.h_sd, answer.touched, rho_m=answer.rho, mass_kg=answer.mass
        )
        return Reconstructed(line, text, curves, line["reason"] or "")

    def estimate(self, log: EventLog, observer: ObserverName, outlines: Sequence[Outline]) -> Iterator[TickFields]:
        from palmd import observer as observers
        from palmd.record.replay import replay, tick_fields

        if log.rig.curved and (reason := observers.flat_only(observer)):
            raise NotYetError(reason)
        smoothing = observers.Simulated(log.rig)
        live = observers.make(observer, log.rig, smoothing=smoothing, outlines=tuple(outlines))
        return map(tick_fields, replay(log, live))


SYSTEM = TwoPalms()


def summary(answer: Reconstruction) -> str:
    """One line on a converged result: outline's standard deviation where touched (RMS), the body's constants."""
    if answer.h_sd is None or answer.touched is None:
        raise ValueError("there is no outline")
    band = float(np.sqrt(np.mean(answer.h_sd[answer.touched] ** 2)))
    parts = [
        *([f"looks like: {answer.shape_class.text}"] if answer.shape_class.text else []),
        f"outline ± {band * 1e6:.1f} µm on {np.mean(answer.touched):.0%} of the normals",
        f"rho {answer.rho * 1e3:.2f} ± {answer.rho_sd * 1e3:.2f} mm",
        f"mu {answer.mu:z.4f} ± {answer.mu_sd:.4f}",
        f"mass {answer.mass * 1e3:.1f} ± {answer.mass_sd * 1e3:.1f} g" if math.isfinite(answer.mass) else "no mass",
        *(f"flat side or bridged dent of {1e3 * s:.1f} ± {1e3 * sd:.1f} mm" for _, s, sd in answer.sides.tolist()),
        f"explains {answer.lasts:.1f} s between {answer.t[0]:.1f} and {answer.t[-1]:.1f} s",
        f"{answer.seconds:.1f} s",
    ]
    return ", ".join(parts)
