"""The page's files, read once at start; requests can name only these, so no path leads outside."""

from __future__ import annotations

import gzip
import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from palmd.view.page_quantities import page_quantities

STATIC = Path(__file__).parent / "static"
_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}


@dataclass(frozen=True, slots=True)
class File:
    """The response to a path; `packed` is the gzip-compressed body, empty for files sent uncompressed."""

    body: bytes
    type: str
    packed: bytes = b""

    @classmethod
    def of_page(cls, body: bytes, type: str) -> Self:
        """A file of the page, which is compressed because it is sent often."""
        return cls(body, type, gzip.compress(body, mtime=0))


_COMMENTS = {
    ".js": re.compile(r"^[ \t]*(?:/\*\*.*?\*/|//[^\n]*)[ \t]*$", re.DOTALL | re.MULTILINE),
    ".css": re.compile(r"/\*.*?\*/", re.DOTALL),
}
_INDENTATION = re.compile(r"^[ \t]+", re.MULTILINE)


def without_comments(text: str, suffix: str) -> str:
    """A source file without whole-line comments and indentation; line numbers do not change."""
    comments = _COMMENTS.get(suffix)
    if comments is not None:
        text = comments.sub(lambda found: "\n" * found[0].count("\n"), text)
    return _INDENTATION.sub("", text)


def _body(path: Path) -> bytes:
    """The body of a file as sent; third-party code is unchanged."""
    if path.parent != STATIC:
        return path.read_bytes()
    return without_comments(path.read_text(encoding="utf-8"), path.suffix).encode()


def page_files() -> dict[str, File]:
    """Every file of the page by URL path; `/` is the page itself, `/quantities.json` is generated from the tables."""
    files = {
        f"/{path.relative_to(STATIC).as_posix()}": File.of_page(_body(path), _TYPES[path.suffix])
        for path in sorted(STATIC.rglob("*"))
        if path.suffix in _TYPES
    }
    table = json.dumps(page_quantities(), ensure_ascii=False, separators=(",", ":"))
    quantities = File.of_page(table.encode(), "application/json; charset=utf-8")
    return files | {"/": files["/index.html"], "/quantities.json": quantities}
