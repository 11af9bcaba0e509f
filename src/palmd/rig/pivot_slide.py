"""A body in a gripper on a vertical slide, standing on the pad: it rolls under friction and its weight. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

from palmd.rig.pivot import Axis, Grasp

TUMBLING_RAD_S = 100.0


@dataclass(slots=True)
class Slide:
    """Orientation (rad) and its rate (rad/s). It starts at rest: an impact of the falling carriage is dissipated."""

    grasp: Grasp
    psi: float
    omega: float = 0.0

    def advance(self, before: Axis, now: Axis, step_s: float) -> float:
        """Advance by a step (s) in which the arm moves along the pad from `before` to `now`; returns the force (N).

        One step of the fourth-order Runge–Kutta method. NaN if the body tumbles.
        """
        grasp, h, psi, omega = self.grasp, step_s, self.psi, self.omega
        middle = (0.5 * (before[0] + now[0]), 0.5 * (before[1] + now[1]), 0.5 * (before[2] + now[2]))
        a1, _ = grasp.motion(psi, omega, before)
        w2 = omega + 0.5 * h * a1
        a2, _ = grasp.motion(psi + 0.5 * h * omega, w2, middle)
        w3 = omega + 0.5 * h * a2
        a3, _ = grasp.motion(psi + 0.5 * h * w2, w3, middle)
        w4 = omega + h * a3
        a4, force = grasp.motion(psi + h * w3, w4, now)
        self.psi += h / 6.0 * (omega + 2.0 * w2 + 2.0 * w3 + w4)
        self.omega += h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
        return force if abs(self.omega) < TUMBLING_RAD_S else math.nan
