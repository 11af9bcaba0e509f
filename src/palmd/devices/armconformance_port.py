"""The conformance talk on a real port: what a script says is sent when it says so, and what is heard goes back."""

from __future__ import annotations

import time
from types import TracebackType
from typing import Self, TypeVar

from palmd.devices.armconformance_talk import Script, Talk, TalkAnswer, TalkRequest
from palmd.devices.armlink import Line, LineReader, Stop, encode_command
from palmd.devices.port import Port, PortWaiter

_T = TypeVar("_T")


class ArmLineError(Exception):
    """The port cannot be opened or was lost; says why and what to do."""


class ArmLine:
    """The port with the controller behind it."""

    def __init__(self, path: str, baud: int) -> None:
        """Opens it; ArmLineError when it cannot be opened."""
        self._port = Port("arm", path, baud)
        if not self._port.poll_open(time.monotonic()):
            raise ArmLineError(self._port.error)
        self._reader = LineReader(baud)
        self._waiter = PortWaiter([self._port])

    def play(self, script: Script[_T]) -> _T:
        """What the script ends with; ArmLineError when the port is lost on the way."""
        try:
            say = next(script)
            while True:
                say = script.send(self._heard(say))
        except StopIteration as end:
            value: _T = end.value
            return value

    def _heard(self, say: TalkRequest) -> TalkAnswer:
        lines: list[Line] = []
        raw = self._listen(lines, say.t_send, 0)
        t_sent = time.monotonic()
        self._port.write(say.data)
        raw += self._listen(lines, t_sent + say.listen_s, say.enough)
        return TalkAnswer(lines, raw, t_sent, time.monotonic())

    def _listen(self, lines: list[Line], t_end: float, enough: int) -> bytes:
        """Adds the lines that come until t_end (s), or until there are enough; returns all the bytes."""
        raw = b""
        while time.monotonic() < t_end and not 0 < enough <= len(lines):
            self._waiter.wait(t_end)
            data = self._port.read()
            if not self._port.is_open:
                raise ArmLineError(self._port.error)
            raw += data
            lines += self._reader.feed(data, time.monotonic())
        return raw

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Lets go of the port."""
        self._port.close()

    def stop(self, talk: Talk) -> None:
        """Asks for a planned stop, in case that anything still moves."""
        self._port.write(encode_command(Stop(talk.next_ss())))
