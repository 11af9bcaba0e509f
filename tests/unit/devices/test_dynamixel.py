"""Protocol 2.0 against the manual's examples, against the maker's own library, and against bad lines."""

import random

import pytest
from dynamixel_sdk import COMM_SUCCESS, Protocol2PacketHandler
from hypothesis import given
from hypothesis import strategies as st

from palmd.devices.dynamixel import (
    GOAL,
    HARDWARE_ERROR,
    HEADER,
    POSITION,
    VELOCITY,
    WATCHDOG,
    Instruction,
    crc16,
    encode,
    encode_status,
    packet_reader,
    ping,
    read,
    reboot,
    stuffed,
    sync_read,
    sync_write,
    unstuffed,
    write,
)
from palmd.devices.servobus import Registers

BAUD = 1_000_000
NASTY = st.lists(st.sampled_from([0xFF, 0xFF, 0xFF, 0xFD, 0xFD, 0x00, 0x55, 0x82]), max_size=40).map(bytes)
DATA = st.one_of(st.binary(max_size=40), NASTY)
PACKETS = st.one_of(
    st.builds(lambda i, d: encode(i, Instruction.WRITE, d), st.integers(0, 252), DATA),
    st.builds(encode_status, st.integers(0, 252), st.sampled_from([0, 1, 0x80, 0x84]), DATA),
)


@pytest.mark.parametrize(
    ("packet", "manual"),
    [
        (ping(1), "FF FF FD 00 01 03 00 01 19 4E"),
        (encode_status(1, 0, bytes((0x06, 0x04, 0x26))), "FF FF FD 00 01 07 00 55 00 06 04 26 65 5D"),
        (read(1, 132, 4), "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15"),
        (encode_status(1, 0, bytes((0xA6, 0, 0, 0))), "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0"),
        (write(1, GOAL, 512), "FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89"),
        (reboot(1), "FF FF FD 00 01 03 00 08 2F 4E"),
        (write(1, WATCHDOG, 5), "FF FF FD 00 01 06 00 03 62 00 05 68 E4"),
        (write(1, WATCHDOG, 0), "FF FF FD 00 01 06 00 03 62 00 00 76 E4"),
        (sync_write(GOAL, {1: 150, 2: 170}),
         "FF FF FD 00 FE 11 00 83 74 00 04 00 01 96 00 00 00 02 AA 00 00 00 82 87"),
        (sync_write(GOAL, {1: 2148, 2: 1948}),
         "FF FF FD 00 FE 11 00 83 74 00 04 00 01 64 08 00 00 02 9C 07 00 00 1B 31"),
        (sync_read(132, 4, (1, 2)), "FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA"),
        (sync_read(120, 16, (1, 2)), "FF FF FD 00 FE 09 00 82 78 00 10 00 01 02 3B CA"),
    ],
)  # fmt: skip
def test_packets_are_those_of_the_manual(packet, manual):
    assert packet == bytes.fromhex(manual)


def test_an_answer_of_ordinary_numbers_is_stuffed_and_read_back():
    raw = bytes.fromhex("FF FF FD 00 01 15 00 55 00 E8 03 01 01 00 00 FF FF FD FD FF FF FF 63 08 00 00 62 A2")
    (packet,) = packet_reader(BAUD).feed(raw, 0.0)
    registers = Registers(120, packet.parameters)
    assert (registers[VELOCITY], registers[POSITION]) == (-3, 2147)
    assert HARDWARE_ERROR not in registers
    assert encode_status(1, 0, packet.parameters) == raw


class Line:
    """What the maker's library wants of a port that brings an answer, on bytes in memory."""

    def __init__(self, answer):
        self.is_using, self.answer = False, answer

    def readPort(self, length):  # noqa: N802
        out, self.answer = self.answer[:length], self.answer[length:]
        return list(out)

    def isPacketTimeout(self):  # noqa: N802
        return not self.answer


def random_data(dice):
    return bytes(dice.choice((0xFF, 0xFF, 0xFD, 0x00, dice.randrange(256))) for _ in range(dice.randrange(1, 30)))


