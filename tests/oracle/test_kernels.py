"""The observers' kernels: Jacobians against differences, covariance algebra against textbook forms, agreement of
models.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from derived import derived

from palmd.model import extended, sensitivity, shape, shape_map, smoothing
from palmd.model.integrate import exponential_step
from palmd.model.outputs import NAMED

FLAT = [0.0, 0.0]
IN_PHASE = [-0.7, 0.8, 0.0, 2e-3, -0.2, 0.1, 0.2, -0.03]  # κ, λ, not the averaged law, 1/(2f); errors of these
RIG = [9.81, 0.12, 0.12, 0.0, 0.1, *FLAT, *IN_PHASE]
PALMS = [0.7, 1.5, 0.4, -0.3, 1.0, -2.0]
JERK = [3.0, -4.0]


def _coefficients(random: np.random.Generator) -> np.ndarray:
    coefficients = random.standard_normal(shape.COEFFICIENTS) * shape.prior_sd(0.02) * 0.5
    coefficients[0] = 0.02
    return coefficients


def _shape_state(random: np.random.Generator) -> np.ndarray:
    Z = shape_map.Z
    x = np.zeros(shape_map.N)
    x[Z.PSI], x[Z.OMEGA0], x[Z.LN_RHO] = 0.2, 1.3, np.log(0.014)
    x[Z.MU], x[Z.LN_DITHER], x[Z.DAMPING] = 0.15, np.log(0.012), 3e-4
    x[Z.SHAPE :] = _coefficients(random)
    return x


def _extended_state(x: np.ndarray) -> np.ndarray:
    """The same body and instant in the coordinates of the named state."""
    X, Z = extended.X, shape_map.Z
    coefficients = x[Z.SHAPE :]
    y = np.zeros(extended.N)
    phi1, phi2 = PALMS[:2]
    y[[X.PHI1, X.PHI2, X.OMEGA1, X.OMEGA2]] = PALMS[:4]
    # contact_rows is for ψ = 0: the palms are rotated instead of the body
    radii, readings = shape.contact_rows(phi1 - x[Z.PSI], phi2)
    y[[X.R1, X.R2]], y[[X.S1, X.S2]] = radii @ coefficients, readings @ coefficients
    y[X.OMEGA0], y[X.PSI], y[X.RHO] = x[Z.OMEGA0], x[Z.PSI], np.exp(x[Z.LN_RHO])
    y[X.MU], y[X.LN_DITHER], y[X.DAMPING] = x[Z.MU], x[Z.LN_DITHER], x[Z.DAMPING]
    y[X.CURVATURE :] = shape.curvature_rows() @ coefficients
    return y


def _spd(n: int, random: np.random.Generator, scale: np.ndarray) -> np.ndarray:
    root = random.standard_normal((n, n)) * 0.2 + np.eye(n)
    return (root @ root.T) * np.outer(scale, scale)


def _array(value: ca.DM) -> np.ndarray:
    return np.asarray(ca.DM(value))


def _differences(f, x: np.ndarray) -> np.ndarray:
    columns = []
    for i in range(len(x)):
        step = 1e-6 * max(abs(x[i]), 1e-3)
        up, down = x.copy(), x.copy()
        up[i] += step
        down[i] -= step
        columns.append((f(up) - f(down)) / (2 * step))
    return np.array(columns).T


SHAPE_U = [0.002, *PALMS, *JERK, *RIG]
EXTENDED_U = [0.002, *PALMS[4:], *JERK, *RIG]


@pytest.mark.parametrize("seed", range(3))
def test_both_models_predict_the_same_motion(seed: int) -> None:
    """Named state and shape map are two coordinates of one motion; they agree after a step."""
    x = _shape_state(np.random.default_rng(seed))
    y = _extended_state(x)
    P_x, P_y = np.zeros((shape_map.N,) * 2), np.zeros((extended.N,) * 2)
    x_next = _array(derived(shape_map.predict_function)(x, P_x, SHAPE_U)[0]).ravel()
    y = _array(derived(extended.predict_function)(y, P_y, EXTENDED_U)[0]).ravel()
    Z, X = shape_map.Z, extended.X
    assert y[X.OMEGA0] == pytest.approx(x_next[Z.OMEGA0], abs=2e-6)
    assert y[X.PSI] == pytest.approx(x_next[Z.PSI], abs=1e-9)
    palms_next = y[[X.PHI1, X.PHI2]]
    radii, readings = shape.contact_rows(palms_next[0] - x_next[Z.PSI], palms_next[1])
    assert y[[X.R1, X.R2]] == pytest.approx(radii @ x_next[Z.SHAPE :], abs=1e-9)
    assert y[[X.S1, X.S2]] == pytest.approx(readings @ x_next[Z.SHAPE :], abs=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_named_values_agree_between_the_models(seed: int) -> None:
    x = _shape_state(np.random.default_rng(seed))
    one = _array(derived(shape_map.named_function)(x, [*PALMS, *RIG])[0]).ravel()
    two = _array(derived(extended.named_function)(_extended_state(x), [*PALMS[4:], *RIG])[0]).ravel()
    assert dict(zip(NAMED, one, strict=True)) == pytest.approx(dict(zip(NAMED, two, strict=True)), rel=1e-9, abs=1e-12)


@pytest.mark.parametrize(("omega0", "dt"), [(1.3, 0.001), (0.4, 0.002)], ids=["faster than", "slower than"])
def test_prediction_integrates_the_drift(omega0: float, dt: float) -> None:
    """Against many small midpoint steps of the same model's rates; slips faster or slower than the vibration."""
    x = _extended_state(_shape_state(np.random.default_rng(1)))
    x[extended.X.OMEGA0] = omega0
    u = [dt, *EXTENDED_U[1:]]
    moved = _array(derived(extended.predict_function)(x, np.zeros((extended.N,) * 2), u)[0]).ravel()
    n = 400
    s, a1, a2, g = ca.SX.sym("s", extended.N), ca.SX.sym("a"), ca.SX.sym("b"), ca.SX.sym("g", len(RIG))
    function = ca.Function("rates", [s, a1, a2, g], [extended.drift(s, a1, a2, g)])

    def rates(state: np.ndarray, t: float) -> np.ndarray:
        still = np.zeros(extended.N - extended.MOVING)
        return np.append(_array(function(state, PALMS[4] + JERK[0] * t, PALMS[5] + JERK[1] * t, RIG)).ravel(), still)

    y, h = x.copy(), dt / n
    for i in range(n):
        middle = y + h / 2 * rates(y, i * h)
        y = y + h * rates(middle, (i + 0.5) * h)
    assert moved == pytest.approx(y, abs=5e-5)
    assert abs(y[extended.X.OMEGA0] - omega0) > 0.1


