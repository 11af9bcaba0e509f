"""Scenes in Chipmunk (pymunk): impulses with friction between a body of arcs and two conveyor palms.

The body's outline is made of arcs. Each palm touches its own disc, with radius and centre of the arc at the palm's
normal; at the joint of two arcs both discs have the same contact point. A palm is a kinematic segment through the
hinge; its vibration is Chipmunk's surface velocity, which has the same effect on friction as a flat palm's motion along
itself. The steps are short compared with the vibration: friction reverses within one of them.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pymunk

from palmd.events import FloatArray
from palmd.rig.shapes import Body, SupportFunction
from palmd.rig.simulate import STEP_S
from palmd.system.mechanism import PALMS
from tools.studies.engines.scene import EngineRun, EngineScene, RunRows, palm_steps
from tools.studies.sharp_shapes import ArcSupport

STEPS = 12
"""Engine steps per row of a run: 42 µs each."""
_ARCS = 7200
"""With 240 arcs a rocking body turns by 2.4 degrees more or less than with a smooth outline, with these by 0.06."""
_ITERATIONS = 60
_BIAS = 1e-200  # share of a penetration that is left after a second
_PALM_M = (-0.1, 0.2)


def arcs_of(support: SupportFunction) -> ArcSupport:
    """The outline made of `_ARCS` arcs of equal angle; within 2 nm of a smooth one.

    Each has the outline's mean radius of curvature over its normals, corrected so that the outline closes.
    """
    theta: FloatArray = np.arange(_ARCS, dtype=np.float64) * (math.tau / _ARCS)
    fine = 64
    inner: FloatArray = (np.arange(_ARCS * fine, dtype=np.float64) + 0.5) * (math.tau / _ARCS / fine)
    curvature_radius: FloatArray = np.add(support.sample(inner), support.sample(inner, 2))
    v = curvature_radius.reshape(_ARCS, fine).mean(axis=1)
    # an outline of arcs closes where Σ v_j (u(θ_{j+1}) − u(θ_j)) = 0
    step = np.exp(1j * (theta + math.tau / _ARCS)) - np.exp(1j * theta)
    basis = np.array([step.real, step.imag])
    v -= basis.T @ np.linalg.solve(basis @ basis.T, basis @ v)
    h0, slope0 = float(support.sample(theta[:1])[0]), float(support.sample(theta[:1], 1)[0])
    centres, h, slope = [], h0, slope0
    for angle, radius in zip(theta.tolist(), v.tolist(), strict=True):
        c, s = math.cos(angle), math.sin(angle)
        x, y = (h - radius) * c - slope * s, (h - radius) * s + slope * c
        centres.append((x, y))
        after = angle + math.tau / _ARCS
        c, s = math.cos(after), math.sin(after)
        h, slope = x * c + y * s + radius, y * c - x * s
    return ArcSupport(tuple(theta.tolist()), tuple(v.tolist()), tuple(centres))


def _share(gained: pymunk.Vec2d, palm: int, touches: dict[int, tuple[float, float, float]]) -> float:
    """Factor on the engine's impulse of a palm so that both impulses together give the body's change of momentum.

    The engine's impulse is 0.6 % too large on average.
    """
    ix, iy, _ = touches[palm]
    if len(touches) == 1:
        return float((gained.x * ix + gained.y * iy) / max(ix * ix + iy * iy, 1e-30))
    ox, oy, _ = touches[1 - palm]
    across = ix * oy - iy * ox
    return float((gained.x * oy - gained.y * ox) / across) if across else 1.0


def simulate(scene: EngineScene, duration_s: float, steps: int = STEPS) -> EngineRun:
    """Runs the scene; see `tools.studies.engines.scene.Engine`."""
    run, q = scene.run, scene.start
    outline = arcs_of(run.body.support)
    body = Body(run.body.shape, outline, run.body.rho, run.body.mass)
    space = pymunk.Space()
    space.gravity, space.iterations = (0.0, -9.81), _ITERATIONS
    space.collision_slop, space.collision_bias = 0.0, _BIAS
    moving = pymunk.Body(body.mass, body.mass * body.rho**2)
    moving.position = q.x, q.y
    discs = [pymunk.Circle(moving, radius) for radius in (outline.radii[0], outline.radii[0])]
    palms = [pymunk.Body(body_type=pymunk.Body.KINEMATIC) for _ in discs]
    levels = scene.heights[0], -scene.heights[1]
    surfaces = [
        pymunk.Segment(palm, (_PALM_M[0], level), (_PALM_M[1], level), 0.0)
        for palm, level in zip(palms, levels, strict=True)
    ]
    for number, (disc, surface, mu) in enumerate(zip(discs, surfaces, scene.frictions, strict=True)):
        disc.friction, surface.friction = 1.0, mu  # the engine multiplies both
        disc.filter = pymunk.ShapeFilter(categories=1 << number, mask=4 << number)
        surface.filter = pymunk.ShapeFilter(categories=4 << number, mask=1 << number)
        surface.collision_type = number + 1
    space.add(moving, *discs, *palms, *surfaces)
    rows, normals = RunRows(q), [(0.0, 0.0), (0.0, 0.0)]
    touches: dict[int, tuple[float, float, float]] = {}

    def pressed(arbiter: pymunk.Arbiter, space: pymunk.Space, data: Any) -> None:
        del space, data
        palm = max(shape.collision_type for shape in arbiter.shapes) - 1
        (nx, ny), impulse = normals[palm], arbiter.total_impulse
        side = math.copysign(1.0, impulse.x * nx + impulse.y * ny)
        touches[palm] = side * impulse.x, side * impulse.y, -arbiter.contact_point_set.points[0].distance

    for palm in PALMS:
        space.on_collision(palm, 0, post_solve=pressed)
    in_use, width = [-1, -1], math.tau / len(outline.radii)
    for row in range(round(duration_s / STEP_S)):
        for both in palm_steps(scene, row, steps):
            for number, (step, side) in enumerate(zip(both, (1.0, -1.0), strict=True)):
                c, s = math.cos(step.angle), math.sin(step.angle)
                normals[number] = -side * s, side * c
                palms[number].angle, palms[number].angular_velocity = step.angle, step.rate
                surfaces[number].surface_velocity = (c * step.speed, s * step.speed)
                arc = int(((step.angle - side * 0.5 * math.pi - moving.angle) % math.tau) / width)
                if arc != in_use[number]:
                    in_use[number] = arc
                    discs[number].unsafe_set_radius(outline.radii[arc])
                    discs[number].unsafe_set_offset(outline.centres[arc])
            touches.clear()
            before = moving.velocity
            space.step(STEP_S / steps)
            gained = body.mass * (moving.velocity - before - STEP_S / steps * space.gravity)
            for palm, (ix, iy, depth) in touches.items():
                (nx, ny), share = normals[palm], _share(gained, palm, touches)
                rows.press(palm, share * (ix * nx + iy * ny), depth)
        x, y = moving.position
        if not rows.end(x, y, moving.angle, moving.angular_velocity):
            break
    return rows.simulated(body)
