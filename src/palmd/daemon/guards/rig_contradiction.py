"""Can the pose that the arm reports at rest be one of the rig as configured? Distances and angles, in numbers. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from palmd.devices.actuator import Pose
from palmd.motion.kinematics import PoseError, RigGeometry, wrapped

QUARTER_TURNS = (90.0, 180.0, -90.0)
FOUND_RAD = 3.0 * math.radians(0.7)
"""How far the tool of an arm that has not been driven yet may be turned against the palm that it holds: 3σ of half a
degree each of the grip, and of a yaw that was set by hand. A palm 5 mm longer than configured turns it by more."""


def arc_contradiction(geometry: RigGeometry, pose: Pose, tool_rad: float) -> str:
    """Of two palms that an arm turns: reach from palm 1's base, and the tool angle, to `tool_rad`."""
    words = _arc_words(geometry, pose, tool_rad)
    if not words:
        return ""
    for turn in QUARTER_TURNS:
        turned = replace(geometry, arm_yaw=wrapped(geometry.arm_yaw + math.radians(turn)))
        if not _arc_words(turned, pose, tool_rad):
            yaw = math.degrees(turned.arm_yaw)
            return f"{words}; it fits a base turned by {turn:+g}°, that is arm.base_yaw_deg: {yaw:g}"
    return words


def _arc_words(geometry: RigGeometry, pose: Pose, tool_rad: float) -> str:
    try:
        angles = geometry.palm_angles(pose.x_m, pose.y_m)
    except PoseError as error:
        return str(error)
    expected = wrapped(sum(angles) - geometry.arm_yaw)
    off = wrapped(pose.t_rad - expected)
    if abs(off) <= tool_rad:
        return ""
    x, y = pose.x_m * 1e3, pose.y_m * 1e3
    return (
        f"the arm at x {x:.1f} mm, y {y:.1f} mm reports a tool angle of {math.degrees(pose.t_rad):.1f}°; base, yaw and "
        f"palm lengths as configured give {math.degrees(expected):.1f}°, {math.degrees(off):+.1f}° off; or the tool "
        "was turned in its grip"
    )


def pivot_contradiction(place: Callable[[Pose], tuple[float, ...]], yaw_deg: float, pose: Pose, tool_rad: float) -> str:
    """Of a pivoting gripper, whose pivot (m) cannot be below the pad's surface."""
    del tool_rad
    x, z = place(pose)
    if z >= 0.0:
        return ""
    return (
        f"the arm at x {pose.x_m * 1e3:.1f} mm, y {pose.y_m * 1e3:.1f} mm puts the pivot {-z * 1e3:.1f} mm below "
        f"the pad's surface, {x * 1e3:.1f} mm along it, by arm.base_x_mm, base_y_mm and base_yaw_deg: {yaw_deg:g}"
    )


def no_contradiction(pose: Pose, tool_rad: float) -> str:
    """Of a controller that drives the joints themselves: it stands nowhere that could be wrong."""
    del pose, tool_rad
    return ""
