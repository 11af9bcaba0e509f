"""The Python interface `import palmd`: recorded runs as arrays, the observers, and running daemons."""

from __future__ import annotations

from palmd.api.answers import EstimatedRun, SmoothedRun, estimate, reconstruct
from palmd.api.errors import PalmdError
from palmd.api.live import Live, connect
from palmd.api.motion import RigJog, RigMotion
from palmd.api.outline import OutlineData
from palmd.api.runs import Events, RunData, open
from palmd.api.table import DataTable

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
