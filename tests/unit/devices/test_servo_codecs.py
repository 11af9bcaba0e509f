"""The servos' protocols against documented packets and the makers' libraries, and against bad lines."""

import random
from types import SimpleNamespace

import pytest
from dynamixel_sdk import COMM_SUCCESS, Protocol2PacketHandler
from hypothesis import given
from hypothesis import strategies as st

from palmd.devices import dynamixel as dxl
from palmd.devices import feetech as sts
from palmd.devices.servobus import Instruction, Registers

BAUD = 1_000_000
NASTY = st.lists(st.sampled_from([0xFF, 0xFF, 0xFF, 0xFD, 0xFD, 0xFE, 0x00, 0x01, 0x02, 0x04, 0x55, 0x82]), max_size=40)
DATA = st.one_of(st.binary(max_size=40), NASTY.map(bytes))
of_every_make = pytest.mark.parametrize("codec", [dxl, sts], ids=("dynamixel", "feetech"))


@pytest.mark.parametrize(
    ("packet", "manual"),
    [
        (dxl.MAKE.ping(1), "FF FF FD 00 01 03 00 01 19 4E"),
        (dxl.encode_status(1, 0, bytes((0x06, 0x04, 0x26))), "FF FF FD 00 01 07 00 55 00 06 04 26 65 5D"),
        (dxl.MAKE.read(1, 132, 4), "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15"),
        (dxl.encode_status(1, 0, bytes((0xA6, 0, 0, 0))), "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0"),
        (dxl.MAKE.write(1, dxl.GOAL, 512), "FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89"),
        (dxl.MAKE.restart(1), "FF FF FD 00 01 03 00 08 2F 4E"),
        (dxl.MAKE.write(1, dxl.WATCHDOG, 5), "FF FF FD 00 01 06 00 03 62 00 05 68 E4"),
        (dxl.MAKE.sync_write(dxl.GOAL, {1: 150, 2: 170}),
         "FF FF FD 00 FE 11 00 83 74 00 04 00 01 96 00 00 00 02 AA 00 00 00 82 87"),
        (dxl.MAKE.sync_read(132, 4, (1, 2)), "FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA"),
        (sts.MAKE.ping(1), "FF FF 01 02 01 FB"),
        (sts.MAKE.sync_read(56, 4, (1, 2)), "FF FF FE 06 82 38 04 01 02 3A"),
        (sts.MAKE.read(1, 56, 2), "FF FF 01 04 02 38 02 BE"),
        (sts.encode_status(1, 0, bytes((0x18, 0x05))), "FF FF 01 04 00 18 05 DD"),
        (sts.MAKE.write(1, sts.GOAL, 2048), "FF FF 01 05 03 2A 00 08 C4"),
    ],
)  # fmt: skip
def test_packets_are_those_of_the_manuals(packet, manual):
    """The STS's Sync Read is verified against LeRobot's motors."""
    assert packet == bytes.fromhex(manual)


def test_an_answer_that_contains_the_header_is_stuffed_and_read_back():
    raw = bytes.fromhex("FF FF FD 00 01 15 00 55 00 E8 03 01 01 00 00 FF FF FD FD FF FF FF 63 08 00 00 62 A2")
    (packet,) = dxl.packet_reader(BAUD).feed(raw, 0.0)
    registers = Registers(120, packet.parameters)
    assert (registers[dxl.VELOCITY], registers[dxl.POSITION]) == (-3, 2147)
    assert dxl.HARDWARE_ERROR not in registers
    assert dxl.encode_status(1, 0, packet.parameters) == raw


def test_feetech_goals_have_the_speed_of_a_profile():
    raw = sts.MAKE.goals({1: 2148, 2: 1948}, {1: 12.0, 2: -0.001}, 12)
    parameters = bytes((42, 6)) + bytes.fromhex("01 64 08 00 00 E8 03") + bytes.fromhex("02 9C 07 00 00 01 00")
    assert raw == sts.encode(0xFE, 0x83, parameters), "1000 counts/s, and at least 1: 0 would be no limit"


@pytest.mark.parametrize(
    ("register", "value", "raw"),
    [
        (sts.POSITION, -3, "03 80"),
        (sts.POSITION, 2047, "FF 07"),
        (sts.LOAD, -1000, "E8 07"),
        (sts.HOMING_OFFSET, -5, "05 08"),
    ],
)
def test_feetech_numbers_are_magnitude_and_sign_bit(register, value, raw):
    assert register.encode(value) == bytes.fromhex(raw)
    assert Registers(register.address, bytes.fromhex(raw))[register] == value


def test_numbers_out_of_a_registers_range_are_refused():
    with pytest.raises(OverflowError, match="register 42"):
        sts.GOAL.encode(1 << 15)


