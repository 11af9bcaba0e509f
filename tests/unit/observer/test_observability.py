"""Observability: a number that falls when nothing can be estimated and recovers with motion."""

from __future__ import annotations

import math

import numpy as np
import pytest
from campaign import nightly
from simulated import simulated, watched

from palmd import observer
from palmd.config.two_palms import PlanSpec
from palmd.events import PalmMotion
from palmd.model import sensitivity, shape, shape_map
from palmd.model.outputs import rig_inputs
from palmd.observer.observability import Observability, scaled_singular_value
from palmd.observer.prior import FRICTION_SD, blind_start, shape_map_sd
from palmd.rig.plant import FrictionSurface, Hinge, Plant, stable_poses
from palmd.rig.shapes import random_body
from palmd.rig.world import default_config
from palmd.system.description import RigDescription
from palmd.system.vibration import AVERAGED
from tools.closed_loop import TwoPalmsLoop

SINE = {"phi1_deg": 25, "phi2_deg": 10}
STEP_S = 5e-4
FIXED, VARIANCE = RigDescription(hinge="fixed"), 1.2e-8


def test_it_is_the_least_ratio_of_prior_to_posterior_sd() -> None:
    """Two independent quantities with prior sd 2 and 3, known to 0.5 and 0.1: the first has the smaller ratio, 4."""
    information = np.diag([1 / 0.5**2, 1 / 0.1**2, 0.0])
    assert scaled_singular_value(information, np.eye(3)[:2], np.array([2.0, 3.0, 1.0])) == pytest.approx(4.0)
    # the same in other units, and for sum and difference
    turned = np.array([[1e3, 1e3, 0.0], [1.0, -1.0, 0.0]])
    assert scaled_singular_value(information, turned, np.array([2.0, 3.0, 1.0])) == pytest.approx(4.0)


def test_a_correlated_nuisance_parameter_reduces_it() -> None:
    row = np.array([[1.0, 1.0]])
    both = scaled_singular_value(1e8 * row.T @ row, np.eye(2)[:1], np.array([1.0, 1.0]))
    assert both == pytest.approx(1.0, rel=1e-3), "half of the prior variance is left"
    alone = scaled_singular_value(1e8 * row.T @ row, np.eye(2)[:1], np.array([1.0, 0.0]))
    assert alone == pytest.approx(1e4, rel=1e-3)


def test_no_information_gives_zero_and_nan_input_gives_nan() -> None:
    assert scaled_singular_value(np.zeros((3, 3)), np.eye(3)[:2], np.ones(3)) == 0.0
    assert math.isnan(scaled_singular_value(np.zeros((3, 3)), np.full((2, 3), math.nan), np.ones(3)))


@pytest.mark.nightly
@pytest.mark.parametrize(("observer_name", "seed", "kind"), [("shape", 3, "rig"), ("extended", 3, "nominal")])
def test_it_falls_at_rest_and_recovers_with_motion(observer_name, seed, kind) -> None:
    segments = [{"sine": SINE, "frequency_hz": [0.41, 0.57], "duration_s": d} for d in (5.0, 20.0)]
    plan = PlanSpec.model_validate({"name": "p", "segments": [segments[0], {"hold_s": 3.0}, segments[1]]})
    run = TwoPalmsLoop(default_config(), plan, seed, kind=kind, observer_name=observer_name)
    run.start()
    t0 = run.t
    seen = [(i.t - t0, i.messages["palm/estimate"]["observability"]) for i in run.run(11.0)]
    moving, still, again = (
        np.median([value for t, value in seen if low < t < high]) for low, high in ((2.0, 5.0), (6.5, 8.0), (9.5, 11.0))
    )
    assert moving > 1.5
    assert again > 1.0
    assert still < 0.4
    assert still < min(moving, again) / 5


def _palms(t: float) -> PalmMotion:
    """Both palms tilt together: φ2 is constant."""
    k, amplitude = math.pi, 0.2 * min(t, 1.0) ** 2
    sin, cos = amplitude * math.sin(k * t), amplitude * math.cos(k * t)
    return PalmMotion((0.75 + sin, 1.6), (k * cos, 0.0), (-(k**2) * sin, 0.0))


def _along(mu: float, seed: int) -> tuple[float, float]:
    """Median of the number along a plant's true trajectory, and the r.m.s. of θ̇1 (rad/s)."""
    body, surface = random_body("nominal", np.random.default_rng(seed)), FrictionSurface(mu, 2e-3, 2e-4)
    hinge = Hinge("fixed", base=(0.0, 0.0))
    body = body.turned(stable_poses(body, _palms(0.0))[0])
    plant = Plant(body, hinge, surface)
    plant.place(_palms(0.0), psi=0.0)
    theta = np.arange(360) * math.tau / 360
    Z = shape_map.Z
    x = np.zeros(shape_map.N)
    x[Z.SHAPE :] = np.linalg.lstsq(shape.basis(theta), body.support.sample(theta), rcond=None)[0]
    x[Z.LN_RHO], x[Z.MU], x[Z.LN_DITHER], x[Z.DAMPING] = math.log(body.rho), mu, math.log(2e-3), 2e-4
    rig = RigDescription(hinge="fixed", vibration=AVERAGED)  # as in the plant: on weakly vibrating palms it would stick
    fixed_lag = Observability(rig_inputs(rig), np.full(2, 1.2e-8))
    one, two = plant.contacts()
    start = blind_start((one.s, two.s), _palms(0.0), 8, True, np.random.default_rng(0))
    fixed_lag.begin(0.0, shape_map_sd(start))
    values, slips = [], []
    for k in range(8000):
        t = k * STEP_S
        palms = _palms(t)
        if k % 20 == 0:
            x[Z.PSI], x[Z.OMEGA0] = plant.state.psi, plant.state.omega0
            if fixed_lag.due(t):
                at = np.array([*palms.angles, *palms.rates, *palms.accelerations])
                fixed_lag.sample(t, x, at, np.zeros(2))
            fixed_lag.count(1)
            fixed_lag.count(2)
            values.append(fixed_lag.value())
            slips.append(palms.rates[0] - plant.state.omega0)
        plant.advance(_palms(t + STEP_S / 2), _palms(t + STEP_S), STEP_S)
    assert all(plant.touching)
    return float(np.median(values[200:])), float(np.sqrt(np.mean(np.square(slips[100:]))))


