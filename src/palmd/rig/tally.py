"""Counts of what passes on an emulated line, from the device to the terminal and back: for end-to-end checks. Pure."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Protocol

from palmd.devices.armlink import LineReader


@dataclass(slots=True)
class DeviceTally:
    """What one device has said, and what mischief made of it before it went on the line.

    `messages` are packets or lines; `altered` ones went out with other bytes than they had, `withheld` ones not at all.
    """

    messages: int = 0
    altered: int = 0
    withheld: int = 0
    bytes_said: int = 0
    bytes_on_line: int = 0

    def take(self, said: bytes, spoilt: bytes, messages: int = 1) -> None:
        """So many messages, and what was left of them."""
        self.messages += messages
        self.bytes_said += len(said)
        self.bytes_on_line += len(spoilt)
        if spoilt != said:
            self.altered += messages if spoilt else 0
            self.withheld += 0 if spoilt else messages

    def as_dict(self) -> dict[str, int]:
        """Every count by name."""
        return asdict(self)


class HostLines:
    """What the host has sent to the arm, and how many of its set-points mischief touched on their way."""

    def __init__(self, baud: int) -> None:
        """`baud` in bit/s."""
        self.setpoints = 0
        self.setpoints_touched = 0
        self._reader = LineReader(baud)

    def take(self, heard: bytes, spoilt: bytes, t: float) -> None:
        """Bytes heard at `t` (s), and what the controller gets of them; the line in hand counts as touched too."""
        found = sum(line.body.startswith("S") for line in self._reader.feed(heard, t))
        self.setpoints += found
        if heard != spoilt:
            self.setpoints_touched += found + (self._reader.pending > 0)

    def as_dict(self) -> dict[str, int]:
        """Every count by name, those of the line before mischief included."""
        counts = {"setpoints": self.setpoints, "setpoints_touched": self.setpoints_touched}
        return counts | self._reader.counters.as_dict()


class Decoder(Protocol):
    """What a host of any kind of device takes bytes in with."""

    @property
    def counters(self) -> Any:
        """What it has counted, with `as_dict`."""

    @property
    def pending(self) -> int:
        """How many bytes of an incomplete message are in hand."""

    def feed(self, data: bytes, t_recv: float) -> Any:
        """Take the bytes read at `t_recv` (s)."""

    def reset(self) -> None:
        """The line has been interrupted."""


class Listener:
    """What a host that misses nothing makes of the bytes that a terminal has taken."""

    def __init__(self, decoder: Decoder) -> None:
        """`decoder` is a new one of the kind that the host has."""
        self._decoder = decoder

    def take(self, data: bytes, t: float) -> None:
        """Bytes that went out at `t` (s)."""
        self._decoder.feed(data, t)

    def interrupted(self) -> None:
        """The plug has been pulled."""
        self._decoder.reset()

    def as_dict(self) -> dict[str, int]:
        """Every count by name, and `pending` bytes."""
        counts: dict[str, int] = self._decoder.counters.as_dict()
        return counts | {"pending": self._decoder.pending}
