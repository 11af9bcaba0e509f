"""The systems of CMU-CS-01-107, chapter 4, as the paper writes them, and their observability codistributions.

palmd estimates with `model/dynamics.py`, which keeps v1 and v2. The systems here eliminate them instead and divide by
the contacts' sliding rates ω1 − ω0 and ω12 − ω0. They serve to check the paper and to ask what can be observed.

All symbols are SI. `gravity` is positive; the scalar g of (4.23) to (4.57) is its negative. The fields of the special
cases follow from the general ones by substitution; `printed_dynamics.py` holds what the paper prints for them.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from typing import Literal, get_args

import casadi as ca
import numpy as np

from palmd.events import FloatArray
from palmd.model.contact import normal, offsets
from palmd.model.symbolic import SX

Case = Literal["general", "equal rates", "palm 1 fixed", "palms fixed", "palms fixed, with inputs"]
CASES: tuple[Case, ...] = get_args(Case)

POINT = (
    "r1", "r2", "omega0", "s1", "s2", "phi1", "omega1", "phi2", "omega2", "rho", "mass", "gravity",
)  # fmt: skip
"""What a codistribution is evaluated at, in this order, SI: the paper's ten states, the object's mass, gravity > 0."""

r1, r2, omega0, s1, s2, phi1, omega1, phi2, omega2, rho, mass, gravity = map(SX.sym, POINT)
alpha1, alpha2, inertia1, inertia2, tau1, tau2 = map(
    SX.sym, ("alpha1", "alpha2", "inertia1", "inertia2", "tau1", "tau2")
)
g = -gravity
phi12, omega12, alpha12 = phi1 + phi2, omega1 + omega2, alpha1 + alpha2
d1, d2 = offsets(phi2, r1, r2, s1, s2)  # (3.13), (3.14)


@dataclass(frozen=True, slots=True)
class PaperSystem:
    """q̇ = f(q) + τ1 g1(q) + τ2 g2(q), y = h(q): (4.1), (4.2)."""

    state: SX
    drift: SX
    input1: SX
    input2: SX
    outputs: SX


@dataclass(frozen=True, slots=True)
class Observed:
    """Functions of the observation space (4.28) of a system, by name, chosen to span its codistribution (4.29)."""

    system: PaperSystem
    functions: dict[str, SX]

    def codistribution(self) -> SX:
        """The differentials of the functions as rows, one column a state (4.29)."""
        return ca.jacobian(ca.vertcat(*self.functions.values()), self.system.state)

    def differential(self, name: str) -> SX:
        """Of one of the functions, a row."""
        return ca.jacobian(self.functions[name], self.system.state)


def lie(field: SX, function: SX, state: SX) -> SX:
    """L_X φ = X · dφ, the derivative of `function` along `field`, as above (4.28)."""
    return ca.jtimes(function, state, field)


def accelerations() -> tuple[SX, SX]:
    """(a0, α0) of the object from the palms' torques and accelerations (4.9), (4.10); m/s², rad/s²."""
    push1 = (inertia1 * alpha1 - tau1) / (mass * s1)  # −fc1/m of (4.7)
    push2 = (inertia2 * alpha12 - tau2) / (mass * s2)  # fc2/m of (4.8)
    a0 = -push1 * normal(phi1, 1) + push2 * normal(phi12, 2) + ca.vertcat(0, g)
    return a0, (push1 * d1 - push2 * d2) / rho**2


def contact_rates(a0: SX, alpha0: SX) -> tuple[SX, SX]:
    """(ṡ1, ṡ2) by (4.16), (4.17), m/s, from the object's accelerations; infinite where it turns with a palm."""
    slide1, slide2 = omega1 - omega0, omega12 - omega0
    along1, along2 = ca.dot(a0, normal(phi1, 1)), ca.dot(a0, normal(phi12, 2))
    s1_dot = (
        -(s1 * alpha1 - omega0**2 * r1 - along1 + alpha0 * d1) / slide1
        - (omega1 + omega0) / ca.tan(phi2) * s1
        + (omega1 + omega0) * slide2 / (slide1 * ca.sin(phi2)) * s2
    )
    s2_dot = (
        (-s2 * alpha12 - omega0**2 * r2 - along2 + alpha0 * d2) / slide2
        + (omega12 + omega0) / ca.tan(phi2) * s2
        - (omega12 + omega0) * slide1 / (slide2 * ca.sin(phi2)) * s1
    )
    return s1_dot, s2_dot


