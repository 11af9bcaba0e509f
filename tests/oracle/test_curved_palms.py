"""The kernels for curved palms against the emulated plant, which uses other equations, and against flat palms as κ → 0.

Independently vibrating palms are emulated by the averaging plant at a frequency without ripple, with the kernels'
rounded kink.
"""

from __future__ import annotations

import math
from functools import cache

import casadi as ca
import numpy as np
import pytest
from derived import derived
from plain_friction import rippled_directions

from palmd.events import PalmMotion
from palmd.model import arcs, rollout, sensitivity, shape, shape_map, smoothing
from palmd.model.outputs import NAMED, RIG_INPUTS, rig_inputs
from palmd.model.shape_map import Z
from palmd.model.symbolic import SX
from palmd.observer.object_memory import DIRECTIONS, readings_on_arcs
from palmd.rig import sign_pairs
from palmd.rig.curved_plant import CurvedPlant, max_curvature_radius
from palmd.rig.friction import plant_on
from palmd.rig.imperfections import PERFECT, Imperfections, PadImperfection
from palmd.rig.plant import FrictionSurface, Hinge, PadPair, Plant, PlantOptions
from palmd.rig.shaker import Shaker, Shaking
from palmd.rig.shapes import Body, random_body
from palmd.system.arcs import circle_radius, joints_of, palm_points
from palmd.system.description import PadSensor, RigDescription
from palmd.system.rig_constants import RIG_NAMES
from palmd.system.vibration import AVERAGED, INDEPENDENT, Vibration

CURVATURES = [(14.0, 11.5), (-9.0, -14.0), (15.0, 0.0), (-8.0, 12.0), (0.0, -10.0)]
LENGTH = 0.0555
FAST_HZ = 1e7  # too fast for a body to follow
VIBRATIONS = {"averaged": AVERAGED, "independent": Vibration(frequency=FAST_HZ)}


def _rig(curvatures: tuple[float, float], hinge: str = "arc", vibration: Vibration = INDEPENDENT) -> RigDescription:
    pads = tuple(PadSensor(curvature=kappa) for kappa in curvatures)
    return RigDescription(hinge=hinge, pads=pads, vibration=vibration)  # type: ignore[arg-type]


