"""Contacts in a stream of input events: protocols A and B, overflows, and tools that are no touch."""

import pytest

from palmd.config.pads import EvdevConfig
from palmd.devices.evdev import EvdevReader, encode
from palmd.devices.pad import make_pad

SYN, MT, DROPPED = (0, 0, 0), (0, 2, 0), (0, 3, 0)
SLOT, X, Y, TOOL, ID, PRESSURE, DISTANCE = 0x2F, 0x35, 0x36, 0x37, 0x39, 0x3A, 0x3B
ABS_X, ABS_Y, ABS_PRESSURE, ABS_DISTANCE = 0x00, 0x01, 0x18, 0x19


def a(code, value):
    return (3, code, value)


def touch(value):
    return (1, 0x14A, value)


def slot(number, ident, x, y, *more):
    return [a(SLOT, number), a(ID, ident), a(X, x), a(Y, y), *more]


def packet(x, y, *more):
    return [a(X, x), a(Y, y), *more, MT]


def places(frames, **reader):
    """x of the report after each frame, "lift" for a lift-off, None where nothing is reported."""
    made, out = EvdevReader(**reader), []
    for i, frame in enumerate(frames):
        reports = made.feed(encode([*frame, SYN], 1.0 + 0.01 * i), 1.001 + 0.01 * i)
        last = reports[-1] if reports else None
        out.append(None if last is None else last.x_counts if last.in_use else "lift")
    return out


PACKETS = {
    "ids, empty packet": ([packet(500, 3, a(ID, 0)), packet(501, 3, a(ID, 0)), [MT]], [500, 501, "lift"]),
    "no ids, empty packet": ([packet(500, 3), packet(501, 3), [MT]], [500, 501, "lift"]),
    "BTN_TOUCH 0 and no packet": ([[*packet(500, 3), touch(1)], packet(501, 3), [touch(0)]], [500, 501, "lift"]),
    "pressure 0 and no packet": ([[*packet(500, 3), a(ABS_PRESSURE, 9)], [a(ABS_PRESSURE, 0)]], [500, "lift"]),
    "BTN_TOUCH 0 and an empty packet": ([[*packet(500, 3), touch(1)], [touch(0), MT]], [500, "lift"]),
    "a button alone ends no contact": ([packet(500, 3), [(1, 0x110, 1)], packet(510, 3)], [500, 500, 510]),
    "the last SYN_MT_REPORT left out": ([packet(500, 3), [a(X, 505), a(Y, 3)], [MT]], [500, 505, "lift"]),
    "by their ids the first counts, in any order": (
        [packet(500, 3, a(ID, 4)), packet(900, 3, a(ID, 5)) + packet(510, 3, a(ID, 4)), packet(905, 3, a(ID, 5)), [MT]],
        [500, 510, 905, "lift"],
    ),
    "without ids the nearest continues": (
        [packet(500, 3), packet(900, 3) + packet(510, 3), packet(520, 3) + packet(905, 3), packet(910, 3)],
        [500, 510, 520, 910],
    ),
    "put down again": ([packet(500, 3), [MT], packet(700, 3), [MT]], [500, "lift", 700, "lift"]),
    "hovers": ([packet(500, 3, a(DISTANCE, 4)), packet(500, 3, a(DISTANCE, 0)), [MT]], [None, 500, "lift"]),
    "a palm": (
        [packet(500, 3, a(TOOL, 2)), packet(500, 3, a(TOOL, 0)), packet(500, 3, a(TOOL, 2))],
        [None, 500, "lift"],
    ),
    "an overflow": (
        [packet(500, 3), [DROPPED, a(X, 9)], packet(510, 3), [DROPPED], [MT]],
        [500, None, 510, None, "lift"],
    ),
}


@pytest.mark.parametrize("name", PACKETS)
def test_packets_of_protocol_a_give_the_expected_contacts(name):
    frames, expected = PACKETS[name]
    assert places(frames) == expected


