"""Scenes in MuJoCo: an ellipsoid between two boxes, whose positions and velocities are prescribed.

A palm is a box on a hinge joint and a slide joint along itself, heavy and set anew before each step, so that it moves
as prescribed and its vibration is a motion of the box. MuJoCo's contacts are soft: they are as stiff as the step allows
without bouncing (`solref`), with `solimp` 0.1, so that sliding friction does not lift the body. The collision of an
ellipsoid with a box is iterative and needs a tolerance of 1e-13 or less for its normals.
"""

from __future__ import annotations

import math

import mujoco

from palmd.rig.simulate import STEP_S
from tools.studies.engines.scene import EngineRun, EngineScene, RunRows, palm_steps

STEPS = 20
"""Of the engine in each row of a run: 25 µs."""
_THICK_M = 0.02
_SETTINGS = 'cone="elliptic" impratio="100" ccd_tolerance="1e-14" ccd_iterations="200" tolerance="0" iterations="30"'


def model_of(scene: EngineScene, dt: float) -> mujoco.MjModel:
    """The scene's model: world x is X, z is Y."""
    body, ellipse = scene.run.body, scene.ellipse
    half, (a, b), (x, y) = 0.5 * _THICK_M, ellipse.half_axes, ellipse.centre
    inertia = body.mass * body.rho**2
    palms = "".join(
        f"""<body name="palm{number}" gravcomp="1">
          <joint type="hinge" axis="0 -1 0" armature="1e6"/><joint type="slide" axis="1 0 0" armature="1e6"/>
          <inertial pos="0 0 0" mass="1e6" diaginertia="1e6 1e6 1e6"/>
          <geom type="box" size="0.15 0.05 {half}" pos="0.1 0 {side * (height - half)}" friction="{mu} 0 0"
            contype="{number}" conaffinity="0"/>
        </body>"""
        for number, side, height, mu in zip((1, 2), (1.0, -1.0), scene.heights, scene.frictions, strict=True)
    )
    return mujoco.MjModel.from_xml_string(f"""
      <mujoco><option timestep="{dt}" gravity="0 0 -9.81" {_SETTINGS}/>
        <default><geom condim="3" solref="{8 * dt} 3.2" solimp="0.1 0.1 0.001 0.5 2"/></default>
        <worldbody>{palms}<body name="object">
          <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/><joint type="hinge" axis="0 -1 0"/>
          <inertial pos="0 0 0" mass="{body.mass}" diaginertia="{inertia} {inertia} {inertia}"/>
          <geom type="ellipsoid" size="{a} {0.5 * (a + b)} {b}" pos="{x} 0 {y}" friction="0 0 0"
            axisangle="0 -1 0 {math.degrees(ellipse.tilt)}" contype="0" conaffinity="3"/>
        </body></worldbody></mujoco>""")


def simulate(scene: EngineScene, duration_s: float, steps: int = STEPS) -> EngineRun:
    """Runs the scene; see `tools.studies.engines.scene.Engine`."""
    dt, q = STEP_S / steps, scene.start
    model = model_of(scene, dt)
    data = mujoco.MjData(model)
    data.qpos[4:], data.qvel[4:] = (q.x, q.y, q.psi), (q.vx, q.vy, q.omega0)
    rows = RunRows(q)
    for row in range(round(duration_s / STEP_S)):
        for both in palm_steps(scene, row, steps):
            data.qpos[:4] = [each for step in both for each in (step.angle, step.moved)]
            data.qvel[:4] = [each for step in both for each in (step.rate, step.speed)]
            mujoco.mj_step(model, data)
            contacts, forces = data.contact, data.efc_force
            for depth, pair, address in zip(contacts.dist, contacts.geom, contacts.efc_address, strict=True):
                rows.press(int(min(pair)), float(forces[address]) * dt, -float(depth))
        x, y, psi = data.qpos[4:].tolist()
        if not rows.end(x, y, psi, float(data.qvel[6])):
            break
    return rows.simulated(scene.run.body)