@pytest.fixture(params=VIBRATIONS)
def vibration(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Vibration:
    def forward_share(slip: float, speed: float, _: object = ()) -> float:
        means, _ = rippled_directions(np.full(2, slip), np.float64(speed), lambda _: np.zeros((2, 2)), 0.0)
        return float(1 + means[0]) / 2

    monkeypatch.setattr(sign_pairs, "forward_share", forward_share)
    return VIBRATIONS[request.param]


def _plant(
    body: Body,
    surface: FrictionSurface,
    curvatures: PadPair,
    vibration: Vibration,
    imperfections: Imperfections = PERFECT,
) -> Plant:
    speed = 2 / math.pi * surface.dither
    return plant_on(
        body, Hinge("arc"), surface, curvatures, imperfections=imperfections,
        options=PlantOptions(friction_law=vibration.law), shaking=Shaking("independent", (Shaker(FAST_HZ, speed),) * 2),
    )  # fmt: skip


def _body(seed: int, curvatures: tuple[float, float]) -> Body:
    random = np.random.default_rng(seed)
    while True:
        body = random_body("friction", random)
        if max(curvatures) * max_curvature_radius(body) < 0.8:
            return body


def _coefficients(body: Body, order: int) -> np.ndarray:
    return shape.coefficients_of(body.support.sample(np.arange(360) * math.tau / 360), order)


def _plan(t: float, phi1: float, phi2: float) -> PalmMotion:
    a, b = 0.25, 0.12
    return PalmMotion(
        (phi1 + a * math.sin(1.9 * t), phi2 + b * math.sin(1.3 * t)),
        (1.9 * a * math.cos(1.9 * t), 1.3 * b * math.cos(1.3 * t)),
        (-(1.9**2) * a * math.sin(1.9 * t), -(1.3**2) * b * math.sin(1.3 * t)),
    )


def _state(body: Body, surface: FrictionSurface, psi: float, omega0: float, order: int = shape.HARMONICS) -> np.ndarray:
    x = np.zeros(shape_map.size(order))
    x[[Z.PSI, Z.OMEGA0, Z.LN_RHO, Z.MU, Z.LN_DITHER, Z.DAMPING]] = (
        psi, omega0, math.log(body.rho), surface.mu, math.log(surface.dither), surface.damping,
    )  # fmt: skip
    x[Z.SHAPE :] = _coefficients(body, order)
    return x


@pytest.mark.nightly
@pytest.mark.parametrize("curvatures", CURVATURES)
def test_a_second_of_motion_agrees_with_the_emulated_plant(
    curvatures: tuple[float, float], vibration: Vibration
) -> None:
    body, surface = _body(3, curvatures), FrictionSurface(0.15, 0.012, 2e-4)
    phi = joints_of(body.support.at(0.0)[0], (0.75, 1.65), curvatures)
    plant = _plant(body, surface, curvatures, vibration)
    plant.place(_plan(0.0, *phi), 0.4, 0.3)
    rig = rig_inputs(_rig(curvatures, vibration=vibration))
    named, predict = (derived(f, curved=True) for f in (shape_map.named_function, shape_map.predict_function))
    x, P, dt = _state(body, surface, 0.4, 0.3), np.zeros((shape_map.N,) * 2), 5e-4
    turned = 0.0
    for k in range(2000):
        middle, end = (_plan(t, *phi) for t in ((k + 0.5) * dt, (k + 1) * dt))
        plant.advance(middle, end, dt)
        if k % 4 == 3:  # the filters use longer steps
            start = _plan((k - 3) * dt, *phi)
            jerk = (np.array(end.accelerations) - np.array(start.accelerations)) / (4 * dt)
            u = [4 * dt, *start.angles, *start.rates, *start.accelerations, *jerk, *rig]
            before = x[Z.PSI]
            x = np.asarray(predict(x, P, u)[0]).ravel()
            turned += abs(x[Z.PSI] - before)
    assert all(plant.touching)
    assert turned > 0.2, "it really moved"
    assert x[Z.PSI] == pytest.approx(plant.state.psi, abs=2e-6)
    assert x[Z.OMEGA0] == pytest.approx(plant.state.omega0, abs=2e-5)
    x[[Z.PSI, Z.OMEGA0]] = plant.state.psi, plant.state.omega0
    y = dict(
        zip(NAMED, np.asarray(named(x, [*end.angles, *end.rates, *end.accelerations, *rig])[0]).ravel(), strict=True)
    )
    one, two = plant.contacts()
    assert (y["s1"], y["s2"]) == pytest.approx((one.s, two.s), abs=1e-9)
    assert (y["r1"], y["r2"]) == pytest.approx(plant.radii(), abs=1e-9)
    assert (y["com_x"], y["com_y"]) == pytest.approx((plant.state.x, plant.state.y), abs=1e-9)
    assert (body.mass * y["f1"], body.mass * y["f2"]) == pytest.approx((one.force, two.force), rel=1e-6)


@pytest.mark.parametrize("curvatures", CURVATURES)
def test_gradients_agree_with_those_of_the_implicit_contact(curvatures: tuple[float, float]) -> None:
    body, surface = _body(5, curvatures), FrictionSurface(0.12, 0.015, 1e-4)
    phi = joints_of(body.support.at(0.0)[0], (0.75, 1.65), curvatures)
    palms, rig = [*phi, 0.4, -0.2, 0.5, 0.3], rig_inputs(_rig(curvatures))
    x = _state(body, surface, 0.3, 0.7)
    named = derived(shape_map.named_function, curved=True)

    def y(at: np.ndarray) -> np.ndarray:
        return np.asarray(named(at, [*palms, *rig])[0]).ravel()

    J = np.asarray(named(x, [*palms, *rig])[1])[:, : len(x)]
    step = np.where(np.arange(len(x)) < Z.SHAPE, 1e-6, 1e-8)
    wanted = np.column_stack(
        [(y(x + step * e) - y(x - step * e)) / (2 * s) for e, s in zip(np.eye(len(x)), step, strict=True)]
    )
    scale = np.abs(wanted).max(axis=1, keepdims=True) + 1e-9
    assert (np.abs(J - wanted) / scale).max() < 1e-6
    aim = np.asarray(derived(sensitivity.aim_function, curved=True)(x, [*phi, *curvatures]))
    assert aim == pytest.approx(J[[NAMED.index(name) for name in ("r1", "r2", "s1", "s2")]], abs=1e-9)
    dt = 0.004
    predict, P = derived(shape_map.predict_function, curved=True), np.eye(len(x)) * 1e-6
    u = [dt, *palms, 1.0, -2.0, *rig]
    transition = np.column_stack([
        (np.asarray(predict(x + s * e, P, u)[0]) - np.asarray(predict(x - s * e, P, u)[0])).ravel() / (2 * s)
        for e, s in zip(np.eye(len(x)), step, strict=True)
    ])  # fmt: skip
    found = np.asarray(predict(x, P, u)[1])
    noise = np.asarray(predict(x, np.zeros_like(P), u)[1])
    assert noise[0, 0] == pytest.approx(shape_map.Q_PSI * dt)
    assert noise[1, 1] >= shape_map.Q_OMEGA0 * dt, "the friction law's error is added"
    moved = transition @ P @ transition.T + noise
    assert found == pytest.approx(moved, rel=1e-4, abs=1e-6 * np.abs(moved).max())


def test_nearly_flat_palms_agree_with_flat_ones_to_a_nanometre() -> None:
    body, surface = _body(7, (0.0, 0.0)), FrictionSurface(0.1, 0.01, 1e-4)
    x, P = _state(body, surface, 0.2, 0.5), np.eye(shape_map.N) * 1e-6
    palms = [0.7, 1.6, 0.4, -0.2, 0.5, 0.3]
    flat, arc = (rig_inputs(_rig(curvatures)) for curvatures in ((0.0, 0.0), (1e-9, -1e-9)))
    straight = derived(shape_map.named_function)(x, [*palms, *flat])
    bent = derived(shape_map.named_function, curved=True)(x, [*palms, *arc])
    for one, other in zip(straight, bent, strict=True):
        one, other = np.asarray(one), np.asarray(other)
        assert np.abs(one - other).max() < 1e-6 * np.abs(one).max()
    assert np.asarray(bent[0])[:5].ravel() == pytest.approx(np.asarray(straight[0])[:5].ravel(), abs=1e-9)
    u = [0.004, *palms, 1.0, -2.0]
    moved = [
        np.asarray(derived(shape_map.predict_function, curved=bool(k))(x, P, [*u, *rig])[0])
        for k, rig in enumerate((flat, arc))
    ]
    assert moved[0] == pytest.approx(moved[1], abs=1e-9)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("curvatures", CURVATURES)
def test_array_functions_and_kernels_find_the_same_contacts(curvatures: tuple[float, float], seed: int) -> None:
    body = _body(seed, curvatures)
    h = _coefficients(body, shape.HARMONICS)
    phi1, phi2 = joints_of(body.support.at(0.0)[0], (0.75, 1.65), curvatures)
    psi = np.arange(24) * math.tau / 24
    s = arcs.contacts_on_arcs(h, np.full(24, phi1), np.full(24, phi2), psi, curvatures)
    x = _state(body, FrictionSurface(), 0.0, 0.0)
    named = derived(shape_map.named_function, curved=True)
    for number, angle in enumerate(psi):
        x[Z.PSI] = angle
        y = np.asarray(named(x, [phi1, phi2, 0, 0, 0, 0, *rig_inputs(_rig(curvatures))])[0]).ravel()
        assert y[[NAMED.index("s1"), NAMED.index("s2")]] == pytest.approx(s[:, number], abs=1e-10)
    circle = np.zeros_like(h)
    circle[0] = h[0]
    both = arcs.contacts_on_arcs(circle, np.array([phi1]), np.array([phi2]), np.zeros(1), curvatures)[:, 0].tolist()
    assert circle_radius((phi1, phi2), both, curvatures) == pytest.approx(h[0], abs=1e-12)


def test_orientation_rows_are_gradients_of_readings() -> None:
    curvatures = (14.0, -9.0)
    h = _coefficients(_body(2, curvatures), shape.HARMONICS)
    palms = PalmMotion.at_rest(joints_of(h[0], (0.75, 1.65), curvatures))
    s, rows = readings_on_arcs(palms, h, curvatures)
    change = np.random.default_rng(1).standard_normal(len(h)) * 1e-9
    after, _ = readings_on_arcs(palms, h + change, curvatures)
    assert s.shape == (2, DIRECTIONS)
    for palm in range(2):
        assert after[palm] - s[palm] == pytest.approx(rows[palm] @ change, abs=1e-13)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("curvatures", "sagittas", "standoffs"),
    [
        ((0.0, 0.0), (1e-4, -8e-5), (0.0, 0.0)),
        ((0.0, 0.0), (0.0, 0.0), (5e-4, -3e-4)),
        ((14.0, -9.0), (3e-4, -2e-4), (5e-4, -3e-4)),
    ],
    ids=["bows", "standoffs", "arcs"],
)
def test_motion_on_bowed_and_displaced_pads_agrees_with_the_plant(
    curvatures: PadPair, sagittas: PadPair, standoffs: PadPair, vibration: Vibration
) -> None:
    """The smoother's steps, readings and forces against a plant whose palms have the same imperfections."""
    pads = [PadImperfection(sagitta=a, standoff=b) for a, b in zip(sagittas, standoffs, strict=True)]
    body, surface = _body(4, curvatures), FrictionSurface(0.15, 0.012, 2e-4)
    imperfections = Imperfections(tuple(pads), (2e-3, 1e-3), friction=0.2)
    nominal = joints_of(body.support.at(0.0)[0], (0.75, 1.65), curvatures)
    phi = imperfections.true_palms(PalmMotion.at_rest(nominal)).angles
    plant = _plant(body, surface, curvatures, vibration, imperfections)
    plant.place(_plan(0.0, *phi), 0.3, 0.3)
    p = np.zeros(smoothing.CONSTANTS)
    C, form, lengths = smoothing.C, smoothing.Form(curved=any(curvatures)), [LENGTH, LENGTH]
    p[C.LN_RHO], p[C.DRAG], p[C.SATURATION] = math.log(body.rho), surface.mu / surface.dither, surface.dither**-2.0
    p[C.DAMPING], p[C.LN_MASS] = surface.damping, math.log(body.mass)
    p[smoothing.RIG] = [imperfections.constants()[name] for name in RIG_NAMES]
    p[C.SHAPE :] = _coefficients(body, smoothing.ORDER)
    rig, step = rig_inputs(_rig(curvatures, vibration=vibration)), derived(smoothing.step_function, form)
    x, dt, steps = np.array([0.3, 0.3]), 5e-4, 1000
    for k in range(steps):
        middle, end = (_plan(t, *phi) for t in ((k + 0.5) * dt, (k + 1) * dt))
        plant.advance(middle, end, dt)
        if k % 4 == 3:  # longer steps
            start = _plan((k - 3) * dt, *nominal)
            jerk = (np.array(end.accelerations) - np.array(start.accelerations)) / (4 * dt)
            u = [4 * dt, *start.angles, *start.rates, *start.accelerations, *jerk, *rig, *lengths]
            x = np.asarray(step(x, p, u)[0]).ravel()
    assert all(plant.touching)
    assert x == pytest.approx([plant.state.psi, plant.state.omega0], abs=3e-6)
    nodes = [[plant.state.psi, plant.state.omega0], [plant.state.psi + dt * plant.state.omega0, plant.state.omega0]]
    palms = _plan(steps * dt, *nominal)
    for pad, contact in enumerate(plant.contacts(), 1):
        z = [dt, 0.0, pad, *palms.angles, *palms.rates, 0.0, *curvatures, *lengths]
        assert float(derived(smoothing.contact_function, form)(*nodes, p, z)[0]) == pytest.approx(contact.s, abs=1e-6)
        z = [dt, 0.0, pad, *palms.angles, *palms.rates, *palms.accelerations, *rig, *lengths]
        assert float(derived(smoothing.force_function, form)(*nodes, p, z)[0]) == pytest.approx(contact.force, rel=3e-4)


