"""Arm-link lines worked by hand, both directions, and the line reader."""

from __future__ import annotations

import math

import pytest

from palmd.devices.armlink import (
    ERROR_TEXT,
    MAX_LINE_BYTES,
    SETPOINT_BYTES,
    Ack,
    ArmState,
    Command,
    Hello,
    HelloReply,
    LineReader,
    LinkError,
    Pose,
    Query,
    Refusal,
    Reply,
    Reset,
    SetPoint,
    Start,
    Stop,
    crc8,
    encode_command,
    encode_reply,
    error_text,
    frame,
    parse_command,
    parse_reply,
    wrap_mdeg,
)

BAUD = 38400
BYTE_S = 10 / BAUD
POSE = Pose(0.123456, -0.000123, math.radians(-90.5))
POSE_WIRE = "+123456-000123-090500"

COMMANDS: list[tuple[Command, str]] = [
    (Hello(), "H"),
    (Start(0), "G00"),
    (SetPoint(10, POSE), "S0A" + POSE_WIRE),
    (Query(255), "QFF"),
    (Stop(0x3C), "P3C"),
    (Reset(1), "R01"),
]
REPLIES: list[tuple[Reply, str]] = [
    (HelloReply(0.016, -0.6, 0.65, -0.5, 0.55, 1.0, 10.0), "H1,16,-600000,650000,-500000,550000,1000000,10000000"),
    (Ack(10, ArmState.TRACKING, POSE), "A0AT" + POSE_WIRE),
    (Refusal(10, -600), "E0A-0600"),
]


def crc8_by_division(data: bytes) -> int:
    """The remainder of data · x⁸ modulo x⁸ + x² + x + 1 over GF(2), by long division."""
    value = int.from_bytes(data, "big") << 8
    while value.bit_length() > 8:
        value ^= 0x107 << value.bit_length() - 9
    return value


def body_of(line: bytes, newline: bytes) -> str:
    reader = LineReader(BAUD)
    assert line.endswith(newline)
    (got,) = reader.feed(line, 0.0)
    return got.body


# Checksum and framing


def test_crc8_has_the_published_check_value() -> None:
    assert crc8(b"123456789") == 0xF4


def test_golden_lines() -> None:
    """H is x⁶ + x³; modulo x⁸ + x² + x + 1, x¹⁴ is 0xC7 and x¹¹ is 0x38, together 0xFF."""
    assert encode_command(Hello()) == b"H*FF\n"
    assert frame("123456789", b"\r\n") == b"123456789*F4\r\n"


@pytest.mark.parametrize(("command", "body"), COMMANDS)
def test_commands_are_encoded_and_decoded(command: Command, body: str) -> None:
    line = encode_command(command)
    assert line == body.encode() + b"*%02X\n" % crc8_by_division(body.encode())
    again = parse_command(body_of(line, b"\n"))
    assert encode_command(again) == line
    assert type(again) is type(command)


@pytest.mark.parametrize(("reply", "body"), REPLIES)
def test_replies_are_encoded_and_decoded(reply: Reply, body: str) -> None:
    line = encode_reply(reply)
    assert line == body.encode() + b"*%02X\r\n" % crc8_by_division(body.encode())
    assert encode_reply(parse_reply(body_of(line, b"\r\n"))) == line


def test_a_set_point_has_the_documented_length() -> None:
    assert len(encode_command(SetPoint(0, POSE))) == SETPOINT_BYTES


def test_values_arrive_in_si() -> None:
    got = parse_reply("A0AT+123456-000123-090500")
    assert isinstance(got, Ack)
    assert (got.ss, got.state) == (10, ArmState.TRACKING)
    assert (got.pose.x_m, got.pose.y_m) == pytest.approx((0.123456, -0.000123))
    assert got.pose.t_rad == pytest.approx(-1.5795, abs=1e-4)
    assert parse_reply(REPLIES[0][1]) == REPLIES[0][0]
    assert parse_reply("E01-0621") == Refusal(1, -621)


# Invalid lines

BAD_COMMANDS = (
    "", "h", "H0", "G", "G0", "G000", "g00", "G0G", "X00", "S00", "S00" + POSE_WIRE[:-1],
    "S00" + POSE_WIRE + "0", "S00 123456-000123-090500", "S00+12345 -000123-090500",
    "S00+123456-000123+180001", "A0AT" + POSE_WIRE, "S00+１23456-000123-09050", "Q00\n",
    "S00+000000+000000-180000",
)  # fmt: skip
BAD_REPLIES = (
    "", "A0A" + POSE_WIRE, "A0AZ" + POSE_WIRE, "A0At" + POSE_WIRE, "AXXT" + POSE_WIRE, "E00-600", "E00 0600",
    "E0-0600", "H1", "H1,16,0,0,0,0,1", "H2,16,-6,6,-6,6,1,1", "H1,0,-6,6,-6,6,1,1", "H1,16,6,-6,-6,6,1,1",
    "H1,16,-6,6,-6,6,0,1", "H1,16,-6,6,-6,6,1,1,1", "H1,16,-6.5,6,-6,6,1,1", "G00",
)  # fmt: skip


