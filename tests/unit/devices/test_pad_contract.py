"""Requirements of every kind of pad: splits, garbage, silence, restart, unplugging."""

import math
import random

import pytest
from pad_bench import KINDS, PadBench

from palmd.devices.evdev import RECORD
from palmd.devices.pad import make_pad
from palmd.events import PadSample
from palmd.rig.pads import Press

SPLITS = 100_000
SOON_S = 0.1  # limit for detecting a touch, a lift-off or a silence
RESTART_S = 1.5  # limit for a restarted device that needs its start-up command again
BLOCK = {"evdev": 9 * RECORD.size}  # bytes between garbage; the kernel gives whole records only

pytestmark = pytest.mark.parametrize("kind", KINDS)


def garbage(kind, dice):
    """Up to seven random bytes; for the kernel's input devices a random record."""
    return dice.randbytes(RECORD.size if kind == "evdev" else dice.randrange(8))


@pytest.fixture
def bench(kind):
    return PadBench(KINDS[kind]).go(0.2)


def swept(bench, seconds=3.0):
    """A contact rolls over the middle of the pad and back, with occasional lift-offs."""
    for step in range(round(seconds / 0.1)):
        if step % 10 == 9:
            bench.press = None
            bench.go(0.1)
        else:
            bench.touched(0.015 + 0.025 * abs((step % 20) - 10) / 10, 0.1)
    return bench


def test_a_touch_gives_position_and_force_and_its_end_a_lift(bench):
    t = bench.t
    bench.touched(0.0281)
    readings = bench.samples()
    assert len(readings) >= 10
    assert readings[0].t_sample <= t + SOON_S
    assert sum(each.s for each in readings) / len(readings) == pytest.approx(0.0281, abs=1e-4)
    assert readings[-1].force == pytest.approx(1.0, rel=0.05)
    assert bench.driver.touching
    t, bench.press = bench.t, None
    bench.go(0.2)
    (lift,) = bench.lifts()
    assert lift <= t + SOON_S
    assert not bench.driver.touching


def test_random_splits_of_the_bytes_give_the_same_readings(kind, bench):
    stream = bytes(swept(bench).said)
    dice, block = random.Random(1), BLOCK.get(kind, 211)
    stream = b"".join(stream[i : i + block] + garbage(kind, dice) for i in range(0, len(stream), block))
    stream *= 1 + 2 * SPLITS // len(stream)
    edges = sorted(dice.sample(range(1, len(stream)), SPLITS))
    whole, cut = make_pad(1, KINDS[kind]), make_pad(1, KINDS[kind])
    expected = read(whole.reports(stream, 1.0))
    found = read(
        each for a, b in zip([0, *edges], [*edges, len(stream)], strict=True) for each in cut.reports(stream[a:b], 1.0)
    )
    assert found == expected
    assert len(found) > 300
    assert cut.counts()["bytes"] == whole.counts()["bytes"] == len(stream)


def read(reports):
    return [(each.x_counts, each.y_counts, each.pressure, each.in_use) for each in reports]


def test_timestamps_are_monotonic_and_never_in_the_future(kind, bench):
    stream, dice, driver = bytes(swept(bench, 1.0).said), random.Random(2), make_pad(1, KINDS[kind])
    at, t, latest = 0, 0.0, -math.inf
    while at < len(stream):
        size = dice.randrange(1, 40)
        t += dice.random() * 0.01
        for report in driver.reports(stream[at : at + size], t):
            assert latest <= report.t_first <= report.t_recv == t
            latest = report.t_first
        at += size


def test_random_bytes_raise_nothing_and_are_no_touch(kind):
    driver, dice = make_pad(1, KINDS[kind]), random.Random(3)
    driver.opened(0.0)
    t, readings = 0.0, 0
    for _ in range(5000):
        t += 0.01
        readings += sum(isinstance(event, PadSample) for event in driver.feed(dice.randbytes(dice.randrange(40)), t))
        driver.poll(t)
    counts = driver.counts()
    assert counts["bytes"] > 90_000
    assert readings <= (0 if kind != "versapad" else 200), "a VersaPad has no checksum and a short header"
    assert kind == "evdev" or "garbled" in driver.health(True)
    assert driver.diagnosis is None or "bytes" in driver.diagnosis


def test_garbage_between_packets_changes_no_reading_and_has_no_lasting_effect(kind):
    dice = random.Random(4)
    bad = [True]

    def spoil(said):
        if not bad[0] or dice.random() > 0.3:
            return said
        return garbage(kind, dice) + (said if kind == "evdev" else said[: len(said) // 2])

    bench = PadBench(KINDS[kind], spoil)
    bench.go(0.2).touched(0.0281, 2.0)
    places = [each.s for each in bench.samples()]
    assert len(places) > 50
    wrong = [s for s in places if abs(s - 0.0281) > 1e-3]
    assert len(wrong) <= (0 if kind != "versapad" else 5)
    bad[0], t = False, bench.t
    bench.go(0.3)
    assert bench.samples(t)[0].t_sample <= t + SOON_S


def test_a_silent_touched_pad_gives_a_lift(kind, bench):
    bench.touched(0.0281)
    bench.plugged, t = False, bench.t
    bench.go(0.2)
    if kind == "evdev":  # reports changes only, so silence is no lift-off
        assert not bench.lifts(t)
        return
    (lift,) = bench.lifts(t)
    assert lift <= t + SOON_S
    assert bench.driver.touch_end == "silent"
    assert bench.driver.evidence("silent", bench.t)


def test_unplugging_ends_the_touch_and_readings_resume_after_replugging(bench):
    bench.touched(0.0281)
    bench.plugged = False
    (lift,) = bench.driver.lost(bench.t)
    assert lift.t_sample == bench.t
    assert (bench.driver.is_open, bench.driver.touching) == (False, False)
    bench.go(0.5)
    bench.restart()
    bench.plugged, t = True, bench.t
    bench.driver.opened(t)
    bench.go(0.3)
    assert bench.samples(t)[0].t_sample <= t + 2 * SOON_S


def test_a_restarted_device_is_read_again_without_intervention(bench):
    bench.touched(0.0281)
    bench.restart()
    t = bench.t
    bench.go(RESTART_S + 0.3)
    found = bench.samples(t)
    assert found
    assert found[-1].t_sample > bench.t - SOON_S
    assert found[-1].s == pytest.approx(0.0281, abs=5e-4)


def test_two_contacts_raise_nothing(bench):
    bench._far.report(bench.t, [Press(0.01, 0.5), Press(0.05, 0.5)])
    assert bench.go(0.1).driver.counts()["bytes"] >= 0
