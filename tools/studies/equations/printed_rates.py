"""Chapter 4 of CMU-CS-01-107 as printed: palms at constant rates, beside what `paper.py` derives.

Fraction bars lost in the text are put back where they must have been; signs and terms stay as they are printed. What
is wrong here is wrong in the paper, see `errata.py`.
"""

from __future__ import annotations

import casadi as ca

from tools.studies.equations import paper
from tools.studies.equations.equation_check import EquationCheck
from tools.studies.equations.paper import d1, d2, g, omega0, omega1, omega2, phi1, phi2, phi12, r1, r2, s1, s2

sin, cos, tan, row = ca.sin, ca.cos, ca.tan, ca.horzcat


def claims() -> tuple[EquationCheck, ...]:
    """(4.36) to (4.57)."""
    return (*_equal_rates(), *_palm1_fixed())


def _equal_rates() -> tuple[EquationCheck, ...]:
    system, slide = paper.equal_rates(), omega1 - omega0
    functions = paper.observed("equal rates").functions
    s1_dot = (omega0**2 * r1 + g * cos(phi1)) / slide + (omega1 + omega0) * (s2 - s1 * cos(phi2)) / sin(phi2)
    s2_dot = (-(omega0**2) * r2 + g * cos(phi12)) / slide + (omega1 + omega0) * (s2 * cos(phi2) - s1) / sin(phi2)
    drift = ca.vertcat(-d1 * slide, -d2 * slide, 0, s1_dot, s2_dot, omega1)
    lever = r1 * cos(phi2) + r2
    d_s1_dot = row(
        omega0**2 / slide,
        0,
        (r1 * omega0 * (2 * omega1 - omega0) + g * cos(phi1)) / slide**2 + (s2 - s1 * cos(phi2)) / sin(phi2),
        -(omega1 + omega0) / tan(phi2),
        (omega1 + omega0) / sin(phi2),
        -g * sin(phi1) / slide,
    )
    d_s2_dot = row(
        0,
        -(omega0**2) / slide,
        (-r2 * omega0 * (2 * omega1 - omega0) + g * cos(phi12)) / slide**2 + (s2 * cos(phi2) - s1) / sin(phi2),
        -(omega1 + omega0) / sin(phi2),
        (omega1 + omega0) / tan(phi2),
        -g * sin(phi12) / slide,
    )
    s1_ddot = (
        -2 * omega0**2 * omega1 * lever / (slide * sin(phi2))
        - s1 * omega1 * (2 * omega0 + omega1)
        - g * sin(phi1) * (omega0 + 2 * omega1) / slide
    )
    d_s1_ddot = row(
        -2 * omega0**2 * omega1 / (slide * tan(phi2)),
        -2 * omega0**2 * omega1 / (slide * sin(phi2)),
        -2 * omega0 * omega1 * (2 * omega1 - omega0) * lever / (slide**2 * sin(phi2))
        - 2 * s1 * omega1
        - 3 * omega1 * g * sin(phi1) / slide**2,
        -omega1 * (2 * omega0 + omega1),
        0,
        -g * cos(phi1) * (omega0 + 2 * omega1) / slide,
    )
    return (
        EquationCheck("4.36", drift, system.drift),
        EquationCheck("4.40", s1_dot, functions["Lf s1"]),
        EquationCheck("4.41", d_s1_dot, paper.observed("equal rates").differential("Lf s1")),
        EquationCheck("4.42", s2_dot, functions["Lf s2"]),
        EquationCheck("4.43", d_s2_dot, paper.observed("equal rates").differential("Lf s2")),
        EquationCheck("4.44", s1_ddot, functions["Lf Lf s1"]),
        EquationCheck("4.45", d_s1_ddot, paper.observed("equal rates").differential("Lf Lf s1")),
        EquationCheck("4.46", g * omega0**4 * omega1 * sin(phi1) / slide**4, paper.determinant("equal rates")),
    )


