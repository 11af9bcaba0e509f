"""VersaPad packets decoded by hand, resynchronisation, timestamps, calibration and lift-off."""

from __future__ import annotations

import math
import random
import statistics
from dataclasses import replace

import numpy as np
import pytest

from palmd.config.pads import VersaPadConfig
from palmd.config.three_palms import PlanePadConfig
from palmd.devices.pad import MARGIN_MM, PadDriver, TouchTracker, make_pad
from palmd.devices.port import Port
from palmd.devices.versapad import PadPacket, PressureFormat, VersaPadDecoder, encode_packet
from palmd.events import PadLift, PadSample
from palmd.rig.fault_injection import FaultInjector, order

BAUD = 9600
PACKET_S = 0.00625
BYTE_S = 10 / BAUD
MARGIN_S = 0.003
GOLDEN = bytes.fromhex("c4 3b 3f 07 00 64")
"""In use; x = -5 = 0xFFB: low six bits 0x3B, high 0x3F; y = 7; pressure 100 = 0x64."""


def packet(t: float, x_counts: int = 0, pressure: int = 50, in_use: bool = True) -> PadPacket:
    return PadPacket(t, t, x_counts, 0, pressure, in_use, False, False, False, False)


# Codec


def test_golden_packet_decodes() -> None:
    (got,) = VersaPadDecoder(BAUD).feed(GOLDEN, 2.0)
    assert (got.x_counts, got.y_counts, got.pressure) == (-5, 7, 100)
    assert (got.in_use, got.left, got.right, got.tap, got.batched) == (True, False, False, False, False)
    assert got.t_recv == 2.0


def test_golden_packet_encodes() -> None:
    assert encode_packet(-5, 7, 100) == GOLDEN


@pytest.mark.parametrize(
    ("header", "flag"), [(0xE0, "left"), (0xD0, "right"), (0xC8, "tap"), (0xC4, "in_use"), (0xC0, None)]
)
def test_flags_are_where_the_contract_puts_them(header: int, flag: str | None) -> None:
    (got,) = VersaPadDecoder(BAUD).feed(bytes([header, 0, 0, 0, 0, 0]), 0.0)
    assert [name for name in ("left", "right", "tap", "in_use") if getattr(got, name)] == [flag] * bool(flag)


@pytest.mark.parametrize(
    ("low", "high", "counts"), [(0x3F, 0x1F, 2047), (0x00, 0x20, -2048), (0x3F, 0x3F, -1), (0x01, 0x00, 1)]
)
def test_twelve_bit_twos_complement(low: int, high: int, counts: int) -> None:
    (got,) = VersaPadDecoder(BAUD).feed(bytes([0xC4, low, high, low, high, 0]), 0.0)
    assert (got.x_counts, got.y_counts) == (counts, counts)
    assert encode_packet(counts, counts, 0)[1:5] == bytes([low, high, low, high])


def test_encoding_refuses_values_out_of_range() -> None:
    with pytest.raises(ValueError, match="x_counts"):
        encode_packet(2048, 0, 0)
    with pytest.raises(ValueError, match="y_counts"):
        encode_packet(0, -2049, 0)
    with pytest.raises(ValueError, match="pressure"):
        encode_packet(0, 0, 128)


def test_pressure_format_six_bits_shifted_and_inverted() -> None:
    six = PressureFormat(byte=5, mask=0x7E, shift=1, invert=True)
    raw = encode_packet(0, 0, 3, pressure_format=six)
    assert raw[5] == (63 - 3) << 1
    (got,) = VersaPadDecoder(BAUD, six).feed(raw, 0.0)
    assert got.pressure == 3


@pytest.mark.parametrize("wrong", [{"byte": 0}, {"byte": 6}, {"mask": 0}, {"mask": 0x80}, {"shift": 7}, {"shift": -1}])
def test_impossible_pressure_formats_are_refused(wrong: dict[str, int]) -> None:
    with pytest.raises(ValueError, match="pressure"):
        PressureFormat(**wrong)  # type: ignore[arg-type]


# Resynchronisation


def test_a_header_in_mid_packet_starts_a_new_one() -> None:
    decoder = VersaPadDecoder(BAUD)
    assert len(decoder.feed(GOLDEN[:4] + GOLDEN, 0.0)) == 1
    assert decoder.counters.truncated == 4
    assert decoder.counters.discarded == 4


