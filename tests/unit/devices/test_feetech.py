"""The STS protocol against documented packets and the maker's checksum, and against bad lines."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from palmd.devices.feetech import (
    GOAL,
    HOMING_OFFSET,
    LOAD,
    MAKE,
    POSITION,
    encode,
    encode_status,
    packet_reader,
    ping,
    read,
    sync_read,
    write,
)
from palmd.devices.servobus import Registers

BAUD = 1_000_000
SPLITS = 100_000
NASTY = st.lists(st.sampled_from([0xFF, 0xFF, 0xFE, 0x01, 0x02, 0x04, 0x00]), max_size=30).map(bytes)
DATA = st.one_of(st.binary(max_size=30), NASTY)
PACKETS = st.builds(encode_status, st.integers(0, 253), st.sampled_from([0, 1, 4, 0x20]), DATA)


@pytest.mark.parametrize(
    ("packet", "documented"),
    [
        (ping(1), "FF FF 01 02 01 FB"),
        (sync_read(56, 4, (1, 2)), "FF FF FE 06 82 38 04 01 02 3A"),
        (read(1, 56, 2), "FF FF 01 04 02 38 02 BE"),
        (encode_status(1, 0, bytes((0x18, 0x05))), "FF FF 01 04 00 18 05 DD"),
        (write(1, GOAL, 2048), "FF FF 01 05 03 2A 00 08 C4"),
    ],
)
def test_packets_are_as_documented(packet, documented):
    """The second is verified against lerobot's motors; the others are those of the maker's protocol manual."""
    assert packet == bytes.fromhex(documented)


def test_goals_carry_the_speed_at_which_their_way_takes_a_profile():
    raw = MAKE.goals({1: 2148, 2: 1948}, {1: 12.0, 2: -0.001}, 12)
    assert raw == encode(
        0xFE, 0x83, bytes((42, 6)) + bytes.fromhex("01 64 08 00 00 E8 03") + bytes.fromhex("02 9C 07 00 00 01 00")
    ), "1000 counts/s, and at least 1: 0 would be no limit"


@pytest.mark.parametrize(
    ("register", "value", "raw"),
    [(POSITION, -3, "03 80"), (POSITION, 2047, "FF 07"), (LOAD, -1000, "E8 07"), (HOMING_OFFSET, -5, "05 08")],
)
def test_signed_numbers_are_a_size_and_a_sign_bit(register, value, raw):
    assert register.encode(value) == bytes.fromhex(raw)
    assert Registers(register.address, bytes.fromhex(raw))[register] == value


def test_what_a_register_cannot_hold_is_refused():
    with pytest.raises(OverflowError, match="register 42"):
        GOAL.encode(1 << 15)


@given(st.lists(st.one_of(PACKETS, DATA), max_size=8), st.data())
def test_every_split_gives_the_same_and_every_byte_is_counted(pieces, data):
    stream = b"".join(pieces)
    edges = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=10)))
    whole, cut = packet_reader(BAUD), packet_reader(BAUD)
    expected = whole.feed(stream, 0.0)
    found = [p for a, b in zip([0, *edges], [*edges, len(stream)], strict=True) for p in cut.feed(stream[a:b], 0.0)]
    assert [(p.servo, p.error, p.parameters) for p in found] == [(p.servo, p.error, p.parameters) for p in expected]
    for reader in (whole, cut):
        kept = sum(len(p.parameters) + 6 for p in expected)
        assert reader.counters.bytes == len(stream) == kept + reader.counters.discarded + reader.pending


def test_a_hundred_thousand_splits_give_the_same_packets():
    dice = random.Random(1)
    stream = b"".join(
        encode_status(dice.randrange(254), 0, dice.randbytes(dice.randrange(40))) + dice.randbytes(dice.randrange(6))
        for _ in range(8000)
    )
    edges = sorted(dice.sample(range(1, len(stream)), SPLITS))
    whole, cut = packet_reader(BAUD), packet_reader(BAUD)
    expected = whole.feed(stream, 0.0)
    found = [p for a, b in zip([0, *edges], [*edges, len(stream)], strict=True) for p in cut.feed(stream[a:b], 0.0)]
    assert [(p.servo, p.parameters) for p in found] == [(p.servo, p.parameters) for p in expected]
    assert len(expected) > 6000


@given(st.binary(max_size=200))
def test_any_bytes_raise_nothing_and_are_over_when_given_up(data):
    reader = packet_reader(BAUD)
    found = reader.feed(data, 0.0) + reader.flush()
    assert reader.pending == 0
    assert reader.counters.packets == len(found)


def test_one_flipped_bit_loses_one_packet():
    reader = packet_reader(BAUD)
    bad = bytearray(encode_status(2, 0, bytes(16)))
    bad[9] ^= 4
    assert [p.servo for p in reader.feed(bytes(bad) + encode_status(1, 0, bytes(16)), 0.0)] == [1]
    assert reader.counters.crc_errors == 1


def test_the_first_byte_is_dated_by_the_line():
    reader, raw = packet_reader(BAUD), encode_status(1, 0, bytes(16))
    reader.feed(raw[:5], 1.0)
    (packet,) = reader.feed(raw[5:], 2.0)
    assert packet.t_first == pytest.approx(1.0 - 4 * 10 / BAUD)


def test_an_id_that_no_servo_has_is_refused():
    with pytest.raises(ValueError, match="0 to 253"):
        ping(255)
