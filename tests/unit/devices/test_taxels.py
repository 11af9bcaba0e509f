"""Arrays of pressure sensors: the bytes of each protocol, positions, forces, and their uncertainty."""

import math

import numpy as np
import pytest
from pad_bench import KINDS, PadBench
from pydantic import ValidationError

from palmd.config.pads import TaxelsConfig, pad_sensor
from palmd.devices import taxels
from palmd.devices.taxels import TaxelDecoder, modbus_frame, tsf85_field, tsf85_frame
from palmd.rig.pads import PadOptions, Press, make_emulator

PLAIN = {"kind": "taxels", "port": "a", "zero_mm": 1.0, "length_mm": 55.0}


def array(protocol="text", rows=20, columns=4, pitch_mm=3.0, **values):
    length = {} if "length_mm" in values or rows == 10 else {"length_mm": min(55.0, (rows - 0.5) * pitch_mm)}
    return TaxelsConfig.model_validate(
        PLAIN | length | {"protocol": protocol, "rows": rows, "columns": columns, "pitch_mm": pitch_mm} | values
    )


def counts_of(position_mm, config, width_mm, total=2000.0):
    """Exact counts of a logistic contact (the profile assumed by the host) at a distance from the first row."""
    edges = (np.arange(config.rows + 1) - 0.5) * config.pitch_mm
    shares = np.diff(1.0 / (1.0 + np.exp(-(edges - position_mm) / (width_mm * math.sqrt(3.0) / math.pi))))
    return np.repeat(shares[:, None] * total / config.columns, config.columns, axis=1)


def line(counts):
    return (" ".join(str(round(each)) for each in counts.ravel()) + "\n").encode()


def read(config, counts):
    (report,) = TaxelDecoder(config).feed(b"\n" + line(counts), 1.0)
    return report


def test_the_start_command_of_a_module_of_7_by_4_is_the_documented_one():
    config = array("tsf85", 7, pitch_mm=5.0)
    assert TaxelDecoder(config).protocol.startup() == bytes.fromhex("9A 00 58 01 0A"), "every 10 ms"


def test_a_frame_of_every_field_is_read_big_endian_whatever_its_checksum_byte():
    config = array("tsf85", 7, pitch_mm=5.0)
    values = np.arange(28)
    fields = tsf85_field(taxels.TIME, 0, bytes(8)) + tsf85_field(taxels.PRESSURES, 0, values.astype(">u2").tobytes())
    fields += b"".join(tsf85_field(kind, 0, bytes(n)) for kind, n in taxels.TSF85_FIELD_BYTES.items() if n < 8)
    raw = bytearray(tsf85_frame(0x58, fields))
    raw[1] = 0x37
    (report,) = TaxelDecoder(config).feed(bytes(raw), 1.0)
    assert report.pressure == values.sum()


def test_two_modules_form_one_pad_and_a_single_one_none():
    config = array("tsf85", 14, pitch_mm=5.0)
    decoder = TaxelDecoder(config)

    def module(number, value):
        return tsf85_frame(0x59, tsf85_field(taxels.PRESSURES, number, np.full(28, value, ">u2").tobytes()))

    assert decoder.feed(module(0, 1), 1.0) == []
    (report,) = decoder.feed(module(1, 3), 1.01)
    assert report.pressure == 28 * 4


def test_the_second_module_lies_beyond_the_first():
    config = array("tsf85", 14, pitch_mm=5.0, contact_width_mm=2.5)
    pressed = np.zeros((2, 28), dtype=">u2")
    pressed[1, 8:20] = 100, 100, 100, 100, 200, 200, 200, 200, 100, 100, 100, 100
    fields = b"".join(tsf85_field(taxels.PRESSURES, module, pressed[module].tobytes()) for module in (1, 0))
    (report,) = TaxelDecoder(config).feed(tsf85_frame(0x58, fields), 1.0)
    assert report.x_counts * 1e-3 == pytest.approx((7 + 3) * 5.0, abs=0.01), "its fourth row"