def _palm1_fixed() -> tuple[EquationCheck, ...]:
    system, slide, both = paper.palm1_fixed(), omega2 - omega0, omega2 + omega0
    functions = paper.observed("palm 1 fixed").functions
    s1_dot = -(omega0**2 * r1 + g * cos(phi1)) / omega0 - omega0 * s1 / tan(phi2) - slide * s2 / sin(phi2)
    s2_dot = (
        (-(omega0**2) * r2 + g * cos(phi12)) / slide + both * s2 / tan(phi2) + both * omega0 * s1 / (slide * sin(phi2))
    )
    drift = ca.vertcat(d1 * omega0, -d2 * slide, 0, s1_dot, s2_dot, omega2)
    lever = r1 + r2 * cos(phi2)
    d_s1_dot = row(
        -omega0,
        0,
        -r1 + g * cos(phi1) / omega0**2 - s1 / tan(phi2) + s2 / sin(phi2),
        -omega0 / tan(phi2),
        -slide / sin(phi2),
        (omega0 * s1 + slide * s2 * cos(phi2)) / sin(phi2) ** 2,
    )
    d_s2_dot = row(
        0,
        -(omega0**2) / slide,
        (-r2 * omega0 * (2 * omega2 - omega0) + g * cos(phi12)) / slide**2
        + s2 / tan(phi2)
        - s1 * (omega2**2 + 2 * omega0 * omega2 - omega0**2) / (slide**2 * sin(phi2)),
        both * omega0 / (slide * sin(phi2)),
        both / tan(phi2),
        -g * sin(phi12) / slide
        - s2 * both / sin(phi2) ** 2
        - both * omega0 * s1 * cos(phi2) / (slide * sin(phi2) ** 2),
    )
    s2_ddot = (
        -2 * omega0**2 * omega2 * lever / (slide * sin(phi2))
        - s2 * omega2 * (2 * omega0 + omega2)
        - g * (omega0 + 2 * omega2) * sin(phi12) / slide
    )
    d_s2_ddot = row(
        -2 * omega0**2 * omega2 / (slide * sin(phi2)),
        -2 * omega0**2 * omega2 / (slide * tan(phi2)),
        -2 * omega0 * omega2 * (2 * omega2 - omega0) * lever / (slide**2 * sin(phi2))
        - 2 * s2 * omega2
        - 3 * omega2 * g * sin(phi12) / slide**2,
        0,
        -omega2 * (2 * omega0 + omega2),
        2 * omega0**2 * omega2 * (r1 * cos(phi2) + r2) / (slide * sin(phi2) ** 2)
        - -g * cos(phi12) * (omega0 + 2 * omega2) / slide,
    )
    bracket = (
        (cos(phi1) / omega0 + sin(phi1) * sin(phi12) / (2 * omega2)) * g
        + omega0 * r1
        + s1 * both / tan(phi2)
        + s2 * slide / sin(phi2)
    )
    rows = paper.observed("palm 1 fixed").codistribution()
    d_phi1 = ca.jacobian(phi1, system.state)
    return (
        EquationCheck("4.47", drift, system.drift),
        EquationCheck("4.51", s1_dot, functions["Lf s1"]),
        EquationCheck("4.51, name", functions["Lf s2"], s1_dot),
        EquationCheck("4.52", d_s1_dot, paper.observed("palm 1 fixed").differential("Lf s1")),
        EquationCheck("4.53", s2_dot, functions["Lf s2"]),
        EquationCheck("4.54", d_s2_dot, paper.observed("palm 1 fixed").differential("Lf s2")),
        EquationCheck("4.55", s2_ddot, functions["Lf Lf s2"]),
        EquationCheck("4.56", d_s2_ddot, paper.observed("palm 1 fixed").differential("Lf Lf s2")),
        EquationCheck(
            "4.57",
            -2 * omega0**3 * omega2**2 / (slide**3 * sin(phi2)) * bracket,
            paper.determinant("palm 1 fixed"),
        ),
        EquationCheck("4.57, columns", ca.det(ca.vertcat(rows[:2, :], d_phi1, rows[3:, :])), ca.det(rows)),
    )
