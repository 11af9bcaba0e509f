"""The emulated rig of a pivoting grasp in one pure object, the counterpart of `rig.world.World` for two palms.

Rigid gripper: while the body touches the pad, the pivot's height determines its orientation, and constraint forces
determine the pad's force (`rig.pivot.Grasp`). Contact is lost where the force would have to pull; beyond the lowest
height, or where friction holds the body, it is jammed. Gripper on a slide: the arm moves the slide's lower stop; while
the body stands on the pad the carriage is clear of the stop and the body rolls (`rig.pivot.Slide`).

A body without contact is in a hand, which waits until the gripper has been raised, tilts the body (under a rigid
gripper towards the nearer end of the pad) and releases it when it touches again.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from palmd.config.pivot import PivotConfig, pivot_rig
from palmd.pivot_quantities import PIVOT_BODY, PIVOT_TRUTH
from palmd.rig.emulated import STEP_S, EmulatedRig
from palmd.rig.fault_injection import FaultOrder, PortName
from palmd.rig.imperfections import Imperfections, PadImperfection, drawn
from palmd.rig.pads import GOOD_PADS, Press, make_emulator
from palmd.rig.pivot import Axis, Grasp, Slide
from palmd.rig.pivot_arm import PivotArm
from palmd.rig.shapes import Kind, random_body
from palmd.system.description import RigDescription

PAD = "pad1"
FARTHEST_M, NEAREST_M = 9e-3, 5e-3  # distance of the pivot from the centre of mass
MU = (0.05, 0.2)
SLIDE_FARTHEST_M, SLIDE_NEAREST_M, SLIDE_MU = 3e-3, 5e-4, (0.25, 0.4)  # on a slide, where friction must roll the body
MASS_KG = (0.04, 0.12)
MAX_FORCE_N = 20.0  # with which the arm presses on a jammed body
MIN_LEVER_M = 3e-4  # with a smaller lever arm the body is jammed
TURNING_S, CLEARANCE_M = 1.0, 2e-3  # the hand's time to tilt the body, and the height to which it must be lifted
TILTED = 0.75  # smallest lever arm after tilting, over the largest one on that side
CENTRED = 0.3  # on a slide: largest lever arm after tilting, over the largest one
_STEPS_A_TURN = 1440


def configured_imperfections(config: PivotConfig, seed: int) -> Imperfections:
    """Errors of the one pad, and in `angles` the slope of its surface along the arm's x; `calibrated` uses `seed`."""
    if config.rig.imperfections == "none":
        return Imperfections((PadImperfection(),), (0.0,))
    rig = pivot_rig(config)
    pad = replace(rig.pad, map_sd=0.0)  # observers of a pivoting grasp do not model a smooth position error
    imperfections = drawn(RigDescription(angle_sd=rig.angle_sd, pads=(pad,)), seed)
    return replace(imperfections, angles=imperfections.angles[:1])


