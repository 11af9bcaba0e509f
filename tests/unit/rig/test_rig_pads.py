"""The emulated touchpad: counts computed by hand, timing bands, dead band, lift-off, merged contacts."""

import numpy as np
import pytest

from palmd.config.pads import PressureConfig, VersaPadConfig
from palmd.devices.versapad import VersaPadDecoder
from palmd.rig.padkinds.versapad import VersaPadEmulator
from palmd.rig.pads import PadOptions, Press

QUIET = PadOptions(noise_m=0.0, force_noise=0.0, force_drift=0.0, hysteresis=0.0)


def pad(config=None, options=QUIET, error=lambda _s, _force: 0.0, seed=0):
    return VersaPadEmulator(config or VersaPadConfig(port="p"), options, error, np.random.default_rng(seed), 0.0)


def packets(data):
    return VersaPadDecoder(9600).feed(data, 1.0)


def test_counts_and_pressure_computed_by_hand():
    packet = packets(pad().report(0.1, [Press(0.0407, 1.0)]))[0]
    assert packet.x_counts == 100  # (40.7 − 28.0) mm at 200 counts an inch
    assert packet.pressure == 50
    assert packet.in_use


def test_axis_and_sign():
    config = VersaPadConfig(port="p", axis="y", sign=-1, zero_mm=30.0)
    packet = packets(pad(config).report(0.1, [Press(0.0173, 1.0)]))[0]
    assert packet.y_counts == 100
    assert abs(packet.x_counts) <= 3


def test_pressure_saturates_and_has_the_configured_format():
    assert packets(pad().report(0.1, [Press(0.03, 9.0)]))[0].pressure == 127
    config = VersaPadConfig(port="p", pressure=PressureConfig(mask=0x3F, invert=True))
    assert pad(config).report(0.1, [Press(0.03, 0.2)])[5] == 0x3F - 10


def test_several_contacts_merge_by_force():
    packet = packets(pad().report(0.1, [Press(0.028, 1.0), Press(0.0407, 0.25)]))[0]
    assert packet.x_counts == 20
    assert packet.pressure == 62


def test_dead_band_and_lift_off():
    for lift_report, expected in (("flag", 1), ("silence", 0)):
        emulator = pad(options=PadOptions(lift_report=lift_report))
        assert emulator.report(0.1, [Press(0.03, 0.03)]) == b""
        assert emulator.report(0.11, [Press(0.03, 0.5)])
        lifted = packets(emulator.report(0.12, []))
        assert [packet.in_use for packet in lifted] == [False] * expected
        assert emulator.report(0.13, []) == b""


def test_a_position_off_the_pad_is_no_contact():
    assert pad().report(0.1, [Press(0.056, 1.0)]) == b""
    assert pad().report(0.1, [Press(-0.001, 1.0)]) == b""


def test_reading_error_is_added():
    packet = packets(pad(error=lambda s, _force: 0.1 * s).report(0.1, [Press(0.037, 1.0)]))[0]
    assert packet.x_counts == round((40.7 - 28.0) * 7.874)


@pytest.mark.parametrize("baud", [9600, 38400, 4800])
def test_reports_come_in_three_timing_bands(baud):
    emulator = pad(VersaPadConfig(port="p", baud=baud))
    times = []
    for _ in range(4000):
        t = emulator.due
        emulator.report(t, [])
        times.append(t)
    gaps = np.diff(times)
    slower = 2.0 if baud == 4800 else 1.0
    assert gaps.mean() == pytest.approx(0.010 * slower, rel=0.05)
    assert 0.004 * slower < gaps.std() < 0.0052 * slower
    assert gaps.min() >= 60.0 / baud - 1e-9


def test_noise_drift_and_hysteresis():
    options = PadOptions(force_noise=0.0, force_drift=0.05, force_drift_s=1.0, hysteresis=0.0)
    emulator = pad(options=options)
    read = [packets(emulator.report(0.01 * k, [Press(0.0281, 2.0)]))[0] for k in range(3000)]
    x, pressure = np.array([p.x_counts for p in read]), np.array([p.pressure for p in read])
    assert 0.6 < x.std() < 1.1  # 0.1 mm is 0.79 counts, and the rounding
    assert 0.03 < pressure.std() / pressure.mean() < 0.07
    assert abs(np.diff(pressure)).max() <= 4  # it drifts, it does not jump
    lagging = pad(options=PadOptions(force_noise=0.0, force_drift=0.0, hysteresis=0.1))
    up = packets(lagging.report(0.1, [Press(0.03, 1.0)]))[0].pressure
    lagging.report(0.2, [Press(0.03, 2.0)])
    down = packets(lagging.report(0.3, [Press(0.03, 1.0)]))[0].pressure
    assert up < 50 < down
