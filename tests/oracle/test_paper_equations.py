"""The paper's printed equations against the derived ones, and the derived ones against other formulations.

The systems of chapter 4 are checked without their own kinematics: the general one against Lagrange's equations of a
body with an explicit outline, those at constant rates against free flight, which is what their drift describes.
"""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest

from tools.studies.equations import errata, paper
from tools.studies.equations.equation_check import EquationCheck

TOLERANCE = 1e-10
POINTS = 20
GRAVITY = 9.81


def _point(claim: EquationCheck, random: np.random.Generator) -> dict[str, float]:
    """Values of about 1, with the object turning against the palms: no denominator comes near zero."""
    return {
        name: random.uniform(-3.0, -2.0) if name == "omega0" else random.uniform(0.4, 1.4) for name in claim.names()
    }


def _mismatch(claim: EquationCheck, random: np.random.Generator) -> float:
    """The largest difference over POINTS points, relative to the largest entry."""
    worst = 0.0
    for _ in range(POINTS):
        printed, derived = claim.values(_point(claim, random))
        assert np.isfinite(derived).all()
        scale = max(np.abs(derived).max(), np.abs(printed).max(), 1e-3)
        worst = max(worst, float(np.abs(printed - derived).max() / scale))
    return worst


CLAIMS = errata.claims()
ERRATA = errata.errata()
WRONG = {one.claim.equation for one in ERRATA}


@pytest.mark.parametrize("equation", [name for name in CLAIMS if name not in WRONG])
def test_the_printed_equation_follows(equation: str) -> None:
    assert _mismatch(CLAIMS[equation], np.random.default_rng(1)) < TOLERANCE


@pytest.mark.parametrize("equation", sorted(WRONG))
def test_an_erratum_is_one_everywhere(equation: str) -> None:
    assert _mismatch(CLAIMS[equation], np.random.default_rng(2)) > 1e-3


@pytest.mark.parametrize("erratum", ERRATA, ids=lambda one: one.claim.equation)
def test_the_correction_follows_everywhere(erratum: errata.Erratum) -> None:
    corrected = EquationCheck(erratum.equation, erratum.corrected, erratum.claim.derived)
    assert _mismatch(corrected, np.random.default_rng(3)) < TOLERANCE


def test_no_equation_is_listed_twice_and_chapter_4_is_complete() -> None:
    modules = (errata.printed_geometry, errata.printed_dynamics, errata.printed_rates)
    assert len(CLAIMS) == sum(len(module.claims()) for module in modules)
    numbers = {name.split(",")[0].split()[0] for name in CLAIMS}
    derived = [*range(23, 27), *range(30, 37), *range(40, 48), *range(51, 59), *range(61, 69)]
    assert {f"4.{k}" for k in derived} <= numbers


# ------------------------------------------------------------------------------- other formulations


class Lagrange:
    """A body with an explicit outline under torques of the palms, by d/dt ∂L/∂q̇ − ∂L/∂q in q = (ψ, φ1, φ2)."""

    MASS, RHO, INERTIA = 0.12, 0.014, (2e-4, 3e-4)

    def __init__(self, random: np.random.Generator) -> None:
        lump = [(0, 0.02, 0.0)] + [
            (k, random.uniform(-1, 1) * 1e-3 * (2 / k) ** 2, random.uniform(0, 6)) for k in range(1, 6)
        ]
        q, q_dot, q_ddot = ca.SX.sym("q", 3), ca.SX.sym("q_dot", 3), ca.SX.sym("q_ddot", 3)
        psi, phi1, phi12 = q[0], q[1], q[1] + q[2]

        def h(theta: ca.SX) -> ca.SX:
            return sum(a * ca.cos(k * theta + c) for k, a, c in lump)

        n1, n2 = ca.vertcat(-ca.sin(phi1), ca.cos(phi1)), ca.vertcat(ca.sin(phi12), -ca.cos(phi12))
        thetas = (phi1 - psi - ca.pi / 2, phi12 - psi - 3 * ca.pi / 2)
        radii = [h(theta) for theta in thetas]
        com = ca.solve(ca.horzcat(n1, n2).T, ca.vertcat(*radii))

        def boundary(theta: ca.SX) -> ca.SX:
            """The outline's point h n + h′ n′ in the world."""
            angle = ca.SX.sym("angle")
            slope = ca.substitute(ca.jacobian(h(angle), angle), angle, theta)
            turned = theta + psi
            n, along = ca.vertcat(ca.cos(turned), ca.sin(turned)), ca.vertcat(-ca.sin(turned), ca.cos(turned))
            return com + h(theta) * n + slope * along

        distances = [ca.sqrt(ca.sumsqr(boundary(theta))) for theta in thetas]
        com_dot = ca.jtimes(com, q, q_dot)
        kinetic = (
            self.MASS * (ca.sumsqr(com_dot) + (self.RHO * q_dot[0]) ** 2)
            + self.INERTIA[0] * q_dot[1] ** 2
            + self.INERTIA[1] * (q_dot[1] + q_dot[2]) ** 2
        ) / 2
        lagrangian = kinetic - self.MASS * GRAVITY * com[1]
        momentum = ca.gradient(lagrangian, q_dot)
        force = ca.jtimes(momentum, q, q_dot) + ca.jtimes(momentum, q_dot, q_ddot) - ca.gradient(lagrangian, q)
        rates = [ca.jtimes(one, q, q_dot) for one in (*radii, *distances)]
        self.force = ca.Function("force", [q, q_dot, q_ddot], [force])
        self.contacts = ca.Function("contacts", [q, q_dot], [ca.vertcat(*radii, *distances), ca.vertcat(*rates)])


