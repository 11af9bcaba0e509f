"""The kernel's input events, from records to reports: `struct input_event` of a 64-bit machine. Pure.

    seconds, microseconds (8 bytes each), type, code (2 each), value (4, signed)

A device tells only what has changed, and a still contact tells nothing: **silence is not lift-off**. Records up to a
SYN_REPORT belong together. When the kernel's buffer has overflown it says SYN_DROPPED: what follows up to the next
SYN_REPORT is incomplete, and the state must be asked for anew, for a lift-off may be among what is lost.
Contacts come as ABS_X, ABS_Y with BTN_TOUCH, or (type B) in slots, each with a tracking id that is -1 when it is let
go.
Source: Linux Documentation/input/event-codes.rst, multi-touch-protocol.rst.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import asdict, dataclass

from palmd.devices.pad import PadReport

RECORD = struct.Struct("<qqHHi")

EV_SYN, EV_KEY, EV_ABS = 0x00, 0x01, 0x03
SYN_REPORT, SYN_DROPPED = 0, 3
BTN_TOUCH = 0x14A
ABS_X, ABS_Y, ABS_PRESSURE = 0x00, 0x01, 0x18
MT_SLOT, MT_X, MT_Y, MT_TRACKING_ID, MT_PRESSURE = 0x2F, 0x35, 0x36, 0x39, 0x3A

FOREIGN_S = 1.0
"""A record whose stamp is farther than this from when it was read has been stamped by another clock."""

MANY_SLOTS = 64

Record = tuple[int, int, int]
"""Type, code, value."""


@dataclass(slots=True)
class EvdevCounters:
    """What a device has brought. `frames` are groups of records that belong together.

    `dropped` counts overflows of the kernel's buffer, `foreign_clock` frames that were not stamped by the monotonic
    clock, `extra_contacts` frames with more contacts than one, `torn` bytes of half a record, `batches` reads with
    several frames, `out_of_range` places that are not on the pad.
    """

    bytes: int = 0
    frames: int = 0
    dropped: int = 0
    foreign_clock: int = 0
    extra_contacts: int = 0
    torn: int = 0
    batches: int = 0
    out_of_range: int = 0

    def as_dict(self) -> dict[str, int]:
        """Every count by name."""
        return asdict(self)


def encode(records: Iterable[Record], t: float) -> bytes:
    """Records stamped with `t` (s)."""
    seconds, microseconds = divmod(round(t * 1e6), 1_000_000)
    return b"".join(RECORD.pack(seconds, microseconds, *record) for record in records)


@dataclass(slots=True)
class _Contact:
    """One slot: unknown coordinates are None, `since` is the count of contacts when it was put down, 0 without one."""

    x: int | None = None
    y: int | None = None
    pressure: int | None = None
    since: int = 0


_OF_TOUCH = {(EV_KEY, BTN_TOUCH), (EV_ABS, 0x39)}  # the key, and the identity of a slot's contact


class EvdevReader:
    """Turns a device's records into reports; `wants_state` says that the state must be asked for anew."""

    def __init__(self) -> None:
        self.counters = EvdevCounters()
        self.wants_state = True
        self._torn = b""
        self._skipping = False
        self._single = _Contact()
        self._touch_key = False
        self._slots: dict[int, _Contact] = {}
        self._slot = 0
        self._contacts = 0
        self._told = False
        self._touch_known = False  # whether it has said since it was last forgotten if there is a contact

    @property
    def pending(self) -> int:
        """How many bytes of an incomplete record are in hand."""
        return len(self._torn)

    def reset(self) -> None:
        """The device has gone: nothing is known any more."""
        self.counters.torn += len(self._torn)
        self._torn = b""
        self.forget()

    def forget(self) -> None:
        """What was known of the contacts no longer holds."""
        self._single, self._touch_key = _Contact(), False
        self._slots, self._slot = {}, 0
        self._skipping = self._touch_known = False
        self.wants_state = True

    def feed(self, data: bytes, t_recv: float) -> list[PadReport]:
        """Take what was read at `t_recv` (s, monotonic) and return the reports of whole frames.

        `in_use` is false in the report of a lift-off; pressure is 0 where the device has none.
        """
        self.counters.bytes += len(data)
        data = self._torn + data
        whole = len(data) - len(data) % RECORD.size
        self._torn = data[whole:]
        reports: list[PadReport] = []
        frames = 0
        for seconds, microseconds, kind, code, value in RECORD.iter_unpack(data[:whole]):
            if kind == EV_SYN and code == SYN_DROPPED:
                self.counters.dropped += 1
                self.forget()
                self._skipping = True
            elif kind == EV_SYN and code == SYN_REPORT:
                if self._skipping:
                    self._skipping = False
                    continue
                frames += 1
                report = self._report(seconds + microseconds * 1e-6, t_recv)
                if report is not None:
                    reports.append(report)
            elif not self._skipping:
                self._take(kind, code, value)
        self.counters.frames += frames
        self.counters.batches += frames > 1
        return reports

    def _take(self, kind: int, code: int, value: int) -> None:
        self._touch_known |= (kind, code) in _OF_TOUCH
        if kind == EV_KEY and code == BTN_TOUCH:
            if value and not self._touch_key:
                self._contacts += 1
                self._single.since = self._contacts
            self._touch_key = bool(value)
        elif kind == EV_ABS:
            slot = self._slots.setdefault(self._slot, _Contact())
            match code:
                case 0x00:
                    self._single.x = value
                case 0x01:
                    self._single.y = value
                case 0x18:
                    self._single.pressure = value
                case 0x2F:
                    self._slot = value if 0 <= value < MANY_SLOTS else MANY_SLOTS
                case 0x35:
                    slot.x = value
                case 0x36:
                    slot.y = value
                case 0x3A:
                    slot.pressure = value
                case 0x39 if value < 0:
                    slot.since = 0
                case 0x39:  # another id without a lift is another contact
                    self._contacts += 1
                    slot.since = self._contacts

    def _report(self, t_stamp: float, t_recv: float) -> PadReport | None:
        down = [slot for slot in self._slots.values() if slot.since and slot.x is not None]
        self.counters.extra_contacts += len(down) > 1
        contact: _Contact | None = min(down, key=lambda slot: slot.since) if down else None
        if contact is None and self._touch_key and not any(slot.since for slot in self._slots.values()):
            contact = self._single if self._single.x is not None else None
        if not 0.0 <= t_recv - t_stamp < FOREIGN_S:
            self.counters.foreign_clock += 1
            t_stamp = t_recv
        if contact is None and not self._touch_known:
            return None
        told, self._told = self._told, contact is not None
        if contact is None:
            return PadReport(t_stamp, t_recv, 0, 0, 0, in_use=False, batched=False) if told else None
        self.wants_state = False
        pressure = contact.pressure if contact.pressure is not None else self._single.pressure
        return PadReport(t_stamp, t_recv, contact.x or 0, contact.y or 0, pressure or 0, in_use=True, batched=False)
