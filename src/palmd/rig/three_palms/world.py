"""The emulated rig of three palms in space in one pure object, the counterpart of `rig.world.World` for two palms.

Constraint forces keep the body on the palms; where a palm would have to pull, or a contact leaves its pad, the body
falls off, and a hand puts it back at rest some time later.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from palmd.config.three_palms import PlanePadConfig, ThreePalmsConfig
from palmd.events import FloatArray
from palmd.model.icosphere import icosphere
from palmd.model.rotation import quaternion
from palmd.rig.emulated import STEP_S, EmulatedRig
from palmd.rig.fault_injection import FaultOrder, PortName
from palmd.rig.imperfections import PadImperfection
from palmd.rig.padkinds.versapad import VersaPadEmulator
from palmd.rig.pads import GOOD_PADS, Press
from palmd.rig.shapes import Kind
from palmd.rig.three_palms.arm import TiltArm
from palmd.rig.three_palms.bodies import random_bodies, random_rotation
from palmd.rig.three_palms.plant import BodyOnPalms, FrictionParameters, TurningPalms
from palmd.system.three_palms import HALVINGS, JOINTS, PALMS, room_on_pads
from palmd.three_palms_quantities import PALM3_BODY, PALM3_TRUTH

STEPS_PER_HALF = 2
"""Base steps per half step of the plant."""
PLANT_STEP_S = 2 * STEPS_PER_HALF * STEP_S
REST_POSE = np.array([0.9, 0.8, 0.8])
SETTLING_S = 2.5
SETTLING_DRAG = 4e-3
AWAY_S = 2.0
MASS_KG = (0.04, 0.12)
MU, DITHER_M_S = (0.05, 0.2), (8e-3, 1.2e-2)
_AT_REST = (0.0,) * len(JOINTS)
_NO_READINGS = [[math.nan, math.nan]] * len(PALMS)
_EXACT = PadImperfection()


class PlanePadEmulator(VersaPadEmulator):
    """A square VersaPad with readings along both axes; `Press.across` is measured from its middle."""

    _config: PlanePadConfig

    def _is_detected(self, press: Press) -> bool:
        side = self._config.length_mm * 1e-3
        on_pad = 0.0 < press.s < side and abs(press.across) < 0.5 * side
        return on_pad and press.force > self._options.dead_band_n

    def _counts_across(self, across: float) -> int:
        plane = self._config
        measured_mm = (across + float(self._rng.normal(0.0, self._noise_m))) * 1e3
        return min(max(round(plane.across_sign * measured_mm * plane.counts_per_mm), self._range[0]), self._range[1])


class ThreePalmsWorld(EmulatedRig[TiltArm]):
    """See the module."""

    topics = (PALM3_TRUTH, PALM3_BODY)

    def __init__(self, config: ThreePalmsConfig, seed: int, *, kind: Kind = "rig", t: float = 0.0) -> None:
        """The palms at rest with a random body at rest on them; the rig is exactly as configured."""
        self.config, self.seed, self.kind = config, seed, kind
        self.contact_losses = 0
        rng = np.random.default_rng(seed)
        home = tuple(REST_POSE.tolist())
        arm = TiltArm(config, home, rng, step_s=STEP_S)
        pads = {
            f"pad{number}": PlanePadEmulator(pad, GOOD_PADS, _EXACT.reading_error_m, rng, t)
            for number, pad in zip(PALMS, config.pads.planes, strict=True)
        }
        super().__init__(pads, arm, rng, t)
        self._middles = {f"pad{n}": (p.across_zero_mm * 1e-3) for n, p in zip(PALMS, config.pads.planes, strict=True)}
        self._side = config.pads.palm1.length_mm * 1e-3
        self._joints = arm.joints(t)
        self._palms = TurningPalms(self._joints)
        self._readings = self._previous_readings = _NO_READINGS  # a and b, at `_t_readings` and a step before
        self._t_readings = t
        self._t_return = -math.inf
        self._lifted = False
        self._touching = True
        self._draw_body()

    @property
    def body(self) -> BodyOnPalms:
        """The body on the palms, with its motion."""
        return self._body

    # -- interface ----------------------------------------------------------------------------------------

    def new_object(self) -> None:
        """Take the body away and, two seconds later, put another one on the palms."""
        self._draw_body()
        self._lose_contact(self.t)

    def truth(self) -> dict[str, Any]:
        """The true state at `t`, as published on `rig/palm3`."""
        body, touching = self._body, self._touching
        R, force = body.state[6:15].reshape(3, 3), self._mass * body.force if touching else np.full(3, math.nan)
        return {
            "quat_xyzw": list(quaternion(R)),
            **dict(zip((f"omega_{axis}_rad_s" for axis in "xyz"), body.state[15:].tolist(), strict=True)),
            **dict(zip((f"com_{axis}_m" for axis in "xyz"), body.state[:3].tolist(), strict=True)),
            **dict(zip((f"{joint}_rad" for joint in JOINTS), self._joints[0], strict=True)),
            **dict(zip((f"{joint}_rate_rad_s" for joint in JOINTS), self._joints[1], strict=True)),
            **{f"a{palm}_m": self._readings[i][0] for i, palm in enumerate(PALMS)},
            **{f"b{palm}_m": self._readings[i][1] for i, palm in enumerate(PALMS)},
            **{f"f{palm}_n": float(force[i]) for i, palm in enumerate(PALMS)},
            **{f"touch{palm}": touching for palm in PALMS},
            "object": self.objects,
            "arm_state": str(self._arm.state),
        }

    def object_truth(self) -> dict[str, Any]:
        """The body itself, as published on `rig/palm3_object`."""
        body, friction = self._body.body, self._body.friction
        return {
            "object": self.objects,
            "shape": "the sum of a ball, two ellipsoids and a rounded polytope",
            "halvings": HALVINGS,
            "h_m": body.support(icosphere()[0][None])[0][0].tolist(),
            "inertia_m2": body.inertia[0].ravel().tolist(),
            "mass_kg": self._mass,
            "mu": float(friction.mu[0]),
            "dither_m_s": float(friction.dither[0]),
            "damping_m2_s": float(friction.drag[0]),
        }

    def _counts(self) -> dict[str, Any]:
        return {"touching": self._touching, "contact_losses": self.contact_losses}

    # -- one step -----------------------------------------------------------------------------------------

    def _step(self) -> None:
        """Advance everything by half a millisecond; the plant advances every fourth time."""
        self._steps += 1
        t = self.t
        self._inject_due_faults(t)
        self._transmit_due(t)
        if self._steps % STEPS_PER_HALF:
            return
        self._joints = self._arm.joints(t)
        self._palms.turn(self._joints)
        if self._steps % (2 * STEPS_PER_HALF) == 0:
            self._advance_plant(t)

    def _advance_plant(self, t: float) -> None:
        """One step of the plant, which ends at the present."""
        if not self._touching:
            if not self._lifted and t >= self._t_return:
                self._place_body()
            return
        body = self._body
        body.advance(self._palms.rows, PLANT_STEP_S)
        readings = self._palms.readings(body.point)
        self._previous_readings, self._readings, self._t_readings = self._readings, readings.tolist(), t
        if not (body.force.min() > 0.0 and room_on_pads(readings, self._side).min() > 0.0):
            self.contact_losses += 1
            self._lose_contact(t)

    def _lose_contact(self, t: float) -> None:
        self._touching, self._t_return = False, t + AWAY_S
        self._readings = _NO_READINGS

    def _place_body(self) -> None:
        """Place the body in a random orientation on the palms as they stand, and let it settle to rest."""
        body, rng = self._body, self._rng
        palms = TurningPalms((self._joints[0], _AT_REST, _AT_REST)).rows
        settling = FrictionParameters(0 * body.friction.mu, body.friction.dither, np.full(1, SETTLING_DRAG))
        trial = BodyOnPalms(body.body, settling, self.config.rig.gravity_m_s2)
        R = random_rotation(rng, 1)
        normal = palms[0, :9].reshape(3, 3)
        h, _, _ = body.body.support(-np.einsum("bji,nj->bni", R, normal))
        centre: FloatArray = np.asarray(np.linalg.solve(normal, h[0]), np.float64)
        trial.begin(centre, np.zeros(3), R, np.zeros(3))
        for _ in range(round(SETTLING_S / PLANT_STEP_S)):
            trial.advance(palms, PLANT_STEP_S)
        body.state[:] = trial.state
        body.state[3:6] = body.state[15:] = 0.0
        self._touching = True

    def _object_presses(self, pad: PortName) -> list[Press]:
        number = list(self._middles).index(pad)
        since = self.t - self._t_readings
        a, b = (
            now + since * ((now - before) / PLANT_STEP_S)
            for now, before in zip(self._readings[number], self._previous_readings[number], strict=True)
        )
        if not (self._touching and math.isfinite(a)):
            return []
        return [Press(b, self._mass * float(self._body.force[number]), a - self._middles[pad])]

    def _draw_body(self) -> None:
        rng = self._rng
        friction = FrictionParameters(rng.uniform(*MU, 1), rng.uniform(*DITHER_M_S, 1), np.zeros(1))
        self._body = BodyOnPalms(random_bodies(1, rng), friction, self.config.rig.gravity_m_s2)
        self._mass = float(rng.uniform(*MASS_KG))
        self.objects += 1
        self._place_body()

    def _inject_fault(self, order: FaultOrder, begins: bool) -> None:
        self._arm.inject_fault(order, begins)
        if order.name == "swap" and begins:
            self.new_object()
        elif order.name == "lift":
            self._lifted = begins
            if begins and self._touching:
                self._lose_contact(self.t)