@pytest.mark.parametrize("model", [extended, shape_map], ids=["extended", "shape_map"])
def test_prediction_propagates_covariance_with_the_true_jacobian(model) -> None:
    random = np.random.default_rng(5)
    x = _shape_state(random)
    u = SHAPE_U
    if model is extended:
        x, u = _extended_state(x), EXTENDED_U
    scale = np.maximum(np.abs(x), 1e-3) * 1e-2
    P = _spd(len(x), random, scale)
    predict = derived(model.predict_function)
    F = _differences(lambda at: _array(predict(at, P, u)[0]).ravel(), x)
    got = _array(predict(x, P, u)[1])
    noise = got - F @ P @ F.T
    assert np.abs(noise - np.diag(np.diag(noise))).max() < 1e-3 * np.outer(scale, scale).max()
    assert (np.diag(noise) > -1e-3 * scale**2).all(), "process noise cannot be negative"
    assert got == pytest.approx(got.T, abs=0)


@pytest.mark.parametrize("model", [extended, shape_map], ids=["extended", "shape_map"])
def test_an_update_equals_the_information_form(model) -> None:
    """x + K y and (P⁻¹ + hᵀh/R)⁻¹, h by differences."""
    random = np.random.default_rng(6)
    x = _shape_state(random)
    extra = PALMS[:2]
    if model is extended:
        x, extra = _extended_state(x), []
    P = _spd(len(x), random, np.maximum(np.abs(x), 1e-3) * 1e-3)
    R = 1.1e-8
    update = (
        derived(extended.update_function, "update_s1", extended.X.S1)
        if model is extended
        else derived(shape_map.update_function, "update_s1", 1)
    )

    def predicted(at: np.ndarray) -> np.ndarray:
        if model is extended:
            return at[[extended.X.S1]]
        _, readings = shape.contact_rows(PALMS[0] - at[shape_map.Z.PSI], PALMS[1])
        return readings[[0]] @ at[shape_map.Z.SHAPE :]

    h = _differences(predicted, x)
    value = float(predicted(x)[0] + 8e-5)
    x_next, P_next, score = (_array(v) for v in update(x, P, [value, R, 16.0, 1.0, *extra]))
    S = float((h @ P @ h.T)[0, 0]) + R
    assert x_next.ravel() == pytest.approx(x + (P @ h.T).ravel() / S * 8e-5, rel=1e-6, abs=1e-12)
    wanted = P - P @ h.T @ h @ P / S
    assert np.abs(P_next - wanted).max() < 1e-9 * np.abs(P).max()
    assert (np.linalg.eigvalsh(P_next) > 0).all()
    nis = (8e-5) ** 2 / S
    assert score.ravel() == pytest.approx([-0.5 * (np.log(S) + nis), nis], rel=1e-6)
    one_of_nine = [_array(v) for v in update(x, P, [value, R, 16.0, 9.0, *extra])]
    weak = [_array(v) for v in update(x, P, [value, 9.0 * R, 16.0, 1.0, *extra])]
    assert one_of_nine[0] == pytest.approx(weak[0], rel=1e-9)
    assert one_of_nine[1] == pytest.approx(weak[1], rel=1e-9)
    assert one_of_nine[2].ravel() == pytest.approx([score.ravel()[0] / 9.0, nis], rel=1e-6)