@pytest.mark.parametrize("seed", [1, *nightly(3)])
def test_it_falls_when_the_object_turns_along_with_the_palms(seed: int) -> None:
    sliding, stuck = _along(0.02, seed), _along(0.6, seed)
    assert stuck[1] < 0.03, "friction must carry the object along"
    assert stuck[0] < 0.35
    assert sliding[0] > 2.5 * stuck[0]


def started() -> tuple[Observability, np.ndarray, np.ndarray]:
    """Observability from t = 0 on, the prior 1σ of the states, and a state."""
    fixed_lag = Observability(rig_inputs(FIXED), np.full(2, VARIANCE))
    start = blind_start((0.02, 0.02), PalmMotion.at_rest((0.8, 1.6)), 8, True, np.random.default_rng(0))
    fixed_lag.begin(0.0, shape_map_sd(start))
    x = np.zeros(shape_map.N)
    x[shape_map.Z.LN_RHO], x[shape_map.Z.LN_DITHER], x[shape_map.Z.SHAPE] = math.log(0.014), math.log(0.01), 0.02
    return fixed_lag, shape_map_sd(start), x


def test_silent_pads_give_zero() -> None:
    fixed_lag, prior_sd, x = started()
    assert prior_sd[shape_map.Z.MU] == FRICTION_SD
    for k in range(60):
        fixed_lag.sample(k * 0.02, x, np.array([0.8, 1.6, 0.3, 0.2, 0.0, 0.0]), np.zeros(2))
    assert fixed_lag.value() == pytest.approx(0.0, abs=1e-6)


def test_chained_blocks_equal_one_long_block() -> None:
    """Ten short blocks against one long block of the same second."""
    fixed_lag, prior_sd, x = started()
    Z, kernels = shape_map.Z, {"aim": sensitivity.aim_function(), "gather": sensitivity.gather_function()}
    x[Z.SHAPE + 3] = 1e-3
    T, G, aim = np.eye(2, shape_map.N), np.zeros((shape_map.N,) * 2), None
    dt = 0.025
    for k in range(41):
        t = k * dt
        x[Z.PSI], x[Z.OMEGA0] = 0.3 * math.sin(3 * t), 0.9 * math.cos(3 * t)
        palms = np.array([0.8 + 0.2 * math.sin(2 * t), 1.6, 0.4 * math.cos(2 * t), 0.0, -0.8 * math.sin(2 * t), 0.0])
        fixed_lag.sample(t, x, palms, np.zeros(2))
        fixed_lag.count(1)
        fixed_lag.count(2)
        if k == 0:
            aim = np.array(kernels["aim"](x, [*palms[:2], 0.0, 0.0]))
        if k < 40:
            inputs = [dt, *palms, 0.0, 0.0, *rig_inputs(FIXED), 1 / VARIANCE, 1 / VARIANCE]
            T, G = (np.array(value) for value in kernels["gather"](x, T, G, inputs))
    assert fixed_lag.value() == pytest.approx(scaled_singular_value(G, aim, prior_sd), rel=1e-6)


def test_a_gap_between_samples_ends_the_window() -> None:
    """Across a gap the trajectory is unknown: only later samples count, and the last number holds meanwhile."""
    fixed_lag, _, x = started()
    x[shape_map.Z.SHAPE + 3] = 1e-3

    def run(t0: float, seconds: float) -> float:
        for k in range(round(seconds / 0.02)):
            t = t0 + k * 0.02
            x[shape_map.Z.PSI] = 0.4 * t
            fixed_lag.count(1)
            fixed_lag.count(2)
            fixed_lag.sample(t, x, np.array([0.8 + 0.1 * t, 1.6, 0.1, 0.0, 0.0, 0.0]), np.zeros(2))
        return fixed_lag.value()

    full = run(0.0, 1.5)
    assert full > 0.0
    assert run(2.0, 0.06) == full
    assert run(2.06, 0.1) < full / 2


@pytest.mark.parametrize("name", ["shape", "extended"])
def test_it_is_finite_in_every_valid_tick_after_the_first_second_and_nan_before(name: str) -> None:
    run = simulated("nominal", 107, 4.0)
    seen = list(watched(observer.make(name, run.rig), run.events))
    assert all(math.isnan(e.observability) for e in seen if e.t < 1.0)
    assert all(math.isfinite(e.observability) for e in seen if e.t > 1.13)
    assert any(e.valid for e in seen if e.t > 1.13)
