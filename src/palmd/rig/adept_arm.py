"""The emulated Adept arm with the palms' linkage at its tool. Pure."""

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
from palmd.rig.setpoint_checker import SetPointChecker, most_phi12
from palmd.rig.tool import DrivenTool, limits_round

_ROOM = 1.2  # what the controller allows beyond what the palms' limits need
_JOG_DEG = 4.0


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
        """At rest at `home` (rad); `lag_s` is what the servos lag beyond their own."""
        self.hinge = Hinge("arc", config.rig.palm_lengths_mm[0] * 1e-3, _base(config))
        self.jams = 0
        self._home = self._angles = home
        self._linkage = Linkage.from_config(config)
        self.judge = SetPointChecker(self._linkage, config.limits, most_phi12(config))
        start = self._linkage.pose(*home)
        super().__init__(arm.baud, arm_limits(config), start, rng, step_s=step_s, lag_s=lag_s)

    def palms_at(self, t: float) -> PalmMotion:
        """As the arm's pose tells them."""
        x, y = self._servos[0].at(t), self._servos[1].at(t)
        palms = self._linkage.motion(x, y)
        if palms is None:  # the linkage is at its stop: the palms stay where they were
            self.jams += 1
            return PalmMotion.at_rest(self._angles)
        self._angles = palms.angles
        return palms

    def receive(self, heard: bytes, spoilt: bytes, t: float, late_s: float = 0.0) -> None:
        """See `DrivenTool`; what is heard late is judged with that in mind."""
        self.judge.listened_late(t, late_s)
        super().receive(heard, spoilt, t)

    def feel(self, palms: PalmMotion, contacts: Callable[[], Sequence[PlantContact]], t: float) -> None:
        """It is too strong to feel anything."""

    def hold_by_hand(self, palms: Joints) -> None:
        """In manual mode."""
        self._led = self._linkage.pose(*palms)

    def status(self) -> dict[str, Any]:
        """Counts of its set-points too."""
        return super().status() | self.judge.as_dict()

    def _jogged(self, palms: Joints) -> Pose:
        return self._linkage.pose(*_jogged(palms, self._home))

    def _hear_setpoint(self, pose: Pose, t: float) -> None:
        self.judge.hear(pose, t, None if self.state is ArmState.TRACKING else self._true_pose(t))


def arm_limits(config: Config) -> ArmLimits:
    """What the controller allows: a box round every pose the palms' limits allow, and room above their rates.

    E's speed is at most L1·ω1 + L2·(ω1 + ω2), its acceleration L1·(α + ω²) + L2·(2α + 4ω²).
    """
    linkage, limits = Linkage.from_config(config), config.limits
    most_deg = math.degrees(most_phi12(config))
    poses = [
        linkage.pose(*map(math.radians, angles))
        for angles in itertools.product(*(np.linspace(low, high, 40).tolist() for low, high in limits.angles_deg))
        if sum(angles) < most_deg
    ]
    omega, alpha = math.radians(limits.rate_deg_s), math.radians(limits.acceleration_deg_s2)
    inner, outer = linkage.lengths
    return limits_round(
        poses,
        v_max=_ROOM * (inner + 2.0 * outer) * omega,
        a_max=_ROOM * (inner * (alpha + omega**2) + outer * (2.0 * alpha + 4.0 * omega**2)),
    )


def _base(config: Config) -> tuple[float, float]:
    x_mm, y_mm = config.rig.base_mm
    return x_mm * 1e-3, y_mm * 1e-3


def _jogged(angles: Joints, home: Joints) -> Joints:
    """Where an operator jogs the palms to (rad): a little nearer to home, or off it; so never out of the limits."""
    way = [goal - angle for goal, angle in zip(home, angles, strict=True)]
    far, step = max(map(abs, way)), math.radians(_JOG_DEG)
    if far < step:
        return (angles[0] + step, *angles[1:])
    return tuple(angle + step / far * each for angle, each in zip(angles, way, strict=True))