@pytest.mark.parametrize("body", BAD_COMMANDS)
def test_bad_commands_are_refused(body: str) -> None:
    with pytest.raises(LinkError):
        parse_command(body)


@pytest.mark.parametrize("body", BAD_REPLIES)
def test_bad_replies_are_refused(body: str) -> None:
    with pytest.raises(LinkError):
        parse_reply(body)


def test_sequence_may_come_in_either_case() -> None:
    assert parse_command("Gab") == Start(0xAB)
    assert encode_command(Start(0xAB)).startswith(b"GAB*")


@pytest.mark.parametrize(
    "pose",
    [
        Pose(1.0, 0.0, 0.0),
        Pose(0.0, -1.0, 0.0),
        Pose(math.nan, 0.0, 0.0),
        Pose(0.0, 1e308, 0.0),
        Pose(0.0, 0.0, math.inf),
    ],
)
def test_poses_out_of_range_are_refused(pose: Pose) -> None:
    with pytest.raises(LinkError):
        encode_command(SetPoint(0, pose))


def test_sequence_numbers_and_codes_out_of_range_are_refused() -> None:
    for ss in (-1, 256):
        with pytest.raises(LinkError, match=f"sequence number {ss} is not 0 to 255"):
            encode_command(Start(ss))
    with pytest.raises(LinkError):
        encode_reply(Refusal(0, -10_000))


@pytest.mark.parametrize(
    ("angle", "wrapped"),
    [(0, 0), (180_000, 180_000), (-180_000, 180_000), (180_001, -179_999), (540_000, 180_000), (-1, -1)],
)
def test_angles_wrap_to_half_a_turn(angle: int, wrapped: int) -> None:
    assert wrap_mdeg(angle) == wrapped


def test_an_angle_that_rounds_to_minus_half_a_turn_is_sent_as_positive() -> None:
    assert b"+180000*" in encode_command(SetPoint(0, Pose(0.0, 0.0, -math.pi + 1e-9)))


def test_every_code_of_the_contract_has_a_text() -> None:
    contract = {-504, -522, -524, -600, -610, -611, -620, -621, -622, -623}
    guards_itself = {-1006}  # from the V+ program, when it detects that the arm is off its path
    assert set(ERROR_TEXT) == contract | guards_itself
    assert error_text(-600).startswith("-0600 the controller lost the link")
    assert "unknown" in error_text(-999)


# The reader

LINE = encode_reply(Ack(1, ArmState.READY, POSE))


@pytest.mark.parametrize("noise", [b"\n", b"\r\n", b"*00\n", b"H*ff\n", b"H*F\n", b"\x00H*FF\n", b"\xff\xfe*00\n"])
def test_unframed_lines_are_counted(noise: bytes) -> None:
    reader = LineReader(BAUD)
    assert len(reader.feed(noise + LINE, 0.0)) == 1
    assert reader.counters.unframed == 1
    assert reader.counters.bytes_discarded == len(noise)


def test_an_overlong_line_is_dropped_and_the_buffer_stays_bounded() -> None:
    reader = LineReader(BAUD)
    for n in range(100):
        assert reader.feed(b"A" * 50, float(n)) == []
        assert reader.pending <= MAX_LINE_BYTES
    assert len(reader.feed(b"\n" + LINE, 100.0)) == 1
    assert reader.counters.overlong == 1
    assert reader.counters.bytes_discarded == 5001


def test_reset_discards_the_current_line() -> None:
    reader = LineReader(BAUD)
    reader.feed(LINE[:10], 0.0)
    reader.reset()
    assert len(reader.feed(LINE, 0.1)) == 1
    assert reader.counters.bytes_discarded == 10


def test_the_earliest_time_of_the_first_byte_is_kept_over_reads() -> None:
    reader = LineReader(BAUD)
    reader.feed(LINE[:1], 1.0)
    (late,) = reader.feed(LINE[1:], 1.020)
    assert late.t_first == 1.0
    reader.feed(LINE[:1], 2.0)
    (early,) = reader.feed(LINE[1:], 2.0)
    assert early.t_first == pytest.approx(2.0 - (len(LINE) - 1) * BYTE_S)