@pytest.mark.parametrize(
    ("spoilt", "lost"),
    [
        ("c4 40", 2),
        ("c4 3b 80", 3),
        ("c4 3b 3f 07 00 80", 6),
        ("c4 3b c1", 3),
        ("c4 3b 3f 40", 4),
        ("c4 3b 3f 07 40", 5),
    ],
)
def test_an_illegal_byte_discards_the_current_packet(spoilt: str, lost: int) -> None:
    decoder = VersaPadDecoder(BAUD)
    assert len(decoder.feed(bytes.fromhex(spoilt) + GOLDEN, 0.0)) == 1
    assert decoder.counters.bad_data == lost
    assert decoder.counters.discarded == lost


def test_bytes_outside_a_packet_are_bad_headers() -> None:
    decoder = VersaPadDecoder(BAUD)
    assert len(decoder.feed(b"VP1234\r" + GOLDEN, 0.0)) == 1
    assert decoder.counters.bad_header == 7


def test_reset_discards_the_current_packet() -> None:
    decoder = VersaPadDecoder(BAUD)
    decoder.feed(GOLDEN[:3], 0.0)
    decoder.reset()
    assert decoder.feed(GOLDEN[3:], 0.001) == []
    assert decoder.counters.as_dict() == {
        "bytes": 6,
        "packets": 0,
        "bad_header": 3,
        "bad_data": 0,
        "truncated": 3,
        "batches": 0,
        "out_of_range": 0,
        "gaps": 0,
        "bytes_discarded": 6,
    }


def test_a_packet_split_by_a_usb_adapter_is_read() -> None:
    decoder = VersaPadDecoder(BAUD)
    decoder.feed(GOLDEN[:2], 0.0)
    assert len(decoder.feed(GOLDEN[2:], 0.020)) == 1


def test_the_tail_of_a_much_later_packet_completes_nothing() -> None:
    decoder = VersaPadDecoder(BAUD)
    decoder.feed(GOLDEN[:2], 0.0)
    assert decoder.feed(GOLDEN[2:], 0.050) == []
    assert (decoder.counters.truncated, decoder.counters.bad_header, decoder.counters.gaps) == (2, 4, 1)


# Time stamps


def test_first_byte_is_back_dated_within_a_read() -> None:
    (got,) = VersaPadDecoder(BAUD).feed(GOLDEN, 1.0)
    assert got.t_first == pytest.approx(1.0 - 5 * BYTE_S)


def test_bytes_read_one_by_one_are_dated_by_the_first() -> None:
    decoder = VersaPadDecoder(BAUD)
    found = [p for i in range(6) for p in decoder.feed(GOLDEN[i : i + 1], 1.0 + 1.5 * i * BYTE_S)]
    assert [p.t_first for p in found] == [1.0]


def test_a_late_first_read_is_corrected_by_the_following_one() -> None:
    decoder = VersaPadDecoder(BAUD)
    decoder.feed(GOLDEN[:1], 1.0)
    (got,) = decoder.feed(GOLDEN[1:], 1.0 + BYTE_S)  # five bytes within one byte time: the first was late
    assert got.t_first == pytest.approx(1.0 - 4 * BYTE_S)


def test_batch_is_flagged_and_back_dated_packet_by_packet() -> None:
    decoder = VersaPadDecoder(BAUD)
    first, second = decoder.feed(GOLDEN + GOLDEN, 1.0)
    assert first.batched
    assert second.batched
    assert decoder.counters.batches == 1
    assert second.t_first - first.t_first == pytest.approx(6 * BYTE_S)


def test_tail_and_head_in_one_read_are_no_batch() -> None:
    decoder = VersaPadDecoder(BAUD)
    decoder.feed(GOLDEN[:3], 1.0)
    (got,) = decoder.feed(GOLDEN[3:] + GOLDEN[:3], 1.006)
    assert not got.batched


# The driver


def pad(**values: object) -> PadDriver:
    return make_pad(1, VersaPadConfig.model_validate({"port": "a"} | values))


def sampled(driver: PadDriver, x_counts: int, y_counts: int = 0, pressure: int = 50) -> PadSample | None:
    """The contact in a single packet."""
    (event,) = driver.feed(encode_packet(x_counts, y_counts, pressure), 1.0) or [None]
    assert not isinstance(event, PadLift)
    return event


def test_counts_become_metres_and_newtons() -> None:
    assert sampled(pad(), -100) == PadSample(
        1.0 - 5 * BYTE_S, 1, pytest.approx(0.028 - 0.1 / 7.874), pytest.approx(1.0)
    )


