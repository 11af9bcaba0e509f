"""Whether an object stays held, by the rig's truth: when it is wedged, and when that has been noticed."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, cast

import pytest

from palmd.events import PalmMotion
from palmd.harness.wireless import Instant
from palmd.motion.rollout_predictor import MOST_FORCE
from palmd.quantities import ESTIMATE
from palmd.rig.curved_plant import CurvedPlant
from palmd.rig.plant import FrictionSurface, Hinge
from palmd.rig.shapes import cylinder
from palmd.system.arcs import joints_of
from tools.studies.held import NOTICED_S, HeldWatch, wedged

CURVATURES = (14.0, 12.0)
MASS = 0.1


def truth(apart: float, curvatures: tuple[float, float] = CURVATURES, **other: Any) -> dict[str, Any]:
    """Of a cylinder between tangents that far `apart` (rad)."""
    plant = CurvedPlant(cylinder(0.02, MASS), Hinge("arc"), FrictionSurface(), curvatures)
    palms = PalmMotion.at_rest(joints_of(0.02, (math.pi / 2 - apart / 2, apart), curvatures))
    plant.place(palms, 0.4)
    one, two = plant.contacts()
    return {
        "phi1_rad": palms.angles[0], "phi2_rad": palms.angles[1], "omega1_rad_s": 1.0, "omega2_rad_s": 0.0,
        "s1_m": one.s, "s2_m": two.s, "contact1": True, "contact2": True, "f1_n": 1.0, "f2_n": 1.0, **other,
    }  # fmt: skip


@pytest.mark.parametrize("curvatures", [CURVATURES, (0.0, 0.0)])
def test_a_circle_is_wedged_where_its_tangents_are_less_than_both_cones_apart(curvatures: tuple[float, float]) -> None:
    mu = 0.3, 0.3
    both = 2 * math.atan(0.3)
    assert wedged(truth(both - 0.01, curvatures), mu, curvatures)
    assert not wedged(truth(both + 0.01, curvatures), mu, curvatures)
    assert not wedged(truth(both - 0.01, curvatures), (0.3, 0.25), curvatures)


def watched(*ticks: tuple[float, dict[str, Any], bool]) -> HeldWatch:
    watch = HeldWatch(MASS, (0.3, 0.3), CURVATURES)
    for t, told, valid in ticks:
        watch.take(cast(Instant, SimpleNamespace(t=t, truth=told, messages={ESTIMATE.name: {"valid": valid}})))
    return watch


def test_what_is_held_is_no_mishap() -> None:
    watch = watched((0.0, truth(1.5), True), (1.0, truth(1.5), True))
    assert (watch.wedged, watch.pressed, watch.unnoticed) == (0, 0, 0)
    assert watch.most_force == pytest.approx(1.0 / MASS)


def test_the_force_is_one_for_each_kilogram() -> None:
    just, more = (MASS * MOST_FORCE * share for share in (0.99, 1.01))
    assert watched((0.0, truth(1.5, f2_n=just), True)).pressed == 0
    assert watched((0.0, truth(1.5, f2_n=more), True)).pressed == 1


LATE = NOTICED_S + 0.1


def test_a_mishap_is_noticed_once_the_palms_stand_or_nothing_is_claimed() -> None:
    caught, still = truth(0.3), truth(0.3, omega1_rad_s=0.0)
    lifted = truth(1.5, contact2=False)
    assert watched((0.0, caught, True), (0.5, caught, True), (LATE, caught, True)).unnoticed == 1
    assert watched((0.0, caught, True), (0.5, still, True), (LATE, caught, True)).unnoticed == 0
    assert watched((0.0, lifted, True), (0.5, lifted, False), (LATE, lifted, True)).unnoticed == 0
    assert watched((0.0, caught, True), (0.5, truth(1.5), True), (LATE, truth(1.5), True)).unnoticed == 1


def test_each_mishap_is_judged_once() -> None:
    caught, fine = truth(0.3), truth(1.5)
    again = [(t, caught, True) for t in (0.0, LATE, 2 * LATE)] + [(3 * LATE, fine, True)]
    assert watched(*again).unnoticed == 1
    assert watched(*again, (4 * LATE, caught, True), (6 * LATE, caught, True)).unnoticed == 2
    assert watched(*again).wedged == 3
