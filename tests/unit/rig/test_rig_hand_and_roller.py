"""The hand that swings the palms, and the roller that is placed on them, on the emulated rig."""

import math

import numpy as np
import pytest

from palmd.config.two_palms import LimitsConfig
from palmd.devices.armlink import Ack, ArmState, LineReader, Query, Refusal, Start, encode_command, parse_reply
from palmd.devices.versapad import VersaPadDecoder
from palmd.events import PalmMotion
from palmd.rig.hand import Hand
from palmd.rig.roller import RESISTANCE, Roller
from palmd.rig.world import World, default_config

REACH = (0.0555, 0.0555)


@pytest.mark.parametrize("limits", [LimitsConfig(), LimitsConfig(phi1_deg=(20, 70), phi2_deg=(75, 105))])
def test_the_hand_swings_smoothly_over_the_whole_range(limits):
    home = (math.radians(45.0), math.radians(90.0))
    hand = Hand(limits, home)
    assert hand.at(0.0) == home
    angles = np.degrees([hand.at(t) for t in np.arange(0.0, 60.0, 0.01)])
    (low1, high1), (low2, high2) = limits.phi1_deg, limits.phi2_deg
    assert low1 - 1e-9 <= angles[:, 0].min() < low1 + 1.0
    assert low2 - 1e-9 <= angles[:, 1].min() < low2 + 1.0
    assert min(high1, 130.0) - 1.0 < angles[:, 0].max() <= high1 + 1e-9
    assert high2 - 3.0 < angles[:, 1].max() <= high2 + 1e-9
    assert angles.sum(axis=1).max() <= 170.0 + 1e-9
    assert np.abs(np.diff(angles, axis=0)).max() < 120.0 * 0.01


def test_by_hand_the_arm_is_in_manual_mode_and_reports_its_pose():
    world, reader = World(default_config(), 1, by_hand=True), LineReader(38400)
    acks, errors = [], []
    for k in range(1, 4001):
        if k % 50 == 0:
            world.receive("arm", encode_command(Start(0) if k == 2000 else Query(k // 50 % 256)))
        for line in reader.feed(world.advance(k * 1e-3)["arm"], k * 1e-3):
            reply = parse_reply(line.body)
            acks += [reply] if isinstance(reply, Ack) else []
            errors += [reply.code] if isinstance(reply, Refusal) else []
    assert {ack.state for ack in acks} == {ArmState.MANUAL}
    assert errors == [-623]
    xs = [ack.pose.x_m for ack in acks]
    assert max(xs) - min(xs) > 0.05
    assert not world.status()["on_palms"]


def motion(phi1_deg, phi2_deg, **rates):
    return PalmMotion.at_rest((math.radians(phi1_deg), math.radians(phi2_deg)))._replace(**rates)


def heard(palms, seconds=20.0, kind="ball", pad=0, seed=1):
    """Times and positions (s, m) of contacts on one pad alone."""
    roller = Roller(kind, 9.81, REACH, np.random.default_rng(seed))
    found = []
    for k in range(int(seconds * 1e3)):
        t = k * 1e-3
        roller.advance(t, palms(t) if callable(palms) else palms)
        if roller.presses(pad) and not roller.presses(1 - pad):
            found.append((t, roller.presses(pad)[0].s))
    return np.array(found).reshape(-1, 2)


@pytest.mark.parametrize(("kind", "share"), [("ball", 5 / 7), ("cylinder", 2 / 3)])
@pytest.mark.parametrize(("pad", "palms", "fall_deg"), [(0, (12.0, 110.0), 12.0), (1, (55.0, 110.0), 15.0)])
def test_the_roller_rolls_down_the_flatter_palm_with_its_physical_acceleration(kind, share, pad, palms, fall_deg):
    t, s = heard(motion(*palms), kind=kind, pad=pad).T
    assert len(heard(motion(*palms), pad=1 - pad)) == 0
    alpha = math.radians(fall_deg)
    expected = -share * 9.81 * (math.sin(alpha) - RESISTANCE * math.cos(alpha))
    ends = np.flatnonzero(np.diff(t) > 0.1)
    assert 6 <= len(ends) <= 14  # one every second or two
    for first, last in zip(ends[:-1] + 1, ends[1:], strict=True):
        down = slice(last - 150, last)
        assert 2.0 * np.polyfit(t[down], s[down], 2)[0] == pytest.approx(expected, rel=1e-3)
        assert s[first] == pytest.approx(REACH[pad] - 3e-3)
        assert s[last] == pytest.approx(0.010 / math.tan(math.radians(palms[1]) / 2), abs=2e-3)


def test_the_roller_is_removed_while_the_palms_move_and_not_placed_on_steep_ones():
    moving = heard(lambda t: motion(12.0, 110.0, rates=(0.1 if 5.0 < t < 10.0 else 0.0, 0.0)))
    assert len(moving)
    assert not ((moving[:, 0] > 5.0) & (moving[:, 0] < 10.9)).any()
    assert len(heard(motion(45.0, 90.0))) == 0
    assert len(heard(motion(12.0, 110.0), seed=2)) != len(heard(motion(12.0, 110.0)))


def test_the_worlds_pads_measure_the_roller():
    config = default_config().model_copy(update={"limits": LimitsConfig(phi1_deg=(6, 12))})
    world = World(config, 3, roller="ball")
    decoder, reports = VersaPadDecoder(9600), 0
    for k in range(1, 5001):
        reports += sum(packet.in_use for packet in decoder.feed(world.advance(k * 1e-3)["pad1"], k * 1e-3))
    assert reports > 50
    assert not world.status()["on_palms"]