def test_axis_and_sign() -> None:
    got = sampled(pad(axis="y", sign=-1), 99, -100)
    assert got.s == pytest.approx(0.028 + 0.1 / 7.874)


def test_readings_off_the_pad_are_counted_and_are_no_contacts() -> None:
    driver = pad(zero_mm=0.0, counts_per_mm=10.0, length_mm=50.0)
    farthest = round((50 + MARGIN_MM) * 10)
    found = [sampled(driver, counts) is not None for counts in (0, 1, farthest, farthest + 1)]
    assert found == [False, True, True, False]
    assert driver.counts()["out_of_range"] == 2


def test_a_pad_that_reads_both_coordinates_reports_the_position_across() -> None:
    driver = make_pad(1, PlanePadConfig(port="a", counts_per_mm=10.0, length_mm=75.0, across_sign=-1))
    got = sampled(driver, 0, 100)
    assert got.across == pytest.approx(0.0275) == driver.view(1.0).across
    assert sampled(driver, 0, 390) is None, "beyond its edge"


def test_saturated_pressure_is_no_force() -> None:
    got = sampled(pad(), 0, pressure=127)
    assert (got.force, got.at_least) == (None, pytest.approx(2.54))


def test_garbage_is_reported_at_the_next_check_only() -> None:
    driver = pad()
    driver.feed(b"\x3f" * 100, 1.0)
    assert [list(driver.health(refresh)) for refresh in (False, True, False)] == [[], ["garbled"], ["garbled"]]
    assert "100 bytes, but no report among them at 9600 baud" in (driver.diagnosis or "")
    assert list(driver.health(True)) == []


class FakePort(Port):
    def __init__(self) -> None:
        self.breaks: list[bool] = []

    def set_break(self, active: bool) -> None:
        self.breaks.append(active)


def test_a_handshake_holds_the_port_in_break_and_reports_a_missing_answer() -> None:
    driver, port = pad(handshake="break"), FakePort()
    driver.opened(0.0)
    for i in range(200):
        driver.reports(b"", 0.01 * i)
        driver.tend(port, 0.0)
    assert port.breaks == [True, False]
    assert not driver.starting
    assert "no identity" in (driver.diagnosis or "")
    assert list(driver.health(False)) == ["handshake"]


# Lift-off


def test_the_flag_gives_one_lift() -> None:
    touch = TouchTracker(1, PACKET_S)
    assert touch.report(packet(1.0)) is None
    assert touch.touching
    assert touch.report(packet(1.01, in_use=False)) == PadLift(1.01, 1)
    assert touch.report(packet(1.02, in_use=False)) is None
    assert not touch.touching


def test_silence_of_five_mean_intervals_gives_one_lift() -> None:
    touch = TouchTracker(2, PACKET_S)
    for n in range(200):
        touch.report(packet(n * 0.012))
    t_last = 199 * 0.012
    assert touch.mean_interval_s == pytest.approx(0.012, rel=1e-3)
    assert touch.poll(t_last + 0.0599) is None
    lift = touch.poll(t_last + 0.0601)
    assert lift.t_sample == pytest.approx(t_last + 0.060, abs=1e-4)
    assert touch.poll(t_last + 1.0) is None


def test_the_mean_interval_stays_within_the_lines_capacity() -> None:
    touch = TouchTracker(1, PACKET_S)
    for n in range(100):
        touch.report(packet(n * 10.0))
    assert touch.mean_interval_s == pytest.approx(2.5 * 6 * BYTE_S)
    assert 5 * touch.mean_interval_s < 0.100
    for _ in range(100):
        touch.report(packet(1000.0))
    assert touch.mean_interval_s == pytest.approx(6 * BYTE_S)


def alive(intervals: list[float], lots: int = 900) -> tuple[TouchTracker, float]:
    """A touched pad that has reported at these intervals (s), repeatedly; and the time of the last report."""
    touch, t = TouchTracker(1, PACKET_S, PACKET_S), 1.0
    for number in range(lots):
        t += intervals[number % len(intervals)]
        touch.bytes_received(t)
        touch.report(packet(t))
    return touch, t


def test_a_dead_line_is_detected_sooner_if_the_pad_never_pauses() -> None:
    touch, t = alive([0.00625, 0.00625, 0.00625, 0.0125, 0.01875])
    assert touch.patience_s == pytest.approx(1.2 * 0.01875 + 0.004 - PACKET_S)
    assert touch.poll(t + touch.patience_s - 1e-4) is None
    assert touch.poll(t + touch.patience_s + 1e-4) is not None


