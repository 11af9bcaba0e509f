"""The rig's own counts: every byte is accounted for, and effects of fault injection are counted separately."""

import math

from palmd.devices.armlink import LineReader, Pose, SetPoint, Start, encode_command
from palmd.rig.fault_injection import PORTS, order
from palmd.rig.tally import DeviceTally, HostLines
from palmd.rig.world import World, default_config


def test_sent_altered_and_withheld_messages_are_counted_separately():
    said = DeviceTally()
    said.take(b"abcdef", b"abcdef")
    said.take(b"abcdef", b"abcde")
    said.take(b"abcdef", b"")
    said.take(b"ID\r", b"ID\r", messages=0)
    assert said == DeviceTally(messages=3, altered=1, withheld=1, bytes_said=21, bytes_on_line=14)


def test_set_points_are_counted_before_fault_injection_and_altered_ones_separately():
    lines = HostLines(38400)
    one = encode_command(SetPoint(1, Pose(0.1, 0.2, 0.3)))
    lines.take(encode_command(Start(0)), encode_command(Start(0)), 0.0)
    lines.take(one, one, 0.1)
    lines.take(one, b"", 0.2)
    assert (lines.setpoints, lines.setpoints_touched) == (2, 1)
    lines.take(one[:5], b"x", 0.3)
    assert (lines.setpoints, lines.setpoints_touched) == (2, 2)
    lines.take(one[5:], one[5:], 0.3)
    assert (lines.setpoints, lines.setpoints_touched) == (3, 2)


def test_every_byte_on_a_line_is_sent_or_still_waiting():
    world = World(default_config(), 3)
    world.fault_injector.add(order("garble", 0.5, "pad1", 0.3, for_s=1.0))
    world.fault_injector.add(order("mute", 0.5, "pad2", for_s=1.0))
    out = dict.fromkeys(PORTS, b"")
    for step in range(1, 2001):
        for port, data in world.advance(step * 1e-3).items():
            out[port] += data
        if step % 100 == 0:
            world.receive("arm", encode_command(Start(step % 256)))
    status = world.status()
    for port in PORTS:
        assert status[f"{port}_bytes_on_line"] == len(out[port]) + status[f"{port}_bytes_waiting"], port
    assert status["pad1_messages"] == status["pad1_packets"] > 100
    assert status["pad1_altered"] > 50
    assert status["pad1_withheld"] == status["pad2_altered"] == 0
    assert status["pad2_withheld"] > 50
    assert status["arm_messages"] == lines_in(out["arm"])


def lines_in(data):
    reader = LineReader(38400)
    return len(reader.feed(data, math.inf))
