"""Start-up of a VersaPad: send breaks and receive its identity."""

from __future__ import annotations

import re
from typing import Literal

Kind = Literal["none", "break", "break_twice"]

BREAK_S = 0.400
ANSWER_S = 1.0
"""Timeout of the identity after a break (s)."""

_IDENTITY = re.compile(rb"VP.{4,5}\r")
_KEEP_BYTES = 64


class Handshake:
    """Non-blocking state machine of the start-up: from time and bytes read to whether the line is in break.

    It ends with `identity` once the pad has answered every break, else with an `error`. Packets in the stream are
    ignored, and the same bytes may also go to the decoder.
    """

    def __init__(self, kind: Kind, t_start: float) -> None:
        """Begin at `t_start` (s, monotonic); kind `none` is done at once."""
        self._breaks_left = {"none": 0, "break": 1, "break_twice": 2}[kind]
        self._received = bytearray()
        self._t_break = t_start
        self.identity: bytes | None = None
        self.error: str | None = None
        self.done = self._breaks_left == 0

    def step(self, t: float, data: bytes) -> bool:
        """Process the bytes read by `t` (s); return whether the line should be in break from now on."""
        if self.done:
            return False
        if t < self._t_break + BREAK_S:
            return True  # the pad answers after the break; earlier bytes are no answer
        self._received += data
        match = _IDENTITY.search(self._received)
        del self._received[:-_KEEP_BYTES]
        if match is not None:
            self._answered(match[0], t)
        elif t >= self._t_break + BREAK_S + ANSWER_S:
            self._end(
                f"no identity within {ANSWER_S:.0f} s after the break: check the pad's cable, power and baud rate"
            )
        return not self.done and t < self._t_break + BREAK_S

    def _answered(self, identity: bytes, t: float) -> None:
        if self.identity not in (None, identity):
            self._end(f"the pad sent two different identities: {self.identity!r}, then {identity!r}")
            return
        self.identity = identity
        self._breaks_left -= 1
        self._received.clear()
        self._t_break = t
        self.done = self._breaks_left == 0

    def _end(self, error: str) -> None:
        self.error = error
        self.identity = None
        self.done = True
