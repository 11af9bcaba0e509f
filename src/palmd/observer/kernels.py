"""The compiled parts that observers of two palms need. Nothing is loaded before it is needed."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, get_args

from palmd.events import ObserverName

if TYPE_CHECKING:
    from palmd.config.two_palms import Config

Part = tuple[str, Callable[[], str]]
"""Name of a part, and the function that compiles or finds it and returns its backend."""


def needed(config: Config | None) -> list[Part]:
    """Parts that a run with this configuration loads; without a configuration those of any run with flat palms."""
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
    """Parts for observing, smoothing and exploring on two palms."""
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
    # a smoother of curved palms, too, solves its equations with the C code in the library of flat ones
    return [*parts, ("smoother's equations", lambda: smoothing.library().backend)] if curved else parts
