"""Test whether the pose that the arm reports at rest is possible for the configured rig: distances and angles. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from palmd.devices.actuator import Pose
from palmd.motion.kinematics import PoseError, RigGeometry, wrapped

QUARTER_TURNS = (90.0, 180.0, -90.0)
UNDRIVEN_TOOL_RAD = 3.0 * math.radians(0.7)
"""Tolerance of the tool angle against the held palm before the arm has been driven: 3σ, with σ of half a degree each
for the grip and for a yaw set by hand. A palm 5 mm longer than configured turns it by more."""


def arc_contradiction(geometry: RigGeometry, pose: Pose, tool_rad: float) -> str:
    """For two palms turned by an arm: check the distance from palm 1's base, and the tool angle to `tool_rad`."""
    words = _arc_words(geometry, pose, tool_rad)
    if not words:
        return ""
    for turn in QUARTER_TURNS:
        turned = replace(geometry, arm_yaw=wrapped(geometry.arm_yaw + math.radians(turn)))
        if not _arc_words(turned, pose, tool_rad):
            yaw = math.degrees(turned.arm_yaw)
            return f"{words}; it fits a base rotated by {turn:+g}°, that is arm.base_yaw_deg: {yaw:g}"
    return words


def _arc_words(geometry: RigGeometry, pose: Pose, tool_rad: float) -> str:
    try:
        angles = geometry.palm_angles(pose.x_m, pose.y_m)
    except PoseError as error:
        return str(error)
    expected = wrapped(sum(angles) - geometry.arm_yaw)
    deviation = wrapped(pose.t_rad - expected)
    if abs(deviation) <= tool_rad:
        return ""
    x, y = pose.x_m * 1e3, pose.y_m * 1e3
    return (
        f"the arm at x {x:.1f} mm, y {y:.1f} mm reports a tool angle of {math.degrees(pose.t_rad):.1f}°; base, yaw and "
        f"palm lengths as configured give {math.degrees(expected):.1f}°, deviation "
        f"{math.degrees(deviation):+.1f}°; or the tool was turned in its grip"
    )


def pivot_contradiction(place: Callable[[Pose], tuple[float, ...]], yaw_deg: float, pose: Pose, tool_rad: float) -> str:
    """For a pivoting gripper: the pivot (m) cannot be below the pad's surface."""
    del tool_rad
    x, z = place(pose)
    if z >= 0.0:
        return ""
    return (
        f"the arm at x {pose.x_m * 1e3:.1f} mm, y {pose.y_m * 1e3:.1f} mm puts the pivot {-z * 1e3:.1f} mm below "
        f"the pad's surface, {x * 1e3:.1f} mm along it, by arm.base_x_mm, base_y_mm and base_yaw_deg: {yaw_deg:g}"
    )


def no_contradiction(pose: Pose, tool_rad: float) -> str:
    """For a controller that drives the joints directly: every pose is possible."""
    del pose, tool_rad
    return ""
