"""Compiles the observers into the cache, so that the first run need not; without a compiler it says so."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial
from typing import get_args

_BACKENDS = {"c": "compiled C", "vm": "CasADi's virtual machine, no compiled C", "numpy": "NumPy, nothing to compile"}


def add_arguments(_parser: argparse.ArgumentParser) -> None:
    """There are none."""


def run(_arguments: argparse.Namespace) -> int:
    """Makes each observer once; takes seconds for what is not in the cache yet."""
    from palmd import observer
    from palmd.model import pivot, rollout, smoothing
    from palmd.system.description import RigDescription

    def backend_of(name: observer.ObserverName) -> str:
        return observer.make(name, RigDescription()).backend

    for name in get_args(observer.ObserverName):
        _told(f"{name} observer", partial(backend_of, name))
    _told("smoother", lambda: smoothing.library().backend)
    _told("pivoting grasp", lambda: pivot.library().backend)
    _told("explorer", lambda: rollout.library().backend)
    return 0


def _told(what: str, backend_of: Callable[[], str]) -> None:
    print(f"{what}: ", end="", flush=True)
    begun = time.monotonic()
    print(f"{_BACKENDS[backend_of()]}, {time.monotonic() - begun:.1f} s")
