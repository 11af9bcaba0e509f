"""Finds both palms' curvature with a machined cylinder; a running daemon opens and closes the palms around it.

The daemon runs with approximate curvatures, for example from a straight edge; the pads' counts_per_mm must be right.
Arms the arm if necessary, and then stops it at the end. Keep a hand at the emergency stop.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

from palmd.calibration import cylinder_session
from palmd.calibration.files import document, plain, report, store
from palmd.calibration.pad_curvature import PadCurvature, pad_curvatures
from palmd.config.two_palms import Config
from palmd.system.mechanism import PALMS

FORMAT = 1
FILE = "curvature.yaml"
_SIGNIFICANCE = 4.0  # standard deviations
_MAX_NOISE_RATIO = 3.0  # of the residuals to the pad's noise


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The calibration's arguments."""
    cylinder_session.add_arguments(parser, FILE)


def run(arguments: argparse.Namespace) -> int:
    """Writes nothing before both palms are measured; CliError if the input is wrong or the rig fails."""
    config, folder, found = cylinder_session.turn_and_measure(arguments, pad_curvatures)
    report(table(found), remarks(found, config))
    settings = proposed_settings(found)
    results = {f"palm{number}": plain(asdict(palm)) for number, palm in zip(PALMS, found, strict=True)}
    header = {"palmd_curvature": FORMAT, "radius_mm": arguments.radius_mm}
    store(folder / FILE, document(header, config.rig.model_copy(update=settings), {"rig": settings}, results))
    text = ", ".join(f"{name}: {value}" for name, value in settings.items())
    print(f"{arguments.config}: write in rig: {text}")
    return 0


def table(found: tuple[PadCurvature, PadCurvature]) -> str:
    """The result as text for a terminal; 1σ after each ±, for an exact radius."""
    return "\n".join(
        f"palm {number}: {palm.readings} readings\n"
        f"  curvature_per_m {palm.curvature_per_m:.3f} ± {palm.curvature_sd_per_m:.3f}{_radius(palm)}\n"
        f"  zero_mm         {palm.zero_mm:.3f} ± {palm.zero_sd_mm:.3f}\n"
        f"  residual        {palm.noise_mm:.3f} mm per reading"
        for number, palm in zip(PALMS, found, strict=True)
    )


def remarks(found: tuple[PadCurvature, PadCurvature], config: Config) -> Iterator[str]:
    """Warnings for the operator."""
    for number, palm, pad in zip(PALMS, found, config.pads.each(), strict=True):
        if abs(palm.curvature_per_m) < _SIGNIFICANCE * palm.curvature_sd_per_m:
            yield f"palm {number} is not significantly curved"
        if abs(palm.zero_mm - pad.zero_mm) > _SIGNIFICANCE * palm.zero_sd_mm:
            yield (
                f"pad {number}'s zero has an error of {palm.zero_mm - pad.zero_mm:+.2f} mm: run `palmd calibrate pads`"
                " after writing the curvatures"
            )
        if palm.noise_mm > _MAX_NOISE_RATIO * pad.noise_mm:
            yield (
                f"pad {number}: {palm.noise_mm:.2f} mm residual per reading, much more than its noise_mm of"
                f" {pad.noise_mm:g}: is the palm an arc?"
            )


def proposed_settings(found: tuple[PadCurvature, PadCurvature]) -> dict[str, Any]:
    """Settings for the configuration's section `rig`."""
    return {
        f"palm{number}_curvature_per_m": round(palm.curvature_per_m, 3)
        for number, palm in zip(PALMS, found, strict=True)
    }


def _radius(palm: PadCurvature) -> str:
    kappa = palm.curvature_per_m
    return f", R = {1e3 / abs(kappa):.1f} mm {'concave' if kappa > 0 else 'convex'}" if kappa else ""
