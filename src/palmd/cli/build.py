"""Compiles the observers into the cache, so that the first run need not; without a compiler it says so."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial
from typing import Any, get_args

_BACKENDS = {"c": "compiled C", "vm": "CasADi's virtual machine, no compiled C", "numpy": "NumPy, nothing to compile"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument(
        "--all",
        action="store_true",
        help="what other systems need too: curved palms, flat sides, three palms in space; a minute more",
    )


def run(arguments: argparse.Namespace) -> int:
    """Makes each observer once; takes seconds for what is not in the cache yet."""
    from palmd import observer
    from palmd.model import pivot, rollout, shape_map, smoothing
    from palmd.system.description import RigDescription

    def backend_of(name: observer.ObserverName) -> str:
        return observer.make(name, RigDescription()).backend

    for name in get_args(observer.ObserverName):
        _told(f"{name} observer", partial(backend_of, name))
    _told("shape observer, with a smoother's harmonics", lambda: shape_map.library(smoothing.ORDER).backend)
    _told("smoother", lambda: smoothing.library().backend)
    _told("pivoting grasp", lambda: pivot.library().backend)
    _told("explorer", lambda: rollout.library().backend)
    if arguments.all:
        _build_other_systems()
    return 0


def _build_other_systems() -> None:
    from palmd.model import rollout, sensitivity, shape_map, sharp, smoothing, three_palms
    from palmd.observer.three_palms.search import ORDER, START_ORDER

    def backend_of(library: Callable[..., Any], *which: int) -> str:
        return str(library(*which).backend)

    for what, curved in (
        ("observer", partial(shape_map.library, curved=True)),
        ("smoother", partial(smoothing.library, curved=True)),
        ("explorer", partial(rollout.library, curved=True)),
        ("observability", partial(sensitivity.library, curved=True)),
    ):
        _told(f"curved palms, {what}", partial(backend_of, curved))
    _told("flat sides", partial(backend_of, sharp.library))
    _told("three palms in space, the beginning", partial(backend_of, three_palms.driven_library))
    for order in (START_ORDER, ORDER):
        _told(f"three palms in space, degree {order}", partial(backend_of, three_palms.library, order))


def _told(what: str, backend_of: Callable[[], str]) -> None:
    print(f"{what}: ", end="", flush=True)
    begun = time.monotonic()
    print(f"{_BACKENDS[backend_of()]}, {time.monotonic() - begun:.1f} s")