def test_palms_too_concave_for_the_body_are_rejected() -> None:
    body = _body(1, (0.0, 0.0))
    with pytest.raises(ValueError, match="too concave for the body: kappa v is"):
        CurvedPlant(body, Hinge("fixed"), FrictionSurface(), (1.0 / max_curvature_radius(body), 0.0))


def test_points_lie_on_circles_through_the_hinge() -> None:
    one, two = palm_points((0.5, 2.2), (np.linspace(0, 0.05, 5), np.linspace(0, 0.05, 5)), (14.0, -9.0))
    centre1 = np.array([-math.sin(0.5), math.cos(0.5)]) / 14.0
    centre2 = np.array([math.sin(2.7), -math.cos(2.7)]) / -9.0
    assert np.linalg.norm(one - centre1, axis=1) == pytest.approx(np.full(5, 1 / 14.0), abs=1e-15)
    assert np.linalg.norm(two - centre2, axis=1) == pytest.approx(np.full(5, 1 / 9.0), abs=1e-15)


def test_a_rollout_ends_where_the_filters_steps_end() -> None:
    curvatures = (14.0, 11.5)
    body, surface = _body(3, curvatures), FrictionSurface(0.15, 0.012, 2e-4)
    phi = joints_of(body.support.at(0.0)[0], (0.75, 1.65), curvatures)
    rig, x = rig_inputs(_rig(curvatures)), _state(body, surface, 0.4, 0.3)
    move = [*phi, phi[0] + 0.2, phi[1] - 0.1, 0.6, 0.1]
    roll, begin = _rolls()
    moved, outputs = (np.asarray(each) for each in roll(x, begin(x, move, rig), move, rig))
    predict, P = derived(shape_map.predict_function, curved=True), np.zeros((shape_map.N,) * 2)
    for k in range(rollout.SUBSTEPS * 4):
        start, end = (rollout.palms_on(ca.DM(move), SX(0.0025 * j)) for j in (k, k + 1))
        begin, after = (
            [float(ca.evalf(v)) for v in (p.phi1, p.phi2, p.omega1, p.omega2, p.alpha1, p.alpha2)] for p in (start, end)
        )
        jerk = [(b - a) / 0.0025 for a, b in zip(begin[4:], after[4:], strict=True)]
        x = np.asarray(predict(x, P, [0.0025, *begin, *jerk, *rig])[0]).ravel()
    assert moved.ravel() == pytest.approx(x[:2], abs=2e-5), "the filter's steps are four times as long"
    assert outputs.shape == (rollout.OUTPUTS, rollout.SUBSTEPS)
    assert rig.shape == (RIG_INPUTS,)


