"""Input events: frames, remembered and reset values, and the failures that a touch driver must handle."""

import math
import os
import time
from itertools import pairwise

import pytest
import terminals
from hypothesis import given
from hypothesis import strategies as st

from palmd.config.pads import EvdevConfig
from palmd.devices import evdev
from palmd.devices.evdev import RECORD, EvdevReader, encode
from palmd.devices.evdevport import EvdevPort
from palmd.devices.pad import make_pad
from palmd.events import PadLift, PadSample

SYN = (evdev.EV_SYN, evdev.SYN_REPORT, 0)
DROPPED = (evdev.EV_SYN, evdev.SYN_DROPPED, 0)
DOWN, UP = (evdev.EV_KEY, evdev.BTN_TOUCH, 1), (evdev.EV_KEY, evdev.BTN_TOUCH, 0)


def x(value):
    return mt(evdev.ABS_X, value)


def y(value):
    return mt(evdev.ABS_Y, value)


def mt(code, value):
    return (evdev.EV_ABS, code, value)


def pad(**values):
    driver = make_pad(1, EvdevConfig(kind="evdev", port="a", zero_mm=0.0, counts_per_mm=10.0, **values))
    driver.opened(0.0)
    return driver


def test_a_record_has_the_kernels_format():
    record = "0C 00 00 00 00 00 00 00 4E 46 05 00 00 00 00 00 03 00 00 00 34 02 00 00"
    assert encode([x(564)], 12.345678) == bytes.fromhex(record)
    assert RECORD.size == 24


def test_unchanged_values_are_not_sent_and_are_remembered():
    driver = pad()
    (first,) = driver.feed(encode([DOWN, x(200), y(7), mt(evdev.ABS_PRESSURE, 20), SYN], 1.0), 1.001)
    assert (first.t_sample, first.s, first.force) == (1.0, pytest.approx(0.020), pytest.approx(0.4))
    (second,) = driver.feed(encode([y(9), SYN], 1.01), 1.011)
    assert (second.s, second.force) == (first.s, first.force)


def test_a_contact_at_rest_is_repeated_and_silence_is_no_lift_off():
    driver = pad()
    driver.feed(encode([DOWN, x(200), y(7), SYN], 1.0), 1.001)
    said = [event for i in range(500) for event in driver.poll(1.0 + 0.01 * i)]
    assert driver.touching
    assert all(isinstance(event, PadSample) and event.s == pytest.approx(0.020) for event in said)
    assert max(b.t_sample - a.t_sample for a, b in pairwise(said)) < 0.1, "before it counts as silent"
    (lift,) = driver.feed(encode([UP, SYN], 6.5), 6.5)
    assert isinstance(lift, PadLift)
    assert driver.touch_end == "lifted"
    assert list(driver.poll(7.0)) == []


def test_while_the_palms_turn_silence_counts_as_a_lost_device():
    driver = pad()
    driver.feed(encode([DOWN, x(200), y(7), SYN], 1.0), 1.001)
    said = [event for i in range(100) for event in driver.poll(1.0 + 0.01 * i, math.radians(30.0))]
    (lift,) = (event for event in said if isinstance(event, PadLift))
    assert 0.2 < lift.t_sample - 1.0 < 0.23, "six degrees"
    assert said[-1] is lift
    assert (driver.touching, driver.touch_end) == (False, "silent")
    assert "the palms have turned by" in driver.evidence("silent", 2.0)


def test_while_the_palms_turn_a_sending_device_is_not_lost():
    driver = pad()
    for i in range(100):
        driver.feed(encode([DOWN, x(200), y(i % 2), SYN], 1.0 + 0.01 * i), 1.001 + 0.01 * i)
        assert not driver.poll(1.005 + 0.01 * i, math.radians(60.0))
    assert driver.touching


def test_without_pressure_there_is_no_force():
    (sample,) = pad(pressure=False).feed(encode([DOWN, x(200), y(7), SYN], 1.0), 1.0)
    assert sample.force is None


def test_a_lift_off_lost_in_an_overflow_is_detected():
    driver = pad()
    driver.feed(encode([DOWN, x(200), y(7), SYN], 1.0), 1.0)
    assert driver.feed(encode([x(210), DROPPED, x(220), SYN], 1.1), 1.1) == []
    assert driver.feed(encode([y(8), SYN], 1.11), 1.11) == [], "the position along the palm is unknown"
    assert list(driver.poll(1.12)) == [], "and is not repeated meanwhile"
    assert [type(event) for event in driver.poll(1.14)] == [PadLift]
    assert driver.touch_end == "silent"
    (again,) = driver.feed(encode([DOWN, x(230), y(8), SYN], 1.15), 1.15)
    assert again.s == pytest.approx(0.023)


def test_an_overflow_without_a_lost_lift_off_ends_no_contact():
    driver = pad()
    driver.feed(encode([DOWN, x(200), y(7), SYN], 1.0), 1.0)
    driver.feed(encode([DROPPED, SYN], 1.1), 1.1)
    (again,) = driver.feed(encode([DOWN, x(230), y(8), SYN], 1.12), 1.12)
    assert again.s == pytest.approx(0.023)
    assert not [event for i in range(20) for event in driver.poll(1.12 + 0.01 * i) if isinstance(event, PadLift)]


