"""The force guard on single readings."""

from palmd.daemon.guards.force import ForceGuard
from palmd.events import PadLift, PadSample

FULL = 2.54


def readings(guard, force, n, pad=1, t=0.0):
    """`n` readings of one force (N); beyond the full scale they are saturated."""
    for i in range(n):
        saturated = force >= FULL
        reading, at_least = (None, FULL) if saturated else (force, None)
        guard.feed(PadSample(t + 0.01 * i, pad, 0.02, reading, at_least=at_least))


def codes(guard, under_way=True):
    return set(guard.conditions(under_way=under_way))


def test_a_pad_above_its_limit_holds_and_above_one_and_a_half_times_stops():
    guard = ForceGuard((1.0, 2.0), (1, 2))
    readings(guard, 0.9, 50)
    assert not codes(guard)
    readings(guard, 1.2, 30)
    assert codes(guard) == {"force-limit"}
    assert "pad 1 measures 1.2" in guard.evidence()
    readings(guard, 1.7, 30)
    assert codes(guard) == {"force-limit", "force-excess"}
    readings(guard, 1.7, 30, pad=2)
    assert "pad 2" not in guard.evidence()


def test_saturation_counts_during_a_motion_after_less_than_half_a_second():
    guard = ForceGuard((3.0,), (1,))
    readings(guard, 9.0, 10)
    assert codes(guard) == {"force-limit"}
    assert not codes(guard, under_way=False)
    assert "at least 2.54 N" in guard.evidence()


def test_saturation_is_at_least_the_full_scale():
    guard = ForceGuard((1.0,), (1,))
    readings(guard, 9.0, 30)
    assert codes(guard, under_way=False) == {"force-limit", "force-excess"}


def test_a_lifted_pad_and_a_pad_without_forces_are_not_tested():
    guard = ForceGuard((1.0,), (1,))
    readings(guard, 1.5, 30)
    guard.feed(PadLift(1.0, 1))
    assert not codes(guard)
    for n in range(30):
        guard.feed(PadSample(2.0 + 0.01 * n, 1, 0.02))
    assert not codes(guard)
