"""Scenes in MuJoCo: the plant of `palmd demo --physics mujoco` (`palmd.rig.mujoco_plant`) on rigid mounts."""

from __future__ import annotations

from palmd.rig.mujoco_plant import MujocoPlant
from palmd.rig.simulate import STEP_S
from tools.studies.engines.scene import EngineRun, EngineScene, RunRows


def simulate(scene: EngineScene, duration_s: float) -> EngineRun:
    """Runs the scene; see `tools.studies.engines.scene.Engine`."""
    run, rows = scene.run, RunRows(scene.start)
    plant = MujocoPlant(run.body, run.hinge, run.surface, run.shaking, imperfections=run.imperfections)
    plant.place(scene.palms_at(0.0), scene.start.psi)
    for row in range(round(duration_s / STEP_S)):
        plant.advance(scene.palms_at((row + 0.5) * STEP_S), scene.palms_at((row + 1) * STEP_S), STEP_S)
        for palm, force in enumerate(plant.step_forces.tolist()):
            if force > 0.0:
                rows.press(palm, force * STEP_S, plant.penetration_m)
        q = plant.state
        if not rows.end(q.x, q.y, q.psi, q.omega0) or plant.fallen:
            break
    return rows.simulated(run.body)