@pytest.mark.parametrize(
    ("frame", "documented"),
    [
        (modbus_frame(0x42, b""), "01 42 80 11"),
        (modbus_frame(0x06, bytes((0, 13, 0, 1))), "01 06 00 0D 00 01 D9 C9"),
        (modbus_frame(0x03, bytes((0, 0, 0, 10))), "01 03 00 00 00 0A C5 CD"),
    ],
)
def test_modbus_frames_have_the_standard_checksum(frame, documented):
    """The last is the example in every text on Modbus RTU."""
    assert frame == bytes.fromhex(documented)


def test_an_exception_is_counted_and_named():
    bench = PadBench(KINDS["st0001"])
    bench.driver.feed(modbus_frame(0xC2, b"\x01"), 0.5)
    assert "Modbus exceptions" in bench.driver.diagnosis


def test_unanswered_queries_are_reported():
    bench = PadBench(KINDS["st0001"])
    bench.plugged = False
    bench.go(1.0)
    assert "without an answer" in bench.driver.diagnosis


@pytest.mark.parametrize("text", ["1, 2;3\t4", " 1 2  3 ,4 ", "0001 2 3 4;"])
def test_numbers_may_be_separated_by_spaces_tabs_commas_and_semicolons(text):
    config = array(rows=4, columns=1, touch_n=0.001)
    (report,) = TaxelDecoder(config).feed(b"boot\n" + text.encode() + b"\r\n", 1.0)
    assert report.pressure == 10


@pytest.mark.parametrize("text", ["1 2 3", "1 2 3 4 5", "1 2 x 4", "-1 2 3 4", "1 2 3 4000000", "", "# 1 2 3 4"])
def test_any_other_line_is_no_frame(text):
    decoder = TaxelDecoder(array(rows=4, columns=1))
    assert decoder.feed(b"\n" + text.encode() + b"\n", 1.0) == []
    assert decoder.counters.discarded == decoder.counters.bytes


def test_an_incomplete_first_line_is_ignored():
    decoder = TaxelDecoder(array(rows=4, columns=1, touch_n=0.001))
    assert decoder.feed(b"34 2 3 4\n", 1.0) == []
    assert len(decoder.feed(b"1 2 3 4\n", 1.1)) == 1
    decoder.reset()
    assert decoder.feed(b"34 2 3 4\n", 1.2) == []


def test_positions_are_right_until_the_arrays_end_hides_much_of_the_profile():
    config = array(contact_width_mm=2.0, newtons_per_count=1e-6)
    for place in np.linspace(1.5, 55.5, 40):
        report = read(config, counts_of(place, config, 2.0, 8e5))
        assert not report.unlocated
        assert report.x_counts * 1e-3 == pytest.approx(place, abs=0.05)
    beyond = read(config, counts_of(-1.5, config, 2.0, 8e5))
    assert beyond.unlocated


@pytest.mark.parametrize(("distance", "error"), [(1.8, 0.1), (2.5, 0.05), (3.5, 0.025)])
@pytest.mark.parametrize("wider", [0.85, 1.0, 1.15])
@pytest.mark.parametrize(("rows", "pitch_mm", "width_mm"), [(20, 3.0, 2.0), (15, 4.0, 2.8)])
def test_a_width_that_is_not_known_exactly_shifts_contacts_near_the_end(
    rows, pitch_mm, width_mm, wider, distance, error
):
    """Distance and error in widths, as documented; of a contact with an abrupt end, unlike the profile assumed."""
    config = array(rows=rows, pitch_mm=pitch_mm, contact_width_mm=width_mm, newtons_per_count=1e-6)
    for further in np.linspace(0.0, pitch_mm, 8):
        place = -0.5 * pitch_mm + distance * width_mm + further
        x = np.clip(((np.arange(rows + 1) - 0.5) * pitch_mm - place) / (math.sqrt(5.0) * wider * width_mm), -1.0, 1.0)
        rows_of = np.diff(0.25 * x * (3.0 - x**2)) * 2e5
        report = read(config, np.repeat(rows_of[:, None], config.columns, axis=1))
        assert abs(report.x_counts * 1e-3 - place) <= 1.05 * error * width_mm


def test_two_contacts_have_no_position():
    config = array(contact_width_mm=2.0)
    report = read(config, counts_of(9.0, config, 2.0) + counts_of(45.0, config, 2.0))
    assert report.in_use
    assert report.unlocated


