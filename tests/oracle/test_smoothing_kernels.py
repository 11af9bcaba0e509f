"""The smoother's kernels: Jacobians against differences, values against a plain NumPy version of the dynamics."""

from __future__ import annotations

import bodies
import casadi as ca
import numpy as np
import pytest
from bodies import CONSTANTS, DAMPING, DRAG, LN_MASS, LN_RHO, ORDER, SATURATION, SHAPE, Bodies
from derived import derived
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import root

from palmd.model import smoothing
from palmd.model.dynamics import HALF_PERIOD_INPUT
from palmd.model.shape import prior_sd

LENGTHS = (0.0555, 0.048)  # of the pads
FORCE = 0.8  # N
FLAT = [0.0, 0.0]
HALF_PERIOD, BRIEF = 2e-3, 2e-4  # s, of a vibration; of one so fast that slips hardly alternate
INDEPENDENT = [0.0, 1.0, 0.0, HALF_PERIOD, *[0.0] * 4]  # κ, λ, not the averaged law, 1/(2f); errors of these
RIG = [9.81, 0.12, 0.12, 0.0, 0.0, *FLAT, *INDEPENDENT, *LENGTHS]
PALMS = np.array([0.7, 1.5, 0.4, -0.3, 1.0, -2.0])
JERK = np.array([3.0, -4.0])
SLOWLY = 0.25  # scale of that motion at which both contacts slip more slowly than the palms vibrate
DT = 0.005
NODES = np.array([[0.2, 1.3], [0.2066, 1.34]])


def _constants(seed: int = 0, mu: float = 0.15, dither: float = 0.012) -> np.ndarray:
    p = np.zeros(smoothing.CONSTANTS)
    p[[LN_RHO, DRAG, SATURATION, DAMPING, LN_MASS]] = np.log(0.014), mu / dither, dither**-2.0, 3e-4, np.log(0.16)
    p[SHAPE:] = 0.5 * prior_sd(0.02, ORDER) * np.random.default_rng(seed).standard_normal(2 * ORDER + 1)
    p[SHAPE] = 0.02
    p[bodies.RIG + 12] = 0.2 * (mu > 0)  # the palms' friction differs
    return p


def _step(
    x: np.ndarray, p: np.ndarray, dt: float = DT, pace: float = 1.0, half_period: float = HALF_PERIOD
) -> list[np.ndarray]:
    rig = [*RIG[:HALF_PERIOD_INPUT], half_period, *RIG[HALF_PERIOD_INPUT + 1 :]]
    u = [dt, *_palms_at(0.0, pace), *(pace * JERK), *rig]
    return [np.asarray(each) for each in derived(smoothing.step_function).call([x, p, u])]


def _reading(kernel: ca.Function, nodes: np.ndarray, p: np.ndarray, z: list[float]) -> list[np.ndarray]:
    return [np.asarray(each) for each in kernel.call([nodes[0], nodes[1], p, z])]


def _palms_at(t: float, pace: float = 1.0) -> np.ndarray:
    phi, omega, alpha, jerk = PALMS[:2], pace * PALMS[2:4], pace * PALMS[4:], pace * JERK
    return np.concatenate([
        phi + t * omega + t**2 / 2 * alpha + t**3 / 6 * jerk, omega + t * alpha + t**2 / 2 * jerk, alpha + t * jerk
    ])  # fmt: skip


def _differences(f, y: np.ndarray, scale: np.ndarray) -> np.ndarray:
    columns = []
    for i, step in enumerate(1e-5 * scale):
        up, down = y.copy(), y.copy()
        up[i] += step
        down[i] -= step
        columns.append((f(up) - f(down)).ravel() / (2 * step))
    return np.array(columns).T


RIG_SD = np.append(
    np.repeat([1e-4, 3e-3, 3e-5, 2e-3, 2e-4, 2e-3], 2), [0.3, 5e-5, 5e-5, 0.3, 0.1, 0.1, 0.02]
)  # as a calibrated rig is known
SCALE = np.concatenate([[0.1, 10.0, 1e3, 1e-4, 0.1], RIG_SD, np.full(2 * ORDER + 1, 1e-3)])


def test_both_versions_have_the_same_constants() -> None:
    C = smoothing.C
    assert tuple(C) == (LN_RHO, DRAG, SATURATION, DAMPING, LN_MASS, bodies.RIG, SHAPE)
    assert (smoothing.CONSTANTS, smoothing.ORDER) == (CONSTANTS, ORDER)


