"""Codecs round trip, results do not depend on how bytes are split, and garbage is counted."""

from __future__ import annotations

import math

from hypothesis import example, given
from hypothesis import strategies as st

from palmd.config.arms import AdeptConfig
from palmd.config.pads import VersaPadConfig
from palmd.devices.armhost import ArmHost
from palmd.devices.armlink import (
    CONTROLLER_NEWLINE,
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
    encode_command,
    encode_reply,
    frame,
    parse_command,
    parse_reply,
)
from palmd.devices.pad import make_pad
from palmd.devices.versapad import PadPacket, VersaPadDecoder, encode_packet
from palmd.events import PadSample

BAUD = 9600

counts = st.integers(-2048, 2047)
packets = st.builds(
    encode_packet,
    counts,
    counts,
    st.integers(0, 127),
    in_use=st.booleans(),
    left=st.booleans(),
    right=st.booleans(),
    tap=st.booleans(),
)
pad_bytes = st.sampled_from([0xC0, 0xC4, 0xFC, 0xC1, 0x80, 0x7F, 0x40, 0x3F, 0x00, 0xFF])
garbage = st.one_of(st.binary(max_size=40), st.lists(pad_bytes, max_size=40).map(bytes))
streams = st.lists(st.one_of(garbage, packets), max_size=12).map(b"".join)
gaps = st.floats(0, 0.05)


@st.composite
def cut(draw: st.DrawFn, data: bytes) -> list[bytes]:
    """Some way to read `data` in pieces, empty reads included."""
    edges = sorted(draw(st.lists(st.integers(0, len(data)), max_size=10)))
    return [data[a:b] for a, b in zip([0, *edges], [*edges, len(data)], strict=True)]


def content(packet: PadPacket) -> tuple[object, ...]:
    return (packet.x_counts, packet.y_counts, packet.pressure, packet.in_use, packet.left, packet.right, packet.tap)


# VersaPad


@given(counts, counts, st.integers(0, 127), st.booleans(), st.booleans(), st.booleans(), st.booleans())
def test_pad_packets_round_trip(
    x: int, y: int, pressure: int, in_use: bool, left: bool, right: bool, tap: bool
) -> None:
    raw = encode_packet(x, y, pressure, in_use=in_use, left=left, right=right, tap=tap)
    (got,) = VersaPadDecoder(BAUD).feed(raw, 0.0)
    assert content(got) == (x, y, pressure, in_use, left, right, tap)


@given(streams, st.data())
def test_every_byte_of_a_pad_is_counted_for_any_split(stream: bytes, data: st.DataObject) -> None:
    whole, split = VersaPadDecoder(BAUD), VersaPadDecoder(BAUD)
    expected = [content(packet) for packet in whole.feed(stream, 0.0)]
    got = []
    for piece in data.draw(cut(stream)):
        got += [content(packet) for packet in split.feed(piece, 0.0)]
        c = split.counters
        assert c.bytes == 6 * c.packets + c.discarded + split.pending
    assert got == expected
    assert split.counters.bytes == len(stream)
    assert split.counters.discarded == whole.counters.discarded


@given(streams, st.data())
def test_pad_times_never_decrease_nor_lie_in_the_future(stream: bytes, data: st.DataObject) -> None:
    decoder, t, times = VersaPadDecoder(BAUD), 0.0, []
    for piece in data.draw(cut(stream)):
        t += data.draw(gaps)
        for packet in decoder.feed(piece, t):
            assert packet.t_first <= packet.t_recv == t
            times.append(packet.t_first)
        c = decoder.counters
        assert c.bytes == 6 * c.packets + c.discarded + decoder.pending
    assert times == sorted(times)


@given(st.binary(max_size=30), packets)
def test_a_good_packet_is_found_after_any_garbage(noise: bytes, good: bytes) -> None:
    got = VersaPadDecoder(BAUD).feed(noise + good, 0.0)
    assert got
    assert content(got[-1]) == content(VersaPadDecoder(BAUD).feed(good, 0.0)[0])


@given(st.lists(packets, min_size=1, max_size=8), st.data())
def test_one_lost_byte_costs_one_packet(sent: list[bytes], data: st.DataObject) -> None:
    stream = b"".join(sent)
    lost = data.draw(st.integers(0, len(stream) - 1))
    got = VersaPadDecoder(BAUD).feed(stream[:lost] + stream[lost + 1 :], 0.0)
    assert len(got) == len(sent) - 1


@given(streams, st.data())
def test_contacts_lie_on_the_pad_for_any_input(stream: bytes, data: st.DataObject) -> None:
    pad, t = make_pad(2, VersaPadConfig(port="pad")), 0.0
    for piece in data.draw(cut(stream)):
        t += data.draw(gaps)
        for event in pad.feed(piece, t):
            assert event.t_sample <= t
            assert not isinstance(event, PadSample) or 0.0 < event.s <= 0.0565
        pad.poll(t)


# Arm link

poses = st.builds(
    Pose,
    st.integers(-999_999, 999_999).map(lambda um: um / 1e6),
    st.integers(-999_999, 999_999).map(lambda um: um / 1e6),
    st.integers(-179_999, 180_000).map(lambda mdeg: math.radians(mdeg / 1e3)),
)
numbers = st.integers(0, 255)
commands = st.one_of(
    st.just(Hello()),
    st.builds(SetPoint, numbers, poses),
    *(st.builds(kind, numbers) for kind in (Start, Query, Stop, Reset)),
)
positive = st.integers(1, 10**9)
replies = st.one_of(
    st.builds(Ack, numbers, st.sampled_from(ArmState), poses),
    st.builds(Refusal, numbers, st.integers(-9999, 9999)),
    st.builds(
        lambda cycle, x, width, y, height, v, a: HelloReply(
            cycle / 1e3, x / 1e6, (x + width) / 1e6, y / 1e6, (y + height) / 1e6, v / 1e6, a / 1e6
        ),
        *(st.integers(1, 1000), st.integers(-(10**9), 10**9), positive, st.integers(-(10**9), 10**9)),
        *(positive, positive, positive),
    ),
)
line_noise = st.one_of(st.binary(max_size=200), st.text("ASGQPRHE0123+-*\r\n", max_size=200).map(str.encode))
talk = st.lists(st.one_of(line_noise, replies.map(encode_reply), commands.map(encode_command)), max_size=10)


