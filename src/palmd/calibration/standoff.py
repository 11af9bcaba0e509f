"""Finds the height of both pads' surfaces over the hinge line, by two machined cylinders that a running daemon moves.

Also determines both pads' zero, scale and sign; one cylinder alone cannot distinguish them from a standoff. Arms the
arm if necessary, and then stops it at the end. Keep a hand at the emergency stop.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any

from palmd.calibration import cylinder_session
from palmd.calibration.cylinder import CylinderError, turning_plan
from palmd.calibration.cylinder_session import (
    recorded_events,
    store_result,
    wait_until_removed,
)
from palmd.calibration.files import report, result_folder
from palmd.calibration.pad_standoff import MIN_RATIO, PadStandoff, pad_standoffs
from palmd.config.two_palms import Config
from palmd.console.arguments import positive
from palmd.console.configured import with_flat_palms
from palmd.console.errors import BAD_INPUT, RIG_FAILED, CliError, as_cli_error
from palmd.motion.check import motion_limits
from palmd.system.mechanism import PALMS

FORMAT = 1
FILE = "standoff.yaml"
_SIGNIFICANCE = 3.0  # standard deviations
_MAX_NOISE_RATIO = 3.0  # of the residuals to the pad's noise


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The calibration's arguments."""
    cylinder_session.add_arguments(parser, FILE)
    parser.add_argument(
        "--second-radius-mm", type=positive(1000.0), required=True, metavar="R", help="of the second one"
    )


def run(arguments: argparse.Namespace) -> int:
    """Writes nothing before both pads are measured; CliError if the input is wrong or the rig fails."""
    measure(arguments, partial(wait_until_removed, arguments))
    return 0


def measure(arguments: argparse.Namespace, exchange: Callable[[Config, str], None]) -> None:
    """The whole calibration; `exchange` is called with the configuration and the name of the cylinder to remove."""
    config = with_flat_palms(arguments.config, "a pad's standoff")
    radii_mm = (arguments.radius_mm, arguments.second_radius_mm)
    if max(radii_mm) < MIN_RATIO * min(radii_mm):
        raise CliError(
            BAD_INPUT,
            f"cylinders of {radii_mm[0]:g} and {radii_mm[1]:g} mm radius are too similar: one radius must be at least"
            f" {MIN_RATIO:g} times the other",
        )
    with as_cli_error(CylinderError):
        plans = [turning_plan(radius_mm * 1e-3, motion_limits(config)) for radius_mm in radii_mm]
    folder = result_folder(arguments)
    names = [f"the cylinder of {radius_mm:g} mm radius" for radius_mm in radii_mm]
    sessions = [recorded_events(arguments, config, plans[0], cylinder=names[0])]
    exchange(config, names[0])
    sessions.append(recorded_events(arguments, config, plans[1], cylinder=names[1]))
    # of the constant itself, and of the play between each palm and its actuator
    opening_sd_deg = math.hypot(config.rig.angle_sd_deg, math.sqrt(len(PALMS)) * config.arm.play_sd_deg)
    radii_m = (radii_mm[0] * 1e-3, radii_mm[1] * 1e-3)
    with as_cli_error(CylinderError, status=RIG_FAILED):
        found = pad_standoffs(sessions, config.pads.each(), radii_m, math.radians(opening_sd_deg))
    report(table(found), remarks(found, config))
    results = {f"palm{number}": asdict(pad) for number, pad in zip(PALMS, found, strict=True)}
    kind = {"palmd_standoff": FORMAT, "radius_mm": radii_mm[0], "second_radius_mm": radii_mm[1]}
    store_result(folder / FILE, kind, arguments, config, proposed_settings(found), results)


def table(found: Sequence[PadStandoff]) -> str:
    """The result as text for a terminal; 1σ after each ±."""
    return "\n".join(
        f"pad{number}: {pad.readings} readings\n"
        f"  standoff_mm   {pad.standoff_mm:+.3f} ± {pad.standoff_sd_mm:.3f}\n"
        f"  zero_mm       {pad.zero_mm:.3f} ± {pad.zero_sd_mm:.3f}\n"
        f"  counts_per_mm {pad.counts_per_mm:.4f} ± {pad.counts_per_mm * pad.scale_sd:.4f}\n"
        f"  sign          {pad.sign}\n"
        f"  residual      {pad.noise_mm:.3f} mm per reading"
        for number, pad in zip(PALMS, found, strict=True)
    )


def remarks(found: Sequence[PadStandoff], config: Config) -> Iterator[str]:
    """Warnings for the operator."""
    for number, pad, pad_config in zip(PALMS, found, config.pads.each(), strict=True):
        if abs(pad.standoff_mm) > _SIGNIFICANCE * pad.standoff_sd_mm:
            side, verb = ("above", "lower") if pad.standoff_mm > 0.0 else ("below", "raise")
            yield (
                f"pad {number}'s surface lies {abs(pad.standoff_mm):.2f} mm {side} the hinge line, seen from the"
                f" object: {verb} it by that with shims, and calibrate again; until then every 1σ includes it"
            )
        if pad.noise_mm > _MAX_NOISE_RATIO * pad_config.noise_mm:
            yield (
                f"pad {number}: {pad.noise_mm:.2f} mm residual per reading, much more than its noise_mm of"
                f" {pad_config.noise_mm:g}: look for vibration, and check each cylinder's radius and order"
            )


def proposed_settings(found: Sequence[PadStandoff]) -> dict[str, dict[str, Any]]:
    """Settings for the configuration, by palm; the standoff is not corrected, so its size adds to its 1σ."""
    return {
        f"palm{number}": {
            "sign": pad.sign,
            "zero_mm": round(pad.zero_mm, 3),
            "counts_per_mm": round(pad.counts_per_mm, 4),
            "zero_sd_mm": _rounded_up(pad.zero_sd_mm, 1e-3),
            "scale_sd": _rounded_up(pad.scale_sd, 1e-4),
            "standoff_sd_mm": _rounded_up(math.hypot(pad.standoff_mm, pad.standoff_sd_mm), 1e-3),
        }
        for number, pad in zip(PALMS, found, strict=True)
    }


def _rounded_up(value: float, unit: float) -> float:
    return round(math.ceil(value / unit) * unit, 6)
