"""Who may come in: answers ZeroMQ's questions about keys (ZAP, RFC 27) in a thread of its own.

The thread does a look-up for each connection and sleeps after each refusal, so that however many strangers knock, they
cost the loop next to nothing. Should it ever end, nobody comes in any more.
"""

from __future__ import annotations

import logging
import threading
import time

import zmq
from zmq.utils import z85

from palmd.keys import Role, ServerKeys

log = logging.getLogger(__name__)

ADDRESS = "inproc://zeromq.zap.01"
DOMAIN = b"palmd"
PAUSE_S = 2e-3
TELL_EVERY_S = 30.0
HANDSHAKE_MS = 5000  # a connection that has not proved its key by then is closed

_VERSION = b"1.0"
_ASKED_FRAMES = 7  # version, request, domain, address, identity, mechanism, key


class Doorkeeper:
    """Turns away every key that is not on the list. Safe in the loop once it is made."""

    def __init__(self, context: zmq.Context[zmq.Socket[bytes]], keys: ServerKeys) -> None:
        """To be made before the sockets that it guards, and closed after them."""
        self.turned_away = 0
        self._keys = keys
        self._context = context
        self._told, self._t_tell = 0, 0.0
        socket = context.socket(zmq.REP)
        socket.bind(ADDRESS)
        self._thread = threading.Thread(target=self._serve, args=(socket,), name="door", daemon=True)
        self._thread.start()

    def guard(self, socket: zmq.Socket[bytes]) -> None:
        """Let only listed keys connect to `socket`; before it is bound."""
        socket.setsockopt(zmq.CURVE_SERVER, 1)
        socket.setsockopt(zmq.CURVE_SECRETKEY, self._keys.pair.secret)
        socket.setsockopt(zmq.ZAP_DOMAIN, DOMAIN)
        socket.setsockopt(zmq.ZAP_ENFORCE_DOMAIN, 1)  # without this thread nobody is let in
        socket.setsockopt(zmq.HANDSHAKE_IVL, HANDSHAKE_MS)

    def role(self, frame: zmq.Frame) -> Role | None:
        """The role of who sent a message that has come through a guarded socket."""
        try:
            public = frame.get("User-Id")
        except zmq.ZMQError:
            return None
        member = self._keys.members.get(str(public).encode())
        return None if member is None else member.role

    def close(self) -> None:
        """End the thread."""
        if not self._thread.is_alive():
            return
        with self._context.socket(zmq.REQ) as socket:
            socket.setsockopt(zmq.LINGER, 0)
            socket.connect(ADDRESS)
            socket.send(b"")
            self._thread.join()

    def _serve(self, socket: zmq.Socket[bytes]) -> None:
        with socket:
            while True:
                frames = socket.recv_multipart()
                if frames == [b""]:
                    return
                public = self._listed(frames)
                status = (b"400", b"not allowed") if public is None else (b"200", b"")
                socket.send_multipart((_VERSION, frames[1], *status, public or b"", b""))
                if public is None:
                    self._turn_away(frames)

    def _listed(self, frames: list[bytes]) -> bytes | None:
        """The key in a question, if it is one that may come in."""
        if len(frames) != _ASKED_FRAMES or frames[2] != DOMAIN or frames[5] != b"CURVE":
            return None
        public = z85.encode(frames[6])
        return public if public in self._keys.members else None

    def _turn_away(self, frames: list[bytes]) -> None:
        self.turned_away += 1
        t = time.monotonic()
        if t >= self._t_tell:
            key = z85.encode(frames[6]).decode("ascii") if len(frames) == _ASKED_FRAMES else "none"
            log.warning(
                "bus: turned away %d connection(s) with unknown keys, the last from %s with the public key %s",
                self.turned_away - self._told,
                frames[3].decode(errors="replace"),
                key,
            )
            self._told, self._t_tell = self.turned_away, t + TELL_EVERY_S
        time.sleep(PAUSE_S)