@pytest.mark.parametrize("seed", range(6))
def test_the_general_system_moves_as_lagrange_says(seed: int) -> None:
    """(4.3) to (4.27): for any torques the state's rate is f + τ1 g1 + τ2 g2."""
    random = np.random.default_rng(seed)
    body = Lagrange(random)
    q = np.array([random.uniform(-3, 3), random.uniform(0.3, 1.1), random.uniform(1.2, 1.8)])
    q_dot, alpha = random.uniform(-2, 2, 3), random.uniform(-5, 5, 2)
    # no generalized force acts on ψ, and it is linear in ψ̈
    at_rest, more = (float(body.force(q, q_dot, [a, *alpha])[0]) for a in (0.0, 1.0))
    alpha0 = -at_rest / (more - at_rest)
    _, both, tau2 = np.asarray(body.force(q, q_dot, [alpha0, *alpha])).ravel()
    tau1 = both - tau2  # the torque on palm 2 turns with φ1 as well
    (r1, r2, s1, s2), (r1_dot, r2_dot, s1_dot, s2_dot) = (np.asarray(each).ravel() for each in body.contacts(q, q_dot))

    system = paper.general()
    values = {
        "r1": r1, "r2": r2, "omega0": q_dot[0], "s1": s1, "s2": s2, "phi1": q[1], "omega1": q_dot[1], "phi2": q[2],
        "omega2": q_dot[2], "rho": body.RHO, "mass": body.MASS, "gravity": GRAVITY, "alpha1": alpha[0],
        "alpha2": alpha[1], "inertia1": body.INERTIA[0], "inertia2": body.INERTIA[1],
    }  # fmt: skip
    rate = system.drift + tau1 * system.input1 + tau2 * system.input2
    derived = [r1_dot, r2_dot, alpha0, s1_dot, s2_dot, q_dot[1], alpha[0], q_dot[2], alpha[1], 0.0]
    claim = EquationCheck("4.25, 4.26", rate, ca.SX(derived))
    got, wanted = claim.values(values)
    assert got == pytest.approx(wanted, rel=1e-8, abs=1e-10)


def _free_flight(case: paper.Case) -> ca.SX:
    """The codistribution of a case at constant rates, from an object that flies: c = c0 + ċ0 t + ½ (0, −g) t².

    A palm's distance from it, r = n·c, changes at −d (ω − ω0), so that s1 = t1·c − d1, s2 = d2 − t2·c are functions
    of time alone; state and flight belong together one to one.
    """
    p = paper
    omega1 = ca.SX(0) if case in ("palm 1 fixed", "palms fixed") else p.omega1
    omega2 = p.omega2 if case == "palm 1 fixed" else ca.SX(0)
    t = ca.SX.sym("t")
    angles = (p.phi1 + omega1 * t, p.phi1 + p.phi2 + (omega1 + omega2) * t)
    slides = (omega1 - p.omega0, omega1 + omega2 - p.omega0)
    normals = [sign * ca.vertcat(-ca.sin(a), ca.cos(a)) for sign, a in zip((1, -1), angles, strict=True)]
    tangents = [sign * ca.vertcat(ca.cos(a), ca.sin(a)) for sign, a in zip((1, -1), angles, strict=True)]
    both = ca.substitute(ca.vertcat(*(n.T for n in normals)), t, 0)
    along = ca.substitute(ca.vertcat(*(n.T for n in tangents)), t, 0)
    c0 = ca.solve(both, ca.vertcat(p.r1, p.r2))
    d = ca.vertcat((along @ c0)[0] - p.s1, (along @ c0)[1] + p.s2)
    rates = ca.vertcat(omega1, omega1 + omega2)
    c0_dot = ca.solve(both, -d * ca.vertcat(*slides) + rates * (along @ c0))
    c = c0 + c0_dot * t + ca.vertcat(0, -p.gravity) * t**2 / 2
    offset = [-ca.jacobian(ca.dot(n, c), t) / slide for n, slide in zip(normals, slides, strict=True)]
    s1, s2 = ca.dot(tangents[0], c) - offset[0], offset[1] - ca.dot(tangents[1], c)

    def in_time(order: int, function: ca.SX) -> ca.SX:
        for _ in range(order):
            function = ca.jacobian(function, t)
        return ca.substitute(function, t, 0)

    functions = {
        "s1": in_time(0, s1), "s2": in_time(0, s2), "φ1": p.phi1, "φ2": p.phi2,
        "Lf s1": in_time(1, s1), "Lf s2": in_time(1, s2), "Lf Lf s1": in_time(2, s1), "Lf Lf s2": in_time(2, s2),
    }  # fmt: skip
    observed = p.observed(case)
    return ca.jacobian(ca.vertcat(*(functions[name] for name in observed.functions)), observed.system.state)