def test_a_touch_begins_at_its_threshold_and_ends_at_half_of_it():
    config = array(touch_n=0.1)
    decoder = TaxelDecoder(config)
    decoder.feed(b"\n", 0.0)
    found = [decoder.feed(line(counts_of(30.0, config, 2.0, n)), 1.0)[0].in_use for n in (90, 110, 70, 40, 70, 110)]
    assert found == [False, True, True, False, False, True]


def test_counts_at_rest_are_no_force():
    config = array(rest_counts=20)
    assert not read(config, np.full((20, 4), 20.0)).in_use
    touched = read(config, counts_of(30.0, config, 2.0) + 20.0)
    assert touched.pressure == pytest.approx(2000, abs=20)
    assert touched.x_counts * 1e-3 == pytest.approx(30.0, abs=0.05)


def test_a_saturated_taxel_bounds_the_force_from_below():
    bench = PadBench(array(taxel_full_scale=300, baud=1_000_000, taxel_gain_sd=0.0))
    assert bench.config.full_scale_n < 2.5
    bench.go(0.1).touched(0.03, force=5.0)
    sample = bench.samples()[-1]
    assert sample.force is None
    assert sample.at_least < 5.0


@pytest.mark.parametrize("ratio", [0.3, *(pytest.param(r, marks=pytest.mark.nightly) for r in (0.4, 0.5)), 0.7])
@pytest.mark.parametrize("kind", ["text", "st0001"])
def test_the_sd_of_a_position_is_its_error_over_many_skins(kind, ratio):
    """The emulated skins have another profile than the host assumes, and various widths."""
    base = KINDS[kind]
    config = base.model_copy(
        update={
            "contact_width_mm": ratio * base.pitch_mm,
            "taxel_gain_sd": 0.05,
            "noise_mm": 0.001,
            "newtons_per_count": 1e-4,
        }
    )
    options, errors = PadOptions(force_noise=0.0, force_drift=0.0, hysteresis=0.0), []
    for seed in range(30):
        far = make_emulator(config, options, lambda _s, _force: 0.0, np.random.default_rng(seed), 0.0)
        decoder = TaxelDecoder(config)
        decoder.feed(b"\n", 0.0)
        for s in np.linspace(0.02, 0.04, 41):
            far.receive(decoder.protocol.request(), 0.0)
            (report,) = decoder.feed(far.report(0.0, [Press(float(s), 1.0)]), 1.0)
            errors.append(report.x_counts * 1e-3 + config.zero_mm - s * 1e3)
    rms, band = float(np.sqrt(np.mean(np.square(errors)))), math.hypot(config.grid_sd_mm, config.gain_sd_mm)
    assert rms <= 1.3 * band
    assert rms >= 0.3 * band


def test_the_reading_noise_includes_repeated_errors():
    config = array(noise_mm=0.05)
    sensor = pad_sensor(config, 0.0)
    assert sensor.noise == pytest.approx(config.reading_noise_mm * 1e-3)
    assert sensor.noise > 3.0 * math.hypot(config.grid_sd_mm, config.gain_sd_mm) * 1e-3
    finer = array(noise_mm=0.05, pitch_mm=1.5, rows=40, taxel_gain_sd=0.0)
    assert finer.reading_noise_mm == pytest.approx(0.05, rel=0.05), "a grid much finer than the contact adds no error"


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"protocol": "tsf85", "rows": 8}, "7 rows for each"),
        ({"protocol": "st0001", "rows": 14}, "60 taxels"),
        ({"protocol": "modbus"}, "protocol"),
        ({"axis": "y"}, "axis"),
        ({"rows": 10}, "end at 29.5 mm from the hinge, before length_mm"),
    ],
)
def test_an_impossible_array_is_refused(values, says):
    with pytest.raises(ValidationError, match=says):
        array(**values)


@pytest.mark.parametrize("kind", ["tsf85", "st0001", "text"])
def test_reports_have_the_rate_that_the_line_allows(kind):
    bench = PadBench(KINDS[kind]).go(0.1).touched(0.03, 1.0)
    found = len(bench.samples())
    assert found == pytest.approx(0.9 / KINDS[kind].report_s, rel=0.15)