class Device(EvdevPort):
    """A device whose state can be read."""

    def __init__(self, state):
        super().__init__("pad1", "nowhere")
        self.state, self.asked = state, 0

    def snapshot(self):
        self.asked += 1
        return self.state


def test_a_contact_that_exists_at_opening_is_read_once():
    driver, device = pad(), Device(encode([DOWN, x(200), y(7), SYN], 1.0))
    for i in range(5):
        driver.tend(device, 0.0)
        driver.poll(1.0 + 0.01 * i)
    assert device.asked == 1
    assert driver.touching


def test_the_first_of_two_fingers_counts_until_it_leaves():
    reader = EvdevReader()
    first = [mt(0x2F, 0), mt(0x39, 40), mt(0x35, 100), mt(0x36, 5)]
    second = [mt(0x2F, 1), mt(0x39, 41), mt(0x35, 300), mt(0x36, 5)]
    (one,) = reader.feed(encode([*first, SYN], 1.0), 1.0)
    (both,) = reader.feed(encode([*second, SYN], 1.1), 1.1)
    (left,) = reader.feed(encode([mt(0x2F, 0), mt(0x39, -1), SYN], 1.2), 1.2)
    (none,) = reader.feed(encode([mt(0x2F, 1), mt(0x39, -1), SYN], 1.3), 1.3)
    assert [one.x_counts, both.x_counts, left.x_counts] == [100, 100, 300]
    assert not none.in_use
    assert reader.counters.extra_contacts == 1


def test_a_new_id_without_a_lift_off_is_a_new_contact():
    reader = EvdevReader()
    reader.feed(encode([mt(0x39, 1), mt(0x35, 100), mt(0x36, 5), SYN], 1.0), 1.0)
    reader.feed(encode([mt(0x2F, 1), mt(0x39, 2), mt(0x35, 200), mt(0x36, 5), SYN], 1.1), 1.1)
    (report,) = reader.feed(encode([mt(0x2F, 0), mt(0x39, 3), mt(0x35, 150), SYN], 1.2), 1.2)
    assert report.x_counts == 200, "the older of the remaining ones"


def test_an_unexpected_clock_is_reported_and_not_used():
    driver = pad()
    for i in range(20):
        (sample,) = driver.feed(encode([DOWN, x(200 + i), y(7), SYN], 1.7e9 + i), 5.0 + 0.01 * i)
        assert sample.t_sample == 5.0 + 0.01 * i
    assert list(driver.health(True)) == ["foreign-clock"]


def test_positions_beyond_the_pad_are_counted_and_are_no_contact():
    driver = pad()
    assert driver.feed(encode([DOWN, x(2000), y(7), SYN], 1.0), 1.0) == []
    assert driver.counts()["out_of_range"] == 1


@given(st.data())
def test_every_split_of_the_bytes_gives_the_same_result(data):
    frames = data.draw(st.lists(st.tuples(st.integers(0, 500), st.booleans()), max_size=6))
    stream = b"".join(
        encode([DOWN if down else UP, x(at), y(1), SYN], 1.0 + 0.01 * i) for i, (at, down) in enumerate(frames)
    )
    edges = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=6)))
    whole, cut = EvdevReader(), EvdevReader()
    expected = whole.feed(stream, 1.1)
    found = [p for a, b in zip([0, *edges], [*edges, len(stream)], strict=True) for p in cut.feed(stream[a:b], 1.1)]
    assert found == expected
    assert cut.counters.frames == len(frames)


@given(st.binary(max_size=300))
def test_arbitrary_bytes_raise_nothing(data):
    driver = pad()
    for event in driver.feed(data, 1.0):
        assert math.isfinite(event.t_sample)
    driver.lost(2.0)


@pytest.fixture
def terminal():
    with terminals.line() as ends:
        yield ends


def test_the_same_records_are_read_from_a_terminal(terminal):
    master, path = terminal
    port, driver = EvdevPort("pad1", path), pad()
    assert port.poll_open(0.0)
    assert port.read() == b""
    t = time.monotonic()
    os.write(master, encode([DOWN, x(200), y(7), SYN], t))
    (sample,) = driver.feed(port.read(), time.monotonic())
    assert sample.t_sample == pytest.approx(t, abs=1e-5)
    assert port.snapshot() == b""
    port.close()
    assert not port.is_open


def test_a_missing_device_is_reported_and_tried_again(tmp_path):
    port = EvdevPort("pad1", str(tmp_path / "event9"))
    assert not port.poll_open(0.0)
    assert "no such device" in port.error
    os.mkfifo(tmp_path / "event9")
    assert not port.poll_open(0.1), "before the retry interval is over"
    assert port.poll_open(0.6)
    port.close()


def test_a_device_that_vanishes_is_closed(terminal):
    port = EvdevPort("pad1", terminal[1])
    port.poll_open(0.0)
    port._fd, kept = os.open("/dev/null", os.O_RDONLY), port._fd
    os.close(kept)
    assert port.read() == b""
    assert not port.is_open
    assert "was lost" in port.error
    assert port.counters.losses == 1