@cache
def _rolls() -> tuple[ca.Function, ca.Function]:
    return derived(rollout.roll_function, curved=True), derived(rollout.begin_function, curved=True)


def _rolled(x: np.ndarray, move: list[float], rig: np.ndarray, calls: int) -> tuple[np.ndarray, np.ndarray]:
    """Outputs after each step, and the contacts found there by a search from scratch: (steps, 8), (steps, 2)."""
    roll, begin = _rolls()
    s, outputs, blind = begin(x, move, rig), [], []
    for call in range(calls):
        elapsed = call * rollout.SUBSTEPS * rollout.STEP_S
        steps = np.asarray(roll(x, s, [*move[:5], elapsed], rig)[1]).T
        for number, step in enumerate(steps, 1):
            x = np.concatenate([step[:2], x[2:]])
            blind.append(np.asarray(begin(x, [*move[:5], elapsed + number * rollout.STEP_S], rig)).ravel())
        s = steps[-1, rollout.S]
        outputs.extend(steps)
    return np.array(outputs), np.array(blind)


@pytest.mark.parametrize("curvatures", CURVATURES)
def test_contacts_tracked_by_a_rollout_agree_with_a_search_from_scratch(curvatures: tuple[float, float]) -> None:
    rig, errors, shifts = rig_inputs(_rig(curvatures)), [], []
    for seed in range(4):
        random, body = np.random.default_rng(seed), _body(seed, curvatures)
        phi = np.array(joints_of(body.support.at(0.0)[0], (0.75, 1.65), curvatures))
        move = [*phi, *(phi + random.uniform(-0.3, 0.3, 2)), 0.6, 0.0]
        x = _state(body, FrictionSurface(0.1, 0.012, 2e-4), random.uniform(0.0, math.tau), 0.0)
        outputs, blind = _rolled(x, move, rig, 12)
        held = np.logical_and.accumulate(outputs[:, 2:4].min(axis=1) > 0.0)
        errors.append(np.abs(outputs[held][:, rollout.S] - blind[held]).max(axis=1))
        shifts.append(np.abs(np.diff(outputs[held][:, rollout.S], axis=0)).max(axis=1))
    error, shift = np.concatenate(errors), np.concatenate(shifts)
    assert len(error) > 100
    assert np.quantile(shift, 0.9) > 1e-4, "the contacts move appreciably in a step"
    assert np.quantile(error, 0.9) < 5e-6
    assert error.max() < 1e-4


def test_a_rollout_over_a_jumping_contact_is_marked_as_invalid() -> None:
    """A lens whose flat side is flatter than the palm touches at two places there."""
    curvatures = (14.0, 12.0)
    rig, phi = rig_inputs(_rig(curvatures)), joints_of(0.022, (math.radians(40.0), math.radians(95.0)), curvatures)
    least = []
    for flatness in (0.45, 0.9):
        x = np.zeros(shape_map.N)
        x[[Z.PSI, Z.OMEGA0, Z.LN_RHO, Z.LN_DITHER, Z.SHAPE]] = 0.5, 4.0, math.log(0.017), math.log(0.01), 0.022
        for k, bend in ((2, 1.5), (4, 1.0), (6, 0.5)):  # of v, summing to a peak at 0 and π
            x[Z.SHAPE + 2 * k - 1] = flatness * bend * 0.022 / (1 - k**2)
        outputs, _ = _rolled(x, [*phi, *phi, 0.6, 0.0], rig, 1)
        least.append(outputs[:, 2:4].min(axis=1))
    assert (least[0] > 0.0).all(), "κv of 0.7 at most"
    assert least[1][0] > 0.0
    assert least[1][-1] == -math.inf, "κv of 1.1 at its flattest"
