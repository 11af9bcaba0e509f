"""What is compiled for observing two palms. Nothing of it is loaded before it is made."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, get_args

from palmd.events import ObserverName

if TYPE_CHECKING:
    from palmd.config.two_palms import Config

Part = tuple[str, Callable[[], str]]
"""What it is, and what makes it or finds it made, and says how it runs."""


def needed(config: Config | None) -> list[Part]:
    """What the processes of a run with this configuration load; without one, what any with flat palms do."""
    if config is None:
        return [*(_observer(name) for name in get_args(ObserverName) if name != "shape"), *of_palms(curved=False)]
    if config.observer.primary == "shape":
        return of_palms(any(config.rig.curvatures_per_m))
    return [_observer(config.observer.primary)]


def _observer(name: ObserverName) -> Part:
    from palmd import observer
    from palmd.system.description import RigDescription

    return f"{name} observer", lambda: observer.make(name, RigDescription()).backend


def of_palms(curved: bool) -> list[Part]:
    """What observing, smoothing and exploring on two palms take."""
    from palmd.model import rollout, sensitivity, shape_map, smoothing

    which = "curved palms, " if curved else ""
    parts: list[Part] = [
        (f"{which}shape observer", lambda: shape_map.library(curved=curved).backend),
        (
            f"{which}shape observer with a smoother's harmonics",
            lambda: shape_map.library(smoothing.ORDER, curved).backend,
        ),
        (f"{which}observability", lambda: sensitivity.library(curved).backend),
        (f"{which}smoother", lambda: smoothing.library(curved).backend),
        (f"{which}explorer", lambda: rollout.library(curved).backend),
    ]
    # a smoother of any palms reduces its equations by the C that comes with flat ones
    return [*parts, ("smoother's equations", lambda: smoothing.library().backend)] if curved else parts
