"""The emulated rig of a pivoting grasp in one pure object, as `rig.world.World` is that of two palms.

A rigid gripper: while the body touches the pad, the pivot's height says how it stands, and constraint forces what the
pad feels (`rig.pivot.Grasp`). It leaves the pad where the force would have to pull; beyond the lowest height, or where
friction holds it, it is jammed. A gripper on a slide: the arm has the slide's lower stop; where the body stands on the
pad the carriage is clear of it, and the body rolls (`rig.pivot_slide`).

What has left the pad is in a hand: it waits until the gripper has come up, tilts the body (under a rigid gripper
towards the nearer end of the pad) and lets go when it touches again.
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
from palmd.rig.pads import GOOD_PADS, PadOptions, Press, make_emulator
from palmd.rig.pivot import Axis, Grasp
from palmd.rig.pivot_arm import PivotArm
from palmd.rig.pivot_slide import Slide
from palmd.rig.shapes import Kind, random_body
from palmd.system.description import RigDescription

PAD = "pad1"
FARTHEST_M, NEAREST_M = 9e-3, 5e-3  # of the pivot from the centre of mass
MU = (0.05, 0.2)
SLIDE_FARTHEST_M, SLIDE_NEAREST_M, SLIDE_MU = 3e-3, 5e-4, (0.25, 0.4)  # on a slide, whose body friction must roll
MASS_KG = (0.04, 0.12)
JAMMED_N = 20.0  # what the arm presses with at most, and takes for a jam
LEVER_M = 3e-4  # below which the body is jammed
TURNED_S, CLEAR_M = 1.0, 2e-3  # what a hand takes to tilt it, and how high it must have been lifted
TILTED = 0.75  # share of the largest lever on a side that the hand tilts it to, or more
LEVEL = 0.3  # the same on a slide, or less
_STEPS_A_TURN = 1440


def configured_imperfections(config: PivotConfig, seed: int) -> Imperfections:
    """Of the one pad, and in `angles` how its surface rises along the arm's x; `calibrated` is drawn by `seed`."""
    if config.rig.imperfections == "none":
        return Imperfections((PadImperfection(),), (0.0,))
    rig = pivot_rig(config)
    pad = replace(rig.pad, map_sd=0.0)  # its observers know of no smooth error of place
    off = drawn(RigDescription(angle_sd=rig.angle_sd, pads=(pad,)), seed)
    return replace(off, angles=off.angles[:1])


