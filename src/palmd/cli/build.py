"""Compiles the observers into the cache, so that the first run need not; without a compiler it says so."""

from __future__ import annotations

import argparse
import threading
import time
from collections.abc import Callable
from pathlib import Path

from palmd.config import AnyConfig
from palmd.console.configured import any_configured
from palmd.observer.kernels import Part, of_palms
from palmd.systems import LIVE, load_part

_PATIENCE_S = 2.0

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
    usual = [each for live in LIVE.values() for each in load_part(live.kernels)(None)]
    for each in [*usual, *_emulated(), *(_other_systems() if arguments.all else ())]:
        _told(*each)
    return 0


def needed_by(config: AnyConfig) -> list[Part]:
    """What the processes of a run with this configuration load."""
    parts: list[Part] = load_part(LIVE[config.system].kernels)(config)
    return parts


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


def _emulated() -> list[Part]:
    from palmd.rig import compiled_plant

    return [("emulated rig", compiled_plant.backend)]


def _other_systems() -> list[Part]:
    from palmd.model import sharp
    from palmd.observer.three_palms.needed import of_three_palms

    return [*of_palms(curved=True), ("flat sides", lambda: sharp.library().backend), *of_three_palms()]


def _told(what: str, backend_of: Callable[[], str]) -> None:
    print(f"{what}: ", end="", flush=True)
    begun = time.monotonic()
    print(f"{_BACKENDS[backend_of()]}, {time.monotonic() - begun:.1f} s")
