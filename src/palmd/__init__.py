"""palmd: live reconstruction of an unknown planar object on two touchpad palms.

    run = palmd.open("run.mcap")      # a recorded run or an event log, as NumPy arrays
    palmd.estimate(run)               # the daemon's observer over the run, tick by tick
    palmd.reconstruct(run)            # smoothed estimate from the whole run
    palmd.connect()                   # client of a running daemon: its estimates, and commands to it

`import palmd` loads nothing else; each name is loaded when it is first used (see docs/start/library.md).
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from palmd.api import (
        DataTable,
        EstimatedRun,
        Events,
        Live,
        OutlineData,
        PalmdError,
        RigJog,
        RigMotion,
        RunData,
        SmoothedRun,
        connect,
        estimate,
        open,
        reconstruct,
    )

__version__ = "0.2.0"

__all__ = [
    "DataTable",
    "EstimatedRun",
    "Events",
    "Live",
    "OutlineData",
    "PalmdError",
    "RigJog",
    "RigMotion",
    "RunData",
    "SmoothedRun",
    "connect",
    "estimate",
    "open",
    "reconstruct",
]


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value: object = getattr(importlib.import_module("palmd.api"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