@pytest.mark.parametrize(("mu", "relative"), [(0.0, 1e-5), (0.15, 2e-3)])
def test_jacobian_of_the_step(mu: float, relative: float) -> None:
    """With friction the step's own rate depends on the state, which its Jacobian omits."""
    scale = np.concatenate([[0.1, 1.0], SCALE])
    y = np.concatenate([[0.2, 0.3], _constants(mu=mu)])
    function = derived(smoothing.step_function)

    def moved(v: np.ndarray) -> list[np.ndarray]:
        return [np.asarray(each) for each in function.call([v[:2], v[2:], [DT, *PALMS, *JERK, *RIG]])]

    jacobian, wanted = moved(y)[1] * scale, _differences(lambda v: moved(v)[0], y, scale) * scale
    assert jacobian == pytest.approx(wanted, abs=relative * np.abs(wanted[1]).max())
    assert np.abs(jacobian[0]).max() == pytest.approx(np.abs(wanted[0]).max(), rel=1e-3)


@pytest.mark.parametrize("pad", [1, 2])
@pytest.mark.parametrize("name", ["contact", "force"])
def test_gradient_of_a_reading(name: str, pad: int) -> None:
    kernel = derived(smoothing.contact_function) if name == "contact" else derived(smoothing.force_function)
    z = [DT, 0.002, pad, *PALMS[:4], FORCE, *FLAT, *LENGTHS] if name == "contact" else [DT, 0.002, pad, *PALMS, *RIG]
    y = np.concatenate([NODES.ravel(), _constants()])
    scale = np.concatenate([[0.1, 1.0, 0.1, 1.0], SCALE])

    def value(v: np.ndarray) -> np.ndarray:
        return _reading(kernel, v[:4].reshape(2, 2), v[4:], z)[0]

    _, J = _reading(kernel, NODES, y[4:], z)
    wanted = _differences(value, y, 1e-2 * scale)
    assert (J * scale).ravel() == pytest.approx((wanted * scale).ravel(), rel=1e-5, abs=1e-8)


def _error_of_step(
    mu: float, dither: float, omega0: float, dt: float = DT, pace: float = 1.0, half_period: float = HALF_PERIOD
) -> tuple[float, float, float]:
    """(error of ψ, error of ω0, change of ω0) in one step, against 500 Runge–Kutta steps of the NumPy version."""
    p = _constants(1, mu, dither)
    bodies, n = Bodies(p[:, None], RIG[0], RIG[1], half_period=half_period), 500
    psi, spin = np.array([0.2]), np.array([omega0])
    for k in range(n):
        psi, spin = bodies.moved(psi, spin, tuple(_palms_at((k + part) * dt / n, pace) for part in (0, 0.5, 1)), dt / n)
    moved = _step(np.array([0.2, omega0]), p, dt, pace, half_period)[0].ravel()
    return moved[0] - psi.item(), moved[1] - spin.item(), spin.item() - omega0


@pytest.mark.parametrize(
    ("mu", "dither", "omega0", "half_period", "pace", "angle", "rate"),
    [
        (0.0, 0.012, 1.3, HALF_PERIOD, 1.0, 3e-8, 1e-6),
        (0.15, 0.012, 0.1, HALF_PERIOD, SLOWLY, 2e-6, 1e-5),
        (0.25, 0.008, 0.1, BRIEF, SLOWLY, 7e-6, 1e-4),
    ],
    ids=["no friction", "friction", "stiff friction"],
)
def test_the_step_integrates_the_motion(
    mu: float, dither: float, omega0: float, half_period: float, pace: float, angle: float, rate: float
) -> None:
    """Error below the process noise of such a step, 7e-6 rad and 2e-4 rad/s, where ω0 relaxes at about 500 /s.

    Also during reversals, as long as slips stay below the vibration's speed.
    """
    of_angle, of_rate, change = _error_of_step(mu, dither, omega0, DT, pace, half_period)
    assert abs(change) > 0.05
    assert abs(of_angle) < angle
    assert abs(of_rate) < rate


def test_sudden_braking_is_integrated_to_high_order() -> None:
    long, short = (abs(_error_of_step(0.15, 0.012, 0.3, dt, half_period=BRIEF)[1]) for dt in (DT, DT / 2))
    assert short < long / 12


