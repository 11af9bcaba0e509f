"""A pad's measured characteristic equals that of the emulated pad, despite lifts, gaps and corrupted bytes."""

from dataclasses import replace

import numpy as np
import pytest

from palmd.calibration.pad_characteristic import TooFewReportsError, characterise
from palmd.config.pads import VersaPadConfig
from palmd.devices.versapad import PadPacket, VersaPadDecoder, encode_packet
from palmd.rig.padkinds.versapad import PACKET_S, VersaPadEmulator
from palmd.rig.pads import ACROSS_JITTER_COUNTS, PadOptions, Press
from tools.rolled_marble import rolled

CONFIG = VersaPadConfig(port="p")
SECONDS = 20.0
COUNT_MM = 1.0 / CONFIG.counts_per_mm


def measured(config=CONFIG, seed=1, change=lambda packets: packets, **options):
    packets, counters = rolled(config, seed, SECONDS, PadOptions(**options))
    return characterise(change(packets), counters.as_dict(), config)


def packet(t, x=0, y=0, pressure=50, in_use=True):
    return PadPacket(t, t, x, y, pressure, in_use, left=False, right=False, tap=False, batched=False)


def moving(times):
    """Noise-free reports of a marble that crosses the pad again and again."""
    return [packet(t, round(200 * np.sin(3.0 * t)), round(100 * np.cos(2.0 * t))) for t in times]


def corrupted(packets, every):
    """Replace the place of every n-th report by a random one on the pad."""
    rng = np.random.default_rng(0)
    return [
        replace(p, x_counts=int(rng.integers(-200, 200)), y_counts=int(rng.integers(-150, 150))) if not k % every else p
        for k, p in enumerate(packets)
    ]


@pytest.mark.parametrize("noise_mm", [0.02, 0.05, 0.1, 0.3])
def test_noise_is_estimated_with_a_consistent_sd(noise_mm):
    along = [measured(seed=seed, noise_m=noise_mm * 1e-3).x for seed in range(12)]
    errors = np.array([(axis.noise_mm - noise_mm) / axis.noise_sd_mm for axis in along])
    assert abs(errors.mean()) < 0.8  # in units of one run's sd: no significant bias
    assert 0.5 < np.mean(errors**2) < 2.5
    assert max(axis.noise_sd_mm for axis in along) < 0.04 * noise_mm + 0.0015


def test_noise_below_the_rounding_is_an_upper_bound():
    along = [measured(seed=seed, noise_m=0.0).x for seed in range(10)]
    assert max(axis.noise_mm for axis in along) < 0.015  # a ninth of the step
    assert all(0.0 < axis.noise_sd_mm < 0.015 for axis in along)


def test_noise_across_the_pad_equals_the_emulated_jitter():
    """A uniform choice of 2 n + 1 counts has the variance n (n + 1) / 3."""
    jitter_mm = (ACROSS_JITTER_COUNTS * (ACROSS_JITTER_COUNTS + 1) / 3) ** 0.5 * COUNT_MM
    across = measured().y
    assert across.noise_mm == pytest.approx(jitter_mm, abs=3.0 * across.noise_sd_mm)


@pytest.mark.parametrize("step", [1, 2, 5])
def test_a_coarser_step_is_detected_and_excluded_from_the_noise(step):
    def coarse(packets):
        return [replace(p, x_counts=step * round(p.x_counts / step) - 1) for p in packets]

    along = measured(noise_m=3e-4, change=coarse).x
    assert along.step_counts == step
    assert along.step_mm == pytest.approx(step * COUNT_MM)
    assert along.noise_mm == pytest.approx(0.3, abs=3.0 * along.noise_sd_mm)


