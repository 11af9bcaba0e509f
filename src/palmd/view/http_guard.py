"""Access control for HTTP and WebSocket requests: only pages of this server, under a name of this machine. Pure.

A page of another site can neither read the stream nor send a command, as its origin differs. Foreign host names whose
DNS points at this machine (DNS rebinding) are refused as well.
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
