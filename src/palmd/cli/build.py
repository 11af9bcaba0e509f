"""Compiles the observers into the cache, so that the first run need not; without a compiler it says so."""

from __future__ import annotations

import argparse
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import get_args

from palmd.console.configured import any_configured
from palmd.events import ObserverName
from palmd.pivot_config import AnyConfig, PivotConfig

_PATIENCE_S = 2.0

Part = tuple[str, Callable[[], str]]
"""What it is, and what makes it or finds it made, and says how it runs."""

_BACKENDS = {
    "c": "compiled C",
    "vm": "CasADi's virtual machine, no compiled C",
    "numpy": "NumPy, nothing to compile",
    "python": "Python, no compiled C",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument(
        "config",
        type=Path,
        nargs="?",
        metavar="CONFIG",
        help="what a run with this configuration needs, and no more (default: what any rig with flat palms needs)",
    )
    parser.add_argument(
        "--all",
        action="store_true",
        help="what other systems need too: curved palms, flat sides, three palms in space; a minute more",
    )


def run(arguments: argparse.Namespace) -> int:
    """Makes each set of kernels once; takes seconds for what is not in the cache yet."""
    if arguments.config is not None and not arguments.all:
        for each in needed_by(any_configured(arguments.config)):
            _told(*each)
        return 0
    for each in [*_observers(), *_of_palms(curved=False), *_beside(), *_emulated()]:
        _told(*each)
    if arguments.all:
        for each in [*_of_palms(curved=True), *_other_systems()]:
            _told(*each)
    return 0


def needed_by(config: AnyConfig) -> list[Part]:
    """What the processes of a run with this configuration load."""
    if isinstance(config, PivotConfig):
        return _beside()
    curved = any(config.rig.curvatures_per_m)
    if config.observer.primary == "shape":
        return _of_palms(curved)
    return [_observer(config.observer.primary)]


def made_ready(config: AnyConfig, tell: Callable[[str], None]) -> None:
    """Make what a run needs before its processes start, each of which would else compile; tell if it lasts."""
    patience = threading.Timer(_PATIENCE_S, tell, ["compiling what these palms need, once; it takes a minute or two"])
    patience.daemon = True
    patience.start()
    try:
        for _, make in needed_by(config):
            make()
    finally:
        patience.cancel()


def _observers() -> list[Part]:
    return [_observer(name) for name in get_args(ObserverName) if name != "shape"]


def _observer(name: ObserverName) -> Part:
    from palmd import observer
    from palmd.system.description import RigDescription

    return f"{name} observer", lambda: observer.make(name, RigDescription()).backend


def _of_palms(curved: bool) -> list[Part]:
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


def _beside() -> list[Part]:
    from palmd.model import pivot

    return [("pivoting grasp", lambda: pivot.library().backend)]


def _emulated() -> list[Part]:
    from palmd.rig import compiled_plant

    return [("emulated rig", compiled_plant.backend)]


def _other_systems() -> list[Part]:
    from palmd.model import sharp, three_palms
    from palmd.observer.three_palms.growth import ORDER
    from palmd.observer.three_palms.search import START_ORDER

    def space(order: int) -> Part:
        return f"three palms in space, degree {order}", lambda: three_palms.library(order).backend

    return [
        ("flat sides", lambda: sharp.library().backend),
        ("three palms in space, the beginning", lambda: three_palms.driven_library().backend),
        *map(space, (START_ORDER, ORDER)),
    ]


def _told(what: str, backend_of: Callable[[], str]) -> None:
    print(f"{what}: ", end="", flush=True)
    begun = time.monotonic()
    print(f"{_BACKENDS[backend_of()]}, {time.monotonic() - begun:.1f} s")