def test_corrupted_reports_affect_neither_noise_nor_step():
    clean, dirty = measured(seed=3), measured(seed=3, change=lambda packets: corrupted(packets, every=60))
    assert dirty.x.noise_mm == pytest.approx(clean.x.noise_mm, rel=0.05)
    assert dirty.y.noise_mm == pytest.approx(clean.y.noise_mm, rel=0.05)
    thirds = [replace(p, x_counts=3 * p.x_counts) for p in moving(0.01 * np.arange(2000)) if abs(p.x_counts) < 70]
    assert characterise(corrupted(thirds, every=60), {}, CONFIG).x.step_counts == 3


def test_intervals_and_bands_match_a_calculation_by_hand():
    gaps = np.repeat([0.00625, 0.0125, 0.01875, 0.03], [600, 250, 125, 25])
    times = np.cumsum(np.random.default_rng(0).permutation(gaps))
    result = characterise(moving(times), {}, CONFIG)
    used = np.diff(times)
    assert result.interval_mean_ms == pytest.approx(used.mean() * 1e3)
    assert result.interval_sd_ms == pytest.approx(used.std() * 1e3)
    assert result.packet_time_ms == pytest.approx(6.25)
    assert [band.packet_times for band in result.bands] == [1, 2, 3]
    assert [band.share for band in result.bands] == pytest.approx([0.6, 0.25, 0.125], abs=0.002)
    assert [band.mean_ms for band in result.bands] == pytest.approx([6.25, 12.5, 18.75])
    assert max(band.sd_ms for band in result.bands) < 1e-6


def test_the_emulated_pad_has_the_papers_intervals():
    """Figure 3.12(b): mean 10 ms, sd 5 ms, about three bands, at any baud rate."""
    for baud in (9600, 38400):
        result = measured(VersaPadConfig(port="p", baud=baud))
        assert result.packet_time_ms == pytest.approx(PACKET_S * 1e3, rel=0.02)
        assert result.interval_mean_ms == pytest.approx(10.0, rel=0.05)
        assert result.interval_sd_ms == pytest.approx(5.0, rel=0.15)
        assert sum(band.share for band in result.bands) == pytest.approx(1.0, abs=0.02)
        assert [band.mean_ms for band in result.bands] == pytest.approx([6.8, 12.4, 18.5], abs=0.6)


def test_one_early_report_does_not_set_the_unit_of_the_bands():
    """At 38400 baud a packet takes 1.6 ms, so the baud rate does not give the pad's own interval."""
    times = 0.01 * np.arange(500)
    times[100] -= 0.007
    result = characterise(moving(times), {}, VersaPadConfig(port="p", baud=38400))
    assert result.packet_time_ms == pytest.approx(10.0)
    assert result.bands[0].share > 0.99


@pytest.mark.parametrize("flag", [True, False])
def test_a_lift_is_not_counted_as_an_interval(flag):
    regular = 0.01 * np.arange(200)
    lifted = [packet(2.0, in_use=False)] if flag else []
    pause = 0.03 if flag else 1.0  # with A = 0 even the shortest pause is a lift
    result = characterise(moving(regular) + lifted + moving(regular + 2.0 + pause), {}, CONFIG)
    assert result.touches == 2
    assert result.reports == 400
    assert result.interval_mean_ms == pytest.approx(10.0)
    assert result.interval_sd_ms == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("dead_band_n", [0.04, 0.2, 0.5])
def test_the_dead_band_is_the_force_where_reports_begin(dead_band_n):
    result = measured(dead_band_n=dead_band_n)
    counts = dead_band_n / CONFIG.newtons_per_count
    assert 0.9 * counts - 1 <= result.dead_band_counts <= 1.15 * counts + 1  # 4 % noise, 3 % drift, one count
    assert result.dead_band_n == pytest.approx(result.dead_band_counts * CONFIG.newtons_per_count)
    assert result.pressure_high > 90  # of 100, which correspond to 2 N


def test_one_corrupted_pressure_does_not_set_the_dead_band():
    packets, counters = rolled(CONFIG, 1, SECONDS, PadOptions(dead_band_n=0.2))
    packets[300] = replace(packets[300], pressure=0)
    assert characterise(packets, counters.as_dict(), CONFIG).dead_band_counts >= 8


