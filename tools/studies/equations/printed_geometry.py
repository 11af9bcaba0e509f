"""Chapter 3 of CMU-CS-01-107 and the kinematics of chapter 4 as printed, beside what geometry alone says.

The geometry: the centre of mass c is where n1·c = r1 and n2·c = r2, the contacts are c + R x_i with
R x_i = −(r_i n_i + d_i t_i), and r, d change with the normal as r′ = −d, d′ = r − v. All else follows by
differentiation along the motion: θ̇1 = ω1 − ω0, θ̇2 = ω12 − ω0.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from palmd.model.contact import normal, solve_from_normals, tangent
from palmd.model.symbolic import SX
from tools.studies.equations.equation_check import EquationCheck

sin, cos, tan, dot = ca.sin, ca.cos, ca.tan, ca.dot

r1, d1, v1, r2, d2, v2 = map(SX.sym, ("r1", "d1", "v1", "r2", "d2", "v2"))
phi1, phi2, psi = map(SX.sym, ("phi1", "phi2", "psi"))
omega0, omega1, omega2 = map(SX.sym, ("omega0", "omega1", "omega2"))
alpha0, alpha1, alpha2 = map(SX.sym, ("alpha0", "alpha1", "alpha2"))
phi12, omega12, alpha12 = phi1 + phi2, omega1 + omega2, alpha1 + alpha2
n1, t1, n2, t2 = normal(phi1, 1), tangent(phi1, 1), normal(phi12, 2), tangent(phi12, 2)

QUARTER_TURN = SX([[0, -1], [1, 0]])
RX1, RX2 = -(r1 * n1 + d1 * t1), -(r2 * n2 + d2 * t2)
COM = solve_from_normals(phi1, phi2, r1, r2)
S1, S2 = dot(t1, COM + RX1), -dot(t2, COM + RX2)


@dataclass(frozen=True, slots=True)
class PrintedSupport:
    """The generalized contact support functions r̃1, d̃1, r̃2, d̃2 (3.2) to (3.5), m."""

    r1: SX
    d1: SX
    r2: SX
    d2: SX


def along(function: SX, turn: SX | float, rate1: SX | float, rate2: SX | float) -> SX:
    """d/dt of a `function` of r, d, φ, ψ and the rates while object and palms turn at these rates."""
    theta1_dot, theta2_dot = rate1 - turn, rate1 + rate2 - turn
    moving = ca.vertcat(r1, d1, r2, d2, phi1, phi2, psi, omega0, omega1, omega2)
    speed = ca.vertcat(
        -d1 * theta1_dot, (r1 - v1) * theta1_dot, -d2 * theta2_dot, (r2 - v2) * theta2_dot,
        rate1, rate2, turn, alpha0, alpha1, alpha2,
    )  # fmt: skip
    return ca.jtimes(function, moving, speed)


def in_time(function: SX) -> SX:
    """d/dt along the motion."""
    return along(function, omega0, omega1, omega2)


def over_psi(function: SX) -> SX:
    """∂/∂ψ with the palms at rest; θ1 and θ2 fall as ψ grows (3.1), so d/dθ is its negative."""
    return along(function, 1.0, 0.0, 0.0)


def claims() -> tuple[EquationCheck, ...]:
    """(3.6) to (3.32), (4.11) to (4.17) and the appendix; all hold at any r, d, v, not only in balance."""
    # (3.2) to (3.5) in the world frame, where the object's normals are −n_i, −t_i
    between = RX1 - RX2
    tilde = PrintedSupport(-dot(between, n1), -dot(between, t1), -dot(between, n2), -dot(between, t2))
    return (*_supports(tilde, between), *_poses(tilde), *_quasistatic(tilde), *_dynamic())


def _supports(tilde: PrintedSupport, between: SX) -> tuple[EquationCheck, ...]:
    lever1, lever2 = (r1 * cos(phi2) + r2) / sin(phi2), (r2 * cos(phi2) + r1) / sin(phi2)
    theta_dot, theta2_dot = omega1 - omega0, omega12 - omega0
    return (
        EquationCheck(
            "3.6",
            ca.vertcat(S2 * sin(phi2), S2 * cos(phi2) - S1, -S1 * sin(phi2), S1 * cos(phi2) - S2),
            ca.vertcat(tilde.r1, tilde.d1, tilde.r2, tilde.d2),
        ),
        EquationCheck("3.7", S1 * t1, COM + RX1),
        EquationCheck("3.8", -S2 * t2, COM + RX2),
        EquationCheck("3.9", S1 * t1 + S2 * t2, between),
        EquationCheck("3.10", -(-over_psi(tilde.r2) + tilde.d2) / sin(phi2), v1),
        EquationCheck("3.11", -(-over_psi(tilde.r1) + tilde.d1) / sin(phi2), v2),
        EquationCheck("3.12", -(r1 * n1 + d1 * t1) + (r2 * n2 + d2 * t2), S1 * t1 + S2 * t2),
        EquationCheck("3.13", lever1 - S1, d1),
        EquationCheck("3.14", -lever2 + S2, d2),
        EquationCheck("A.1", -v2 * sin(phi2) - tilde.d1, -over_psi(tilde.r1)),
        EquationCheck("A.2", -v2 * theta2_dot * sin(phi2) - theta_dot * tilde.d1, in_time(tilde.r1)),
        EquationCheck("A.3", -v1 * sin(phi2) - tilde.d2, -over_psi(tilde.r2)),
        EquationCheck("A.4", -v1 * theta_dot * sin(phi2) - theta2_dot * tilde.d2, in_time(tilde.r2)),
    )


def _poses(tilde: PrintedSupport) -> tuple[EquationCheck, ...]:
    q1, q2 = (S2 - S1 * cos(phi2)) / sin(phi2), (S1 - S2 * cos(phi2)) / sin(phi2)
    # the point of the object that rests while ψ changes: ∂c/∂ψ is the quarter turn of c − c_r
    centre = COM + QUARTER_TURN @ over_psi(COM)
    in_object_frame = ca.vertcat(ca.horzcat(cos(psi), sin(psi)), ca.horzcat(-sin(psi), cos(psi)))
    x1 = in_object_frame @ RX1
    slope = -tilde.d2 * sin(phi1) / sin(phi2) - dot(ca.vertcat(cos(psi), -sin(psi)), x1)
    bend = (v1 * sin(phi12) + (v2 + tilde.r2) * sin(phi1)) / sin(phi2) + dot(ca.vertcat(sin(psi), cos(psi)), x1)
    return (
        EquationCheck("3.15, 3.16", S1 * t1 + q1 * n1, -S2 * t2 + q2 * n2),
        EquationCheck("below 3.16", ca.vertcat(-tilde.d2, -tilde.d1) / sin(phi2), ca.vertcat(q1, q2)),
        EquationCheck("3.17", -tilde.r2 * t1 / sin(phi2) - RX1, COM),
        EquationCheck("3.18", -(tilde.r2 * t1 + tilde.d2 * n1) / sin(phi2), centre),
        EquationCheck("3.19", -tilde.d2 * t1 / sin(phi2) - QUARTER_TURN @ RX1, over_psi(COM)),
        EquationCheck("3.20", -(v1 * n2 - v2 * n1 - tilde.r2 * n1 + tilde.d2 * t1) / sin(phi2), over_psi(centre)),
        EquationCheck("3.21", QUARTER_TURN @ (COM - centre), over_psi(COM)),
        EquationCheck("3.22", -RX1[0] - tilde.d2 * sin(phi1) / sin(phi2), over_psi(COM[1])),
        EquationCheck("3.23", slope, over_psi(COM[1])),
        EquationCheck("3.24", bend, over_psi(over_psi(COM[1]))),
        EquationCheck(
            "A.13",
            (-(v1 * sin(phi2) + tilde.d2) * t1 + (v1 * cos(phi2) + v2 + tilde.r2) * n1) / sin(phi2),
            over_psi(centre),
        ),
        EquationCheck("A.15", tilde.d2 * n1 / sin(phi2) - RX1, COM - centre),
    )


def _quasistatic(tilde: PrintedSupport) -> tuple[EquationCheck, ...]:
    theta_dot, theta2_dot = omega1 - omega0, omega12 - omega0
    r2_tilde_dot, d2_tilde_dot = in_time(tilde.r2), in_time(tilde.d2)
    r1_dot, d1_dot = in_time(r1), in_time(d1)
    # while the balance ∂c_y/∂ψ = 0 is kept, the object turns at −(∂/∂t at rest)/(∂/∂ψ) of it
    balance = over_psi(COM[1])
    turning = -along(balance, 0.0, omega1, omega2) / over_psi(balance)
    numerator = r2_tilde_dot * cos(phi1) - d2_tilde_dot * sin(phi1) + tilde.d2 * omega2 * sin(phi12) / sin(phi2)
    denominator = r1 * sin(phi12) + (r2 + tilde.r2) * sin(phi1) + tilde.d2 * cos(phi1)
    left_rate = omega0 * (d1 * sin(phi1) + r1 * cos(phi1) + tilde.d2 * cos(phi1) / sin(phi2)) - (
        r2_tilde_dot + omega12 * tilde.d2
    ) / sin(phi2) * cos(phi1)
    right_rate = (
        -d2_tilde_dot * sin(phi1) - tilde.d2 * omega1 * cos(phi1) + tilde.d2 * omega2 * sin(phi1) / tan(phi2)
    ) / sin(phi2)
    return (
        EquationCheck("3.27", -(r2_tilde_dot + theta2_dot * tilde.d2) / (theta_dot * sin(phi2)), v1),
        EquationCheck("3.28", -(in_time(tilde.r1) + theta_dot * tilde.d1) / (theta2_dot * sin(phi2)), v2),
        EquationCheck("3.31", r1 * sin(phi1) - d1 * cos(phi1), RX1[0]),
        EquationCheck("3.32", ca.substitute(numerator / denominator, omega0, turning), turning),
        EquationCheck(
            "A.18",
            (r1_dot + d1 * omega1) * sin(phi1) + (r1 * omega1 - d1_dot) * cos(phi1),
            in_time(r1 * sin(phi1) - d1 * cos(phi1)),
        ),
        EquationCheck(
            "A.19",
            d1 * (omega1 - theta_dot) * sin(phi1)
            + r1 * (omega1 - theta_dot) * cos(phi1)
            - (r2_tilde_dot + theta2_dot * tilde.d2) / sin(phi2) * cos(phi1),
            in_time(r1 * sin(phi1) - d1 * cos(phi1)),
        ),
        EquationCheck("A.21", left_rate, in_time(r1 * sin(phi1) - d1 * cos(phi1))),
        EquationCheck("A.22", right_rate, in_time(-tilde.d2 * sin(phi1) / sin(phi2))),
    )


def _dynamic() -> tuple[EquationCheck, ...]:
    a0 = in_time(in_time(COM))
    s1_dot, s2_dot = in_time(S1), in_time(S2)
    slide1, slide2 = omega1 - omega0, omega12 - omega0
    pull1 = S1 * alpha1 - omega0**2 * r1 - dot(a0, n1) + alpha0 * d1
    pull2 = -S2 * alpha12 - omega0**2 * r2 - dot(a0, n2) + alpha0 * d2
    curvature = -((-s1_dot * sin(phi2) - S1 * omega2 * cos(phi2)) + slide2 * (S1 * cos(phi2) - S2)) / (
        slide1 * sin(phi2)
    )
    rate1 = (
        -pull1 / slide1 - (omega1 + omega0) / tan(phi2) * S1 + (omega1 + omega0) * slide2 / (slide1 * sin(phi2)) * S2
    )
    rate2 = (
        pull2 / slide2 + (omega12 + omega0) / tan(phi2) * S2 - (omega12 + omega0) * slide1 / (slide2 * sin(phi2)) * S1
    )
    return (
        EquationCheck("4.11", (2 * s1_dot * omega1 + pull1) / (omega1**2 - omega0**2), v1),
        EquationCheck("4.12", curvature, v1),
        EquationCheck("4.16", rate1, s1_dot),
        EquationCheck("4.17", rate2, s2_dot),
    )
