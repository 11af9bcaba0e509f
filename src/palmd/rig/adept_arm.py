"""The emulated Adept arm that moves the palms through their linkage. Pure."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from palmd.config.arms import AdeptConfig
from palmd.config.two_palms import Config
from palmd.devices.actuator import ArmState, Pose
from palmd.events import Joints, PalmMotion
from palmd.rig.arm import Linkage
from palmd.rig.controller import ArmLimits
from palmd.rig.plant import Hinge, PlantContact
from palmd.rig.setpoint_checker import SetPointChecker, max_phi12
from palmd.rig.tool import DrivenTool, limits_around

_HEADROOM = 1.2  # ratio of the controller's limits to those that the palms' limits require
_JOG_DEG = 4.0  # by how much the operator jogs the palms in manual mode


class AdeptArm(DrivenTool):
    """See `EmulatedActuator`."""

    def __init__(
        self,
        config: Config,
        arm: AdeptConfig,
        home: Joints,
        rng: np.random.Generator,
        *,
        step_s: float,
        lag_s: float,
    ) -> None:
        """At rest at `home` (rad); `lag_s` is added to the servos' own lag."""
        self.hinge = Hinge("arc", config.rig.palm_lengths_mm[0] * 1e-3, _base(config))
        self.jams = 0
        self._home = self._angles = home
        self._linkage = Linkage.from_config(config)
        self.setpoint_checker = SetPointChecker(self._linkage, config.limits, max_phi12(config))
        start = self._linkage.pose(*home)
        super().__init__(arm.baud, arm_limits(config), start, rng, step_s=step_s, lag_s=lag_s)

    def palms_at(self, t: float) -> PalmMotion:
        """Palm motion that follows from the arm's pose; constant while the linkage is at its stop."""
        x, y = self._servos[0].at(t), self._servos[1].at(t)
        palms = self._linkage.motion(x, y)
        if palms is None:  # the linkage is at its stop: the palms stay where they were
            self.jams += 1
            return PalmMotion.at_rest(self._angles)
        self._angles = palms.angles
        return palms

    def receive(self, sent: bytes, corrupted: bytes, t: float, late_s: float = 0.0) -> None:
        """See `DrivenTool`; the delay is taken into account when set-points are checked."""
        self.setpoint_checker.note_delay(t, late_s)
        super().receive(sent, corrupted, t)

    def apply_contacts(self, palms: PalmMotion, contacts: Callable[[], Sequence[PlantContact]], t: float) -> None:
        """Do nothing: the arm does not yield to contact forces."""

    def move_by_hand(self, palms: Joints) -> None:
        """In manual mode: the arm takes the pose that belongs to these angles (rad)."""
        self._hand_pose = self._linkage.pose(*palms)

    def status(self) -> dict[str, Any]:
        """Counters, including those of the set-point checker."""
        return super().status() | self.setpoint_checker.as_dict()

    def _jogged(self, palms: Joints) -> Pose:
        return self._linkage.pose(*_jogged(palms, self._home))

    def _on_setpoint(self, pose: Pose, t: float) -> None:
        self.setpoint_checker.check(pose, t, None if self.state is ArmState.TRACKING else self._true_pose(t))


def arm_limits(config: Config) -> ArmLimits:
    """Limits of the controller: the bounding box of all poses within the palms' limits, and a margin above their rates.

    The speed of E is at most L1·ω1 + L2·(ω1 + ω2), its acceleration L1·(α + ω²) + L2·(2α + 4ω²).
    """
    linkage, limits = Linkage.from_config(config), config.limits
    max_phi12_deg = math.degrees(max_phi12(config))
    poses = [
        linkage.pose(*map(math.radians, angles))
        for angles in itertools.product(*(np.linspace(low, high, 40).tolist() for low, high in limits.angles_deg))
        if sum(angles) < max_phi12_deg
    ]
    omega, alpha = math.radians(limits.rate_deg_s), math.radians(limits.acceleration_deg_s2)
    inner, outer = linkage.lengths
    return limits_around(
        poses,
        v_max=_HEADROOM * (inner + 2.0 * outer) * omega,
        a_max=_HEADROOM * (inner * (alpha + omega**2) + outer * (2.0 * alpha + 4.0 * omega**2)),
    )


def _base(config: Config) -> tuple[float, float]:
    x_mm, y_mm = config.rig.base_mm
    return x_mm * 1e-3, y_mm * 1e-3


def _jogged(angles: Joints, home: Joints) -> Joints:
    """Angles (rad) after the operator's jog: a step towards `home`, or away from it if there; always within limits."""
    remaining = [goal - angle for goal, angle in zip(home, angles, strict=True)]
    distance, step = max(map(abs, remaining)), math.radians(_JOG_DEG)
    if distance < step:
        return (angles[0] + step, *angles[1:])
    return tuple(angle + step / distance * each for angle, each in zip(angles, remaining, strict=True))
