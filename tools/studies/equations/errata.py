"""Where CMU-CS-01-107 prints something else than follows from its own equations, each with a numerical witness.

Found by comparing every equation of `printed_geometry`, `printed_dynamics` and `printed_rates`; docs/theory/errata.md
is generated from here. Lost fraction bars, dots and tildes of the text at hand are no errata, only signs, factors and
names that it shows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import casadi as ca

from palmd.model.symbolic import SX
from tools.studies.equations import paper, printed_dynamics, printed_geometry, printed_rates
from tools.studies.equations.equation_check import EquationCheck
from tools.studies.equations.paper import g, omega0, omega2, phi1, phi2, phi12, r1, r2, s1, s2

Certainty = Literal["certain", "likely"]

WITNESS: Mapping[str, float] = MappingProxyType({
    "r1": 0.021, "r2": 0.018, "omega0": -1.3, "s1": 0.024, "s2": 0.027, "phi1": 0.7, "omega1": 0.9, "phi2": 1.6,
    "omega2": 0.6, "rho": 0.014, "mass": 0.1, "gravity": 9.81,
})  # fmt: skip
"""Where both sides are evaluated, SI; an ordinary state of an object of 20 mm between the palms."""

REMARKS = (
    "The drift alone, with neither torques nor accelerations of the palms, has no contact forces by (4.7) and (4.8): "
    "a0 = g, α0 = 0. So (4.46) and (4.57) speak of an object in free flight along the palms. One that they carry "
    "needs their torques, and with them the input fields.",
    "Below (4.46) only ω0 and ω1 are named, but the determinant is zero also where sin φ1 = 0. There dL_f L_f s2 takes "
    "the place of dL_f L_f s1, unless sin φ12 = 0 as well.",
    "In the general case the determinant of the differentials that the paper lists is zero where "
    "d1² (ρ² − d2²) (ω1−ω0) = d2² (ρ² − d1²) (ω12−ω0); a circle about its centre of mass lies there always.",
)
"""What is not wrong, but good to know."""


@dataclass(frozen=True, slots=True)
class Erratum:
    """One discrepancy: the text as printed and as it must be, a scalar claim that fails, and its right side.

    `likely` stands where the surviving text might be at fault instead of the paper.
    """

    equation: str
    printed: str
    correct: str
    certainty: Certainty
    claim: EquationCheck
    corrected: SX

    def witness(self) -> tuple[float, float, float]:
        """(printed, derived, corrected) at `WITNESS`, SI."""
        printed, derived = self.claim.values(WITNESS)
        corrected, _ = EquationCheck(self.equation, self.corrected, self.claim.derived).values(WITNESS)
        return float(printed[0]), float(derived[0]), float(corrected[0])


def claims() -> dict[str, EquationCheck]:
    """Every equation that is checked, by its number."""
    modules = (printed_geometry, printed_dynamics, printed_rates)
    return {claim.equation: claim for module in modules for claim in module.claims()}


def errata() -> tuple[Erratum, ...]:
    """All of them, in the paper's order."""
    every = claims()
    sin, cos, tan = ca.sin, ca.cos, ca.tan
    slide, both = omega2 - omega0, omega2 + omega0
    inside2 = r2 + s2 / tan(phi2) - s1 / sin(phi2)
    bracket = (
        (cos(phi1) / omega0 + sin(phi2) * sin(phi12) / (2 * omega2)) * g
        + omega0 * r1
        + s1 * both / tan(phi2)
        + s2 * slide / sin(phi2)
    )
    determinant = 2 * omega0**3 * omega2**2 / (slide**3 * sin(phi2)) * bracket
    return (
        Erratum(
            "4.46",
            "g ω0⁴ ω1 sin φ1 / (ω1−ω0)⁴",
            "−g ω0⁴ ω1 sin φ1 / (ω1−ω0)⁴, for the order of the rows that is stated",
            "certain",
            every["4.46"],
            -every["4.46"].printed,
        ),
        Erratum(
            "4.51",
            "L_f s2 = −(ω0² r1 + g cos φ1)/ω0 − …",
            "L_f s1 = −(ω0² r1 + g cos φ1)/ω0 − …: the name is wrong, the formula is right",
            "certain",
            every["4.51, name"],
            paper.observed("palm 1 fixed").functions["Lf s1"],
        ),
        _entry(
            every["4.54"],
            2,
            "third entry: … − s1 (ω2² + 2ω0ω2 − ω0²) / ((ω2−ω0)² sin φ2)",
            "… + s1 (ω2² + 2ω0ω2 − ω0²) / ((ω2−ω0)² sin φ2)",
            (-r2 * omega0 * (2 * omega2 - omega0) + g * cos(phi12)) / slide**2
            + s2 / tan(phi2)
            + s1 * (omega2**2 + 2 * omega0 * omega2 - omega0**2) / (slide**2 * sin(phi2)),
        ),
        _entry(
            every["4.56"],
            5,
            "last entry: … − −g cos φ12 (ω0+2ω2) / (ω2−ω0)",
            "… − g cos φ12 (ω0+2ω2) / (ω2−ω0)",
            2 * omega0**2 * omega2 * (r1 * cos(phi2) + r2) / (slide * sin(phi2) ** 2)
            - g * cos(phi12) * (omega0 + 2 * omega2) / slide,
        ),
        Erratum(
            "4.57",
            "−2ω0³ω2² / ((ω2−ω0)³ sin φ2) · [(cos φ1/ω0 + sin φ1 sin φ12/(2ω2)) g + …]",
            "+2ω0³ω2² / ((ω2−ω0)³ sin φ2) · [(cos φ1/ω0 + sin φ2 sin φ12/(2ω2)) g + …], "
            "for the order of the rows that is stated",
            "certain",
            every["4.57"],
            determinant,
        ),
        Erratum(
            "4.57",
            "of the columns ds1, ds2, dφ1, …",
            "ds1, ds2, dφ2, …: φ1 is no state here, and the determinant with dφ1 is 0",
            "certain",
            every["4.57, columns"],
            determinant,
        ),
        Erratum(
            "4.63",
            "−g cos φ12/ω0 − ω0 (r2 + s2/tan φ2 − s1/sin φ2)",
            "−g cos φ12/ω0 + ω0 (r2 + s2/tan φ2 − s1/sin φ2), as (4.58) has it",
            "certain",
            every["4.63"],
            -g * cos(phi12) / omega0 + omega0 * inside2,
        ),
        _entry(
            every["4.64"],
            2,
            "(0, −ω0, −g cos φ12/ω0² − (r2 + s2/tan φ2 − s1/sin φ2), ω0/sin φ2, −ω0/tan φ2)",
            "every entry with the opposite sign; the witness is the third",
            g * cos(phi12) / omega0**2 + inside2,
            "certain",
        ),
    )


def _entry(
    claim: EquationCheck, index: int, printed: str, correct: str, corrected: SX, certainty: Certainty = "likely"
) -> Erratum:
    """Of one component of a claim."""
    scalar = EquationCheck(claim.equation, claim.printed[index], claim.derived[index])
    return Erratum(claim.equation, printed, correct, certainty, scalar, corrected)
