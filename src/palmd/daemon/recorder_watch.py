"""What the recorder says of itself, which faults that means, and what no recording has. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from palmd.daemon.journal import Journal

SILENT_S = 3.0
"""It speaks each second."""


class RecorderWatch:
    """Remembers the recorder's last words; there need not be a recorder. Times are seconds."""

    def __init__(self, journal: Journal) -> None:
        """`journal` takes where one recorder has followed another, so that the recording itself marks its gap."""
        self._journal = journal
        self._told: dict[str, Any] = {}
        self._t = math.nan

    def hear(self, told: dict[str, Any], t: float) -> None:
        """The arguments of a `recorder` command that came at `t`."""
        before, number = self._told.get("process"), told.get("process")
        if before is not None and number is not None and before != number:
            gap = t - self._t
            file = self._told.get("path", "no file")
            text = (
                f"recorder {before:.0f} has ended and {number:.0f} goes on: between them up to {gap:.1f} s are missing"
            )
            self._journal.add("recorder", "gap", f"{text}, after {file}", lasted_s=gap)
        self._told, self._t = told, t

    def conditions(self, t: float) -> Iterator[str]:
        """The codes of the fault table that hold at `t`."""
        if t - self._t > SILENT_S:
            yield "recorder-silent"
        elif "problem" in self._told:
            yield "recorder-failed"

    def evidence(self, code: str, t: float) -> str:
        """What speaks for one of its codes at `t`."""
        silent = f"it was last heard {t - self._t:.1f} s ago, the limit is {SILENT_S:g} s"
        return silent if code == "recorder-silent" else str(self._told.get("problem", ""))

    def last(self, t: float) -> dict[str, Any] | None:
        """What it said last, and how long ago; None when it was never heard."""
        return None if math.isnan(self._t) else {**self._told, "age_s": t - self._t}