@pytest.mark.nightly
def test_slips_alternating_beyond_the_vibrations_speed_are_integrated_to_second_order() -> None:
    """Strong friction with the slowest vibration: slips of 0.3 V alternate by another 0.7 V.

    With the strongest friction they alternate by all of V, and contacts stick within the step, which is less exact
    there.
    """
    angle, long, change = _error_of_step(0.2, 0.008, 0.1, DT, SLOWLY)
    _, short, _ = _error_of_step(0.2, 0.008, 0.1, DT / 2, SLOWLY)
    assert abs(angle) < 7e-6
    assert abs(long) < 0.06 * abs(change)
    assert abs(short) < abs(long) / 4
    sticking, finer = (abs(_error_of_step(0.25, 0.008, 0.1, dt, SLOWLY)[1]) for dt in (DT, DT / 2))
    assert sticking < 0.01  # rad/s
    assert finer < sticking / 2


def test_the_strongest_braking_stays_stable() -> None:
    """A step as long as a search's, across all of the vibration's speeds, brakes too little rather than too much.

    From four times the vibration's speed a contact stops within 7 ms.
    """
    _, error, change = _error_of_step(0.25, 0.008, 1.3)
    assert abs(error) < 0.6 * abs(change)
    p, rates = _constants(1, 0.25, 0.008), [1.3]
    x = np.array([0.2, rates[0]])
    for _ in range(20):
        u = [2 * DT, *PALMS[:2], *np.zeros(6), *RIG]
        x = np.asarray(derived(smoothing.step_function).call([x, p, u])[0]).ravel()
        rates.append(x[1])
    size = np.abs(rates)
    assert (np.diff(size[size > 0.1]) < 0).all()
    assert size[10:].max() < 0.02


def test_braking_from_slips_faster_than_the_vibration_is_integrated_to_second_order() -> None:
    """Friction's slope jumps where a slip crosses the vibration's speed, here from three times it to nearly none."""
    (_, long, change), (_, short, _) = (_error_of_step(0.15, 0.012, 1.3, dt) for dt in (DT, DT / 2))
    assert abs(long) < 0.05 * abs(change)
    assert abs(short) < abs(long) / 4


@pytest.mark.parametrize("pad", [1, 2])
@pytest.mark.parametrize("t", [0.0, 0.0013, DT])
def test_a_reading_is_predicted_on_the_cubic_between_the_nodes(t: float, pad: int) -> None:
    p = _constants(2)
    cubic = CubicHermiteSpline([0.0, DT], NODES[:, 0], NODES[:, 1])
    psi, omega0 = np.array([cubic(t)]), np.array([cubic(t, 1)])
    twin = Bodies(p[:, None], RIG[0], RIG[1], half_period=HALF_PERIOD)
    s, _ = _reading(derived(smoothing.contact_function), NODES, p, [DT, t, pad, *PALMS[:4], FORCE, *FLAT, *LENGTHS])
    assert s.item() == pytest.approx(twin.contacts(PALMS, psi)[pad - 1].item(), abs=1e-12)
    force, _ = _reading(derived(smoothing.force_function), NODES, p, [DT, t, pad, *PALMS, *RIG])
    assert force.item() == pytest.approx(0.16 * twin.forces_and_spin(PALMS, psi, omega0)[pad - 1].item(), rel=1e-9)


@pytest.mark.parametrize("pad", [1, 2])
@pytest.mark.parametrize(("kappa", "transmission"), [(-1.0, 1.0), (1.0, 1.0), (-0.4, 0.6), (0.7, 0.0)])
def test_forces_depend_on_the_relation_and_the_transmission_of_vibrations(
    kappa: float, transmission: float, pad: int
) -> None:
    """Half of each is described, the other half is an estimated constant."""
    p, rig = _constants(2), RIG.copy()
    rig[7:9] = kappa / 2, transmission / 2
    p[[bodies.KAPPA, bodies.TRANSMISSION]] = kappa / 2, transmission / 2
    laws = (kappa / 2, transmission / 2), (-kappa, 0.5)
    psi, slow = 0.2, 0.3
    force, _ = _reading(derived(smoothing.force_function), np.array([[psi, slow]] * 2), p, [DT, 0.0, pad, *PALMS, *rig])
    wanted, other = (
        0.16
        * Bodies(p[:, None], RIG[0], RIG[1], *law, HALF_PERIOD).forces_and_spin(
            PALMS, np.array([psi]), np.array([slow])
        )[pad - 1]
        for law in laws
    )
    assert force.item() == pytest.approx(wanted, rel=1e-9)
    assert abs(other - wanted) > 1e-4 * wanted, "they matter"


