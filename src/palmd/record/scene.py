"""The scene at one instant of a run: palms, outline and centre of mass in the world frame. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from palmd.config.two_palms import Config, rig_description
from palmd.events import FloatArray
from palmd.messages import Fields
from palmd.polygon import closed_outline, turned
from palmd.quantities import ESTIMATE, SHAPE
from palmd.system.mechanism import JOINTS, directions, hinge_position

_JOINTS = tuple(f"{joint}_rad" for joint in JOINTS)
_POSE = (*_JOINTS, "psi_rad", "com_x_m", "com_y_m")


@dataclass(frozen=True, slots=True)
class Scene:
    """Points in m. palms (3, 2): tip of pad 1, hinge, tip of pad 2. outline (361, 2): closed. centre (2): of mass.

    `valid` is the validity of the estimate.
    """

    valid: bool
    palms: FloatArray
    outline: FloatArray
    centre: FloatArray


class SceneBuilder:
    """Makes a scene from each outline that follows an estimate of the same tick with a finite pose."""

    def __init__(self, config: Config) -> None:
        self._arc = rig_description(config).arc
        self._pads = [pad.length_mm * 1e-3 for pad in config.pads.each()]
        self._estimate: Fields = {}

    def take(self, topic: str, fields: Fields) -> Scene | None:
        """The scene that a message completes, None if it completes none."""
        if topic == ESTIMATE.name:
            self._estimate = fields
        estimate = self._estimate
        if topic != SHAPE.name or estimate.get("mono_ns") != fields["mono_ns"]:
            return None
        if not all(math.isfinite(estimate[name]) for name in _POSE):
            return None
        angles = directions(estimate[joint] for joint in _JOINTS)
        hinge = np.array(hinge_position(*self._arc, angles[0]))
        tips = [
            hinge + length * np.array([math.cos(angle), math.sin(angle)])
            for length, angle in zip(self._pads, angles, strict=True)
        ]
        centre = np.array([estimate["com_x_m"], estimate["com_y_m"]])
        outline = closed_outline(np.array(fields["theta_rad"]), np.array(fields["h_m"])) @ turned(estimate["psi_rad"])
        return Scene(estimate["valid"], np.array([tips[0], hinge, tips[1]]), centre + outline, centre)
