"""The emulated object between two palms in MuJoCo, a physics engine with its own contact and friction models.

A palm is a plane on a hinge joint and a slide joint along itself, whose positions and velocities are prescribed, so
that its vibration is a motion of the plane; a compliant mount is a spring across the palm. The body is an ellipsoid.
World frame and units as in `rig.plant`.

MuJoCo's contacts are soft. They are as stiff as the step allows without bouncing (`solref`), with `solimp` 0.1, so that
sliding friction does not lift the body. Friction has its own, slower time constant (`solreffriction`): with that of
the normal force it overshoots in each step, and a contact that should stick creeps at 1 mm/s.

Forces are those that a pad of about 60 Hz bandwidth reads, not instantaneous ones.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Unpack

import mujoco
import numpy as np

from palmd.events import FloatArray, PalmMotion
from palmd.rig.ellipses import ellipse_of
from palmd.rig.mean_turning import MeanTurning
from palmd.rig.plant import FrictionSurface, Hinge, Plant, PlantContact, PlantSettings, palm_frame
from palmd.rig.shaker import STILL, Shaker, Shaking
from palmd.rig.shapes import Body
from palmd.rig.vibrating_plant import FORCE_LAG_S
from palmd.system.mechanism import PALMS

STEP_S = 25e-6
"""Largest step of the engine (derivation: 1/160 of a period of 250 Hz, where 1/40 resolves the slip reversals)."""
_SETTINGS = 'cone="elliptic" impratio="100" tolerance="1e-14" iterations="30"'
_NORMAL_STEPS, _FRICTION_STEPS = 8, 64
"""Time constants of contacts in steps of the engine (study 2026-11-29, from one state and motion near a crest, for 1 s:
with 8 for both, a sticking contact creeps at 1 mm/s and the angle differs by 2.3° from palmd's own plant; with these
values by 0.02°)."""
_HEAVY_KG = 1e3
"""Inertia (kg, kg m²) of prescribed joints (derivation: 10 N move it by less than 1e-10 m in a step of 0.1 ms)."""
_LIGHT_INERTIAL = '<inertial pos="0 0 0" mass="1e-3" diaginertia="1e-3 1e-3 1e-3"/>'
_PRESCRIBED = f'armature="{_HEAVY_KG}"'
_TOUCHED_SIDES = (1.0, -1.0)
"""Side of its own direction on which each palm is touched: left (1) or right (−1)."""


def mjcf(
    body: Body, hinge: Hinge, frictions: Sequence[float], damping: float, shakers: Sequence[Shaker], step_s: float
) -> str:
    """The model's XML, in which each palm's plane is a box; raises ValueError for a body that is no ellipse.

    frictions: coefficient of each palm. damping: as in `FrictionSurface`.
    """
    ellipse = ellipse_of(body.support)
    (a, b), (x, y), (base_x, base_y) = ellipse.half_axes, ellipse.centre, hinge.base
    inertia, travel = body.mass * body.rho**2, hinge.palm1_length if hinge.mode == "arc" else 0.0
    palm1, palm2 = (_palm(number, shaker) for number, shaker in enumerate(shakers, 1))
    pairs = "".join(
        f'<pair geom1="palm{palm}" geom2="object" condim="3" friction="{mu} {mu}"'
        f' solref="{_NORMAL_STEPS * step_s} 1" solreffriction="{_FRICTION_STEPS * step_s} 1"'
        ' solimp="0.1 0.1 0.001 0.5 2"/>'
        for palm, mu in zip(PALMS, frictions, strict=True)
    )
    return f"""
      <mujoco><compiler angle="radian"/><option timestep="{step_s}" {_SETTINGS}/>
        <worldbody>
          <body pos="{base_x} {base_y} 0"><joint name="turn1" type="hinge" axis="0 0 1" {_PRESCRIBED}/>{_LIGHT_INERTIAL}
            <body pos="{-travel} 0 0">{_LIGHT_INERTIAL}{palm1}
              <body><joint name="turn2" type="hinge" axis="0 0 1" {_PRESCRIBED}/>{_LIGHT_INERTIAL}{palm2}</body>
            </body>
          </body>
          <body name="object">
            <joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/>
            <joint name="psi" type="hinge" axis="0 0 1" damping="{body.mass * damping}"/>
            <inertial pos="0 0 0" mass="{body.mass}" diaginertia="{inertia} {inertia} {inertia}"/>
            <geom name="object" type="ellipsoid" size="{a} {b} {0.5 * (a + b)}" pos="{x} {y} 0"
              euler="0 0 {ellipse.tilt}" contype="0" conaffinity="0"/>
          </body>
        </worldbody>
        <contact>{pairs}</contact>
        <sensor>{"".join(f'<touch site="palm{palm}"/>' for palm in PALMS)}</sensor>
      </mujoco>"""


def _palm(number: int, shaker: Shaker) -> str:
    """The vibrating part of a palm on its mount, with a sensor of the normal force."""
    mount = shaker.mount
    across, inertial = "", _LIGHT_INERTIAL
    if math.isfinite(mount.mass):
        across = (
            f'<joint name="mount{number}" type="slide" axis="0 1 0" stiffness="{mount.stiffness}"'
            f' damping="{mount.damping}"/>'
        )
        inertial = f'<inertial pos="0 0 0" mass="{mount.mass}" diaginertia="1e-3 1e-3 1e-3"/>'
    return f"""<body name="palm{number}" gravcomp="1">
      <joint name="shaker{number}" type="slide" axis="1 0 0" {_PRESCRIBED}/>{across}{inertial}
      <geom name="palm{number}" type="box" size="1 1 1" contype="0" conaffinity="0"/>
      <site name="palm{number}" type="box" size="1 1 1"/></body>"""


class MujocoPlant(Plant):
    """As `Plant`, for ellipses; motion, contacts and forces are computed by MuJoCo."""

    def __init__(
        self,
        body: Body,
        hinge: Hinge,
        surface: FrictionSurface,
        shaking: Shaking | None,
        *,
        step_s: float = STEP_S,
        **others: Unpack[PlantSettings],
    ) -> None:
        """step_s: largest step of the engine. Raises ValueError for a body that is no ellipse."""
        super().__init__(body, hinge, surface, **others)
        self._shakers = shaking.palms if shaking else (STILL,) * len(PALMS)
        self._step_s, frictions = step_s, [surface.mu * each for each in self._frictions]
        model = self._model = mujoco.MjModel.from_xml_string(
            mjcf(body, self.hinge, frictions, surface.damping, self._shakers, step_s)
        )
        # planes on moving bodies are rejected by the model compiler, but may be set afterwards
        self._plane_geoms = [model.geom(f"palm{palm}").id for palm in PALMS]
        model.geom_type[self._plane_geoms] = mujoco.mjtGeom.mjGEOM_PLANE
        model.geom_rbound[self._plane_geoms] = model.geom_sameframe[self._plane_geoms] = 0
        self._data = mujoco.MjData(model)
        self._turns, self._slides = self._palm_coordinates("turn"), self._palm_coordinates("shaker")
        self._object = slice(self._coordinate("x"), self._coordinate("psi") + 1)
        self._palms = PalmMotion.at_rest((0.0,) * len(PALMS))
        self._t_last_contact = [-math.inf] * len(PALMS)
        self._first_stage = self._second_stage = np.zeros(len(PALMS))  # low-pass filtered forces (N)
        self._turning = MeanTurning(shaking.period_s) if shaking else None
        self.penetration_m = 0.0
        """Largest penetration (m) so far."""
        self.step_forces: FloatArray = np.zeros(len(PALMS))
        """Mean normal forces (N) over the last step."""

    def _coordinate(self, joint: str) -> int:
        return int(self._model.joint(joint).qposadr[0])

    def _palm_coordinates(self, joint: str) -> slice:
        one, two = (self._coordinate(f"{joint}{palm}") for palm in PALMS)
        return slice(one, two + 1, two - one)

    # -- placement and state ------------------------------------------------------------------------------

    def place(self, palms: PalmMotion, psi: float, omega0: float = 0.0) -> None:
        super().place(palms, psi, omega0)
        q, data = self.state, self._data
        mujoco.mj_resetData(self._model, data)
        data.qpos[self._object], data.qvel[self._object] = (q.x, q.y, q.psi), (q.vx, q.vy, q.omega0)
        self._palms = palms
        self._t_last_contact = [self._t] * len(PALMS)
        if self._turning:
            self._turning.reset(self._t, q.psi, q.omega0)
        self._first_stage = self._second_stage = self.step_forces = self.body.mass * np.array(self._rates[3:])
        for palm, side, force, shaker in zip(PALMS, _TOUCHED_SIDES, self._first_stage, self._shakers, strict=True):
            if math.isfinite(shaker.mount.mass):  # the springs carry the body at rest
                mount = self._coordinate(f"mount{palm}")
                self._model.qpos_spring[mount] = side * force / shaker.mount.stiffness

    @property
    def touching(self) -> tuple[bool, bool]:
        """Palms that the body touches, or has touched within the pad's filter time and a vibration period."""
        one, two = (
            not self.fallen and self._t - t <= 2.0 * FORCE_LAG_S + (1.0 / shaker.frequency if shaker.speed else 0.0)
            for t, shaker in zip(self._t_last_contact, self._shakers, strict=True)
        )
        return one, two

    def contacts(self) -> tuple[PlantContact, PlantContact]:
        """Both present contacts; forces as a pad reads them, averaged over the vibration."""
        one, two = (
            PlantContact(on, s, float(force) if on else 0.0)
            for on, s, force in zip(self.touching, self._distances(), self._second_stage, strict=True)
        )
        return one, two

    def status(self) -> dict[str, float]:
        """Largest penetration (m) since the body was made."""
        return {"penetration_m": self.penetration_m}

    @property
    def mean_omega0(self) -> float:
        return self._turning.rate if self._turning else self.state.omega0

    # -- time steps ---------------------------------------------------------------------------------------

    def advance(self, middle: PalmMotion, end: PalmMotion, dt: float) -> None:
        """Advance by dt seconds; `end` is the palms at the end, whose accelerations are constant until then."""
        del middle
        begin, self._palms = self._palms, end
        t, self._t = self._t, self._t + dt
        self._frame = palm_frame(self.hinge, end, self._planes)
        if self.fallen:
            return
        self._set_planes()
        self._run_engine(begin, end, t, dt)
        self._copy_state(dt)

    def _run_engine(self, begin: PalmMotion, end: PalmMotion, t: float, dt: float) -> None:
        model, data = self._model, self._data
        count = math.ceil(dt / self._step_s - 1e-6)
        step_s = model.opt.timestep = dt / count
        model.opt.gravity[:] = 0.0, -self._gravity_now(), 0.0
        accelerations = np.subtract(end.rates, begin.rates) / dt
        data.qpos[self._turns], data.qpos[self._slides] = begin.angles, [each.displacement(t) for each in self._shakers]
        # with velocities of half a step earlier, the engine's steps are exact for constant accelerations
        data.qvel[self._turns] = begin.rates - 0.5 * step_s * accelerations
        data.qfrc_applied[self._turns] = _HEAVY_KG * accelerations
        forces, speeds, sensed = np.zeros(len(PALMS)), data.qvel[self._slides], data.sensordata
        middles: FloatArray = t + (np.arange(count, dtype=np.float64) + 0.5) * step_s
        for both in np.array([each.outward_speeds(middles) for each in self._shakers]).T:
            speeds[:] = both
            mujoco.mj_step(model, data)
            forces += sensed
        self.step_forces = forces / count

    def _set_planes(self) -> None:
        """Place the palms' planes tangent to the pads' surfaces."""
        model, half = self._model, math.sqrt(0.5)
        for geom, side, (slope, above) in zip(self._plane_geoms, _TOUCHED_SIDES, self._planes, strict=True):
            c, s = math.cos(0.5 * side * slope), math.sin(0.5 * side * slope)
            model.geom_pos[geom] = -above * math.sin(slope), side * above * math.cos(slope), 0.0
            model.geom_quat[geom] = half * c, -side * half * c, -side * half * s, half * s

    def _copy_state(self, dt: float) -> None:
        """Copy the engine's state into the attributes that this class inherits."""
        q, data, forces = self.state, self._data, self.step_forces
        q.x, q.y, q.psi = data.qpos[self._object].tolist()
        q.vx, q.vy, q.omega0 = data.qvel[self._object].tolist()
        self._first_stage = self._first_stage + dt / FORCE_LAG_S * (forces - self._first_stage)
        self._second_stage = self._second_stage + dt / FORCE_LAG_S * (self._first_stage - self._second_stage)
        if self._turning:
            self._turning.take(self._t, q.psi)
        self._t_last_contact = [self._t if f > 0.0 else t for f, t in zip(forces, self._t_last_contact, strict=True)]
        if data.ncon:
            self.penetration_m = max(self.penetration_m, -float(data.contact.dist.min()))
        self._on = list(self.touching)
        self._update_tangent_planes()
        self._drop_if_off_the_palms()
