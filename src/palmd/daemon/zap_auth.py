"""Who may come in: answers ZeroMQ's questions about keys (ZAP, RFC 27) in a thread of its own.

The thread does a look-up for each connection and sleeps after each refusal, so that however many strangers knock, they
cost the loop next to nothing. Should it ever end, nobody comes in any more. ZeroMQ asks nothing about a connection that
proves no key; it reports that, and the thread counts the reports.
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
TELL_EVERY_S = 30.0
HANDSHAKE_MS = 5000  # a connection that has not proved its key by then is closed

# a client without a key may hang up before it is told that it needs one, and then there is no detail
_UNPROVEN = zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL | zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL
_VERSION = b"1.0"
_ASKED_FRAMES = 7  # version, request, domain, address, identity, mechanism, key


class ZapAuthenticator:
    """Turns away every key that is not on the list. Safe in the loop once it is made."""

    def __init__(self, context: zmq.Context[zmq.Socket[bytes]], keys: ServerKeys) -> None:
        """To be made before the sockets that it guards, and closed after them."""
        self._turned_away = _Tally(
            "bus: turned away %d connection(s) with unknown keys, the last from %s with the public key %s"
        )
        self._unproven = _Tally("bus: %d connection(s) without a key or with a wrong server.key, the last to %s")
        self._keys = keys
        self._context = context
        self._questions = context.socket(zmq.REP)
        self._questions.bind(ADDRESS)
        self._reports: list[zmq.Socket[bytes]] = []
        self._thread = threading.Thread(target=self._serve, name="door", daemon=True)

    @property
    def turned_away(self) -> int:
        """Connections with keys that nobody knows."""
        return self._turned_away.count

    @property
    def unproven(self) -> int:
        """Connections that proved no key at all: they use none, or not this server's."""
        return self._unproven.count

    def begin(self) -> None:
        """Start the thread, when all is guarded that shall be."""
        self._thread.start()

    def guard(self, socket: zmq.Socket[bytes]) -> None:
        """Let only listed keys connect to `socket`; before it is bound."""
        socket.setsockopt(zmq.CURVE_SERVER, 1)
        socket.setsockopt(zmq.CURVE_SECRETKEY, self._keys.pair.secret)
        socket.setsockopt(zmq.ZAP_DOMAIN, DOMAIN)
        socket.setsockopt(zmq.ZAP_ENFORCE_DOMAIN, 1)  # without this thread nobody is let in
        socket.setsockopt(zmq.HANDSHAKE_IVL, HANDSHAKE_MS)
        address = f"inproc://door-{len(self._reports)}"
        socket.monitor(address, _UNPROVEN)
        report = self._context.socket(zmq.PAIR)
        report.setsockopt(zmq.RCVHWM, 0)  # ZeroMQ stands still while it cannot report
        report.connect(address)
        self._reports.append(report)

    def member(self, frame: zmq.Frame) -> Member | None:
        """Who sent a message that has come through a guarded socket."""
        try:
            public = frame.get("User-Id")
        except zmq.ZMQError:
            return None
        return self._keys.members.get(str(public).encode())

    def close(self) -> None:
        """End the thread; reports may come on, unread, until the context is destroyed."""
        if self._thread.is_alive():
            with self._context.socket(zmq.REQ) as socket:
                socket.setsockopt(zmq.LINGER, 0)
                socket.connect(ADDRESS)
                socket.send(b"")
                self._thread.join()
        self._questions.close()

    def _serve(self) -> None:
        realtime.accompany()
        poller = zmq.Poller()
        for socket in (self._questions, *self._reports):
            poller.register(socket, zmq.POLLIN)
        while True:
            ready = dict(poller.poll())
            for report in self._reports:
                if report in ready:
                    self._count_unproven(report)
            if self._questions in ready:
                frames = self._questions.recv_multipart()
                if frames == [b""]:
                    return
                self._answer(frames)

    def _answer(self, frames: list[bytes]) -> None:
        public = self._listed(frames)
        status = (b"400", b"not allowed") if public is None else (b"200", b"")
        self._questions.send_multipart((_VERSION, frames[1], *status, public or b"", b""))
        if public is None:
            self._turn_away(frames)

    def _listed(self, frames: list[bytes]) -> bytes | None:
        """The key in a question, if it is one that may come in."""
        if len(frames) != _ASKED_FRAMES or frames[2] != DOMAIN or frames[5] != b"CURVE":
            return None
        public = z85.encode(frames[6])
        return public if public in self._keys.members else None

    def _turn_away(self, frames: list[bytes]) -> None:
        key = z85.encode(frames[6]).decode("ascii") if len(frames) == _ASKED_FRAMES else "none"
        self._turned_away.add(frames[3].decode(errors="replace"), key)
        time.sleep(PAUSE_S)

    def _count_unproven(self, report: zmq.Socket[bytes]) -> None:
        with contextlib.suppress(zmq.Again):
            for _ in range(REPORTS_AT_ONCE):
                _, endpoint = report.recv_multipart(zmq.NOBLOCK)
                self._unproven.add(endpoint.decode(errors="replace"))


class _Tally:
    """How often something has happened; it is told once in a while, with how often since it was told last."""

    def __init__(self, words: str) -> None:
        self.count = 0
        self._words = words
        self._told, self._t_tell = 0, 0.0

    def add(self, *details: str) -> None:
        """Once more; `details` are for the words."""
        self.count += 1
        t = time.monotonic()
        if t >= self._t_tell:
            log.warning(self._words, self.count - self._told, *details)
            self._told, self._t_tell = self.count, t + TELL_EVERY_S