@pytest.mark.parametrize("model", [extended, shape_map], ids=["extended", "shape_map"])
def test_an_outlier_moves_the_state_no_more_than_a_reading_on_the_gate(model) -> None:
    random = np.random.default_rng(7)
    x, extra = _shape_state(random), PALMS[:2]
    update = derived(shape_map.update_function, "update_s1", 1)
    if model is extended:
        x, extra, update = _extended_state(x), [], derived(extended.update_function, "update_s1", extended.X.S1)
    P = _spd(len(x), random, np.maximum(np.abs(x), 1e-3) * 1e-3)
    _, readings = shape.contact_rows(PALMS[0] - 0.2, PALMS[1])
    at = readings[0] @ _shape_state(np.random.default_rng(7))[shape_map.Z.SHAPE :]
    gate, R = 16.0, 1.1e-8
    far = _array(update(x, P, [at + 5e-3, R, gate, 1.0, *extra])[0]).ravel() - x
    on_the_gate = _array(update(x, P, [at + 5e-3, R, 1e9, 1.0, *extra])[0]).ravel() - x
    assert np.linalg.norm(far) < 0.7 * np.linalg.norm(on_the_gate)
    P_far = _array(update(x, P, [at + 0.5, R, gate, 1.0, *extra])[1])
    assert P_far == pytest.approx(P, rel=1e-3, abs=1e-3 * np.abs(P).max()), "an outlier carries no information"


def test_the_extended_outline_returns_the_coefficients() -> None:
    x = _shape_state(np.random.default_rng(9))
    h, J = (_array(v) for v in derived(extended.outline_function)(_extended_state(x)))
    assert h.ravel() == pytest.approx(x[shape_map.Z.SHAPE :], abs=1e-12)
    assert J.shape == (shape.COEFFICIENTS, extended.N)


def test_the_shape_basis_matches_its_derivatives() -> None:
    theta, step = np.linspace(0, 6, 13), 1e-6
    slope = (shape.basis(theta + step) - shape.basis(theta - step)) / (2 * step)
    assert shape.tangential_basis(theta) == pytest.approx(-slope, abs=2e-6)
    coefficients = _coefficients(np.random.default_rng(2))
    k = shape.harmonic_of_coefficient()
    v = shape.basis(theta) @ ((1 - k**2) * coefficients)
    symbolic = [float(ca.DM(shape.contact_at(ca.SX(float(a)), ca.SX(coefficients)).v)) for a in theta]
    assert v == pytest.approx(symbolic)


@pytest.mark.parametrize("rate", [0.0, -0.2, -40.0, -2000.0])
def test_the_step_is_exact_for_a_stiff_linear_rate(rate: float) -> None:
    """ẏ = λ y + 1 has a closed solution; Runge–Kutta would diverge at λ dt = −16."""
    y, dt = ca.SX.sym("y"), 0.008

    def rates(s: ca.SX, t: ca.SX) -> ca.SX:
        return rate * s + 1 + 0 * t

    moved, jacobian = exponential_step(rates, y, ca.SX(dt), [0], 0, ca.SX(rate))
    got, slope = (float(v) for v in ca.Function("f", [y], [moved, jacobian])(0.3))
    grown = np.exp(rate * dt)
    assert got == pytest.approx(0.3 * grown + (dt if rate == 0 else (grown - 1) / rate), rel=1e-9)
    assert slope == pytest.approx(grown)


