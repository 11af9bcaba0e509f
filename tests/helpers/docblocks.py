"""The fenced blocks of README and docs: which ones are run, and the comment above each.

`<!-- not run: REASON -->` on the line above a block of commands or Python excludes it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
RUN = ("sh", "python")
SHOWN = ("text", "yaml", "ini", "mermaid")
_BLOCK = re.compile(r"^(?:<!-- not run: ([^\n]+) -->\n)?```(\w*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_INDENTED = re.compile(r"^\n {4}((?:\./|\.venv/bin/)?(?:palmd|make|python3?|pip|git|ls|cp) .*)$", re.MULTILINE)


@dataclass(frozen=True)
class Block:
    """`excluded`: reason why the block is not run; empty if it is run."""

    page: str
    line: int
    kind: str
    text: str
    excluded: str

    @property
    def lines(self) -> list[str]:
        """Its commands, one per line, without comments."""
        joined = self.text.replace("\\\n", " ").splitlines()
        return [line for line in (re.sub(r"(^|\s+)#.*", "", each).strip() for each in joined) if line]


def blocks() -> Iterator[Block]:
    """All blocks, page by page."""
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for found in _BLOCK.finditer(text):
            line = text.count("\n", 0, found.start(2)) + 1
            yield Block(page.relative_to(ROOT).as_posix(), line, found[2], found[3], found[1] or "")


def indented() -> Iterator[tuple[str, str]]:
    """Page and first command of indented blocks, which no test would run."""
    for page in PAGES:
        for found in _INDENTED.finditer(page.read_text(encoding="utf-8")):
            yield page.relative_to(ROOT).as_posix(), found[1]
