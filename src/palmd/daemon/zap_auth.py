"""Authentication of connections: answers ZeroMQ's requests about keys (ZAP, RFC 27) in a thread.

The thread looks up one key per connection and sleeps after each rejection, so that any number of unknown clients costs
the loop almost nothing. If the thread ends, all connections are rejected. ZeroMQ sends no request about a connection
that proves no key; it reports such connections, and the thread counts the reports.
"""

from __future__ import annotations

import contextlib
import logging
import threading
import time

import zmq
from zmq.utils import z85

from palmd.daemon import realtime
from palmd.keys import Member, ServerKeys

log = logging.getLogger(__name__)

ADDRESS = "inproc://zeromq.zap.01"
DOMAIN = b"palmd"
PAUSE_S = 2e-3
REPORTS_AT_ONCE = 100  # of connections that proved no key
LOG_PERIOD_S = 30.0
HANDSHAKE_MS = 5000  # a connection that has not proved its key within this time is closed

# a client without a key may disconnect before the handshake error, and then there is no detail
_UNPROVEN = zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL | zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL
_VERSION = b"1.0"
_ASKED_FRAMES = 7  # version, request, domain, address, identity, mechanism, key


class ZapAuthenticator:
    """Rejects connections with unlisted keys. All methods but the constructor are safe in the loop."""

    def __init__(self, context: zmq.Context[zmq.Socket[bytes]], keys: ServerKeys) -> None:
        """Construct before the sockets that it guards, and close after them."""
        self._turned_away = _LoggedCount(
            "bus: rejected %d connection(s) with unknown keys, the last from %s with the public key %s"
        )
        self._unproven = _LoggedCount("bus: %d connection(s) without a key or with a wrong server.key, the last to %s")
        self._keys = keys
        self._context = context
        self._requests = context.socket(zmq.REP)
        self._requests.bind(ADDRESS)
        self._reports: list[zmq.Socket[bytes]] = []
        self._thread = threading.Thread(target=self._serve, name="door", daemon=True)

    @property
    def turned_away(self) -> int:
        """Number of connections with unlisted keys."""
        return self._turned_away.count

    @property
    def unproven(self) -> int:
        """Number of connections that proved no key: without a key, or with another server's."""
        return self._unproven.count

    def begin(self) -> None:
        """Start the thread; call when all sockets are guarded."""
        self._thread.start()

    def guard(self, socket: zmq.Socket[bytes]) -> None:
        """Let only listed keys connect to `socket`; call before it is bound."""
        socket.setsockopt(zmq.CURVE_SERVER, 1)
        socket.setsockopt(zmq.CURVE_SECRETKEY, self._keys.pair.secret)
        socket.setsockopt(zmq.ZAP_DOMAIN, DOMAIN)
        socket.setsockopt(zmq.ZAP_ENFORCE_DOMAIN, 1)  # without this thread every connection is rejected
        socket.setsockopt(zmq.HANDSHAKE_IVL, HANDSHAKE_MS)
        address = f"inproc://door-{len(self._reports)}"
        socket.monitor(address, _UNPROVEN)
        report = self._context.socket(zmq.PAIR)
        report.setsockopt(zmq.RCVHWM, 0)  # ZeroMQ blocks while it cannot report
        report.connect(address)
        self._reports.append(report)

    def member(self, frame: zmq.Frame) -> Member | None:
        """The listed client that sent a message received on a guarded socket."""
        try:
            public = frame.get("User-Id")
        except zmq.ZMQError:
            return None
        return self._keys.members.get(str(public).encode())

    def close(self) -> None:
        """Stop the thread; reports may still arrive, unread, until the context is destroyed."""
        if self._thread.is_alive():
            with self._context.socket(zmq.REQ) as socket:
                socket.setsockopt(zmq.LINGER, 0)
                socket.connect(ADDRESS)
                socket.send(b"")
                self._thread.join()
        self._requests.close()

    def _serve(self) -> None:
        realtime.raise_helper_priority()
        poller = zmq.Poller()
        for socket in (self._requests, *self._reports):
            poller.register(socket, zmq.POLLIN)
        while True:
            ready = dict(poller.poll())
            for report in self._reports:
                if report in ready:
                    self._count_unproven(report)
            if self._requests in ready:
                frames = self._requests.recv_multipart()
                if frames == [b""]:
                    return
                self._answer(frames)

    def _answer(self, frames: list[bytes]) -> None:
        public = self._listed(frames)
        status = (b"400", b"not allowed") if public is None else (b"200", b"")
        self._requests.send_multipart((_VERSION, frames[1], *status, public or b"", b""))
        if public is None:
            self._log_rejected(frames)

    def _listed(self, frames: list[bytes]) -> bytes | None:
        """The key in a request if it is listed, else None."""
        if len(frames) != _ASKED_FRAMES or frames[2] != DOMAIN or frames[5] != b"CURVE":
            return None
        public = z85.encode(frames[6])
        return public if public in self._keys.members else None

    def _log_rejected(self, frames: list[bytes]) -> None:
        key = z85.encode(frames[6]).decode("ascii") if len(frames) == _ASKED_FRAMES else "none"
        self._turned_away.add(frames[3].decode(errors="replace"), key)
        time.sleep(PAUSE_S)

    def _count_unproven(self, report: zmq.Socket[bytes]) -> None:
        with contextlib.suppress(zmq.Again):
            for _ in range(REPORTS_AT_ONCE):
                _, endpoint = report.recv_multipart(zmq.NOBLOCK)
                self._unproven.add(endpoint.decode(errors="replace"))


class _LoggedCount:
    """Counts events and logs them at most every `LOG_PERIOD_S`, with the number since the last log line."""

    def __init__(self, text: str) -> None:
        self.count = 0
        self._text = text
        self._logged, self._t_log = 0, 0.0

    def add(self, *details: str) -> None:
        """Count one; `details` complete the text."""
        self.count += 1
        t = time.monotonic()
        if t >= self._t_log:
            log.warning(self._text, self.count - self._logged, *details)
            self._logged, self._t_log = self.count, t + LOG_PERIOD_S
