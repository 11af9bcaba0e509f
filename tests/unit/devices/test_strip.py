"""A strip's packets: the firmware's logic, compiled here, against the decoder; splits, garbage, silence."""

import ctypes
import shutil
import subprocess
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from palmd.config.pads import StripConfig
from palmd.devices.pad import make_pad
from palmd.devices.strip import FORCE_MAX, StripDecoder, encode

BAUD = 115200
FIRMWARE = Path(__file__).parents[3] / "tools/strip"
PACKETS = st.builds(
    encode, st.integers(0, 16383), st.integers(0, 4095), st.integers(0, 255), touched=st.booleans(),
    saturated=st.booleans(), age_s=st.floats(0.0, 0.6),
)  # fmt: skip
GARBAGE = st.lists(st.sampled_from([0xA5, 0x5A, 0x11, 0x00, 0xFF]), max_size=30).map(bytes)


class State(ctypes.Structure):
    _fields_ = (("sampled_us", ctypes.c_uint32), ("said_us", ctypes.c_uint32), ("sequence", ctypes.c_uint8),
                ("touched", ctypes.c_bool), ("begun", ctypes.c_bool))  # fmt: skip


class Readings(ctypes.Structure):
    _fields_ = (("position_sum", ctypes.c_uint16), ("drive", ctypes.c_uint16), ("sense", ctypes.c_uint16))


@pytest.fixture(scope="module")
def firmware(tmp_path_factory):
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    made = tmp_path_factory.mktemp("strip") / "strip.so"
    strict = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-shared", "-fPIC"]
    subprocess.run([compiler, *strict, str(FIRMWARE / "strip.c"), "-o", str(made)], check=True)
    library = ctypes.CDLL(str(made))
    library.strip_take.restype = ctypes.c_uint8
    library.strip_take.argtypes = [
        ctypes.POINTER(State), Readings, ctypes.c_uint32, ctypes.c_uint32, ctypes.c_char_p
    ]  # fmt: skip
    library.strip_due.restype = ctypes.c_bool
    library.strip_force.restype = ctypes.c_uint16
    return library


def run(firmware, touches, t_us=0, step_us=250):
    """The packets, with their times (us), of a strip that is touched as `touches` gives for each ms."""
    state, out, said = State(), ctypes.create_string_buffer(12), []
    for step in range(len(touches) * 1000 // step_us):
        now = (t_us + step * step_us) % 2**32
        if firmware.strip_due(ctypes.byref(state), now):
            position, force = touches[step * step_us // 1000]
            sense = force and 2048 * force // (256 + force)  # so that v2 / (v1 - v2) is force / 256
            count = firmware.strip_take(ctypes.byref(state), Readings(position, 2048, sense), now, now + 120, out)
            if count:
                said.append((step * step_us, out.raw[:count]))
    return said


def test_the_decoder_reads_the_firmwares_packets(firmware):
    said = run(firmware, [(1000 + ms, 400) for ms in range(500)])
    packets = StripDecoder(BAUD).feed(b"".join(raw for _, raw in said), 10.0)
    assert len(packets) == 50, "a hundred a second"
    assert [p.x_counts for p in packets] == [1000 + 10 * i for i in range(50)]
    assert all(abs(p.pressure - 400) < 3 and p.in_use and not p.saturated for p in packets)
    first = packets[0]
    assert said[0][1] == encode(first.x_counts, first.pressure, 0, age_s=120e-6)


def test_an_untouched_strip_reports_at_once_and_then_twenty_times_a_second(firmware):
    said = run(firmware, [(0, 0)] * 200 + [(5000, 300)] * 100 + [(0, 0)] * 300)
    packets = StripDecoder(BAUD).feed(b"".join(raw for _, raw in said), 10.0)
    touched = [p.in_use for p in packets]
    assert touched == [False] * 4 + [True] * 10 + [False] * 6
    lift = said[14][0]
    assert 300_000 <= lift <= 310_000, "the lift-off is sent at once"
    assert said[15][0] - lift == pytest.approx(50_000, abs=10_000)


def test_a_touch_near_the_threshold_does_not_flicker(firmware):
    said = run(firmware, [(5000, 30)] * 50 + [(5000, 18)] * 50 + [(5000, 10)] * 20 + [(5000, 20)] * 100)
    packets = StripDecoder(BAUD).feed(b"".join(raw for _, raw in said), 10.0)
    changes = sum(a.in_use != b.in_use for a, b in pairwise(packets))
    assert changes == 1


def test_the_boards_clock_may_wrap(firmware):
    at_wrap = run(firmware, [(1000, 400)] * 200, t_us=2**32 - 100_000)
    assert [t for t, _ in at_wrap] == [t for t, _ in run(firmware, [(1000, 400)] * 200)]


def test_force_is_proportional_to_conductance(firmware):
    assert firmware.strip_force(2048, 0) == 0
    assert firmware.strip_force(2000, 1000) == 256
    assert firmware.strip_force(2000, 1999) == FORCE_MAX
    assert firmware.strip_force(1000, 2000) == FORCE_MAX


@given(st.lists(st.one_of(PACKETS, GARBAGE), max_size=8), st.data())
def test_every_split_of_the_bytes_gives_the_same_and_every_byte_is_counted(pieces, data):
    stream = b"".join(pieces)
    edges = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=8)))
    whole, cut = StripDecoder(BAUD), StripDecoder(BAUD)
    expected = whole.feed(stream, 1.0)
    found = [p for a, b in zip([0, *edges], [*edges, len(stream)], strict=True) for p in cut.feed(stream[a:b], 1.0)]
    decoded = [(p.sequence, p.x_counts, p.pressure, p.in_use) for p in found]
    assert decoded == [(p.sequence, p.x_counts, p.pressure, p.in_use) for p in expected]
    for decoder in (whole, cut):
        counters = decoder.counters
        assert counters.bytes == len(stream) == 12 * counters.packets + counters.discarded + decoder.pending


def test_a_damaged_packet_is_dropped_and_a_lost_one_is_counted():
    decoder = StripDecoder(BAUD)
    spoilt = bytearray(encode(1, 2, 1))
    spoilt[5] ^= 1
    packets = decoder.feed(encode(1, 2, 0) + bytes(spoilt) + encode(1, 2, 2), 1.0)
    assert [p.sequence for p in packets] == [0, 2]
    assert (decoder.counters.crc_errors, decoder.counters.lost) == (1, 1)


def test_readings_have_the_age_given_in_the_packet():
    (packet,) = StripDecoder(BAUD).feed(encode(1, 2, 0, age_s=0.002), 1.0)
    assert packet.t_first == pytest.approx(1.0 - 11 * 10 / BAUD - 0.002)


def strip(**values):
    driver = make_pad(2, StripConfig(kind="strip", port="a", **values))
    driver.opened(0.0)
    return driver


def test_a_force_at_the_end_of_the_scale_is_none():
    (sample,) = strip().feed(encode(5460, FORCE_MAX, 0, saturated=True), 1.0)
    assert sample.force is None


def test_an_unknown_firmware_is_reported():
    driver = strip()
    import palmd.devices.strip as module

    body = bytearray(encode(1, 2, 3)[2:10])
    body[0] = 0x21
    raw = module.SYNC + bytes(body) + module.checksum(bytes(body)).to_bytes(2, "little")
    assert driver.feed(raw, 1.0) == []
    assert "flash the firmware in tools/strip" in driver.diagnosis
