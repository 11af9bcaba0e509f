"""State of the recorder as it reports it, the faults that follow, and gaps in the recording. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from palmd.daemon.journal import Journal

SILENT_S = 3.0
"""Time without a report after which the recorder counts as silent; it reports each second."""


class RecorderWatch:
    """Keeps the recorder's last report; there may be no recorder. Times are seconds."""

    def __init__(self, journal: Journal) -> None:
        """`journal` gets an entry when one recorder replaces another, so that the recording itself marks the gap."""
        self._journal = journal
        self._report: dict[str, Any] = {}
        self._t = math.nan

    def update(self, report: dict[str, Any], t: float) -> None:
        """Process the arguments of a `recorder` command received at `t`."""
        before, number = self._report.get("process"), report.get("process")
        if before is not None and number is not None and before != number:
            gap = t - self._t
            file = self._report.get("path", "no file")
            text = f"recorder {before:.0f} ended, {number:.0f} continues: up to {gap:.1f} s are missing between them"
            self._journal.add("recorder", "gap", f"{text}, after {file}", lasted_s=gap)
        self._report, self._t = report, t

    def conditions(self, t: float) -> Iterator[str]:
        """The fault codes whose condition holds at `t`."""
        if t - self._t > SILENT_S:
            yield "recorder-silent"
        elif "problem" in self._report:
            yield "recorder-failed"

    def evidence(self, code: str, t: float) -> str:
        """Evidence for one of its codes at `t`, in words."""
        silent = f"its last report was {t - self._t:.1f} s ago, the limit is {SILENT_S:g} s"
        return silent if code == "recorder-silent" else str(self._report.get("problem", ""))

    def last(self, t: float) -> dict[str, Any] | None:
        """The last report and its age; None if there was none."""
        return None if math.isnan(self._t) else {**self._report, "age_s": t - self._t}
