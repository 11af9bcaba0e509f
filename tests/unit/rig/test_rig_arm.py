"""The emulated arm: forward and inverse linkage, rates against differences, and the servo's lag."""

import math

import pytest

from palmd.rig.arm import Linkage, Servo, wrap_angle

LINKAGE = Linkage((0.12, 0.01), 0.11, 0.13, (-0.3, 0.05), math.radians(30.0))


@pytest.mark.parametrize("phi1_deg", [6.0, 45.0, 120.0])
@pytest.mark.parametrize("phi2_deg", [35.0, 90.0, 155.0])
def test_the_inverse_linkage_inverts_the_forward_one(phi1_deg, phi2_deg):
    phi1, phi2 = math.radians(phi1_deg), math.radians(phi2_deg)
    pose = LINKAGE.pose(phi1, phi2)
    assert LINKAGE.angles(pose.x_m, pose.y_m) == pytest.approx((phi1, phi2))
    assert wrap_angle(pose.t_rad - (phi1 + phi2 - LINKAGE.yaw)) == pytest.approx(0.0, abs=1e-12)


def test_a_pose_computed_by_hand():
    """φ1 = 90°, φ2 = 90°: palm 1 stands below B, palm 2 points to −X from its foot."""
    linkage = Linkage((0.12, 0.0), 0.12, 0.12, (-0.3, 0.0), 0.0)
    pose = linkage.pose(math.pi / 2, math.pi / 2)
    assert (pose.x_m, pose.y_m, pose.t_rad) == pytest.approx((0.3, -0.12, math.pi))


def test_rates_and_accelerations_agree_with_differences():
    def at(t):
        return 0.8 + 0.3 * math.sin(2.0 * t), 1.6 + 0.2 * math.cos(3.0 * t)

    def axes(t):
        dt = 1e-4
        poses = [LINKAGE.pose(*at(t + k * dt)) for k in (-1, 0, 1)]
        return tuple(
            (p[1], (p[2] - p[0]) / (2 * dt), (p[2] - 2 * p[1] + p[0]) / dt**2)
            for p in ([q.x_m for q in poses], [q.y_m for q in poses])
        )

    for t in (0.1, 0.5, 1.3):
        palms = LINKAGE.motion(*axes(t))
        assert palms.rates[0] == pytest.approx(0.6 * math.cos(2.0 * t), abs=1e-5)
        assert palms.rates[1] == pytest.approx(-0.6 * math.sin(3.0 * t), abs=1e-5)
        assert palms.accelerations[0] == pytest.approx(-1.2 * math.sin(2.0 * t), abs=1e-4)
        assert palms.accelerations[1] == pytest.approx(-1.8 * math.cos(3.0 * t), abs=1e-4)


def test_an_unreachable_pose_is_none():
    far = LINKAGE.pose(0.5, math.radians(178.0))
    assert LINKAGE.angles(far.x_m, far.y_m) is None
    assert LINKAGE.angles(5.0, 5.0) is None
    assert LINKAGE.motion((5.0, 0.0, 0.0), (5.0, 0.0, 0.0)) is None


def test_the_servo_trails_a_ramp_by_its_lag_and_settles():
    servo = Servo(1.0, lag_s=0.02)
    servo.follow(0.0, 0.5)
    position, velocity, acceleration = servo.at(0.5)
    assert position == pytest.approx(1.0 + 0.5 * (0.5 - 0.02), abs=1e-6)
    assert (velocity, acceleration) == pytest.approx((0.5, 0.0), abs=1e-6)
    servo.follow(0.5, 0.0)
    assert servo.at(1.0) == pytest.approx((1.25, 0.0, 0.0), abs=1e-6)


def test_the_servo_is_smooth_across_pieces_and_its_rates_are_derivatives():
    servo = Servo(0.0)
    servo.follow(0.0, 1.0)
    before = servo.at(0.016)
    servo.follow(0.016, -2.0)
    after = servo.at(0.016)
    assert after[:2] == pytest.approx(before[:2])
    e = 1e-6
    for t in (0.02, 0.03):
        low, middle, high = servo.at(t - e), servo.at(t), servo.at(t + e)
        assert middle[1] == pytest.approx((high[0] - low[0]) / (2 * e), abs=1e-6)
        assert middle[2] == pytest.approx((high[1] - low[1]) / (2 * e), rel=1e-4)
