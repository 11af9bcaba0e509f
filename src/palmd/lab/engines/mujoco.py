"""Scenes in MuJoCo: an ellipsoid between two boxes, whose positions and velocities are prescribed.

A palm is a box on a hinge joint and a slide joint along itself, heavy and set anew before each step, so that it moves as
prescribed and its vibration is a motion of the box. MuJoCo's contacts are soft: they are as stiff as the step allows
without bouncing (`solref`), with `solimp` 0.1, so that sliding friction does not lift the body. The collision of an ellipsoid with a box is iterative and needs a tolerance of 1e-13 or less for its normals.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np

from palmd.lab.engines.scene import Scene, Simulated
from palmd.rig.simulate import STEP_S

STEPS = 12
"""Of the engine in each row of a run: 42 µs."""
_THICK_M = 0.02
_SETTINGS = 'cone="elliptic" impratio="100" ccd_tolerance="1e-14" ccd_iterations="200" tolerance="0" iterations="30"'


def model_of(scene: Scene, dt: float) -> mujoco.MjModel:
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


def simulate(scene: Scene, duration_s: float, steps: int = STEPS) -> Simulated:
    """Runs the scene; see `palmd.lab.engines.scene.Engine`."""
    dt, count, q = STEP_S / steps, round(duration_s / STEP_S), scene.start
    model = model_of(scene, dt)
    data = mujoco.MjData(model)
    data.qpos[4:], data.qvel[4:] = (q.x, q.y, q.psi), (q.vx, q.vy, q.omega0)
    rows, forces, deepest = np.empty((count + 1, 6)), np.zeros(2), 0.0
    rows[0] = q.x, q.y, q.psi, q.omega0, math.nan, math.nan
    shakers = scene.run.shaking.palms if scene.run.shaking else ()
    slides = np.zeros(2)
    for k in range(count):
        forces[:], touched = 0.0, False
        motion = scene.palms_at(k * STEP_S)  # in between, accelerations are taken for constant
        (phi1, phi2), (w1, w2), (a1, a2) = motion.angles, motion.rates, motion.accelerations
        turns = ((phi1, w1, a1), (phi1 + phi2, w1 + w2, a1 + a2))
        for j in range(steps):
            late = j * dt
            t = k * STEP_S + late
            for palm, (angle, rate, acceleration) in enumerate(turns):
                data.qpos[2 * palm] = angle + late * (rate + 0.5 * late * acceleration)
                data.qvel[2 * palm] = rate + (late + 0.5 * dt) * acceleration
                if shakers:
                    shaker = shakers[palm]
                    turn = math.tau * shaker.frequency
                    slides[palm] = shaker.speed / turn * math.sin(turn * t + shaker.phase)
                    data.qpos[2 * palm + 1] = slides[palm]
                    data.qvel[2 * palm + 1] = shaker.outward_speed(t + 0.5 * dt)
            mujoco.mj_step(model, data)
            contacts = data.contact
            forces_now, address, pairs = data.efc_force, contacts.efc_address, contacts.geom
            for number, depth in enumerate(contacts.dist):
                forces[min(pairs[number])] += forces_now[address[number]]
                touched = True
                deepest = max(deepest, -float(depth))
        rows[k + 1] = data.qpos[4], data.qpos[5], data.qpos[6], data.qvel[6], *(forces / steps)
        if not touched and k:
            rows = rows[: k + 2]
            break
    rows[0, 4:] = rows[1, 4:]
    return Simulated(scene.run.body, *rows.T, deepest)
