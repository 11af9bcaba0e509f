"""One thing that was looked into: how it stands, and what mends it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Verdict = Literal["ok", "open", "missing", "off", "cannot tell"]


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that palmd needs: how it stands, and the command that mends it, if there is one.

    `off`: readings tell that it is not as configured. `open`: it works, and lets in more than a rig should.
    """

    what: str
    verdict: Verdict
    text: str
    fix: str = ""

    def line(self) -> str:
        """It in one line."""
        return f"{self.verdict:12} {self.what:18} {self.text}" + (f": {self.fix}" if self.fix else "")
