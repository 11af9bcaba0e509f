"""What `import palmd` offers to notebooks and programs: recorded runs as arrays, the observers, a running daemon."""

from __future__ import annotations

from palmd.api.answers import EstimatedRun, SmoothedRun, estimate, reconstruct
from palmd.api.errors import PalmdError
from palmd.api.live import Live, connect
from palmd.api.outline import Outline
from palmd.api.runs import Events, Run, open
from palmd.api.table import Table

__all__ = [
    "EstimatedRun",
    "Events",
    "Live",
    "Outline",
    "PalmdError",
    "Run",
    "SmoothedRun",
    "Table",
    "connect",
    "estimate",
    "open",
    "reconstruct",
]
