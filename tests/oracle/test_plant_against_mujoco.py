"""The emulated body with flat sides against MuJoCo: resting pose, contact forces, onset of slip.

MuJoCo's contacts are soft and its friction creeps; the plant's contacts are rigid, and sticking bodies stand still.
They are compared where both must agree: at rest, and over distances much longer than the soft contacts' depth.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest

from palmd.events import PalmMotion
from palmd.rig.friction import plant_on
from palmd.rig.plant import FrictionSurface, Hinge, PlantOptions
from tools.studies.sharp_shapes import rounded_polygon, uniform_body

mujoco = pytest.importorskip("mujoco")

GRAVITY, MASS, RADIUS, STEP_S, ENGINE_STEP_S = 9.81, 0.1, 5e-4, 5e-4, 1e-4
FIXED = Hinge("fixed", 0.12, (0.0, 0.0))
DIE, BLOCK = (16e-3, 16e-3), (10e-3, 30e-3)
DAMPING, MU = 1e-2, 0.2
RINGING = 1000  # steps over which forces of the soft contacts are averaged


class Pose(NamedTuple):
    """Pose of the centre of mass (m) and the body (rad), with the normal forces of both palms (N)."""

    x: float
    y: float
    psi: float
    forces: tuple[float, float]


def rectangle(size):
    x, y = size[0] / 2 - RADIUS, size[1] / 2 - RADIUS
    ring = [(x, -y), (x, y), (-x, y), (-x, -y)]
    return ring, uniform_body("rectangle", rounded_polygon(ring, RADIUS), MASS)


def placed(size, palms, psi, surface, law="averaged"):
    plant = plant_on(rectangle(size)[1], FIXED, surface, options=PlantOptions(friction_law=law))
    plant.place(PalmMotion.at_rest(palms), psi)
    return plant


def pose_of(plant):
    q, (one, two) = plant.state, plant.contacts()
    return Pose(q.x, q.y, q.psi, (one.force, two.force))


def left_alone(plant, palms, seconds):
    still = PalmMotion.at_rest(palms)
    for _ in range(round(seconds / STEP_S)):
        plant.advance(still, still, STEP_S)
    return pose_of(plant)


def by_engine(size, palms, start, seconds, mu=0.0, damping=0.0):
    """The same rectangle, four capsules joined at their ends, between two planes: x is X, z is Y."""
    ring, body = rectangle(size)
    phi1, phi12 = palms[0], palms[0] + palms[1]
    normals = [(-math.sin(phi1), math.cos(phi1)), (math.sin(phi12), -math.cos(phi12))]
    planes = "".join(f'<geom type="plane" size="1 1 1" zaxis="{x} 0 {y}" friction="{mu} 0 0"/>' for x, y in normals)
    edges = "".join(
        f'<geom type="capsule" size="{RADIUS}" fromto="{a} 0 {b} {c} 0 {d}" friction="{mu} 0 0" mass="0"/>'
        for (a, b), (c, d) in zip(ring, ring[1:] + ring[:1], strict=True)
    )
    inertia = MASS * body.rho**2
    model = mujoco.MjModel.from_xml_string(f"""
      <mujoco><option timestep="{ENGINE_STEP_S}" gravity="0 0 {-GRAVITY}" cone="elliptic" impratio="100"/>
        <default><geom condim="3" solref="0.001 1" solimp="0.99 0.999 1e-5"/></default>
        <worldbody>{planes}<body>
          <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>
          <joint type="hinge" axis="0 -1 0" damping="{MASS * damping}"/>
          <inertial pos="0 0 0" mass="{MASS}" diaginertia="{inertia} {inertia} {inertia}"/>{edges}
        </body></worldbody></mujoco>""")
    data = mujoco.MjData(model)
    data.qpos[:] = start[:3]
    steps, forces, each = round(seconds / ENGINE_STEP_S), np.zeros(2), np.zeros(6)
    for step in range(steps):
        mujoco.mj_step(model, data)
        if step < steps - RINGING:
            continue
        for number, contact in enumerate(data.contact):
            mujoco.mj_contactForce(model, data, number, each)
            forces[min(contact.geom1, contact.geom2)] += each[0] / RINGING
    return Pose(*data.qpos.tolist(), tuple(forces.tolist()))


@pytest.mark.parametrize(
    ("size", "palms", "psi"),
    [(DIE, (0.7, 1.4), 0.2), (DIE, (0.9, 1.3), 1.0), (BLOCK, (0.7, 1.4), 1.0), (BLOCK, (0.9, 1.3), 1.3)],
)
def test_a_rectangle_tips_onto_the_same_side_with_the_same_forces(size, palms, psi):
    plant = placed(size, palms, psi, FrictionSurface(damping=DAMPING))
    there = by_engine(size, palms, pose_of(plant), 1.0, damping=DAMPING)
    here = left_alone(plant, palms, 1.0)
    assert here[:2] == pytest.approx(there[:2], abs=1e-4)
    assert here.psi == pytest.approx(there.psi, abs=3e-3)  # a side is passed within 2 mrad
    assert here.forces == pytest.approx(there.forces, rel=0.02)


@pytest.mark.parametrize("below_deg", [-3.0, 3.0, 6.0])
def test_a_die_slips_down_a_palm_steeper_than_its_friction_angle(below_deg):
    palms, seconds = (-math.atan(MU) - math.radians(below_deg), 2.0), 0.12
    plant = placed(DIE, palms, palms[0], FrictionSurface(MU), law="coulomb")
    begin = pose_of(plant)
    there, here = by_engine(DIE, palms, begin, seconds, MU), left_alone(plant, palms, seconds)
    ways = [math.hypot(end.x - begin.x, end.y - begin.y) for end in (here, there)]
    assert ways[0] == pytest.approx(ways[1], abs=2e-4)
    assert (ways[0] > 1e-3) is (below_deg > 0.0)
