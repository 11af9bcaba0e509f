"""Chapter 4 of CMU-CS-01-107 as printed: the general case and fixed palms, beside what `paper.py` derives.

Fraction bars lost in the text are put back where they must have been; signs and terms stay as they are printed. What
is wrong here is wrong in the paper, see `errata.py`.
"""

from __future__ import annotations

import casadi as ca

from palmd.model.symbolic import SX
from tools.studies.equations import paper
from tools.studies.equations.equation_check import EquationCheck
from tools.studies.equations.paper import (
    alpha1,
    alpha12,
    d1,
    d2,
    g,
    inertia1,
    inertia2,
    mass,
    omega0,
    omega1,
    omega2,
    omega12,
    phi1,
    phi2,
    phi12,
    r1,
    r2,
    rho,
    s1,
    s2,
    tau1,
    tau2,
)

sin, cos, tan, row = ca.sin, ca.cos, ca.tan, ca.horzcat


def claims() -> tuple[EquationCheck, ...]:
    """(4.23) to (4.35) and (4.58) to (4.68)."""
    return (*_general(), *_palms_fixed())


def _general() -> tuple[EquationCheck, ...]:
    a0, alpha0 = paper.accelerations()
    along1 = -ca.dot(a0, _normal1()) + alpha0 * d1
    along2 = -ca.dot(a0, _normal2()) + alpha0 * d2
    push1, push2 = inertia1 * alpha1 - tau1, inertia2 * alpha12 - tau2
    cross = rho**2 * cos(phi2) - d1 * d2
    square1, square2 = rho**2 + d1**2, rho**2 + d2**2
    weight1, weight2 = mass * rho**2 * s1, mass * rho**2 * s2
    slide1, slide2 = omega1 - omega0, omega12 - omega0
    system = paper.general()
    drift = ca.vertcat(
        -d1 * slide1,
        -d2 * slide2,
        inertia1 * alpha1 * d1 / weight1 - inertia2 * alpha12 * d2 / weight2,
        (-s1 * alpha1 + omega0**2 * r1 + g * cos(phi1)) / slide1
        - inertia1 * alpha1 * square1 / (weight1 * slide1)
        - inertia2 * alpha12 * cross / (weight2 * slide1)
        - (omega1 + omega0) / tan(phi2) * s1
        + (omega1 + omega0) * slide2 / (slide1 * sin(phi2)) * s2,
        (-s2 * alpha12 - omega0**2 * r2 + g * cos(phi12)) / slide2
        - inertia1 * alpha1 * cross / (weight1 * slide2)
        - inertia2 * alpha12 * square2 / (weight2 * slide2)
        + (omega12 + omega0) / tan(phi2) * s2
        - (omega12 + omega0) * slide1 / (slide2 * sin(phi2)) * s1,
        omega1,
        alpha1,
        omega2,
        paper.alpha2,
        0,
    )
    input1 = ca.vertcat(0, 0, -d1 / weight1, square1 / (weight1 * slide1), cross / (weight1 * slide2), SX.zeros(5))
    input2 = ca.vertcat(0, 0, d2 / weight2, cross / (weight2 * slide1), square2 / (weight2 * slide2), SX.zeros(5))
    outputs = ca.jacobian(system.outputs, system.state)
    return (
        EquationCheck("4.23", push1 * square1 / weight1 + push2 * cross / weight2 - g * cos(phi1), along1),
        EquationCheck("4.24", -push1 * cross / weight1 - push2 * square2 / weight2 + g * cos(phi12), along2),
        EquationCheck("4.25", drift, system.drift),
        EquationCheck("4.26 g1", input1, system.input1),
        EquationCheck("4.26 g2", input2, system.input2),
        *(
            EquationCheck(f"4.{30 + i}", SX(row(*(float(column == one) for column in range(10)))), outputs[i, :])
            for i, one in enumerate((3, 4, 5, 6, 7, 8))
        ),
    )


def _normal1() -> SX:
    return ca.vertcat(-sin(phi1), cos(phi1))


def _normal2() -> SX:
    return ca.vertcat(sin(phi12), -cos(phi12))


def _palms_fixed() -> tuple[EquationCheck, ...]:
    system = paper.palms_fixed()
    functions = paper.observed("palms fixed").functions
    inside1 = r1 + s1 / tan(phi2) - s2 / sin(phi2)
    inside2 = r2 + s2 / tan(phi2) - s1 / sin(phi2)
    gravity1, gravity2 = g * cos(phi1) / omega0, g * cos(phi12) / omega0
    weight1, weight2 = mass * rho**2 * s1, mass * rho**2 * s2
    square1, square2 = rho**2 + d1**2, rho**2 + d2**2
    cross = rho**2 * cos(phi2) - d1 * d2
    drift = ca.vertcat(d1 * omega0, d2 * omega0, 0, -gravity1 - omega0 * inside1, -gravity2 + omega0 * inside2)
    input1 = ca.vertcat(0, 0, -d1 / weight1, -square1 / (weight1 * omega0), -cross / (weight1 * omega0))
    input2 = ca.vertcat(0, 0, d2 / weight2, -cross / (weight2 * omega0), -square2 / (weight2 * omega0))
    s1_dot, s2_dot = -gravity1 - omega0 * inside1, -gravity2 - omega0 * inside2
    d_s1_dot = row(-omega0, 0, gravity1 / omega0 - inside1, -omega0 / tan(phi2), omega0 / sin(phi2))
    d_s2_dot = row(0, -omega0, -gravity2 / omega0 - inside2, omega0 / sin(phi2), -omega0 / tan(phi2))
    along_input = -square1 / (weight1 * omega0)
    d_along_input = row(-2 * d1 / tan(phi2), -2 * d1 / sin(phi2), square1 / omega0, 2 * d1 + square1 / s1, 0) / (
        weight1 * omega0
    )
    s1_ddot = omega0**2 * (-d1 + r1 / tan(phi2) + r2 / sin(phi2) - s1) + g * sin(phi1)
    return (
        EquationCheck("4.58 f", drift, system.drift),
        EquationCheck("4.58 g1", input1, system.input1),
        EquationCheck("4.58 g2", input2, system.input2),
        EquationCheck("4.61", s1_dot, functions["Lf s1"]),
        EquationCheck("4.62", d_s1_dot, paper.observed("palms fixed").differential("Lf s1")),
        EquationCheck("4.63", s2_dot, functions["Lf s2"]),
        EquationCheck("4.64", d_s2_dot, paper.observed("palms fixed").differential("Lf s2")),
        EquationCheck("4.65", ca.vertcat(s1_ddot, g * sin(phi1)), ca.vertcat(*[functions["Lf Lf s1"]] * 2)),
        EquationCheck("4.66", SX.zeros(1, 5), paper.observed("palms fixed").differential("Lf Lf s1")),
        EquationCheck("4.67", along_input, paper.observed("palms fixed, with inputs").functions["Lg1 s1"]),
        EquationCheck("4.68", d_along_input, paper.observed("palms fixed, with inputs").differential("Lg1 s1")),
    )
