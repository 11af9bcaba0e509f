"""Decoder of the kernel's input events: `struct input_event` of a 64-bit machine to pad reports. Pure.

    seconds, microseconds (8 bytes each), type, code (2 each), value (4, signed)

A device reports changes only, and a contact at rest reports nothing: **silence is not a lift-off**. The records up
to a SYN_REPORT form a frame. There are three protocols:

    slots (type B)    each contact has a slot with a tracking id, which is -1 after the lift-off
    packets (type A)  each frame lists all contacts, each ended by SYN_MT_REPORT; a frame without contacts is a lift-off
    single touch      ABS_X and ABS_Y with BTN_TOUCH

After an overflow of its buffer the kernel sends SYN_DROPPED: the records up to the next SYN_REPORT are incomplete, and
the state known before is invalid. `wants_state` then requests the device's state from the caller (`restore`). Without a
device (recorded bytes), a contact is unknown until the stream has sent it again.
Contacts that do not touch are ignored: while BTN_TOUCH is 0, hovering ones (distance above 0) and palms (decision 79).
Source: Linux Documentation/input/event-codes.rst, multi-touch-protocol.rst.
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

from palmd.devices.health import Counters
from palmd.devices.pad import PadReport

RECORD = struct.Struct("<qqHHi")

EV_SYN, EV_KEY, EV_ABS = 0x00, 0x01, 0x03
SYN_REPORT, SYN_MT_REPORT, SYN_DROPPED = 0, 2, 3
BTN_TOUCH = 0x14A
ABS_X, ABS_Y, ABS_PRESSURE, ABS_DISTANCE = 0x00, 0x01, 0x18, 0x19
MT_SLOT, MT_X, MT_Y, MT_TOOL_TYPE, MT_TRACKING_ID, MT_PRESSURE, MT_DISTANCE = 0x2F, 0x35, 0x36, 0x37, 0x39, 0x3A, 0x3B
TOOL_PALM = 2

CLOCK_TOLERANCE_S = 1.0
"""Largest difference (s) of a record's timestamp from its read time; else the timestamp is of another clock."""

MAX_SLOTS = 64

Record = tuple[int, int, int]
"""Type, code, value."""


@dataclass(slots=True)
class EvdevCounters(Counters):
    """Counters of a device.

    `dropped` counts overflows of the kernel's buffer, `foreign_clock` frames not stamped by the monotonic
    clock, `extra_contacts` frames with more than one contact, `not_touching` frames whose contacts hover, are palms
    or have BTN_TOUCH 0, `torn` bytes of incomplete records, `batches` reads with several frames, `out_of_range`
    positions that are not on the pad.
    """

    bytes: int = 0
    frames: int = 0
    dropped: int = 0
    foreign_clock: int = 0
    extra_contacts: int = 0
    not_touching: int = 0
    torn: int = 0
    batches: int = 0
    out_of_range: int = 0


def encode(records: Iterable[Record], t: float) -> bytes:
    """Encode records with the timestamp `t` (s)."""
    seconds, microseconds = divmod(round(t * 1e6), 1_000_000)
    return b"".join(RECORD.pack(seconds, microseconds, *record) for record in records)


class Protocol(StrEnum):
    """How a device reports its contacts."""

    SINGLE = "single touch"
    SLOTS = "slots (type B)"
    PACKETS = "packets (type A)"


Coordinate = Literal["x", "y"]
_LISTED = -1


@dataclass(slots=True)
class _Contact:
    """State of one contact; None: value not sent yet. `order` numbers contacts by their first touch; 0: no touch."""

    x: int | None = None
    y: int | None = None
    pressure: int | None = None
    distance: int | None = None
    tool: int | None = None
    id: int | None = None
    order: int = 0

    @property
    def sent(self) -> bool:
        """Whether at least one coordinate has been sent."""
        return self.x is not None or self.y is not None

    @property
    def touches(self) -> bool:
        """Whether it is on the surface according to the values sent so far."""
        return not self.distance and self.tool != TOOL_PALM

    def take(self, code: int, value: int) -> None:
        """Set the value of one axis."""
        if code == MT_TRACKING_ID and value != self.id:
            self.order = 0  # another id is another contact
        setattr(self, _FIELDS[code], value)


_SINGLE_AXES = {ABS_X: "x", ABS_Y: "y", ABS_PRESSURE: "pressure", ABS_DISTANCE: "distance"}
_MT_AXES = {
    MT_X: "x", MT_Y: "y", MT_PRESSURE: "pressure", MT_DISTANCE: "distance", MT_TOOL_TYPE: "tool", MT_TRACKING_ID: "id",
}  # fmt: skip
_FIELDS = _SINGLE_AXES | _MT_AXES


