"""Errors of CMU-CS-01-107, read off its figures: it prints none. Reference lines for what is measured here."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PublishedSimulation:
    """Figures 3.10 and 3.11: RMS error of r1, r2 over their RMS, of ψ (rad), and of the vector between the contacts."""

    radius: float
    psi_rad: float
    closure: float


@dataclass(frozen=True, slots=True)
class PublishedExperiment:
    """Figure 3.15: size, distance of the points from the true outline, share touched, ψ against the camera's.

    Skill is 1 − RMS error over the RMS of a camera signal about its mean: what is gained over "it does not turn".
    """

    mean_radius_mm: float
    rms_mm: float
    p90_mm: float
    touched: float
    psi_rad: float
    psi_skill: float


SIMULATION = PublishedSimulation(radius=0.06, psi_rad=0.078, closure=0.003)
HARDWARE = PublishedExperiment(mean_radius_mm=41.0, rms_mm=1.9, p90_mm=2.9, touched=0.54, psi_rad=0.27, psi_skill=0.08)