NO_TOUCH = {
    "a slot that hovers": ([slot(0, 7, 500, 3, a(DISTANCE, 5)), [a(X, 520)], [a(DISTANCE, 0)]], [None, None, 520]),
    "a finger that is raised a little": (
        [slot(0, 7, 500, 3), [a(DISTANCE, 2)], [a(X, 530)], [a(DISTANCE, 0)]],
        [500, "lift", None, 530],
    ),
    "BTN_TOUCH 0 with a live slot": (
        [[*slot(0, 7, 500, 3, a(PRESSURE, 60)), touch(1)], [a(PRESSURE, 5), touch(0)], [a(X, 560)], [touch(1)]],
        [500, "lift", None, 560],
    ),
    "a palm": ([slot(0, 7, 500, 3), [a(TOOL, 2)], [a(X, 560)]], [500, "lift", None]),
    "a pen is a contact": ([slot(0, 7, 500, 3, a(TOOL, 1))], [500]),
    "one of two hovers": (
        [slot(0, 7, 500, 3, a(DISTANCE, 5)), slot(1, 8, 900, 3), [a(SLOT, 0), a(DISTANCE, 0)]],
        [None, 900, 900],
    ),
    "single touch over the surface": (
        [[a(ABS_X, 500), a(ABS_Y, 3), a(ABS_DISTANCE, 9), touch(1)], [a(ABS_DISTANCE, 0)], [touch(0)]],
        [None, 500, "lift"],
    ),
}


@pytest.mark.parametrize("name", NO_TOUCH)
def test_hovering_and_other_tools_are_no_contact(name):
    frames, expected = NO_TOUCH[name]
    assert places(frames) == expected


def test_other_tools_are_counted_and_reported():
    driver = make_pad(1, EvdevConfig(kind="evdev", port="a"))
    driver.opened(0.0)
    driver.feed(encode([*slot(0, 7, 50, 3, a(DISTANCE, 5)), SYN], 1.0), 1.0)
    assert driver.counts()["not_touching"] == 1
    assert "hover" in driver.diagnosis


def test_after_an_overflow_there_is_no_contact_until_it_is_sent_again():
    frames = [slot(0, 7, 500, 3), [DROPPED, a(X, 505)], [a(SLOT, 0), a(X, 510)], [a(Y, 4)]]
    assert places(frames) == [500, None, None, 510]
    assert places(frames, needed=("x",)) == [500, None, 510, 510]


def test_after_an_overflow_a_value_without_a_slot_is_ignored():
    frames = [
        [*slot(0, 7, 500, 3), *slot(1, 8, 900, 3)], [DROPPED], [a(X, 910), a(Y, 3)], [a(SLOT, 0), a(X, 510), a(Y, 3)],
        [a(ID, -1)],
    ]  # fmt: skip
    assert places(frames) == [500, None, 910, 510, "lift"]


def test_a_pressure_lost_in_an_overflow_is_not_zero():
    reader = EvdevReader(needed=("x",))
    reader.feed(encode([*slot(0, 7, 500, 3, a(PRESSURE, 60)), SYN], 1.0), 1.0)
    reader.feed(encode([DROPPED, SYN], 1.1), 1.1)
    assert reader.feed(encode([a(SLOT, 0), a(X, 510), SYN], 1.2), 1.2) == []
    (report,) = reader.feed(encode([a(PRESSURE, 61), SYN], 1.3), 1.3)
    assert (report.x_counts, report.pressure) == (510, 61)


def test_while_a_state_read_is_pending_older_events_are_not_reported():
    reader = EvdevReader()
    reader.feed(encode([*slot(0, 7, 500, 3), SYN], 1.0), 1.0)
    reader.has_state = True
    reports = reader.feed(encode([DROPPED, SYN, *slot(1, 8, 2000, 3), SYN], 1.1), 1.1)
    assert reports == []
    assert reader.wants_state
    state = [*slot(0, 7, 512, 300), *slot(1, 8, 2001, 301), a(SLOT, 1), SYN]
    (report,) = reader.restore(encode(state, 1.11))
    assert (report.x_counts, report.y_counts) == (512, 300), "the first one is still down"
    assert not reader.wants_state
    (report,) = reader.feed(encode([a(ID, -1), SYN], 1.12), 1.12)
    assert report.x_counts == 512, "the other one has left, its slot was the current one"


def test_a_bounding_box_of_two_contacts_is_no_position():
    reader = EvdevReader()
    reader.bounding_box = True
    (one,) = reader.feed(encode([*slot(0, 7, 500, 3), SYN], 1.0), 1.0)
    assert one.x_counts == 500
    assert reader.feed(encode([*slot(1, 8, 900, 3), SYN], 1.1), 1.1) == []
    (left,) = reader.feed(encode([a(ID, -1), SYN], 1.2), 1.2)
    assert left.x_counts == 500