@pytest.mark.parametrize("case", ["equal rates", "palm 1 fixed", "palms fixed"])
def test_the_drift_at_constant_rates_is_free_flight(case: paper.Case) -> None:
    claim = EquationCheck(case, paper.observed(case).codistribution(), _free_flight(case))
    assert _mismatch(claim, np.random.default_rng(4)) < TOLERANCE


# ---------------------------------------------------------------------------------- where it fails


def _typical(**changed: float) -> np.ndarray:
    return np.array([[(dict(errata.WITNESS) | changed)[name] for name in paper.POINT]])


def _determinant(case: paper.Case, point: np.ndarray) -> float:
    return float(np.linalg.det(paper.codistribution(case, point)[0]))


def test_numbers_are_those_of_the_symbols() -> None:
    """`codistribution` orders states, functions and points as it says; (4.46) corrected, at two points at once."""
    points = np.vstack([_typical(), _typical(omega0=0.4, phi1=1.1)])
    got = np.linalg.det(paper.codistribution("equal rates", points))
    for value, (omega0, phi1) in zip(got, ((-1.3, 0.7), (0.4, 1.1)), strict=True):
        assert value == pytest.approx(GRAVITY * omega0**4 * 0.9 * math.sin(phi1) / (0.9 - omega0) ** 4, rel=1e-9)


@pytest.mark.parametrize("changed", [{"omega0": 0.0}, {"omega1": 0.0}, {"phi1": 0.0}])
def test_zeros_at_equal_rates(changed: dict[str, float]) -> None:
    usual = abs(_determinant("equal rates", _typical()))
    assert abs(_determinant("equal rates", _typical(**changed))) < 1e-12 * usual


def test_a_level_palm_1_leaves_equal_rates_observable_by_the_other_contact() -> None:
    observed = paper.observed("equal rates")
    system, rows = observed.system, observed.codistribution()
    twice = paper.lie(system.drift, observed.functions["Lf s2"], system.state)
    exchanged = ca.vertcat(rows[:5, :], ca.jacobian(twice, system.state))
    level, _ = EquationCheck("", ca.det(exchanged), ca.det(rows)).values(dict(errata.WITNESS) | {"phi1": 0.0})
    usual, _ = EquationCheck("", ca.det(exchanged), ca.det(rows)).values(errata.WITNESS)
    assert abs(level[0]) > 0.1 * abs(usual[0])
    mirrored, _ = EquationCheck("", ca.det(exchanged), ca.det(rows)).values(
        dict(errata.WITNESS) | {"phi1": math.pi - 1.6}
    )
    assert abs(mirrored[0]) < 1e-12 * abs(usual[0]), "φ12 = π"


def test_the_general_case_fails_on_one_surface() -> None:
    """d1² (ρ²−d2²) (ω1−ω0) = d2² (ρ²−d1²) (ω12−ω0), in the witness's offsets solved for ω2."""
    w = errata.WITNESS
    sin, cos = math.sin(w["phi2"]), math.cos(w["phi2"])
    d1 = (w["r1"] * cos + w["r2"]) / sin - w["s1"]
    d2 = w["s2"] - (w["r2"] * cos + w["r1"]) / sin
    ratio = d1**2 * (w["rho"] ** 2 - d2**2) / (d2**2 * (w["rho"] ** 2 - d1**2))
    omega2 = (ratio - 1.0) * (w["omega1"] - w["omega0"])
    usual = abs(_determinant("general", _typical()))
    assert abs(_determinant("general", _typical(omega2=omega2))) < 1e-9 * usual
    assert abs(_determinant("general", _typical(omega2=omega2 + 0.1))) > 1e-3 * usual


def test_a_circle_is_never_told_by_the_general_case() -> None:
    r, phi2 = 0.02, errata.WITNESS["phi2"]
    s = r / math.tan(phi2 / 2)
    usual = abs(_determinant("general", _typical()))
    assert abs(_determinant("general", _typical(r1=r, r2=r, s1=s, s2=s))) < 1e-12 * usual