class PivotWorld(EmulatedRig[PivotArm]):
    """See the module."""

    topics = (PIVOT_TRUTH, PIVOT_BODY)

    def __init__(
        self, config: PivotConfig, seed: int, *, kind: Kind = "rig", pad_options: PadOptions = GOOD_PADS, t: float = 0.0
    ) -> None:
        """The gripper at rest in the middle over the pad, as high as it may be; a random body hangs from it.

        The configuration's `rig.imperfections` say how far the rig is off from the rest of it.
        """
        self.config, self.seed, self.kind = config, seed, kind
        self.contact_losses = self.jams = 0
        self.most_force = 0.0
        self.imperfections = configured_imperfections(config, seed)
        self._off = self.imperfections.pads[0]
        rng, pad = np.random.default_rng(seed), config.pads.palm1
        arm = PivotArm(config, rng, step_s=STEP_S)
        super().__init__({PAD: make_emulator(pad, pad_options, self._off.reading_error_m, rng, t)}, arm, rng, t)
        self._pad_length = pad.length_mm * 1e-3
        self._side, self._left_at = 1.0, -math.inf
        self._psi = self._force = 0.0
        self._slide: Slide | None = None  # while the body stands on the pad under one
        self._tilt: float | None = None  # where the hand holds the body; None before it does
        self._t_tilted = t
        self._draw_body()

    # -- the outside --------------------------------------------------------------------------------------

    def new_object(self) -> None:
        """A hand exchanges the body."""
        self._draw_body()

    def truth(self) -> dict[str, Any]:
        """What is really there at `t`, as `rig/pivot` tells it."""
        x, z = self._pivot(self.t)
        e = self.grasp.offset(self._psi) if self._touching else math.nan
        rolls = self._slide
        return {
            "x_m": x[0],
            "z_m": z[0] if rolls is None else self.grasp.height(rolls.psi),
            "s1_m": x[0] + e,
            "e_m": e,
            "psi_rad": self._stands,
            "omega0_rad_s": rolls.omega if rolls is not None else -z[1] / e if self._touching else 0.0,
            "f1_n": self._force if self._touching else 0.0,
            "touch1": self._touching,
            "object": self.objects,
            "arm_state": str(self._arm.state),
        }

    def object_truth(self) -> dict[str, Any]:
        """The body itself, as `rig/pivot_object` tells it."""
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
        """Half a millisecond of everything."""
        self._steps += 1
        t = self.t
        x, z = self._pivot(t)
        if not self._touching:
            self._wait(t, x, z)
        elif self._slide is not None:
            self._roll(self._slide, x, z)
        else:
            self._go_on(x, z)
        self._play_all(t)
        self._at = x, z
        self._speak(t)

    def _pivot(self, t: float) -> tuple[Axis, Axis]:
        """Along the pad, and over the tangent of its surface there where the body touches it; of a slide its stop."""
        x, z = self._arm.place(t)
        slope, height = self._off.tangent_plane(x[0] + self.grasp.offset(self._stands), self._pad_length)
        slope += self.imperfections.angles[0]
        return x, (z[0] - height - slope * x[0], z[1] - slope * x[1], z[2] - slope * x[2])

    @property
    def _stands(self) -> float:
        """The body's orientation on the pad, or in the hand (rad)."""
        return self._psi if self._tilt is None or self._touching else self._tilt

    def _roll(self, slide: Slide, x: Axis, z: Axis) -> None:
        """The body rolls under the carriage; it is lifted by the slide's stop."""
        force = slide.advance(self._at[0], x, STEP_S)
        self._psi = slide.psi
        self._arm.travel = self.grasp.height(slide.psi) - z[0]
        on_it = 0.0 < x[0] + self.grasp.offset(slide.psi) < self._pad_length
        if self._arm.travel < 0.0 or not (force > 0.0 and on_it):
            self._leave()
        else:
            self._press(force)

    def _go_on(self, x: Axis, z: Axis) -> None:
        """The body follows the pivot's height along its side of the dead centre, and its force follows from that."""
        grasp, psi = self.grasp, self._psi
        for _ in range(20):
            e, off = grasp.offset(psi), z[0] - grasp.height(psi)
            if e * self._side < LEVER_M or abs(off) < 1e-12:
                break
            psi -= min(max(off / e, -0.05), 0.05)  # dz/dψ = −e
        e = grasp.offset(psi)
        if e * self._side < LEVER_M:
            if z[0] > grasp.height(psi):
                self._leave()  # higher than it is
            else:
                self._jam()
            return
        omega = -z[1] / e
        h2 = grasp.bend(psi)
        alpha = (h2 * omega * omega - z[2]) / e
        force = grasp.pressed(psi, omega, alpha, x, z)
        lever = min((e - grip * z[0]) * self._side for _, grip in grasp.rubs(x[1] + omega * z[0]))
        self._psi = psi
        if lever < LEVER_M:
            self._jam()
        elif not force > 0.0:
            self._leave()
        else:
            self._jammed = False
            self._press(force)
        if self._touching and not 0.0 < x[0] + e < self._pad_length:
            self._leave()

    def _press(self, force: float) -> None:
        self._force = min(force, JAMMED_N)
        self.most_force = max(self.most_force, self._force)

    def _jam(self) -> None:
        """It cannot turn: the arm presses as hard as it can."""
        self.jams += not self._jammed
        self._jammed = True
        self._press(JAMMED_N)

    def _leave(self) -> None:
        self.contact_losses += 1
        self._touching, self._force, self._tilt, self._slide = False, 0.0, None, None
        self._arm.travel = 0.0
        self._left_at = self._pivot(self.t)[1][0]

    def _wait(self, t: float, x: Axis, z: Axis) -> None:
        """The hand tilts the body once the gripper is high enough, and lets go when it touches."""
        side = 1.0 if x[0] > 0.5 * self._pad_length else -1.0
        if self._tilt is None or side != self._side:
            if z[0] > self._left_at + CLEAR_M:
                self._side, self._tilt, self._t_tilted = side, self._tilted(side), t + TURNED_S
        elif t >= self._t_tilted and z[0] <= self.grasp.height(self._tilt):
            self._touching, self._psi = True, self._tilt
            if self.config.rig.carriage_mass_kg is not None:
                self._slide = Slide(self.grasp, self._psi)

    def _tilted(self, side: float) -> float:
        """An orientation on this side of the dead centre, well away from it; on a slide near one, wherever."""
        angles = np.linspace(-math.pi, math.pi, _STEPS_A_TURN, endpoint=False)
        levers = np.array([self.grasp.offset(a) for a in angles]) * side
        heights = np.array([self.grasp.height(a) for a in angles])
        if self.config.rig.vertical == "float":
            there = np.flatnonzero(np.abs(levers) < LEVEL * np.abs(levers).max())
        else:
            there = np.flatnonzero((levers > TILTED * levers.max()) & (heights >= heights[levers.argmax()]))
        tilt = float(angles[there[int(self._rng.integers(len(there)))]])
        nearest: float = tilt + math.tau * round((self._psi - tilt) / math.tau)
        return nearest

    def _felt(self, pad: PortName) -> list[Press]:
        del pad  # there is one
        if not self._touching:
            return []
        x, z = self._at
        e = self.grasp.offset(self._psi)
        early = max(-self._off.lag, 0.0)
        turns = z[1] / e if self._slide is None else -self._slide.omega  # dθ = dz/e
        rate = x[1] + self.grasp.bend(self._psi) * turns  # de = h″ dθ
        return [Press(x[0] + e + early * rate, self._force)]

    def _late(self, pad: PortName) -> float:
        del pad
        return max(self._off.lag, 0.0)

    def _draw_body(self) -> None:
        rng, rig = self._rng, self.config.rig
        slides = rig.vertical == "float"
        body = replace(random_body(self.kind, rng), mass=float(rng.uniform(*MASS_KG)))
        near, farthest = (SLIDE_NEAREST_M, SLIDE_FARTHEST_M) if slides else (NEAREST_M, FARTHEST_M)
        far, angle = float(rng.uniform(near, farthest)), float(rng.uniform(0.0, math.tau))
        self.grasp = Grasp(
            body,
            (far * math.cos(angle), far * math.sin(angle)),
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
        self._side, self._left_at = 1.0, -math.inf
        self._tilt, self._t_tilted = None, self.t

    def _play(self, order: FaultOrder, begins: bool) -> None:
        self._arm.play(order, begins)
        if order.name == "swap" and begins:
            self.new_object()
        elif order.name == "lift" and begins and self._touching:
            self._leave()
