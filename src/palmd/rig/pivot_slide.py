"""A body in a gripper on a slide while it stands on the pad: it rolls as friction and its weight have it. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

from palmd.rig.pivot import Axis, Grasp

TUMBLES_RAD_S = 100.0


@dataclass(slots=True)
class Slide:
    """Orientation (rad) and its rate (rad/s); set down at rest: what the carriage fell with is lost at once."""

    grasp: Grasp
    psi: float
    omega: float = 0.0

    def advance(self, before: Axis, now: Axis, step_s: float) -> float:
        """Live on for a step (s) in which the arm went along the pad from `before` to `now`; the pad's force (N) then.

        One step of Runge and Kutta's fourth order. NaN where the body tumbles.
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
        return force if abs(self.omega) < TUMBLES_RAD_S else math.nan