def test_the_step_is_of_fourth_order() -> None:
    y, h, t0 = ca.SX.sym("y", 2), ca.SX.sym("h"), ca.SX.sym("t")

    def rates(s: ca.SX, t: ca.SX) -> ca.SX:
        return ca.vertcat(s[1], -300 * ca.sin(s[0]) - 50 * s[1] + 20 * ca.cos(9 * (t0 + t)))

    moved, _ = exponential_step(rates, y, h, [0, 1], 1, ca.SX(-50))
    step = ca.Function("step", [y, h, t0], [moved])

    def after(n: int) -> np.ndarray:
        state = np.array([0.7, 1.0])
        for i in range(n):
            state = _array(step(state, 0.2 / n, i * 0.2 / n)).ravel()
        return state

    exact = after(2000)
    errors = [np.abs(after(n) - exact).max() for n in (20, 40)]
    assert errors[0] / errors[1] > 11, "halving the step must reduce the error about 16-fold"


def test_the_smoothers_step_has_its_own_jacobian_with_stiff_friction() -> None:
    """With an approximate Jacobian the smoother converges slowly and stops before the optimum."""
    random, C = np.random.default_rng(7), smoothing.C
    p = np.zeros(smoothing.CONSTANTS)
    p[[C.LN_RHO, C.DRAG, C.SATURATION, C.DAMPING]] = np.log(0.013), 20.0, 7500.0, 2e-4
    p[C.SHAPE : C.SHAPE + shape.COEFFICIENTS] = _coefficients(random)
    u = np.array([0.01, *PALMS, *JERK, *RIG, 0.12, 0.12])
    step = derived(smoothing.step_function)
    x = np.array([0.2, 0.5])
    J = _array(step(x, p, u)[1])
    scale = np.concatenate([[1e-5, 1e-4, 1e-5, 1e-3, 1.0, 1e-8], np.full(smoothing.CONSTANTS - 4, 1e-7)])
    vibration = 2 + C.RIG + smoothing.R.KAPPA
    scale[vibration : vibration + 4] = 1e-5  # small influence
    numeric = np.zeros_like(J)
    for i, h in enumerate(scale):
        ends = []
        for sign in (1.0, -1.0):
            y = np.concatenate([x, p])
            y[i] += sign * h
            ends.append(_array(step(y[:2], y[2:], u)[0]).ravel())
        numeric[:, i] = (ends[0] - ends[1]) / (2 * h)
    assert pytest.approx(numeric, rel=1e-4, abs=1e-8) == J


def test_gathered_information_is_that_of_the_readings_about_the_initial_state() -> None:
    """Against differences: predicted readings of the moving shape map as functions of its initial state."""
    x0 = _shape_state(np.random.default_rng(3))
    gather, predict = derived(sensitivity.gather_function), derived(shape_map.predict_function)
    dt, steps, w = 0.002, 4, (2.0, 3.0)
    P0 = np.zeros((shape_map.N,) * 2)

    def motion(k: int) -> list[float]:
        t = k * dt
        phi, omega, alpha = (np.array(PALMS[i : i + 2]) for i in (0, 2, 4))
        return [*(phi + t * omega + t**2 / 2 * alpha), *(omega + t * alpha), *alpha]

    def inputs(k: int) -> list[float]:
        return [dt, *motion(k), 0.0, 0.0, *RIG]

    def predicted(x: np.ndarray) -> np.ndarray:
        readings = []
        for k in range(steps):
            phi1, phi2 = motion(k)[:2]
            readings.append(shape.contact_rows(phi1 - x[shape_map.Z.PSI], phi2)[1] @ x[shape_map.Z.SHAPE :])
            x = _array(predict(x, P0, inputs(k))[0]).ravel()
        return np.concatenate(readings)

    rows = _differences(predicted, x0)
    wanted = rows.T @ np.diag(w * steps) @ rows
    x, T, G = x0, np.eye(2, shape_map.N), P0
    for k in range(steps):
        T, G = gather(x, T, G, [*inputs(k), *w])
        x = _array(predict(x, P0, inputs(k))[0]).ravel()
    scale = np.sqrt(np.diag(wanted))
    assert np.abs(_array(G) - wanted).max() < 2e-4 * np.outer(scale, scale).max()
    assert np.abs(_array(G) - wanted)[:6, :6] == pytest.approx(0.0, abs=5e-4 * np.outer(scale, scale)[:6, :6].max())


def test_the_aim_is_the_gradient_of_radii_and_readings() -> None:
    x = _shape_state(np.random.default_rng(4))

    def z(at: np.ndarray) -> np.ndarray:
        radii, readings = shape.contact_rows(PALMS[0] - at[shape_map.Z.PSI], PALMS[1])
        return np.concatenate([radii, readings]) @ at[shape_map.Z.SHAPE :]

    J = _array(derived(sensitivity.aim_function)(x, [*PALMS[:2], *FLAT]))
    assert J.shape == (sensitivity.AIMED_AT, shape_map.N)
    assert pytest.approx(_differences(z, x), abs=1e-8) == J
