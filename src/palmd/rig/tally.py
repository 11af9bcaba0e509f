"""Counters of what passes on an emulated line, from the device to the terminal and back. Pure."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Protocol

from palmd.devices.armlink import LineReader


@dataclass(slots=True)
class DeviceTally:
    """What one device has sent, and what fault injection made of it before it reached the line.

    `messages` are packets or lines; `altered` ones were sent with other bytes, `withheld` ones not at all.
    """

    messages: int = 0
    altered: int = 0
    withheld: int = 0
    bytes_said: int = 0
    bytes_on_line: int = 0

    def take(self, sent: bytes, corrupted: bytes, messages: int = 1) -> None:
        """Count messages, and what was left of them after fault injection."""
        self.messages += messages
        self.bytes_said += len(sent)
        self.bytes_on_line += len(corrupted)
        if corrupted != sent:
            self.altered += messages if corrupted else 0
            self.withheld += 0 if corrupted else messages

    def as_dict(self) -> dict[str, int]:
        """All counters by name."""
        return asdict(self)


class HostLines:
    """What the host has sent to the arm, and how many of its set-points fault injection altered on the way."""

    def __init__(self, baud: int) -> None:
        """`baud` in bit/s."""
        self.setpoints = 0
        self.setpoints_touched = 0
        self._reader = LineReader(baud)

    def take(self, sent: bytes, corrupted: bytes, t: float) -> None:
        """Bytes sent at `t` (s), and what reaches the controller; an incomplete line also counts as touched."""
        setpoints = sum(line.body.startswith("S") for line in self._reader.feed(sent, t))
        self.setpoints += setpoints
        if sent != corrupted:
            self.setpoints_touched += setpoints + (self._reader.pending > 0)

    def as_dict(self) -> dict[str, int]:
        """All counters by name, including those of the line before fault injection."""
        counts = {"setpoints": self.setpoints, "setpoints_touched": self.setpoints_touched}
        return counts | self._reader.counters.as_dict()


class Decoder(Protocol):
    """A host's decoder of any kind of device."""

    @property
    def counters(self) -> Any:
        """Its counters, with `as_dict`."""

    @property
    def pending(self) -> int:
        """Number of bytes of an incomplete message."""

    def feed(self, data: bytes, t_recv: float) -> Any:
        """Take the bytes read at `t_recv` (s)."""

    def reset(self) -> None:
        """Start again after an interruption of the line."""
