"""Friction ripple of a body's own slip: the model against the emulated plant, which resolves the vibration in time."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest

from palmd.events import PalmMotion
from palmd.model.contact import Contact
from palmd.model.dynamics import BodyConstants, Palms, newton_euler
from palmd.model.friction import rippled_directions
from palmd.rig.plant import AS_ASSUMED, FrictionSurface, Hinge
from palmd.rig.shaker import Shaker, Shaking
from palmd.rig.shapes import Body, ellipse
from palmd.rig.vibrating_plant import VibratingPlant
from palmd.system.mechanism import normal_directions

BODY = Body(
    "ellipse", ellipse(0.022, 0.017).moved(0.6e-3, -0.4e-3), math.sqrt((22e-3**2 + 17e-3**2) / 4 + 0.52e-6), 0.1
)
MU, SPEED, FREQUENCY_HZ = 0.2, 0.015, 250.0
KAPPA = {"independent": 0.0, "in_phase": -1.0, "antiphase": 1.0}
APART_HZ = {"independent": 13.0, "in_phase": 0.0, "antiphase": 0.0}
PHASE = {"independent": 1.0, "in_phase": 0.0, "antiphase": math.pi}  # phase of palm 2 minus that of palm 1
STEP_S, STEPS, APART = 5e-4, 8000, 5
OVER = 20  # steps on either side of a mean
SETTLED = 400  # steps after any start
WINDOW = 100  # number of instants, 0.25 s


def exploring(t: float) -> PalmMotion:
    """Both palms rock slowly, by 2° at most, so that slip stays well below the vibration's speed."""
    one, two = 2.2 * t + 0.3, 1.5 * t + 1.1
    return PalmMotion(
        (0.75 + 0.038 * math.sin(one), 1.65 + 0.03 * math.sin(two)),
        (0.0836 * math.cos(one), 0.045 * math.cos(two)),
        (-0.18392 * math.sin(one), -0.0675 * math.sin(two)),
    )


def spin_rate(half_period: float, kappa: float, steps: int = 2) -> ca.Function:
    """Spin acceleration α0 as a function of φ1 … α2, ω0, and r, d, v of both contacts."""
    palms, omega0, contacts = ca.SX.sym("palms", 6), ca.SX.sym("omega0"), ca.SX.sym("contacts", 6)
    one, two = (Contact(*(contacts[i] for i in rows)) for rows in (range(3), range(3, 6)))
    body = BodyConstants(*(ca.SX(each) for each in (BODY.rho, MU, math.pi / 2 * SPEED, 0.0)))
    rig = ca.SX([9.81, 0, 0, 0, 0, 0, 0, kappa, 1, 0, half_period, 0, 0, 0, 0])
    motion = newton_euler(Palms(*ca.vertsplit(palms)), omega0, one, two, body, rig, steps)
    return ca.Function("spin_rate", [ca.vertcat(palms, omega0, contacts)], [motion.alpha0])


def instant(palms: PalmMotion, psi: float, omega0: float) -> list[float]:
    outline = [BODY.support.at(theta) for theta in normal_directions(palms.angles, psi)]
    contacts = [value for h, slope, bend in outline for value in (h, -slope, h + bend)]
    return [*palms.angles, *palms.rates, *palms.accelerations, omega0, *contacts]


def resolved(relation: str) -> tuple[np.ndarray, np.ndarray]:
    """Instants of a motion with resolved vibration, a column each `APART` steps, and the spin there (rad/s).

    Both are means over the vibration.
    """
    shakers = Shaker(FREQUENCY_HZ, SPEED), Shaker(FREQUENCY_HZ + APART_HZ[relation], SPEED, PHASE[relation])
    hinge, surface, shaking = Hinge("fixed", base=(0.0, 0.0)), FrictionSurface(MU), Shaking(relation, shakers)  # type: ignore[arg-type]
    plant = VibratingPlant(BODY, hinge, surface, shaking, options=AS_ASSUMED)
    plant.place(exploring(0.0), 0.9)
    moving = []
    for k in range(STEPS):
        moving.append((plant.state.psi, plant.state.omega0))
        plant.advance(exploring((k + 0.5) * STEP_S), exploring((k + 1) * STEP_S), STEP_S)
    assert all(plant.touching)
    window = np.hanning(2 * OVER + 1)
    psi, omega0 = (np.convolve(each, window / window.sum(), "valid") for each in np.array(moving).T)
    at = range(SETTLED, len(psi), APART)
    instants = [instant(exploring((k + OVER) * STEP_S), psi[k], omega0[k]) for k in at]
    return np.array(instants).T, omega0[SETTLED::APART]


@pytest.mark.parametrize(("relation", "share"), [("independent", 0.95), ("in_phase", 0.8), ("antiphase", 0.5)])
def test_the_ripple_model_predicts_the_spin_on_vibrating_palms_better(relation: str, share: float) -> None:
    instants, omega0 = resolved(relation)
    errors = []
    for half_period in (0.5 / FREQUENCY_HZ, 0.0):
        alpha0 = np.asarray(spin_rate(half_period, KAPPA[relation])(instants))[0]
        gained = np.cumsum(alpha0[1:] + alpha0[:-1]) * 0.5 * APART * STEP_S
        drift = omega0[1:] - omega0[0] - gained
        errors.append(float(np.sqrt(np.mean((drift[WINDOW:] - drift[:-WINDOW]) ** 2))))
    assert errors[0] < share * errors[1]


def one_contact(slips: np.ndarray, drives: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean slip and mean direction of contacts whose slip is driven by their own sign, resolved over 160 periods.

    Slips in units of the vibration's speed. A feedback slower than the vibration keeps the mean slip near `slips`.
    """
    steps, slow, width = 1500, 20.0, 6e-4
    ripple, slow_mean, sums = np.zeros(len(slips)), 0.6 * np.clip(slips, -1.0, 1.0), np.zeros((2, len(slips)))
    for k in range(160 * steps):
        slip = slips + math.cos(math.tau * k / steps) + ripple
        direction = np.clip(slip / width, -1.0, 1.0)
        slow_mean = slow_mean + (direction - slow_mean) / slow / steps
        ripple = ripple - (drives * (direction - slow_mean) + ripple / slow) / steps
        if k >= 140 * steps:
            sums += slip, direction
    mean_slip, mean_direction = sums / (20 * steps)
    return mean_slip, mean_direction


def test_a_contact_that_sticks_at_its_reversals_has_the_mean_direction_of_the_resolved_one() -> None:
    """Without sticking the error at a drive of 4 is 0.2 in slow slip."""
    slips, drives = (
        each.ravel() for each in np.meshgrid(np.linspace(0.1, 0.9, 5), [0.5, 1.0, 2.0, 3.0, 3.6, 4.0, 5.0])
    )
    slips, resolved_directions = one_contact(slips, drives)
    slip, drive = ca.SX.sym("slip"), ca.SX.sym("drive")
    none = ca.SX(0)
    (direction, _), _ = rippled_directions([slip, none], ca.SX(1), lambda _: [[-drive, none], [none, none]], none, 4)
    law = np.asarray(ca.Function("law", [slip, drive], [direction])(slips[None], drives[None]))[0]
    assert np.abs(law - resolved_directions).max() < 0.02
    assert np.sqrt(np.mean((law - resolved_directions) ** 2)) < 0.006
