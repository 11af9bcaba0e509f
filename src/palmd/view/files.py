"""The page's files, read once: a request names one of them or nothing, so that no path leads anywhere else."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

STATIC = Path(__file__).parent / "static"
_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}


@dataclass(frozen=True, slots=True)
class File:
    """What goes out for a path."""

    body: bytes
    type: str


def page_files() -> dict[str, File]:
    """Every file of the page by its path in an address; `/` is the page itself."""
    files = {
        f"/{path.relative_to(STATIC).as_posix()}": File(path.read_bytes(), _TYPES[path.suffix])
        for path in sorted(STATIC.rglob("*"))
        if path.suffix in _TYPES
    }
    return files | {"/": files["/index.html"]}
