"""Scenes in Drake: an ellipsoid between two half-spaces, by discrete steps with the TAMSI solver and point contact.

A palm is a heavy half-space on a revolute joint and a prismatic joint along itself; their positions and velocities are
set before each step, so that its vibration is a motion of the half-space. Contacts are as stiff as the step allows.
Drake regularises friction near zero slip, here below 0.1 mm/s. The convex solvers (SAP and others) are unsuitable: they
lift a body in proportion to its slip, on vibrating palms a vibration across them.
"""

from __future__ import annotations

import logging
import math
from typing import Any

import numpy as np
from pydrake.geometry import (
    AddContactMaterial,
    CollisionFilterDeclaration,
    Ellipsoid,
    GeometrySet,
    HalfSpace,
    ProximityProperties,
)
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    CoulombFriction,
    DiscreteContactApproximation,
    MultibodyPlant,
)
from pydrake.multibody.tree import PlanarJoint, PrismaticJoint, RevoluteJoint, SpatialInertia, UnitInertia
from pydrake.systems.framework import Diagram, DiagramBuilder

from palmd.rig.simulate import STEP_S
from palmd.system.mechanism import PALMS
from tools.studies.engines.scene import EngineRun, EngineScene, RunRows, palm_steps

STEPS = 10
"""Engine steps per row of a run: 50 µs each."""
logging.getLogger("drake").setLevel(logging.ERROR)  # it warns of deformable half-spaces, of which there are none
_STIFFNESS_N_M = 1e9  # stiff: implicit steps allow it
_STICTION_M_S = 1e-4
_HEAVY_KG = 1e4
_COORDINATES = 7  # hinge and slide of each palm, then x, y, angle of the body
_PALMS, _BODY, _PALM_RATES, _BODY_RATES = slice(0, 4), slice(4, 7), slice(7, 11), slice(11, 14)


def _material(friction: float) -> ProximityProperties:
    material = ProximityProperties()
    AddContactMaterial(
        dissipation=None,
        point_stiffness=_STIFFNESS_N_M,
        friction=CoulombFriction(friction, friction),
        properties=material,
    )
    return material


def _combined(friction: float) -> float:
    """Friction of a palm, whose friction with the body is 2 μ1 μ2/(μ1 + μ2): the body's own is 1."""
    return friction / (2.0 - friction)


def model_of(scene: EngineScene, dt: float) -> tuple[Diagram, MultibodyPlant, Any]:
    """The scene's diagram, its plant, and the body: world x is X, y is Y, z points out of the plane."""
    builder = DiagramBuilder()
    plant, graph = AddMultibodyPlantSceneGraph(builder, dt)
    plant.SetUseSampledOutputPorts(False)  # contact results are of the present state
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kTamsi)
    plant.mutable_gravity_field().set_gravity_vector([0.0, -9.81, 0.0])
    body, ellipse = scene.run.body, scene.ellipse
    heavy = SpatialInertia(_HEAVY_KG, [0.0, 0.0, 0.0], UnitInertia(1.0, 1.0, 1.0))
    palms, surfaces = plant.AddModelInstance("palms"), GeometrySet()
    plant.set_gravity_enabled(palms, False)
    for number, side, height, mu in zip((1, 2), (1.0, -1.0), scene.heights, scene.frictions, strict=True):
        turning, palm = (plant.AddRigidBody(f"{name}{number}", palms, heavy) for name in ("turning", "palm"))
        plant.AddJoint(RevoluteJoint(f"hinge{number}", plant.world_frame(), turning.body_frame(), [0.0, 0.0, 1.0]))
        plant.AddJoint(PrismaticJoint(f"slide{number}", turning.body_frame(), palm.body_frame(), [1.0, 0.0, 0.0]))
        facing = RigidTransform(RollPitchYaw(-side * 0.5 * math.pi, 0.0, 0.0), [0.0, side * height, 0.0])
        surfaces.Add(
            plant.RegisterCollisionGeometry(palm, facing, HalfSpace(), f"palm{number}", _material(_combined(mu)))
        )
    gyration = body.rho**2
    moving = plant.AddRigidBody(
        "object",
        plant.AddModelInstance("object"),
        SpatialInertia(body.mass, [0.0, 0.0, 0.0], UnitInertia(gyration, gyration, gyration)),
    )
    plant.AddJoint(PlanarJoint("plane", plant.world_frame(), moving.body_frame()))
    (a, b), (x, y) = ellipse.half_axes, ellipse.centre
    at = RigidTransform(RollPitchYaw(0.0, 0.0, ellipse.tilt), [x, y, 0.0])
    plant.RegisterCollisionGeometry(moving, at, Ellipsoid(a, b, 0.5 * (a + b)), "object", _material(1.0))
    graph.collision_filter_manager().Apply(CollisionFilterDeclaration().ExcludeWithin(surfaces))
    plant.Finalize()
    plant.set_stiction_tolerance(_STICTION_M_S)
    return builder.Build(), plant, moving


def simulate(scene: EngineScene, duration_s: float, steps: int = STEPS) -> EngineRun:
    """Runs the scene; see `tools.studies.engines.scene.Engine`."""
    dt, start = STEP_S / steps, scene.start
    diagram, plant, moving = model_of(scene, dt)
    context = plant.GetMyContextFromRoot(diagram.CreateDefaultContext())
    results = plant.get_contact_results_output_port()
    state = np.zeros(2 * _COORDINATES)
    state[_BODY], state[_BODY_RATES] = (start.x, start.y, start.psi), (start.vx, start.vy, start.omega0)
    palms_by_index = {plant.GetBodyByName(f"palm{palm}").index(): palm - 1 for palm in PALMS}
    rows = RunRows(start)
    for row in range(round(duration_s / STEP_S)):
        for both in palm_steps(scene, row, steps):
            state[_PALMS] = [each for step in both for each in (step.angle, step.moved)]
            state[_PALM_RATES] = [each for step in both for each in (step.rate, step.speed)]
            plant.SetPositionsAndVelocities(context, state)
            found = results.Eval(context)
            for info in map(found.point_pair_contact_info, range(found.num_point_pair_contacts())):
                other = info.bodyA_index() if info.bodyB_index() == moving.index() else info.bodyB_index()
                pair = info.point_pair()
                force = abs(float(np.dot(info.contact_force(), pair.nhat_BA_W)))
                rows.press(palms_by_index[other], force * dt, float(pair.depth))
            context.SetDiscreteState(plant.EvalUniquePeriodicDiscreteUpdate(context))
            state[:] = plant.GetPositionsAndVelocities(context)
        x, y, psi = state[_BODY].tolist()
        if not rows.end(x, y, psi, float(state[-1])):
            break
    return rows.simulated(scene.run.body)
