"""The emulated rig of three palms in space in one pure object, as `rig.world.World` is that of two palms.

The body is held on the palms by constraint forces; where a palm would have to pull, or a contact leaves its pad, the
body falls off: a hand puts it back, at rest, some time later.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from palmd.config.three_palms import ThreePalmsConfig
from palmd.events import FloatArray
from palmd.model.icosphere import icosphere
from palmd.model.rotation import quaternion
from palmd.rig.emulated import STEP_S, EmulatedRig
from palmd.rig.fault_injection import FaultOrder, PortName
from palmd.rig.pads import GOOD_PADS, PadOptions, Press
from palmd.rig.shapes import Kind
from palmd.rig.three_palms.arm import TiltArm
from palmd.rig.three_palms.bodies import random_bodies, random_rotation
from palmd.rig.three_palms.compiled import BodyOnPalms, TurningPalms
from palmd.rig.three_palms.pads import PlanePadEmulator
from palmd.rig.three_palms.plant import BodyStates, Rubbing
from palmd.system.three_palms import HALVINGS, JOINTS, PALMS, room_on_pads
from palmd.three_palms_quantities import PALM3_BODY, PALM3_TRUTH

HALF_STEP = 2
"""Base steps in half a step of the plant."""
PLANT_STEP_S = 2 * HALF_STEP * STEP_S
REST_POSE = np.array([0.9, 0.8, 0.8])
SETTLING_S = 2.5
SETTLING_DRAG = 4e-3
AWAY_S = 2.0
MASS_KG = (0.04, 0.12)
MU, DITHER_M_S = (0.05, 0.2), (8e-3, 1.2e-2)
_STILL = (0.0,) * len(JOINTS)
_NOTHING = [[math.nan, math.nan]] * len(PALMS)  # is what pads read


class ThreePalmsWorld(EmulatedRig[TiltArm]):
    """See the module."""

    topics = (PALM3_TRUTH, PALM3_BODY)

    def __init__(
        self,
        config: ThreePalmsConfig,
        seed: int,
        *,
        kind: Kind = "rig",
        pad_options: PadOptions = GOOD_PADS,
        t: float = 0.0,
    ) -> None:
        """The palms at rest, and a random body at rest on them; the rig is as the configuration says."""
        self.config, self.seed, self.kind = config, seed, kind
        self.contact_losses = 0
        rng = np.random.default_rng(seed)
        home = tuple(REST_POSE.tolist())
        arm = TiltArm(config, home, rng, step_s=STEP_S)
        numbered = zip(PALMS, config.pads.planes, strict=True)
        pads = {f"pad{number}": PlanePadEmulator(pad, pad_options, rng, t) for number, pad in numbered}
        super().__init__(pads, arm, rng, t)
        self._middles = {f"pad{n}": (p.across_zero_mm * 1e-3) for n, p in zip(PALMS, config.pads.planes, strict=True)}
        self._side = config.pads.palm1.length_mm * 1e-3
        self._joints = arm.joints(t)
        self._palms = TurningPalms(self._joints)
        self._read = self._before = _NOTHING  # a and b of each pad, at `_read_at`, and a step before
        self._read_at = t
        self._back_at = -math.inf
        self._lifted = False
        self._touching = True
        self._draw_body()

    @property
    def body(self) -> BodyOnPalms:
        """What is on the palms, and how it moves."""
        return self._body

    # -- the outside --------------------------------------------------------------------------------------

    def new_object(self) -> None:
        """A hand takes the body away and, two seconds later, puts another one on the palms."""
        self._draw_body()
        self._leave(self.t)

    def truth(self) -> dict[str, Any]:
        """What is really there at `t`, as `rig/palm3` tells it."""
        body, touching = self._body, self._touching
        R, force = body.state[6:15].reshape(3, 3), self._mass * body.force if touching else np.full(3, math.nan)
        return {
            "quat_xyzw": list(quaternion(R)),
            **dict(zip((f"omega_{axis}_rad_s" for axis in "xyz"), body.state[15:].tolist(), strict=True)),
            **dict(zip((f"com_{axis}_m" for axis in "xyz"), body.state[:3].tolist(), strict=True)),
            **dict(zip((f"{joint}_rad" for joint in JOINTS), self._joints[0], strict=True)),
            **dict(zip((f"{joint}_rate_rad_s" for joint in JOINTS), self._joints[1], strict=True)),
            **{f"a{palm}_m": self._read[i][0] for i, palm in enumerate(PALMS)},
            **{f"b{palm}_m": self._read[i][1] for i, palm in enumerate(PALMS)},
            **{f"f{palm}_n": float(force[i]) for i, palm in enumerate(PALMS)},
            **{f"touch{palm}": touching for palm in PALMS},
            "object": self.objects,
            "arm_state": str(self._arm.state),
        }

    def object_truth(self) -> dict[str, Any]:
        """The body itself, as `rig/palm3_object` tells it."""
        body, rubbing = self._body.body, self._body.rubbing
        return {
            "object": self.objects,
            "shape": "the sum of a ball, two ellipsoids and a rounded polytope",
            "halvings": HALVINGS,
            "h_m": body.support(icosphere()[0][None])[0][0].tolist(),
            "inertia_m2": body.inertia[0].ravel().tolist(),
            "mass_kg": self._mass,
            "mu": float(rubbing.mu[0]),
            "dither_m_s": float(rubbing.dither[0]),
            "damping_m2_s": float(rubbing.drag[0]),
        }

    def _counts(self) -> dict[str, Any]:
        return {"touching": self._touching, "contact_losses": self.contact_losses}

    # -- one step -----------------------------------------------------------------------------------------

    def _step(self) -> None:
        """Half a millisecond of everything; the plant goes on every fourth."""
        self._steps += 1
        t = self.t
        self._play_all(t)
        self._speak(t)
        if self._steps % HALF_STEP:
            return
        self._joints = self._arm.joints(t)
        self._palms.turn(self._joints)
        if self._steps % (2 * HALF_STEP) == 0:
            self._live(t)

    def _live(self, t: float) -> None:
        """A step of the plant, which ends now."""
        if not self._touching:
            if not self._lifted and t >= self._back_at:
                self._settle()
            return
        body = self._body
        body.advance(self._palms.rows, PLANT_STEP_S)
        read = self._palms.readings(body.point)
        self._before, self._read, self._read_at = self._read, read.tolist(), t
        if not (body.force.min() > 0.0 and room_on_pads(read, self._side).min() > 0.0):
            self.contact_losses += 1
            self._leave(t)

    def _leave(self, t: float) -> None:
        self._touching, self._back_at = False, t + AWAY_S
        self._read = _NOTHING

    def _settle(self) -> None:
        """The body is put on the palms as they stand, some way round, where it comes to rest."""
        body, rng = self._body, self._rng
        palms = TurningPalms((self._joints[0], _STILL, _STILL)).rows
        slow = Rubbing(0 * body.rubbing.mu, body.rubbing.dither, np.full(1, SETTLING_DRAG))
        trial = BodyOnPalms(body.body, slow, self.config.rig.gravity_m_s2)
        R = random_rotation(rng, 1)
        normal = palms[0, :9].reshape(3, 3)
        h, _, _ = body.body.support(-np.einsum("bji,nj->bni", R, normal))
        centre: FloatArray = np.asarray(np.linalg.solve(normal, h[0]), np.float64)
        still = np.zeros((1, 3))
        trial.begin(BodyStates(centre[None], still, R, still))
        for _ in range(round(SETTLING_S / PLANT_STEP_S)):
            trial.advance(palms, PLANT_STEP_S)
        body.state[:] = trial.state
        body.state[3:6] = body.state[15:] = 0.0
        self._touching = True

    def _felt(self, pad: PortName) -> list[Press]:
        number = list(self._middles).index(pad)
        since = self.t - self._read_at
        a, b = (
            now + since * ((now - before) / PLANT_STEP_S)
            for now, before in zip(self._read[number], self._before[number], strict=True)
        )
        if not (self._touching and math.isfinite(a)):
            return []
        return [Press(b, self._mass * float(self._body.force[number]), a - self._middles[pad])]

    def _draw_body(self) -> None:
        rng = self._rng
        rubbing = Rubbing(rng.uniform(*MU, 1), rng.uniform(*DITHER_M_S, 1), np.zeros(1))
        self._body = BodyOnPalms(random_bodies(1, rng), rubbing, self.config.rig.gravity_m_s2)
        self._mass = float(rng.uniform(*MASS_KG))
        self.objects += 1
        self._settle()

    def _play(self, order: FaultOrder, begins: bool) -> None:
        self._arm.play(order, begins)
        if order.name == "swap" and begins:
            self.new_object()
        elif order.name == "lift":
            self._lifted = begins
            if begins and self._touching:
                self._leave(self.t)