def test_the_configured_axis_runs_from_the_hinge():
    config = VersaPadConfig(port="p", axis="y", sign=-1, zero_mm=30.0)
    result = measured(config)
    assert result.along(config) is result.y
    assert result.y.noise_mm == pytest.approx(0.1, abs=3.0 * result.y.noise_sd_mm)
    assert 0.0 < result.y.low_mm < 10.0 < 45.0 < result.y.high_mm < 55.5
    assert result.x.low_mm < -10.0 < 10.0 < result.x.high_mm


def test_places_outside_the_pad_are_counted_and_excluded():
    packets, counters = rolled(CONFIG, 1, SECONDS)
    packets[100:110] = [replace(p, x_counts=2000) for p in packets[100:110]]
    result = characterise(packets, counters.as_dict(), CONFIG)
    assert result.out_of_range == sum(p.in_use for p in packets[100:110]) > 0
    assert result.x.high_mm < 55.5


def test_corrupted_bytes_are_counted_by_cause():
    rng = np.random.default_rng(4)
    decoder, t = VersaPadDecoder(9600), 0.0
    packets = []
    for k in range(1500):
        t += 0.01
        data = encode_packet(round(200 * np.sin(3.0 * t) + rng.normal(0.0, 0.8)), round(100 * np.cos(2.0 * t)), 50)
        illegal = data[:2] + b"\x7f" + data[3:]
        data = {0: b"\x15" + data, 1: data[:3], 2: illegal, 27: illegal}.get(k % 50, data)
        packets += decoder.feed(data, t)
    result = characterise(packets, decoder.counters.as_dict(), CONFIG)
    # an illegal header discards its packet, and the legal bytes that follow are then outside a packet
    assert (result.bad_header_bytes, result.truncated_bytes, result.bad_data_bytes) == (30 + 3 * 60, 3 * 30, 3 * 60)
    assert result.received_bytes == 6 * result.reports + 210 + 90 + 180
    assert result.reports == 1500 - 3 * 30
    assert result.x.noise_mm == pytest.approx(0.1016, rel=0.1)


@pytest.mark.parametrize(
    ("packets", "message"),
    [
        ([], r"too few reports \(0 of at least 150\)"),
        (moving(0.01 * np.arange(149)), r"too few reports \(149 of"),
        ([packet(0.01 * k, in_use=False) for k in range(500)], "too few reports"),
        ([packet(0.01 * k, x=20, y=k % 100) for k in range(500)], "hardly moved along x"),
        ([packet(0.01 * k, x=k % 100, y=20) for k in range(500)], "hardly moved along y"),
        ([packet(0.01 * k, x=max(k - 440, 0), y=k % 100) for k in range(500)], "hardly moved along x"),
        ([packet(0.2 * k, x=k % 100, y=k % 90) for k in range(500)], "hardly moved along x"),
        ([packet(0.01 * k, x=1500, y=k % 90) for k in range(500)], "500 reports are outside the pad: check axis"),
    ],
)
def test_insufficient_data_is_refused_with_a_hint(packets, message):
    with pytest.raises(TooFewReportsError, match=message):
        characterise(packets, {}, CONFIG)


def test_contacts_beyond_the_pads_width_are_ignored_and_several_merge_by_force():
    emulator = VersaPadEmulator(CONFIG, PadOptions(noise_m=0.0), lambda _s, _force: 0.0, np.random.default_rng(0), 0.0)
    assert emulator.report(0.1, [Press(0.028, 1.0, across=0.0199)]) == b""
    both = [Press(0.028, 1.0, across=0.0127), Press(0.028, 0.25, across=0.0)]
    (result,) = VersaPadDecoder(9600).feed(emulator.report(0.2, both), 1.0)
    assert abs(result.y_counts - 80) <= ACROSS_JITTER_COUNTS  # 0.8 · 12.7 mm at 200 counts an inch
