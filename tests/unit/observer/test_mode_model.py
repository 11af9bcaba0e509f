"""Pose and force balance of an object that lies on a side, against geometry."""

import math

import numpy as np
import pytest

from palmd.observer import data_association
from palmd.observer.mode_model import SegmentReadings, SupportFrame, balance
from palmd.observer.mode_segments import ModeSegment

RIG = np.array([9.81, 0.12, 0.12, 0.0, 0.0, 0.0, 0.0])
MODE, SHARED = np.array([17e-3, 3e-3, -6e-3, 14e-3]), np.array([math.log(11e-3), 0.2, math.log(0.012)])
H = 1e-4  # s, of differences


def palms(t):
    """φ1, φ2 and their rates and accelerations, both moving."""
    one, two = (0.9 + 0.3 * np.sin(3 * t), 1.5 + 0.4 * np.cos(2 * t)), (0.9 * np.cos(3 * t), -0.8 * np.sin(2 * t))
    return np.stack([*one, *two, -2.7 * np.sin(3 * t), -1.6 * np.cos(2 * t)], axis=-1)


def world(t, palm):
    """Centre of mass, contact points, normals and tangents in the world, as complex numbers, by geometry alone."""
    phi1, phi2 = palms(t)[:2]
    hinge = 0.12 - 0.12 * np.exp(1j * phi1)
    along = np.exp(1j * np.array([phi1, phi1 + phi2]))
    normals = along * np.array([1j, -1j])
    high, radius, away, height = MODE
    support, other = along[palm], along[1 - palm]
    centre = (high * math.cos(phi2) + radius) / math.sin(phi2)
    corner = hinge + centre * support + high * normals[palm]
    com = hinge + (centre + away) * support + height * normals[palm]
    return com, hinge, support, other, normals[palm], normals[1 - palm], corner - radius * normals[1 - palm]


@pytest.mark.parametrize("palm", [0, 1])
def test_forces_and_torques_balance_in_the_world(palm):
    t = 0.7
    carried = SupportFrame.by(palm, palms(np.array([t])), RIG)
    there = balance(MODE, SHARED, carried, "averaged")
    com, hinge, support, other, normal, other_normal, touched = world(t, palm)
    assert there.other[0] == pytest.approx(abs(touched - hinge), abs=1e-12)
    ahead, behind = world(t + H, palm)[0], world(t - H, palm)[0]
    acceleration = (ahead + behind - 2 * com) / H**2

    def slip(direction, joint, point):
        """Outward slip of the object's material at `point` over the palm there."""
        turned, rates = palms(t)[0] + joint * palms(t)[1], palms(t)[2:4]
        rate = rates[0] + joint * rates[1]
        own = rates[0] + palm * rates[1]
        h = (world(t + H, palm)[1] - world(t - H, palm)[1]) / (2 * H)
        body = (ahead - behind) / (2 * H) + 1j * own * (point - com)
        assert abs(np.exp(1j * turned) - direction) < 1e-12
        return ((body - h - 1j * rate * (point - hinge)) * np.conj(direction)).real

    stands = hinge + there.support[0] * support
    mu, dither = SHARED[1], math.exp(SHARED[2])
    force = 0j
    torque = 0.0
    for pressed, direction, joint, push, point in (
        (there.support_force[0], support, palm, normal, stands),
        (there.other_force[0], other, 1 - palm, other_normal, touched),
    ):
        u = slip(direction, joint, point)
        each = pressed * (push - mu * u / math.hypot(u, dither) * direction)
        force += each
        torque += (np.conj(point - com) * each).imag
    assert force - 9.81j == pytest.approx(acceleration, abs=1e-4)
    turn = palms(t)[4] + palm * palms(t)[5]
    assert torque == pytest.approx(math.exp(2 * SHARED[0]) * turn, abs=1e-9)


def test_only_rocking_readings_are_excluded():
    t = np.arange(0.0, 3.0, 0.01)
    on_support = np.arange(len(t)) % 2 == 0
    carried = SupportFrame.by(0, palms(t), RIG)
    there = balance(MODE, SHARED, carried)
    s = np.where(on_support, there.support, there.other) + 1e-4 * np.random.default_rng(1).normal(size=len(t))
    rocks = on_support & (t < 0.4)
    s[rocks] += 1e-3 * np.sin(60 * t[rocks])
    segment = ModeSegment(0, 0.0, 3.0, MODE[:2], 1e-10 * np.eye(2), excludes_disc=True)
    lying = SegmentReadings(segment, t, s, np.full(len(t), 1e-4), on_support, carried)
    kept = lying.still(MODE, SHARED)
    assert not kept[t < 0.35].any()
    assert kept[t > 0.7].all()
    assert len(lying.only(kept).t) == kept.sum()


def test_a_segment_that_rocks_throughout_gives_no_mode_estimate(monkeypatch):
    monkeypatch.setattr(data_association, "ROUNDS", 1)
    t = np.arange(0.0, 1.0, 0.01)
    on_support = np.arange(len(t)) % 2 == 0
    carried = SupportFrame.by(0, palms(t), RIG)
    there = balance(MODE, SHARED, carried)
    s = np.where(on_support, there.support, there.other) + 4e-3 * np.sin(60 * t)
    segment = ModeSegment(0, 0.0, 1.0, MODE[:2], 1e-10 * np.eye(2), excludes_disc=True)
    rocking = SegmentReadings(segment, t, s, np.full(len(t), 1e-4), on_support, carried)
    assert data_association.mode_estimate(rocking, SHARED, np.array([0.2, 0.1, 0.4])) is None