def as_the_library_sends(theirs, servo, body):
    """With its stuffing and checksum; `txPacket` of 4.1.0 forgets what `addStuffing` returns."""
    packet = theirs.addStuffing([*HEADER, servo, len(body) + 2, 0, *body, 0, 0])
    crc = theirs.updateCRC(0, packet, len(packet) - 2)
    return bytes([*packet[:-2], crc & 0xFF, crc >> 8])


def test_two_thousand_random_packets_are_those_of_the_makers_library():
    dice, theirs = random.Random(5), Protocol2PacketHandler()
    for _ in range(2000):
        servo, data = dice.randrange(253), random_data(dice)
        assert as_the_library_sends(theirs, servo, bytes((3,)) + data) == encode(servo, Instruction.WRITE, data)


def test_the_makers_library_reads_our_answers():
    """But where it looks for stuffing in bytes that it has moved already, and so loses some of them."""
    dice, theirs, read_alike = random.Random(6), Protocol2PacketHandler(), 0
    for _ in range(2000):
        data = random_data(dice)
        if b"\xff\xff\xfd" in data and b"\xfd\xfd" in data + b"\xfd":
            continue
        told, result, error = theirs.readRx(Line(encode_status(7, 0, data)), 7, len(data))
        assert (result, error, bytes(told)) == (COMM_SUCCESS, 0, data)
        read_alike += 1
    assert read_alike > 1000


@given(DATA)
def test_stuffing_is_undone_and_leaves_no_header(data):
    assert unstuffed(stuffed(data)) == data
    assert HEADER not in stuffed(data)


@given(st.lists(PACKETS, max_size=6), st.data())
def test_every_split_of_the_bytes_gives_the_same_packets(packets, data):
    stream = b"".join(packets)
    edges = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=10)))
    whole, cut = packet_reader(BAUD), packet_reader(BAUD)
    expected = whole.feed(stream, 0.0)
    found = [p for a, b in zip([0, *edges], [*edges, len(stream)], strict=True) for p in cut.feed(stream[a:b], 0.0)]
    assert len(expected) == len(packets)
    assert [(p.servo, p.error, p.parameters) for p in found] == [(p.servo, p.error, p.parameters) for p in expected]
    assert cut.pending == whole.pending == 0


@given(st.lists(st.one_of(PACKETS, DATA), max_size=8))
def test_garbage_is_counted_and_nothing_else(pieces):
    reader = packet_reader(BAUD)
    found = reader.feed(b"".join(pieces), 0.0) + reader.flush()
    counters = reader.counters
    assert counters.packets == len(found)
    assert reader.pending == 0
    assert counters.discarded <= counters.bytes


def test_what_a_cut_packet_hides_comes_when_it_is_given_up():
    reader, whole = packet_reader(BAUD), encode_status(2, 0, bytes(16))
    assert reader.feed(encode_status(1, 0, bytes(60))[:20] + whole, 0.0) == []
    (found,) = reader.flush()
    assert found.servo == 2
    assert reader.counters.discarded == 20


def test_one_flipped_bit_loses_one_packet():
    reader = packet_reader(BAUD)
    good, bad = encode_status(1, 0, bytes(16)), bytearray(encode_status(2, 0, bytes(16)))
    bad[12] ^= 4
    assert [p.servo for p in reader.feed(bytes(bad) + good, 0.0)] == [1]
    assert reader.counters.crc_errors == 1


def test_the_first_byte_is_dated_by_the_line():
    reader, raw = packet_reader(BAUD), encode_status(1, 0, bytes(16))
    reader.feed(raw[:5], 1.0)
    (packet,) = reader.feed(raw[5:], 2.0)
    assert packet.t_first == pytest.approx(1.0 - 4 * 10 / BAUD)


def test_an_id_that_no_servo_has_is_refused():
    with pytest.raises(ValueError, match="0 to 252"):
        ping(253)


def test_the_checksum_of_nothing():
    assert crc16(b"") == 0