def test_a_line_that_still_carries_bytes_gets_five_mean_intervals() -> None:
    touch, t = alive([0.00625, 0.00625, 0.00625, 0.0125, 0.01875])
    five_s = 5.0 * touch.mean_interval_s
    touch.bytes_received(t + 0.04)
    assert five_s - 0.04 < touch.patience_s
    assert touch.poll(t + five_s - 1e-4) is None
    assert touch.poll(t + five_s + 1e-4) is not None


def test_a_pad_that_has_paused_before_gets_five_mean_intervals() -> None:
    pauses, _ = alive([0.01] * 300 + [0.045])
    assert pauses.patience_s == pytest.approx(5.0 * pauses.mean_interval_s)
    few, _ = alive([0.01], lots=50)
    assert few.patience_s == pytest.approx(5.0 * few.mean_interval_s)


@pytest.mark.parametrize("adapter_s", [0.001, 0.004, 0.016])
def test_pauses_of_a_pad_that_reports_in_bands_are_no_lift_off(adapter_s: float) -> None:
    """Five minutes of the emulated pad's distribution of pauses."""
    rng, touch, t, heard = random.Random(23), TouchTracker(1, PACKET_S, PACKET_S), 0.0, 0.0
    for _ in range(30_000):
        begun, ended = (adapter_s * math.ceil(at / adapter_s) for at in (t + BYTE_S, t + PACKET_S))
        if touch.touching and begun > heard:
            assert touch.poll(begun + MARGIN_S) is None
        touch.bytes_received(ended)
        touch.report(replace(packet(ended), t_first=t + BYTE_S))
        band = rng.choices((1, 2, 3), (0.64, 0.20, 0.16))[0]
        t, heard = t + max(PACKET_S, band * PACKET_S + rng.gauss(0.0, 0.002)), ended


def touched() -> PadDriver:
    driver = pad()
    for number in range(20):
        driver.feed(encode_packet(number, 0, 10), 1.0 + number * 0.01)
    assert driver.touching
    return driver


def is_foreign(driver: PadDriver) -> bool:
    return "no pad's" in driver.evidence("silent", 1.0)


def test_another_device_is_detected_within_five_intervals() -> None:
    rng, packets = random.Random(3), []
    for _ in range(200):
        driver, t, heard = touched(), 1.2, 0
        while not is_foreign(driver):
            assert not driver.poll(t) or heard > 4
            driver.feed(rng.randbytes(6), t := t + 0.009)
            heard += 1
        packets.append(heard)
        assert heard > 4 or driver.poll(t) == [PadLift(t, 1)]
    assert statistics.mean(packets) < 2.2
    assert sum(each > 3 for each in packets) < 0.1 * len(packets)


def test_bytes_of_another_device_end_the_touch_once_and_a_packet_starts_it_again() -> None:
    driver = touched()
    driver.feed(bytes((0x91, 0x83, 0xF2, 0xA0)), 1.2)
    assert driver.poll(1.2) == [PadLift(1.2, 1)]
    assert driver.poll(1.3) == []
    driver.feed(encode_packet(0, 0, 10), 1.31)
    assert not is_foreign(driver)
    assert driver.touching


def test_a_damaged_pad_is_rarely_mistaken_for_another_device() -> None:
    """A fifth of its bytes flipped, doubled or invented, and heavy pressure, which looks most like another device."""
    line, rng, decoder = FaultInjector(), np.random.default_rng(5), VersaPadDecoder(BAUD)
    line.add(order("garble", 0.0, "pad1", 0.2))
    line.update(0.0)
    alarms = 0
    for number in range(6000):
        raw = encode_packet(number % 200, -number % 200, 70 + number % 50)
        decoder.feed(line.corrupt("pad1", raw, rng), number * 0.01)
        alarms += decoder.foreign
    assert alarms <= 2  # per minute


def test_reset_forgets_suspicious_bytes() -> None:
    decoder = VersaPadDecoder(BAUD)
    for t, foreign in ((1.2, False), (1.21, False)):
        decoder.feed(bytes((0x91, 0x83, 0xF2)), t)
        assert decoder.foreign is foreign
        decoder.reset()
    decoder.feed(bytes((0x91, 0x83, 0xF2, 0x91)), 1.22)
    assert decoder.foreign
