"""Finds both palms' curvature by a turned cylinder; a running daemon opens and closes the palms about it.

The daemon runs with the curvatures as they are believed, from a straight edge say; the pads' counts_per_mm must be
right. Arms the arm if that has not been done, and then stops it in the end. A hand at the emergency stop.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

from palmd.calibration import cylinder_session
from palmd.calibration.files import plain, provenance, write
from palmd.calibration.pad_curvature import PadCurvature, pad_curvatures
from palmd.config.two_palms import Config
from palmd.system.mechanism import PALMS

FORMAT = 1
FILE = "curvature.yaml"
_SURE = 4.0  # standard deviations
_SHAKES = 3.0  # of the pad's noise


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The calibration's arguments."""
    cylinder_session.add_arguments(parser, FILE)


def run(arguments: argparse.Namespace) -> int:
    """Writes nothing before both palms are known; CliError when the input is wrong or the rig fails."""
    config, folder, found = cylinder_session.turned(arguments, pad_curvatures)
    print(table(found))
    for remark in remarks(found, config):
        print(remark, file=sys.stderr)
    called = called_for(found)
    origin = provenance(config.rig.model_copy(update=called))
    told = {f"palm{number}": plain(asdict(palm)) for number, palm in zip(PALMS, found, strict=True)}
    content = {"palmd_curvature": FORMAT, "radius_mm": arguments.radius_mm, **origin}
    write(folder / FILE, {**content, "configuration": {"rig": called}, "found": told})
    print(f"written: {folder / FILE}")
    settings = ", ".join(f"{name}: {value}" for name, value in called.items())
    print(f"{arguments.config}: write in rig: {settings}")
    return 0


def table(found: tuple[PadCurvature, PadCurvature]) -> str:
    """The result in a few lines for a terminal; one sigma behind each ±, the radius taken for exact."""
    return "\n".join(
        f"palm {number}: {palm.readings} readings\n"
        f"  curvature_per_m {palm.curvature_per_m:.3f} ± {palm.curvature_sd_per_m:.3f}{_radius(palm)}\n"
        f"  zero_mm         {palm.zero_mm:.3f} ± {palm.zero_sd_mm:.3f}\n"
        f"  left            {palm.noise_mm:.3f} mm of each reading"
        for number, palm in zip(PALMS, found, strict=True)
    )


def remarks(found: tuple[PadCurvature, PadCurvature], config: Config) -> Iterator[str]:
    """What a person should look into."""
    for number, palm, pad in zip(PALMS, found, config.pads.each(), strict=True):
        if abs(palm.curvature_per_m) < _SURE * palm.curvature_sd_per_m:
            yield f"palm {number} may as well be flat"
        if abs(palm.zero_mm - pad.zero_mm) > _SURE * palm.zero_sd_mm:
            yield (
                f"pad {number}'s zero is {palm.zero_mm - pad.zero_mm:+.2f} mm off: `palmd calibrate pads` when the"
                " curvatures are written"
            )
        if palm.noise_mm > _SHAKES * pad.noise_mm:
            yield (
                f"pad {number}: {palm.noise_mm:.2f} mm are left of each reading, much more than its noise_mm of"
                f" {pad.noise_mm:g}: is the palm an arc?"
            )


def called_for(found: tuple[PadCurvature, PadCurvature]) -> dict[str, Any]:
    """What the configuration's section `rig` should say."""
    return {
        f"palm{number}_curvature_per_m": round(palm.curvature_per_m, 3)
        for number, palm in zip(PALMS, found, strict=True)
    }


def _radius(palm: PadCurvature) -> str:
    kappa = palm.curvature_per_m
    return f", R = {1e3 / abs(kappa):.1f} mm {'concave' if kappa > 0 else 'convex'}" if kappa else ""
