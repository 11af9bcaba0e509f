"""The result of a reconstruction as one JSON object. Pure."""

from __future__ import annotations

from typing import Any

from palmd.aliases import RESULT, with_former_names
from palmd.chords import chords_of
from palmd.jsonvalues import column, or_none
from palmd.observer.mass import MassEstimator
from palmd.observer.reconstruction import Reconstruction
from palmd.observer.shape_classification import as_json
from palmd.observer.visits import Marks, kept_by_band, kept_by_visits
from palmd.record.verdict import verdict
from palmd.system.mechanism import RADII
from palmd.system.rig_constants import RIG_NAMES


def as_line(answer: Reconstruction, at_rest: MassEstimator) -> dict[str, Any]:
    """The result as `palmd reconstruct` writes it: SI units, the unit in each name, None for unknown values.

    `at_rest` is the mass estimated while the object lay still, which needs no outline.
    """
    line = {
        **verdict(answer.converged, answer.touched, answer.reason),
        "chi2": or_none(answer.chi2),
        "theta_rad": column(answer.theta),
        "h_m": column(answer.h),
        "h_sd_m": column(answer.h_sd),
        "touched": _marks(answer.touched),
        "visits": None if answer.visits is None else answer.visits.tolist(),
        "kept_paper": _marks(None if answer.visits is None else kept_by_visits(answer.visits)),
        "kept_band": _marks(_kept_by_band(answer)),
        "rho_m": or_none(answer.rho),
        "rho_sd_m": or_none(answer.rho_sd),
        "mu": or_none(answer.mu),
        "mu_sd": or_none(answer.mu_sd),
        "mass_kg": or_none(answer.mass),
        "mass_sd_kg": or_none(answer.mass_sd),
        "mass_rest_kg": or_none(at_rest.value),
        "mass_rest_sd_kg": or_none(at_rest.sd),
        "rig": _rig(answer) or None,
        "contradicted": _contradicted(answer) if len(answer.rig) else None,
        "sides": None if answer.h is None else _sides(answer),
        "chords": _chords(answer),
        "shape_class": as_json(answer.shape_class) if answer.converged else None,
        "trajectory": _trajectory(answer),
        "seconds": or_none(answer.seconds),
    }
    return with_former_names(RESULT, line)


def _rig(answer: Reconstruction) -> dict[str, dict[str, float | None]]:
    constants = zip(RIG_NAMES, answer.rig.tolist(), answer.rig_sd.tolist(), strict=False)
    return {name: {"value": or_none(value), "sd": or_none(sd)} for name, value, sd in constants}


def _contradicted(answer: Reconstruction) -> dict[str, float]:
    named = zip(RIG_NAMES, answer.contradicted.tolist(), strict=False)
    return {name: sigmas for name, sigmas in named if sigmas}


def _trajectory(answer: Reconstruction) -> dict[str, list[float | None]] | None:
    if not len(answer.t):
        return None
    return {
        "t": column(answer.t),
        "psi_rad": column(answer.psi),
        "omega0_rad_s": column(answer.omega0),
        **{f"{name}_m": column(values) for name, values in zip(RADII, answer.radii, strict=False)},
    }


def _kept_by_band(answer: Reconstruction) -> Marks | None:
    if answer.h_sd is None or answer.touched is None:
        return None
    return kept_by_band(answer.h_sd, answer.touched)


def _marks(marks: Marks | None) -> list[int] | None:
    return None if marks is None else marks.astype(int).tolist()


def _chords(answer: Reconstruction) -> list[dict[str, object]] | None:
    """Straight parts of the hull, as pairs of points in the object's frame; None without an outline."""
    if answer.h is None or answer.touched is None:
        return None
    return [
        {"normal_rad": chord.normal, "length_m": chord.length, "begin_m": list(chord.begin), "end_m": list(chord.end)}
        for chord in chords_of(answer.theta, answer.h, answer.touched)
    ]


def _sides(answer: Reconstruction) -> list[dict[str, float]]:
    return [
        {"normal_rad": normal, "length_m": length, "length_sd_m": sd} for normal, length, sd in answer.sides.tolist()
    ]
