"""The page's files, read once: a request names one of them or nothing, so that no path leads anywhere else."""

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
    """What goes out for a path; `packed` is the body as gzip makes it, empty where that is not worth its time."""

    body: bytes
    type: str
    packed: bytes = b""

    @classmethod
    def of_page(cls, body: bytes, type: str) -> Self:
        """One that is sent often."""
        return cls(body, type, gzip.compress(body, mtime=0))


_COMMENTS = {
    ".js": re.compile(r"^[ \t]*(?:/\*\*.*?\*/|//[^\n]*)[ \t]*$", re.DOTALL | re.MULTILINE),
    ".css": re.compile(r"/\*.*?\*/", re.DOTALL),
}
_INDENTATION = re.compile(r"^[ \t]+", re.MULTILINE)


def without_comments(text: str, suffix: str) -> str:
    """A page's source without comments that stand alone and without indentation; every line keeps its number."""
    comments = _COMMENTS.get(suffix)
    if comments is not None:
        text = comments.sub(lambda found: "\n" * found[0].count("\n"), text)
    return _INDENTATION.sub("", text)


def _body(path: Path) -> bytes:
    """As it is sent: other people's code as it stands."""
    if path.parent != STATIC:
        return path.read_bytes()
    return without_comments(path.read_text(encoding="utf-8"), path.suffix).encode()


def page_files() -> dict[str, File]:
    """Every file of the page by its path in an address; `/` is the page itself, one more is made from the table."""
    files = {
        f"/{path.relative_to(STATIC).as_posix()}": File.of_page(_body(path), _TYPES[path.suffix])
        for path in sorted(STATIC.rglob("*"))
        if path.suffix in _TYPES
    }
    table = json.dumps(page_quantities(), ensure_ascii=False, separators=(",", ":"))
    quantities = File.of_page(table.encode(), "application/json; charset=utf-8")
    return files | {"/": files["/index.html"], "/quantities.json": quantities}
