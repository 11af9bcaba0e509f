"""HTTP responses of the page's server: its files, only for pages of this server under a name of this machine. Pure.

A page of another site can neither read the stream nor send a command, as its origin differs. Foreign host names whose
DNS points at this machine (DNS rebinding) are refused as well. The files are read once at start; requests can name only
these, so no path leads outside.
"""

from __future__ import annotations

import gzip
import hmac
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from http import HTTPStatus
from pathlib import Path
from types import MappingProxyType
from typing import Self
from urllib.parse import urlsplit

from websockets.datastructures import Headers
from websockets.http11 import Request, Response

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


SOCKET = "/socket"
OUR_NAMES = frozenset({"127.0.0.1", "localhost", "::1"})

_SECURITY_HEADERS = {
    "Content-Security-Policy": "default-src 'self'; connect-src 'self' ws://127.0.0.1:* ws://localhost:*; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-cache",
}


REPORT_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src data:; font-src data:; frame-ancestors 'none'; sandbox allow-scripts allow-modals allow-downloads"
}
"""Headers of a report, which has its own script: it runs in a sandbox without access to this page."""


def answer(request: Request, files: dict[str, File]) -> Response | None:
    """The response to an HTTP request; None if it may be upgraded to a WebSocket."""
    host = _unique_header(request.headers, "Host")
    if _name(host) not in OUR_NAMES:
        return _text(HTTPStatus.FORBIDDEN, f"this page is served as 127.0.0.1 or localhost, not as {host!r}\n")
    path = request.path.partition("?")[0]
    if path == SOCKET:
        if _unique_header(request.headers, "Origin") == f"http://{host}":
            return None
        return _text(HTTPStatus.FORBIDDEN, "the socket accepts only palmd's own page\n")
    file = files.get(path)
    if file is None:
        return _text(HTTPStatus.NOT_FOUND, "there is no such file\n")
    if file.packed and "gzip" in ",".join(request.headers.get_all("Accept-Encoding")):
        return _response(HTTPStatus.OK, file.packed, file.type, {"Content-Encoding": "gzip"})
    return _response(HTTPStatus.OK, file.body, file.type)


def library_file(file: File) -> Response:
    """The response with a report or a run."""
    return _response(HTTPStatus.OK, file.body, file.type, REPORT_HEADERS)


def may_operate(shown: object, token: str) -> bool:
    """Whether the token shown by a page is correct; compared in constant time."""
    return isinstance(shown, str) and hmac.compare_digest(shown.encode(errors="replace"), token.encode())


def _name(host: str) -> str | None:
    """The host name in a Host header, None without one."""
    try:
        return urlsplit(f"//{host}").hostname
    except ValueError:
        return None


def _unique_header(headers: Headers, name: str) -> str:
    """The header's value, empty unless it occurs exactly once."""
    values = headers.get_all(name)
    return values[0] if len(values) == 1 else ""


def _text(status: HTTPStatus, text: str) -> Response:
    return _response(status, text.encode(), "text/plain; charset=utf-8")


def _response(status: HTTPStatus, body: bytes, kind: str, more: Mapping[str, str] = MappingProxyType({})) -> Response:
    length = {"Content-Length": str(len(body)), "Content-Type": kind, "Connection": "close"}
    return Response(status.value, status.phrase, Headers(length | _SECURITY_HEADERS | dict(more)), body)