@pytest.mark.parametrize("pad", [1, 2])
def test_a_longer_friction_arm_affects_friction_only(pad: int) -> None:
    psi, omega0, change = np.array([0.2]), np.array([0.3]), []
    for mu in (0.0, 0.15):
        forces = []
        for arm in (0.0, 0.1):
            p = _constants(2, mu)
            p[bodies.ARM] = arm
            nodes = np.array([[psi.item(), omega0.item()]] * 2)
            force, _ = _reading(derived(smoothing.force_function), nodes, p, [DT, 0.0, pad, *PALMS, *RIG])
            twin = Bodies(p[:, None], RIG[0], RIG[1], half_period=HALF_PERIOD)
            wanted = 0.16 * twin.forces_and_spin(PALMS, psi, omega0)[pad - 1].item()
            assert force.item() == pytest.approx(wanted, rel=1e-9)
            forces.append(force.item())
        change.append(abs(forces[1] - forces[0]))
    assert change[0] == 0.0
    assert change[1] > 1e-3


def _surface(palm: int, phi: float, s: float, above: float, sagitta: float) -> tuple[np.ndarray, float]:
    """Position of a palm's bowed surface at `s` along it, and the world direction of its tangent there."""
    sign = 3 - 2 * palm  # the object is left of palm 1 and right of palm 2
    along = np.array([np.cos(phi), np.sin(phi)])
    left = np.array([-along[1], along[0]])
    length = LENGTHS[palm - 1]
    height = above + sagitta * (1 - (2 * s / length - 1) ** 2)
    slope = -sagitta * 4 / length * (2 * s / length - 1)
    return s * along + sign * height * left, phi + sign * np.arctan(slope)


def _touch(p: np.ndarray, phi: tuple[float, float], psi: float) -> np.ndarray:
    """s1, s2 where the body lies on both surfaces, from coinciding points of body and surface."""
    rig, twin = p[bodies.RIG : SHAPE], Bodies(p[:, None])

    def miss(y: np.ndarray) -> np.ndarray:
        apart = []
        for palm in (1, 2):
            angle = phi[0] + rig[10] + (phi[1] + rig[11] if palm == 2 else 0.0)
            place, tangent = _surface(palm, angle, y[1 + palm], rig[7 + palm], rig[3 + palm])
            outward = tangent - (np.pi / 2 if palm == 1 else 3 * np.pi / 2)
            h, slope, _ = (each.item() for each in twin.support(np.array([outward - psi])))
            normal = np.array([np.cos(outward), np.sin(outward)])
            apart.append(y[:2] + h * normal + slope * np.array([-normal[1], normal[0]]) - place)
        return np.concatenate(apart)

    found = root(miss, [0.0, 0.03, 0.02, 0.02], tol=1e-12)
    assert found.success
    return found.x[2:]


@pytest.mark.parametrize("pad", [1, 2])
@pytest.mark.parametrize("seed", range(4))
def test_a_reading_on_an_imperfect_rig_agrees_with_the_geometry(pad: int, seed: int) -> None:
    p = _constants(2)
    p[bodies.RIG : SHAPE] = RIG_SD * np.random.default_rng(seed).standard_normal(len(RIG_SD))
    zero, scale, _, lag, by_force = p[bodies.RIG + np.array([0, 2, 4, 6, 13]) + pad - 1]
    t = 0.003
    psi = CubicHermiteSpline([0.0, DT], NODES[:, 0], NODES[:, 1])(t - lag)
    then = PALMS[:2] - lag * PALMS[2:4]
    reading, _ = _reading(
        derived(smoothing.contact_function), NODES, p, [DT, t, pad, *PALMS[:4], FORCE, *FLAT, *LENGTHS]
    )
    assert reading.item() == pytest.approx(
        zero + by_force * FORCE + (1 + scale) * _touch(p, then, psi)[pad - 1], abs=1e-6
    )


def test_batched_kernels_give_the_results_of_single_ones() -> None:
    library, random = smoothing.library(), np.random.default_rng(0)
    p, rows = _constants(), 24
    a, u = np.zeros((rows, 2)), np.tile([DT, *PALMS, *JERK, *RIG], (rows, 1))
    a[:] = NODES[0] + 0.1 * random.standard_normal((rows, 2))
    end, J = np.zeros((rows, 2)), np.zeros((rows, 2 + CONSTANTS, 2))
    library.bind("step_batch", [a, p, u], [end, J])()
    one = np.zeros(2)
    library.bind("advance", [a[5].copy(), p, u[5].copy()], [one])()
    wanted, jacobian = _step(a[5], p)
    assert end[5] == pytest.approx(wanted.ravel(), abs=1e-12)
    assert one == pytest.approx(wanted.ravel(), abs=1e-12)
    of_one = J[5].T
    assert of_one == pytest.approx(jacobian, rel=1e-9, abs=1e-9)