@given(commands)
def test_commands_round_trip(command: Command) -> None:
    line = encode_command(command)
    (got,) = LineReader(BAUD).feed(line, 0.0)
    assert parse_command(got.body) == command


@given(replies)
def test_replies_round_trip(reply: Reply) -> None:
    line = encode_reply(reply)
    (got,) = LineReader(BAUD).feed(line, 0.0)
    assert parse_reply(got.body) == reply


@given(st.floats(-1e4, 1e4), st.floats(-0.9, 0.9))
def test_any_angle_arrives_as_the_same_direction(angle: float, x: float) -> None:
    (got,) = LineReader(BAUD).feed(encode_command(SetPoint(0, Pose(x, 0.0, angle))), 0.0)
    command = parse_command(got.body)
    assert isinstance(command, SetPoint)
    assert -math.pi < command.pose.t_rad <= math.pi
    assert abs(math.remainder(command.pose.t_rad - angle, math.tau)) <= math.radians(0.51e-3)
    assert abs(command.pose.x_m - x) <= 0.51e-6


@given(st.text(max_size=60))
def test_parsers_raise_only_their_own_error(body: str) -> None:
    for parse in (parse_command, parse_reply):
        try:
            parse(body)
        except LinkError:
            continue


@given(talk.map(b"".join), st.data())
def test_every_byte_of_a_line_is_counted_for_any_split(stream: bytes, data: st.DataObject) -> None:
    whole, split = LineReader(BAUD), LineReader(BAUD)
    expected = [line.body for line in whole.feed(stream, 0.0)]
    times, got, t = [], [], 0.0
    for piece in data.draw(cut(stream)):
        t += data.draw(gaps)
        for line in split.feed(piece, t):
            assert line.t_first <= t
            got.append(line.body)
            times.append(line.t_first)
    assert got == expected
    assert times == sorted(times)
    assert whole.counters == split.counters
    kept = sum(len(frame(body, b"\n")) for body in got)
    accounted = kept + split.counters.bytes_discarded + split.pending
    assert accounted <= len(stream) <= accounted + len(got), "each kept line may also have had a CR"


@given(st.binary(max_size=159).filter(lambda noise: b"\n" not in noise), replies)
def test_a_line_feed_resynchronises(noise: bytes, reply: Reply) -> None:
    got = LineReader(BAUD).feed(noise + b"\n" + encode_reply(reply), 0.0)
    assert got[-1].body + "*" == encode_reply(reply).decode()[: len(got[-1].body) + 1]


@given(replies, st.data())
def test_one_flipped_bit_is_always_detected(reply: Reply, data: st.DataObject) -> None:
    line = bytearray(encode_reply(reply).removesuffix(CONTROLLER_NEWLINE))
    place = data.draw(st.integers(0, len(line) - 1))
    line[place] ^= 1 << data.draw(st.integers(0, 7))
    assert LineReader(BAUD).feed(bytes(line) + b"\n", 0.0) == []


# Host

actions = st.one_of(
    line_noise,
    replies.map(encode_reply),
    st.sampled_from(["request_tracking", "request_stop", "request_reset", "disconnected"]),
    st.builds(Pose, st.floats(), st.floats(), st.floats()),
    st.sampled_from(ArmState),  # a valid answer to the last line sent, with this state
)
LIMITS = HelloReply(0.016, -1.0, 1.0, -1.0, 1.0, 1.0, 1.0)


@given(st.lists(st.tuples(gaps, actions), max_size=60))
@example(
    [(0.0, b""), (0.0, ArmState.READY), (0.01, ArmState.READY), (0.01, "request_tracking")]
    + [(0.016, ArmState.TRACKING), (0.0, Pose(math.inf, 0.0, 0.0)), (0.0, Pose(0.0, 0.0, math.nan))] * 5
    + [(0.0, ArmState.HOLD), (0.016, Pose(0.0, 0.0, math.inf)), (0.0, "request_stop"), (0.0, ArmState.READY)]
)
def test_the_host_accepts_any_input_and_continues(script: list[tuple[float, bytes | ArmState | str | Pose]]) -> None:
    host, far = ArmHost(AdeptConfig(port="arm")), LineReader(38400)
    t, target, asked, last = 0.0, None, {"H", "Q"}, Hello()
    for gap, action in script:
        t += gap
        match action:
            case bytes():
                host.feed(action, t)
            case ArmState():
                answer = LIMITS if isinstance(last, Hello) else Ack(last.ss, action, Pose(0.1, 0.2, 0.3))
                host.feed(encode_reply(answer), t)
            case str():
                getattr(host, action)()
                asked.add({"request_tracking": "G", "request_stop": "P", "request_reset": "R"}.get(action, "H"))
            case Pose():
                target = action
        for line in far.feed(host.poll(t, target).data, t):
            assert line.body[0] in asked | ({"S"} if "G" in asked else set())
            last = parse_command(line.body)
        assert host.due() > t
        assert host.tracking <= host.linked(t)
    assert far.counters.bytes_discarded == 0