@cache
def general() -> PaperSystem:
    """Both palms under torque control: (4.13) to (4.22), the fields (4.25), (4.26), the outputs (4.27).

    The palms' accelerations and moments of inertia stay symbols: the paper has no law for them.
    """
    a0, alpha0 = accelerations()
    s1_dot, s2_dot = contact_rates(a0, alpha0)
    rates = ca.vertcat(
        -d1 * (omega1 - omega0), -d2 * (omega12 - omega0), alpha0, s1_dot, s2_dot, omega1, alpha1, omega2, alpha2, 0
    )
    torques = ca.vertcat(tau1, tau2)
    inputs = ca.jacobian(rates, torques)
    return PaperSystem(
        state=ca.vertcat(r1, r2, omega0, s1, s2, phi1, omega1, phi2, omega2, rho),
        drift=ca.substitute(rates, torques, SX.zeros(2)),
        input1=inputs[:, 0],
        input2=inputs[:, 1],
        outputs=ca.vertcat(s1, s2, phi1, omega1, phi2, omega2),
    )


def _restricted(angle: SX | None, resting: Iterable[SX]) -> PaperSystem:
    """The general system at constant rates, those `resting` zero, with ρ known and `angle` the one that moves."""
    whole = general()
    zero = ca.vertcat(alpha1, alpha2, *resting)
    moving = [r1, r2, omega0, s1, s2] + ([] if angle is None else [angle])
    rows = [next(i for i in range(10) if ca.is_equal(whole.state[i], symbol)) for symbol in moving]
    drift, input1, input2 = (
        ca.substitute(field[rows], zero, SX.zeros(*zero.shape)) for field in (whole.drift, whole.input1, whole.input2)
    )
    return PaperSystem(ca.vertcat(*moving), drift, input1, input2, ca.vertcat(*moving[3:]))


@cache
def equal_rates() -> PaperSystem:
    """Both palms turn at the same constant rate, ω2 = 0 (4.36)."""
    return _restricted(phi1, [omega2])


@cache
def palm1_fixed() -> PaperSystem:
    """Palm 1 stands, palm 2 turns at a constant rate, ω1 = 0 (4.47)."""
    return _restricted(phi2, [omega1])


@cache
def palms_fixed() -> PaperSystem:
    """Both palms are held where they are by their torques, ω1 = ω2 = 0 (4.58)."""
    return _restricted(None, [omega1, omega2])


@cache
def observed(case: Case) -> Observed:
    """The functions whose differentials the paper takes to span the codistribution in each case.

    (4.30) to (4.35) and below, (4.37) to (4.45), (4.48) to (4.56), (4.59) to (4.66), (4.67).
    """
    if case == "general":
        system = general()
        measured = {"s1": s1, "s2": s2, "φ1": phi1, "ω1": omega1, "φ2": phi2, "ω2": omega2}
        once1, once2 = lie(system.input1, s1, system.state), lie(system.input2, s2, system.state)
        twice1, twice2 = lie(system.input1, once1, system.state), lie(system.input2, once2, system.state)
        return Observed(
            system, measured | {"Lg1 s1": once1, "Lg2 s2": once2, "Lg1 Lg1 s1": twice1, "Lg2 Lg2 s2": twice2}
        )
    system = {"equal rates": equal_rates, "palm 1 fixed": palm1_fixed}.get(case, palms_fixed)()
    f1, f2 = (lie(system.drift, s, system.state) for s in (s1, s2))
    touched, turning = {"s1": s1, "s2": s2}, {"Lf s1": f1, "Lf s2": f2}
    if case == "equal rates":
        functions = touched | {"φ1": phi1} | turning | {"Lf Lf s1": lie(system.drift, f1, system.state)}
    elif case == "palm 1 fixed":
        functions = touched | {"φ2": phi2} | turning | {"Lf Lf s2": lie(system.drift, f2, system.state)}
    elif case == "palms fixed":
        twice = {f"Lf Lf s{i}": lie(system.drift, f, system.state) for i, f in ((1, f1), (2, f2))}
        functions = touched | turning | twice
    else:
        functions = touched | turning | {"Lg1 s1": lie(system.input1, s1, system.state)}
    return Observed(system, functions)


def determinant(case: Case) -> SX:
    """Of the codistribution of a constant-rate case, rows in the order of `observed`: (4.46), (4.57)."""
    return ca.det(observed(case).codistribution())


def codistribution(case: Case, points: FloatArray) -> FloatArray:
    """The codistribution (4.29) at each of `points` (n, 12), SI, as `POINT` orders them: (n, functions, states).

    Rows are in the order of `observed(case).functions`, columns in that of its system's state. Infinite or NaN where
    the paper's equations are: ω0 = ω1 or ω0 = ω12, and sin φ2 = 0. Not for the loop.
    """
    function = _codistribution_function(case)
    rows, columns = function.size_out(0)
    values = np.asarray(function(np.atleast_2d(points).T), dtype=np.float64)
    return values.reshape(rows, -1, columns).transpose(1, 0, 2)


@cache
def _codistribution_function(case: Case) -> ca.Function:
    symbols = ca.vertcat(general().state, mass, gravity)
    return ca.Function("codistribution", [symbols], [ca.densify(ca.cse(observed(case).codistribution()))])
