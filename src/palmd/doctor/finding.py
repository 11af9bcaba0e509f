"""Result of one check of machine or rig."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Verdict = Literal["ok", "open", "missing", "mismatch", "unknown"]


@dataclass(frozen=True, slots=True)
class Finding:
    """Result of one check, and the command that fixes it, if there is one.

    `mismatch`: readings contradict the configuration. `open`: it works, but gives access to too many users.
    """

    what: str
    verdict: Verdict
    text: str
    fix: str = ""

    def line(self) -> str:
        """The finding as one line of text."""
        return f"{self.verdict:12} {self.what:18} {self.text}" + (f": {self.fix}" if self.fix else "")