class PivotWorld(EmulatedRig[PivotArm]):
    """See the module."""

    topics = (PIVOT_TRUTH, PIVOT_BODY)

    def __init__(self, config: PivotConfig, seed: int, *, kind: Kind = "rig", t: float = 0.0) -> None:
        """The gripper at rest in the middle over the pad, at the top; a random body hangs from it.

        The configuration's `rig.imperfections` states the rig's true errors.
        """
        self.config, self.seed, self.kind = config, seed, kind
        self.contact_losses = self.jams = 0
        self.most_force = 0.0
        self.imperfections = configured_imperfections(config, seed)
        self._pad_error = self.imperfections.pads[0]
        rng, pad = np.random.default_rng(seed), config.pads.palm1
        arm = PivotArm(config, rng, step_s=STEP_S)
        super().__init__({PAD: make_emulator(pad, GOOD_PADS, self._pad_error.reading_error_m, rng, t)}, arm, rng, t)
        self._pad_length = pad.length_mm * 1e-3
        self._side, self._z_at_loss = 1.0, -math.inf
        self._psi = self._force = 0.0
        self._slide: Slide | None = None  # while the body stands on the pad under a slide
        self._tilt: float | None = None  # orientation in the hand; None before the hand has tilted the body
        self._t_tilted = t
        self._draw_body()

    # -- interface ----------------------------------------------------------------------------------------

    def new_object(self) -> None:
        """Exchange the body."""
        self._draw_body()

    def truth(self) -> dict[str, Any]:
        """The true state at `t`, as published on `rig/pivot`."""
        x, z = self._pivot(self.t)
        e = self.grasp.offset(self._psi) if self._touching else math.nan
        slide = self._slide
        return {
            "x_m": x[0],
            "z_m": z[0] if slide is None else self.grasp.height(slide.psi),
            "s1_m": x[0] + e,
            "e_m": e,
            "psi_rad": self._orientation,
            "omega0_rad_s": slide.omega if slide is not None else -z[1] / e if self._touching else 0.0,
            "f1_n": self._force if self._touching else 0.0,
            "touch1": self._touching,
            "object": self.objects,
            "arm_state": str(self._arm.state),
        }

    def object_truth(self) -> dict[str, Any]:
        """The body itself, as published on `rig/pivot_object`."""
        grasp, theta = self.grasp, np.arange(360, dtype=np.float64) * (math.tau / 360)
        px, py = grasp.pivot
        h = grasp.body.support.sample(theta) - px * np.cos(theta) - py * np.sin(theta)
        return {
            "object": self.objects,
            "shape": grasp.body.shape,
            "theta_rad": theta.tolist(),
            "hP_m": h.tolist(),
            "com_m": [-px, -py],
            "mass_kg": grasp.body.mass,
            "mu": grasp.mu,
        }

    def _counts(self) -> dict[str, Any]:
        return {
            "touching": self._touching,
            "contact_losses": self.contact_losses,
            "jams": self.jams,
            "most_force_n": self.most_force,
        }

    # -- one step -----------------------------------------------------------------------------------------

    def _step(self) -> None:
        """Advance everything by half a millisecond."""
        self._steps += 1
        t = self.t
        x, z = self._pivot(t)
        if not self._touching:
            self._wait_for_contact(t, x, z)
        elif self._slide is not None:
            self._roll_body(self._slide, x, z)
        else:
            self._follow_pivot(x, z)
        self._inject_due_faults(t)
        self._pivot_now = x, z
        self._transmit_due(t)

    def _pivot(self, t: float) -> tuple[Axis, Axis]:
        """Motion of the pivot (or the slide's stop) along the pad, and over the surface's tangent at the contact."""
        x, z = self._arm.pivot_motion(t)
        slope, height = self._pad_error.tangent_plane(x[0] + self.grasp.offset(self._orientation), self._pad_length)
        slope += self.imperfections.angles[0]
        return x, (z[0] - height - slope * x[0], z[1] - slope * x[1], z[2] - slope * x[2])

    @property
    def _orientation(self) -> float:
        """The body's orientation on the pad, or in the hand (rad)."""
        return self._psi if self._tilt is None or self._touching else self._tilt

    def _roll_body(self, slide: Slide, x: Axis, z: Axis) -> None:
        """The body rolls under the carriage; the slide's stop can lift it."""
        force = slide.advance(self._pivot_now[0], x, STEP_S)
        self._psi = slide.psi
        self._arm.travel = self.grasp.height(slide.psi) - z[0]
        is_on_pad = 0.0 < x[0] + self.grasp.offset(slide.psi) < self._pad_length
        if self._arm.travel < 0.0 or not (force > 0.0 and is_on_pad):
            self._lose_contact()
        else:
            self._set_force(force)

    def _follow_pivot(self, x: Axis, z: Axis) -> None:
        """The body follows the pivot's height on its side of the dead centre; the contact force follows from that."""
        grasp, psi = self.grasp, self._psi
        for _ in range(20):
            e, height_error = grasp.offset(psi), z[0] - grasp.height(psi)
            if e * self._side < MIN_LEVER_M or abs(height_error) < 1e-12:
                break
            psi -= min(max(height_error / e, -0.05), 0.05)  # dz/dψ = −e
        e = grasp.offset(psi)
        if e * self._side < MIN_LEVER_M:
            if z[0] > grasp.height(psi):
                self._lose_contact()  # the pivot is too high
            else:
                self._jam()
            return
        omega = -z[1] / e
        h2 = grasp.bend(psi)
        alpha = (h2 * omega * omega - z[2]) / e
        force = grasp.rigid_contact_force(psi, omega, alpha, x, z)
        lever = min(
            (e - friction_ratio * z[0]) * self._side for _, friction_ratio in grasp.friction_phases(x[1] + omega * z[0])
        )
        self._psi = psi
        if lever < MIN_LEVER_M:
            self._jam()
        elif not force > 0.0:
            self._lose_contact()
        else:
            self._jammed = False
            self._set_force(force)
        if self._touching and not 0.0 < x[0] + e < self._pad_length:
            self._lose_contact()

    def _set_force(self, force: float) -> None:
        self._force = min(force, MAX_FORCE_N)
        self.most_force = max(self.most_force, self._force)

    def _jam(self) -> None:
        """The body cannot turn: the arm presses with its maximum force."""
        self.jams += not self._jammed
        self._jammed = True
        self._set_force(MAX_FORCE_N)

    def _lose_contact(self) -> None:
        self.contact_losses += 1
        self._touching, self._force, self._tilt, self._slide = False, 0.0, None, None
        self._arm.travel = 0.0
        self._z_at_loss = self._pivot(self.t)[1][0]

    def _wait_for_contact(self, t: float, x: Axis, z: Axis) -> None:
        """The hand tilts the body once the gripper is high enough, and releases it when it touches."""
        side = 1.0 if x[0] > 0.5 * self._pad_length else -1.0
        if self._tilt is None or side != self._side:
            if z[0] > self._z_at_loss + CLEARANCE_M:
                self._side, self._tilt, self._t_tilted = side, self._draw_tilt(side), t + TURNING_S
        elif t >= self._t_tilted and z[0] <= self.grasp.height(self._tilt):
            self._touching, self._psi = True, self._tilt
            if self.config.rig.carriage_mass_kg is not None:
                self._slide = Slide(self.grasp, self._psi)

    def _draw_tilt(self, side: float) -> float:
        """A random orientation well away from the dead centre on this side; on a slide near one, on either side."""
        angles = np.linspace(-math.pi, math.pi, _STEPS_A_TURN, endpoint=False)
        levers = np.array([self.grasp.offset(a) for a in angles]) * side
        heights = np.array([self.grasp.height(a) for a in angles])
        if self.config.rig.vertical == "float":
            candidates = np.flatnonzero(np.abs(levers) < CENTRED * np.abs(levers).max())
        else:
            candidates = np.flatnonzero((levers > TILTED * levers.max()) & (heights >= heights[levers.argmax()]))
        tilt = float(angles[candidates[int(self._rng.integers(len(candidates)))]])
        nearest: float = tilt + math.tau * round((self._psi - tilt) / math.tau)
        return nearest

    def _object_presses(self, pad: PortName) -> list[Press]:
        del pad  # there is only one
        if not self._touching:
            return []
        x, z = self._pivot_now
        e = self.grasp.offset(self._psi)
        lead_s = max(-self._pad_error.lag, 0.0)
        normal_rate = z[1] / e if self._slide is None else -self._slide.omega  # dθ = dz/e
        rate = x[1] + self.grasp.bend(self._psi) * normal_rate  # de = h″ dθ
        return [Press(x[0] + e + lead_s * rate, self._force)]

    def _reporting_delay(self, pad: PortName) -> float:
        del pad
        return max(self._pad_error.lag, 0.0)

    def _draw_body(self) -> None:
        rng, rig = self._rng, self.config.rig
        slides = rig.vertical == "float"
        body = replace(random_body(self.kind, rng), mass=float(rng.uniform(*MASS_KG)))
        nearest, farthest = (SLIDE_NEAREST_M, SLIDE_FARTHEST_M) if slides else (NEAREST_M, FARTHEST_M)
        distance, angle = float(rng.uniform(nearest, farthest)), float(rng.uniform(0.0, math.tau))
        self.grasp = Grasp(
            body,
            (distance * math.cos(angle), distance * math.sin(angle)),
            mu=float(rng.uniform(*(SLIDE_MU if slides else MU))),
            dither=float(rng.uniform(8e-3, 20e-3)),
            damping=float(rng.uniform(1e-5, 4e-5)),
            carriage=rig.carriage_mass_kg or 0.0,
            carriage_damping=rig.damping_n_s_m,
        )
        self.objects += 1
        self._slide, self._arm.travel = None, 0.0
        self._touching = self._jammed = False
        self._psi = self._force = 0.0
        self._side, self._z_at_loss = 1.0, -math.inf
        self._tilt, self._t_tilted = None, self.t

    def _inject_fault(self, order: FaultOrder, begins: bool) -> None:
        self._arm.inject_fault(order, begins)
        if order.name == "swap" and begins:
            self.new_object()
        elif order.name == "lift" and begins and self._touching:
            self._lose_contact()
