"""The ripple of a body's own slip: the model against the emulated plant that averages over signs of slip likewise."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest

from palmd.events import PalmMotion
from palmd.model import friction
from palmd.model.contact import Contact
from palmd.model.dynamics import BodyConstants, Palms, newton_euler
from palmd.rig.plant import FrictionSurface, Hinge
from palmd.rig.shaker import Shaker, Shaking
from palmd.rig.shapes import Body, ellipse
from palmd.rig.sign_pairs import SignPairsPlant
from palmd.system.mechanism import normal_directions

BODY = Body(
    "ellipse", ellipse(0.022, 0.017).moved(0.6e-3, -0.4e-3), math.sqrt((22e-3**2 + 17e-3**2) / 4 + 0.52e-6), 0.1
)
MU, SPEED, FREQUENCY_HZ = 0.2, 0.015, 250.0
KAPPA = {"independent": 0.0, "in_phase": -1.0, "antiphase": 1.0}
STEP_S, STEPS, APART = 4e-4, 5000, 25
SETTLED = 500  # steps from any start


def exploring(t: float) -> PalmMotion:
    """Both palms rock slowly, by 2° and less: slips stay well below the vibration's speed."""
    one, two = 2.2 * t + 0.3, 1.5 * t + 1.1
    return PalmMotion(
        (0.75 + 0.038 * math.sin(one), 1.65 + 0.03 * math.sin(two)),
        (0.0836 * math.cos(one), 0.045 * math.cos(two)),
        (-0.18392 * math.sin(one), -0.0675 * math.sin(two)),
    )


def spin_rate(half_period: float, kappa: float) -> ca.Function:
    """α0 of palms φ1 … α2, ω0, and r, d, v of both contacts."""
    palms, omega0, contacts = ca.SX.sym("palms", 6), ca.SX.sym("omega0"), ca.SX.sym("contacts", 6)
    one, two = (Contact(*(contacts[i] for i in rows)) for rows in (range(3), range(3, 6)))
    body = BodyConstants(*(ca.SX(each) for each in (BODY.rho, MU, math.pi / 2 * SPEED, 0.0)))
    rig = ca.SX([9.81, 0, 0, 0, 0, 0, 0, kappa, 1, 0, half_period, 0, 0])
    motion = newton_euler(Palms(*ca.vertsplit(palms)), omega0, one, two, body, rig)
    return ca.Function("spin_rate", [ca.vertcat(palms, omega0, contacts)], [motion.alpha0])


def instant(palms: PalmMotion, psi: float, omega0: float) -> list[float]:
    outline = [BODY.support.at(theta) for theta in normal_directions(palms.angles, psi)]
    contacts = [value for h, slope, bend in outline for value in (h, -slope, h + bend)]
    return [*palms.angles, *palms.rates, *palms.accelerations, omega0, *contacts]


def emulated(relation: str) -> tuple[np.ndarray, np.ndarray]:
    """Instants of the plant's motion, a column each, and how its spin really changes there (rad/s²)."""
    shaking = Shaking(relation, (Shaker(FREQUENCY_HZ, SPEED),) * 2)  # type: ignore[arg-type]
    plant = SignPairsPlant(BODY, Hinge("fixed", base=(0.0, 0.0)), FrictionSurface(MU), shaking)
    plant.place(exploring(0.0), 0.9)
    instants, spins = [], []
    for k in range(STEPS):
        instants.append(instant(exploring(k * STEP_S), plant.state.psi, plant.state.omega0))
        spins.append(plant.state.omega0)
        plant.advance(exploring((k + 0.5) * STEP_S), exploring((k + 1) * STEP_S), STEP_S)
    assert all(plant.touching)
    at = slice(SETTLED, STEPS - 1, APART)
    return np.array(instants)[at].T, np.gradient(spins, STEP_S)[at]


@pytest.mark.parametrize("relation", KAPPA)
def test_a_body_on_vibrating_palms_turns_as_its_own_ripple_lets_it(
    relation: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The kink sharp as the plant's, since its rounding counts as much as the ripple in phase."""
    monkeypatch.setattr(friction, "mean_direction", lambda x: 2 / math.pi * ca.asin(ca.fmin(ca.fmax(x, -1), 1)))
    instants, alpha0 = emulated(relation)
    with_ripple, without = (
        float(np.median(np.abs(np.asarray(spin_rate(half_period, KAPPA[relation])(instants))[0] - alpha0)))
        for half_period in (0.5 / FREQUENCY_HZ, 0.0)
    )
    assert with_ripple < 2e-3
    assert without > 10 * with_ripple
