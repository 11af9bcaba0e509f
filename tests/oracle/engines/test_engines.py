"""Independent physics engines as references for the emulated rig and the blind estimators."""

from __future__ import annotations

import math

import numpy as np
import pytest
from campaign import nightly

from palmd.record.eventlog import read_log
from palmd.rig.plant import AS_ASSUMED
from palmd.rig.simulate import STEP_S
from tools.studies.engines import study
from tools.studies.engines.scene import ENGINE_KINDS, draw_scene, engine_log
from tools.studies.simulated import written

SECONDS = 0.3
MOST_M = 2e-6


@pytest.fixture(params=study.PACKAGES)
def engine(request):
    pytest.importorskip(study.PACKAGES[request.param], reason="of the extra `engines`")
    return study.engine_called(request.param)


def resolved(scene, seconds):
    """The emulated rig's own plant on the same scene."""
    run = scene.run
    plant = run.plant(AS_ASSUMED)
    plant.place(run.palms_at(0.0), 0.0)
    psi = []
    for k in range(round(seconds / STEP_S)):
        psi.append(plant.state.psi)
        plant.advance(run.palms_at((k + 0.5) * STEP_S), run.palms_at((k + 1) * STEP_S), STEP_S)
    return np.array(psi)


@pytest.mark.parametrize(("kind", "seed"), [("vibrating", 1), *nightly(("antiphase", 1))])
def test_the_engine_and_the_emulated_rig_rotate_the_body_alike(engine, kind, seed):
    scene = draw_scene(kind, seed)
    there, here = engine(scene, SECONDS), resolved(scene, SECONDS)
    assert there.penetration < MOST_M
    assert len(there.x) == round(SECONDS / STEP_S) + 1
    error = np.degrees(there.psi[: len(here)] - here)
    assert math.sqrt(np.mean(error**2)) < 0.12
    assert np.ptp(np.degrees(here)) > 0.5


@pytest.mark.nightly
def test_a_body_of_arcs_rotates_as_a_smooth_one():
    """Without friction engine and plant have the same equations; only the outline's curvature steps differ."""
    pytest.importorskip("pymunk")
    scene, seconds = draw_scene("slick", 8101), 3.0
    there, here = study.engine_called("chipmunk")(scene, seconds), resolved(scene, seconds)
    error = np.degrees(there.psi[: len(here)] - here)
    assert np.ptp(np.degrees(here)) > 100.0
    assert math.sqrt(np.mean(error**2)) < 5e-3


@pytest.mark.nightly
def test_a_frictionless_log_of_an_engine_is_reconstructed_correctly():
    pytest.importorskip("pymunk")
    row = study.run(study.EngineTask("chipmunk", "slick", "none", 0, 5.0))
    assert row.right
    assert row.penetration_m < MOST_M


@pytest.mark.parametrize("kind", ENGINE_KINDS)
def test_a_log_states_how_the_palms_vibrate(kind):
    pytest.importorskip("pymunk")
    lines, truth = engine_log(study.engine_called("chipmunk"), kind, 3, 0.02, "calibrated")
    with written(lines) as path:
        log = read_log(path)
    assert log.rig.vibration.relation == {"vibrating": "independent", "slick": "independent", "dry": "none"}.get(
        kind, kind
    )
    assert log.rig.vibration.law == "sign_pairs"
    assert ("vibration_m_s" in truth) is (kind != "dry")
    assert (truth["mu"] == 0.0) is (kind == "slick")
