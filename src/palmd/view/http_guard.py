"""Who may come in: pages of this server alone, asked for under a name of this machine. Pure.

A page of another site can neither read the stream nor send a command: its origin is not ours. A name that somebody
else's DNS points at this machine is refused as well.
"""

from __future__ import annotations

import hmac
from collections.abc import Mapping
from http import HTTPStatus
from types import MappingProxyType
from urllib.parse import urlsplit

from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from palmd.view.files import File

SOCKET = "/socket"
OUR_NAMES = frozenset({"127.0.0.1", "localhost", "::1"})

_GUARDS = {
    "Content-Security-Policy": "default-src 'self'; connect-src 'self' ws://127.0.0.1:* ws://localhost:*; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-cache",
}


REPORT_GUARDS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src data:; font-src data:; frame-ancestors 'none'; sandbox allow-scripts allow-modals allow-downloads"
}
"""For a report, which brings its own script: it runs apart from this page and reaches nothing of it."""


def answer(request: Request, files: dict[str, File]) -> Response | None:
    """The response to an HTTP request, None where it may go on to be a WebSocket."""
    host = _single(request.headers, "Host")
    if _name(host) not in OUR_NAMES:
        return _text(HTTPStatus.FORBIDDEN, f"this page is served as 127.0.0.1 or localhost, not as {host!r}\n")
    path = request.path.partition("?")[0]
    if path == SOCKET:
        if _single(request.headers, "Origin") == f"http://{host}":
            return None
        return _text(HTTPStatus.FORBIDDEN, "the socket is for palmd's own page\n")
    file = files.get(path)
    if file is None:
        return _text(HTTPStatus.NOT_FOUND, "there is no such file\n")
    if file.packed and "gzip" in ",".join(request.headers.get_all("Accept-Encoding")):
        return _response(HTTPStatus.OK, file.packed, file.type, {"Content-Encoding": "gzip"})
    return _response(HTTPStatus.OK, file.body, file.type)


def library_file(file: File) -> Response:
    """A report or a run."""
    return _response(HTTPStatus.OK, file.body, file.type, REPORT_GUARDS)


def may_operate(shown: object, token: str) -> bool:
    """Whether a token that somebody shows is ours; told in constant time."""
    return isinstance(shown, str) and hmac.compare_digest(shown.encode(errors="replace"), token.encode())


def _name(host: str) -> str | None:
    """The name in a Host header, None where there is none."""
    try:
        return urlsplit(f"//{host}").hostname
    except ValueError:
        return None


def _single(headers: Headers, name: str) -> str:
    """The header's value, empty unless it stands there exactly once."""
    values = headers.get_all(name)
    return values[0] if len(values) == 1 else ""


def _text(status: HTTPStatus, text: str) -> Response:
    return _response(status, text.encode(), "text/plain; charset=utf-8")


def _response(status: HTTPStatus, body: bytes, kind: str, more: Mapping[str, str] = MappingProxyType({})) -> Response:
    length = {"Content-Length": str(len(body)), "Content-Type": kind, "Connection": "close"}
    return Response(status.value, status.phrase, Headers(length | _GUARDS | dict(more)), body)
