"""Kinematics of the arc hinge, against constructions by hand."""

from __future__ import annotations

import cmath
import math

import pytest

from palmd.events import PalmMotion
from palmd.motion.kinematics import PoseError, RigGeometry, wrapped

PORTS = {"pads": {"palm1": {"port": "/dev/a"}, "palm2": {"port": "/dev/b"}}, "arm": {"port": "/dev/c"}}
GEOMETRY = RigGeometry(0.12, 0.0, 0.12, 0.12, -0.3, 0.0, 0.0)


def test_the_shipped_rig_at_45_and_90_degrees() -> None:
    # O = (120 − 84.853, −84.853), E = O + 120·(−0.7071, 0.7071) = (−49.706, 0); the arm stands at −300.
    assert GEOMETRY.hinge(math.radians(45)) == pytest.approx((0.0351472, -0.0848528), abs=1e-7)
    x, y, t = GEOMETRY.arm_pose((math.radians(45), math.radians(90)))
    assert (x, y) == pytest.approx((0.2502944, 0.0), abs=1e-7)
    assert math.degrees(t) == pytest.approx(135.0)


def test_yaw_rotates_the_arms_coordinates_and_the_tool_angle() -> None:
    turned = RigGeometry(0.12, 0.0, 0.12, 0.12, -0.3, 0.1, math.radians(90))
    x, y, t = turned.arm_pose((math.radians(45), math.radians(90)))
    # E − base = (250.294, −100); in axes turned by +90° that is x′ = y, y′ = −x.
    assert (x, y) == pytest.approx((-0.1, -0.2502944), abs=1e-7)
    assert math.degrees(t) == pytest.approx(45.0)


def test_inverse_kinematics_with_unequal_palms() -> None:
    rig = RigGeometry(0.1, 0.02, 0.13, 0.09, 0.4, -0.3, math.radians(-120))
    for phi1_deg, phi2_deg in ((10, 40), (80, 90), (149, 35), (-160, 170)):
        phi1, phi2 = math.radians(phi1_deg), math.radians(phi2_deg)
        tip = complex(0.1, 0.02) - cmath.rect(0.13, phi1) + cmath.rect(0.09, phi1 + phi2)
        seen = (tip - complex(0.4, -0.3)) * cmath.exp(1j * math.radians(120))
        assert rig.palm_angles(seen.real, seen.imag) == pytest.approx((phi1, phi2), abs=1e-12)
        assert rig.arm_pose((phi1, phi2))[:2] == pytest.approx((seen.real, seen.imag), abs=1e-12)


@pytest.mark.parametrize("x", [0.42 + 0.2401, 0.42 - 0.2401, 5.0, math.nan, math.inf])
def test_unreachable_positions_are_refused_with_the_reach(x: float) -> None:
    with pytest.raises(PoseError, match=r"0\.0 to 240\.0 mm|0\.0\s*to 240\.0 mm"):
        GEOMETRY.palm_angles(x, 0.0)


@pytest.mark.parametrize("reach", [0.0, 0.0005, 0.239999, 0.24])
def test_singular_positions_are_refused_from_both_sides(reach: float) -> None:
    with pytest.raises(PoseError, match="shut or stretched out"):
        GEOMETRY.palm_angles(0.42 + reach, 0.0)


@pytest.mark.parametrize("phi2_deg", [0.0, 0.9, 179.1, 180.0, -90.0, math.nan])
def test_singular_palm_angles_are_refused(phi2_deg: float) -> None:
    with pytest.raises(PoseError, match="phi2 must be 1° to 179°"):
        GEOMETRY.arm_pose((1.0, math.radians(phi2_deg)))


def test_tip_speed_and_acceleration_are_the_derivatives_of_the_position() -> None:
    def pose(t: float) -> tuple[float, float]:
        return 0.8 + 0.9 * t - 1.5 * t * t, 1.6 - 0.7 * t + 2.0 * t * t

    h = 1e-4
    (x0, y0, _), (x1, y1, _), (x2, y2, _) = (GEOMETRY.arm_pose(pose(t)) for t in (-h, 0.0, h))
    speed, acceleration = GEOMETRY.tip_speed_acceleration(PalmMotion(pose(0.0), (0.9, -0.7), (-3.0, 4.0)))
    assert speed == pytest.approx(math.hypot(x2 - x0, y2 - y0) / (2 * h), rel=1e-5)
    assert acceleration == pytest.approx(math.hypot(x2 - 2 * x1 + x0, y2 - 2 * y1 + y0) / h**2, rel=1e-5)


def test_wrapped_is_half_open() -> None:
    assert wrapped(-math.pi) == math.pi
    assert wrapped(3 * math.pi) == math.pi
    assert wrapped(-0.5) == -0.5
