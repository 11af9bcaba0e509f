"""Runs the conformance scripts on a real port."""

from __future__ import annotations

import time
from typing import Self, TypeVar

from palmd.devices.armlink import Line, LineReader, Stop, encode_command
from palmd.devices.port import Port, PortUnavailableError, PortWaiter
from tools.conformance.arm_talk import Script, Talk, TalkAnswer, TalkRequest

_T = TypeVar("_T")


class ArmLine:
    """The controller's port, a context manager."""

    def __init__(self, path: str, baud: int) -> None:
        """Open the port; raises PortUnavailableError if that fails."""
        self._port = Port("arm", path, baud)
        if not self._port.poll_open(time.monotonic()):
            raise PortUnavailableError(self._port.error)
        self._reader = LineReader(baud)
        self._waiter = PortWaiter([self._port])

    def play(self, script: Script[_T]) -> _T:
        """Run a script and return its result; raises PortUnavailableError if the port is lost."""
        try:
            request = next(script)
            while True:
                request = script.send(self._send(request))
        except StopIteration as end:
            value: _T = end.value
            return value

    def _send(self, request: TalkRequest) -> TalkAnswer:
        lines: list[Line] = []
        raw = self._listen(lines, request.t_send, 0)
        t_sent = time.monotonic()
        self._port.write(request.data)
        raw += self._listen(lines, t_sent + request.listen_s, request.enough)
        return TalkAnswer(lines, raw, t_sent, time.monotonic())

    def _listen(self, lines: list[Line], t_end: float, enough: int) -> bytes:
        """Append the lines received until t_end (s) or until there are `enough`; return all bytes."""
        raw = b""
        while time.monotonic() < t_end and not 0 < enough <= len(lines):
            self._waiter.wait(t_end)
            data = self._port.read()
            if not self._port.is_open:
                raise PortUnavailableError(self._port.error)
            raw += data
            lines += self._reader.feed(data, time.monotonic())
        return raw

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._port.close()

    def stop(self, talk: Talk) -> None:
        """Request a planned stop, in case the arm still moves."""
        self._port.write(encode_command(Stop(talk.next_ss())))
