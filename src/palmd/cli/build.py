"""Compiles the observers into the cache, so that the first run need not; without a compiler it says so."""

from __future__ import annotations

import argparse
import time
from typing import get_args


def add_arguments(_parser: argparse.ArgumentParser) -> None:
    """There are none."""


def run(_arguments: argparse.Namespace) -> int:
    """Makes each observer once; takes seconds for what is not in the cache yet."""
    from palmd import observer
    from palmd.events import RigDescription

    for name in get_args(observer.ObserverName):
        print(f"{name} observer: ", end="", flush=True)
        begun = time.monotonic()
        backend = observer.make(name, RigDescription()).backend
        how = "compiled C" if backend == "c" else "CasADi's virtual machine, no compiled C"
        print(f"{how}, {time.monotonic() - begun:.1f} s")
    return 0