class EvdevReader:
    """Decodes a device's records into reports; `wants_state`: the device's state must be read."""

    def __init__(self, needed: Collection[Coordinate] = ("x", "y")) -> None:
        """A contact is reported once its `needed` coordinates are known; other unknown coordinates are 0."""
        self.counters = EvdevCounters()
        self.wants_state = True
        self.has_state = False
        """Whether the device's state can be read; if so, nothing is reported after an overflow until `restore`."""
        self.protocol: Protocol | None = None
        """The device's protocol; None: derived from the records."""
        self.bounding_box = False
        """Whether several contacts are reported as the corners of their bounding box, which are no positions."""
        self._needed = tuple(needed)
        self._torn = b""
        self._contacts = 0
        self._reported = False
        self._pressed_axes: set[int] = set()  # pressure axes sent so far
        self._forget()

    @property
    def pending(self) -> int:
        """Number of buffered bytes of an incomplete record."""
        return len(self._torn)

    def reset(self) -> None:
        """Discard buffered bytes and state after the loss of the device."""
        self.counters.torn += len(self._torn)
        self._torn = b""
        self.forget()

    def forget(self) -> None:
        """Discard the state of the contacts, as when a device is opened, and request the device's state."""
        self._forget()
        self.wants_state = True

    def _forget(self) -> None:
        self._single = _Contact()
        self._touch_key: bool | None = None
        self._slots: dict[int | None, _Contact] = {}
        self._slot: int | None = 0
        self._packets: list[_Contact] = []
        self._packet = _Contact()
        self._packet_ends = 0  # in the current frame
        self._frame_says_lifted = False  # BTN_TOUCH or ABS_PRESSURE became 0 in the current frame
        self._skipping = self._overflowed = False
        self._touch_known = False  # whether the stream has reported since then if there is a contact

    def restore(self, records: bytes) -> list[PadReport]:
        """Replace the state by the device's: the records of one frame, stamped when it was read. Return its reports."""
        seconds, microseconds, *_ = RECORD.unpack(records[-RECORD.size :])
        self._forget()
        self.wants_state = False
        frames = self.counters.frames
        reports = self._read_records(records, seconds + microseconds * 1e-6)
        self.counters.frames = frames
        return reports

    def feed(self, data: bytes, t_recv: float) -> list[PadReport]:
        """Process the bytes read at `t_recv` (s, monotonic) and return the reports of complete frames.

        `in_use` is false in the report of a lift-off; pressure is 0 where the device has none.
        """
        self.counters.bytes += len(data)
        data = self._torn + data
        whole = len(data) - len(data) % RECORD.size
        self._torn = data[whole:]
        before = self.counters.frames
        reports = self._read_records(data[:whole], t_recv)
        self.counters.batches += self.counters.frames > before + 1
        return reports

    def _read_records(self, data: bytes, t_recv: float) -> list[PadReport]:
        reports: list[PadReport] = []
        for seconds, microseconds, kind, code, value in RECORD.iter_unpack(data):
            if kind == EV_SYN and code == SYN_DROPPED:
                self.counters.dropped += 1
                self.forget()
                self._skipping = self._overflowed = True
                self._slot = None
            elif kind == EV_SYN and code == SYN_REPORT:
                if self._skipping:
                    self._skipping = False
                elif not self._awaiting_state:
                    self.counters.frames += 1
                    report = self._report(seconds + microseconds * 1e-6, t_recv)
                    if report is not None:
                        reports.append(report)
            elif not (self._skipping or self._awaiting_state):
                self._take(kind, code, value)
        return reports

    @property
    def _awaiting_state(self) -> bool:
        """Whether records are older than the state that is about to be read."""
        return self._overflowed and self.wants_state and self.has_state

    def _take(self, kind: int, code: int, value: int) -> None:
        if kind == EV_KEY and code == BTN_TOUCH:
            self._touch_known |= not value  # a touch alone has no position
            self._frame_says_lifted |= not value
            if value and not self._touch_key:
                self._single.order = 0
            self._touch_key = bool(value)
        elif kind == EV_SYN and code == SYN_MT_REPORT and self.protocol is not Protocol.SLOTS:
            self._end_packet()
        elif kind == EV_ABS:
            self._take_axis(code, value)

    def _take_axis(self, code: int, value: int) -> None:
        if code in (ABS_PRESSURE, MT_PRESSURE):
            self._pressed_axes.add(code)
        if code in _SINGLE_AXES:
            self._single.take(code, value)
            self._frame_says_lifted |= code == ABS_PRESSURE and not value
        elif code == MT_SLOT:
            self.protocol = Protocol.SLOTS
            self._slots.pop(None, None)  # its slot number is unknown
            self._slot = value if 0 <= value < MAX_SLOTS else MAX_SLOTS
        elif code in _MT_AXES:
            self._touch_known |= code == MT_TRACKING_ID
            if self.protocol is Protocol.PACKETS:
                self._packet.take(code, value)
            else:
                self._slots.setdefault(self._slot, _Contact()).take(code, value)

    def _end_packet(self) -> None:
        """Handle SYN_MT_REPORT: end a contact of the frame; without data there is none."""
        if self.protocol is None:  # records before it went to a slot
            self.protocol = Protocol.PACKETS
            self._packet, self._slots = self._slots.pop(self._slot, _Contact()), {}
        self._touch_known = True
        self._packet_ends += 1
        packet, self._packet = self._packet, _Contact()
        if packet.sent and (packet.id is None or packet.id >= 0):
            packet.order = _LISTED  # listed in this frame
            self._packets.append(packet)

    def _contacts_present(self) -> list[_Contact]:
        """Return all contacts at the end of a frame, on the surface or above it."""
        if self.protocol is Protocol.PACKETS:
            return self._packet_contacts()
        if self._slots or self.protocol is Protocol.SLOTS:
            return [slot for slot in self._slots.values() if slot.sent and self._is_live(slot)]
        return [self._single] if self._touch_key and self._single.sent else []

    def _is_live(self, slot: _Contact) -> bool:
        """Whether a slot has a contact; after an overflow a position suffices: empty slots send none."""
        return self._overflowed if slot.id is None else slot.id >= 0

    def _packet_contacts(self) -> list[_Contact]:
        """Return the contacts of the last frame that listed any, or that reported none."""
        if self._packet.sent:  # the last SYN_MT_REPORT may be omitted
            self._end_packet()
        before = [contact for contact in self._packets if contact.order != _LISTED]
        listed = [contact for contact in self._packets if contact.order == _LISTED]
        if not self._packet_ends:
            return [] if self._frame_says_lifted else before
        for contact in listed:
            contact.order = 0
        for old in sorted((each for each in before if each.order), key=lambda each: each.order):
            same = [each for each in listed if not each.order and each.id == old.id]
            if same:
                min(same, key=lambda each: _distance(each, old)).order = old.order
        return listed

    def _report(self, t_stamp: float, t_recv: float) -> PadReport | None:
        present = self._contacts_present()
        if self.protocol is Protocol.PACKETS:
            self._packets = present
        self._packet_ends, self._frame_says_lifted = 0, False
        # some devices report ABS_DISTANCE for all contacts together
        on_surface = self._touch_key is not False and not self._single.distance
        touching = [each for each in present if on_surface and each.touches]
        self.counters.not_touching += bool(present) and not touching
        for contact in present:
            if contact not in touching:
                contact.order = 0
            elif not contact.order:
                self._contacts += 1
                contact.order = self._contacts
        self.counters.extra_contacts += len(touching) > 1
        if not 0.0 <= t_recv - t_stamp < CLOCK_TOLERANCE_S:
            self.counters.foreign_clock += 1
            t_stamp = t_recv
        known = [] if self.bounding_box and len(touching) > 1 else [each for each in touching if self._is_known(each)]
        if known:
            contact = min(known, key=lambda each: each.order)
            self._reported = True
            force = self._pressure(contact) or 0
            return PadReport(t_stamp, t_recv, contact.x or 0, contact.y or 0, force, in_use=True, batched=False)
        if touching or not self._touch_known:
            return None
        reported, self._reported = self._reported, False
        return PadReport(t_stamp, t_recv, 0, 0, 0, in_use=False, batched=False) if reported else None

    def _pressure(self, contact: _Contact) -> int | None:
        return contact.pressure if contact.pressure is not None else self._single.pressure

    def _is_known(self, contact: _Contact) -> bool:
        """Whether its position is known; after an overflow also its pressure, if the device has one."""
        if any(getattr(contact, axis) is None for axis in self._needed):
            return False
        return not (self._overflowed and self._pressed_axes) or self._pressure(contact) is not None


def _distance(one: _Contact, other: _Contact) -> int:
    """Distance of two contacts (counts, sum of both axes)."""
    return abs((one.x or 0) - (other.x or 0)) + abs((one.y or 0) - (other.y or 0))