# The maker's library


def random_data(dice):
    return bytes(dice.choice((0xFF, 0xFF, 0xFD, 0x00, dice.randrange(256))) for _ in range(dice.randrange(1, 30)))


def as_the_library_sends(theirs, servo, body):
    """With the library's stuffing and checksum; `txPacket` of 4.1.0 ignores the result of `addStuffing`."""
    packet = theirs.addStuffing([*dxl.HEADER, servo, len(body) + 2, 0, *body, 0, 0])
    crc = theirs.updateCRC(0, packet, len(packet) - 2)
    return bytes([*packet[:-2], crc & 0xFF, crc >> 8])


def test_random_packets_are_those_of_the_makers_library():
    dice, theirs = random.Random(5), Protocol2PacketHandler()
    for _ in range(2000):
        servo, data = dice.randrange(253), random_data(dice)
        assert as_the_library_sends(theirs, servo, bytes((3,)) + data) == dxl.encode(servo, Instruction.WRITE, data)


def answering(answer):
    """A port that delivers an answer from memory, with the attributes that the maker's library uses."""
    left = list(answer)

    def read(length):
        out, left[:] = left[:length], left[length:]
        return out

    return SimpleNamespace(is_using=False, readPort=read, isPacketTimeout=lambda: not left)


def test_the_makers_library_reads_our_answers():
    """Except where it looks for stuffing in bytes that it has moved already, and so loses some of them."""
    dice, theirs, read_alike = random.Random(6), Protocol2PacketHandler(), 0
    for _ in range(2000):
        data = random_data(dice)
        if b"\xff\xff\xfd" in data and b"\xfd\xfd" in data + b"\xfd":
            continue
        received, result, error = theirs.readRx(answering(dxl.encode_status(7, 0, data)), 7, len(data))
        assert (result, error, bytes(received)) == (COMM_SUCCESS, 0, data)
        read_alike += 1
    assert read_alike > 1000


# Bad lines


def content(packets):
    return [(packet.servo, packet.error, packet.parameters) for packet in packets]


@of_every_make
@given(st.data())
def test_every_split_of_the_bytes_gives_the_same_and_every_byte_is_counted(codec, data):
    answers = st.builds(codec.encode_status, st.integers(0, 252), st.sampled_from([0, 1, 0x20, 0x80]), DATA)
    stream = b"".join(data.draw(st.lists(st.one_of(answers, DATA), max_size=8)))
    edges = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=10)))
    whole = codec.packet_reader(BAUD)
    expected = whole.feed(stream, 0.0)
    cut = codec.packet_reader(BAUD)
    pieces = zip([0, *edges], [*edges, len(stream)], strict=True)
    assert content(packet for a, b in pieces for packet in cut.feed(stream[a:b], 0.0)) == content(expected)
    kept = sum(len(codec.encode_status(each.servo, each.error, each.parameters)) for each in expected)
    for reader in (whole, cut):
        accounted = reader.counters.discarded + reader.pending
        assert reader.counters.bytes == len(stream) == kept + accounted
    whole.flush()
    assert whole.pending == 0


def test_a_packet_hidden_by_a_cut_one_is_found_after_a_timeout():
    reader, whole = dxl.packet_reader(BAUD), dxl.encode_status(2, 0, bytes(16))
    assert reader.feed(dxl.encode_status(1, 0, bytes(60))[:20] + whole, 0.0) == []
    (found,) = reader.flush()
    assert found.servo == 2
    assert reader.counters.discarded == 20


@of_every_make
def test_one_flipped_bit_loses_one_packet(codec):
    reader = codec.packet_reader(BAUD)
    bad = bytearray(codec.encode_status(2, 0, bytes(16)))
    bad[12] ^= 4
    assert [p.servo for p in reader.feed(bytes(bad) + codec.encode_status(1, 0, bytes(16)), 0.0)] == [1]
    assert reader.counters.crc_errors == 1


@of_every_make
def test_the_first_byte_is_dated_by_the_line_rate(codec):
    reader, raw = codec.packet_reader(BAUD), codec.encode_status(1, 0, bytes(16))
    reader.feed(raw[:5], 1.0)
    (packet,) = reader.feed(raw[5:], 2.0)
    assert packet.t_first == pytest.approx(1.0 - 4 * 10 / BAUD)


@pytest.mark.parametrize(("codec", "unknown"), [(dxl, 253), (sts, 255)])
def test_an_invalid_id_is_refused(codec, unknown):
    with pytest.raises(ValueError, match=f"0 to {codec.ID_MAX}"):
        codec.MAKE.ping(unknown)
