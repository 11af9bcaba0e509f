"""Finds how high both pads' surfaces lie above the hinge line, by two turned cylinders that a daemon moves.

With it come both pads' zero, scale and sign, which one cylinder alone cannot tell from a standoff. Arms the arm if that
has not been done, and then stops it in the end. A hand at the emergency stop.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any

from palmd.calibration import cylinder_session
from palmd.calibration.cylinder import turning_plan
from palmd.calibration.cylinder_session import ending, heard, pads, store, wait_for_none, within
from palmd.calibration.files import writable
from palmd.calibration.pad_standoff import LEAST_RATIO, PadStandoff, pad_standoffs
from palmd.config.two_palms import Config
from palmd.console.configured import with_flat_palms
from palmd.console.errors import BAD_INPUT, RIG_FAILED, CliError
from palmd.motion.check import motion_limits
from palmd.system.mechanism import PALMS

FORMAT = 1
FILE = "standoff.yaml"
_SURE = 3.0  # standard deviations
_SHAKES = 3.0  # of the pad's noise


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The calibration's arguments."""
    cylinder_session.add_arguments(parser, FILE)
    parser.add_argument("--second-radius-mm", type=within(1000.0), required=True, metavar="R", help="of the other one")


def run(arguments: argparse.Namespace) -> int:
    """Writes nothing before both pads are known; CliError when the input is wrong or the rig fails."""
    measure(arguments, partial(wait_for_none, arguments))
    return 0


def measure(arguments: argparse.Namespace, exchange: Callable[[Config, str], None]) -> None:
    """The whole calibration; `exchange` is given configuration and name of the cylinder that must go for the other."""
    config = with_flat_palms(arguments.config, "a pad's standoff")
    radii_mm = (arguments.radius_mm, arguments.second_radius_mm)
    if max(radii_mm) < LEAST_RATIO * min(radii_mm):
        raise CliError(
            BAD_INPUT,
            f"cylinders of {radii_mm[0]:g} and {radii_mm[1]:g} mm radius are too much alike: one must be"
            f" {LEAST_RATIO:g} times the other or more",
        )
    with ending(BAD_INPUT):
        plans = [turning_plan(radius_mm * 1e-3, motion_limits(config)) for radius_mm in radii_mm]
    folder = writable(arguments.output or arguments.config.parent / "calibration")
    names = [f"the cylinder of {radius_mm:g} mm" for radius_mm in radii_mm]
    sessions = [heard(arguments, config, plans[0], cylinder=names[0])]
    exchange(config, names[0])
    sessions.append(heard(arguments, config, plans[1], cylinder=names[1]))
    radii_m = (radii_mm[0] * 1e-3, radii_mm[1] * 1e-3)
    with ending(RIG_FAILED):
        found = pad_standoffs(sessions, pads(config), radii_m, math.radians(_opening_sd_deg(config)))
    print(table(found))
    for remark in remarks(found, config):
        print(remark, file=sys.stderr)
    told = {f"palm{number}": asdict(pad) for number, pad in zip(PALMS, found, strict=True)}
    kind = {"palmd_standoff": FORMAT, "radius_mm": radii_mm[0], "second_radius_mm": radii_mm[1]}
    store(folder / FILE, kind, arguments, config, called_for(found), told)


def _opening_sd_deg(config: Config) -> float:
    """One-sigma of φ2: its own constant, and the play between each palm and its actuator."""
    return math.hypot(config.rig.angle_sd_deg, math.sqrt(len(PALMS)) * config.arm.play_sd_deg)


def table(found: Sequence[PadStandoff]) -> str:
    """The result in a few lines for a terminal; one sigma behind each ±."""
    return "\n".join(
        f"pad{number}: {pad.readings} readings\n"
        f"  standoff_mm   {pad.standoff_mm:+.3f} ± {pad.standoff_sd_mm:.3f}\n"
        f"  zero_mm       {pad.zero_mm:.3f} ± {pad.zero_sd_mm:.3f}\n"
        f"  counts_per_mm {pad.counts_per_mm:.4f} ± {pad.counts_per_mm * pad.scale_sd:.4f}\n"
        f"  sign          {pad.sign}\n"
        f"  left          {pad.noise_mm:.3f} mm of each reading"
        for number, pad in zip(PALMS, found, strict=True)
    )


def remarks(found: Sequence[PadStandoff], config: Config) -> Iterator[str]:
    """What a person should look into."""
    for number, pad, told in zip(PALMS, found, pads(config), strict=True):
        if abs(pad.standoff_mm) > _SURE * pad.standoff_sd_mm:
            where, mend = ("above", "lower") if pad.standoff_mm > 0.0 else ("below", "raise")
            yield (
                f"pad {number}'s surface lies {abs(pad.standoff_mm):.2f} mm {where} the hinge line, seen from the"
                f" object: {mend} it by that with shims, and calibrate again; until then every band has it in"
            )
        if pad.noise_mm > _SHAKES * told.noise_mm:
            yield (
                f"pad {number}: {pad.noise_mm:.2f} mm are left of each reading, much more than its noise_mm of"
                f" {told.noise_mm:g}: does anything shake, and was each cylinder where its radius says?"
            )


def called_for(found: Sequence[PadStandoff]) -> dict[str, dict[str, Any]]:
    """What the configuration should say, palm by palm; a standoff is left where it is, so its size counts."""
    return {
        f"palm{number}": {
            "sign": pad.sign,
            "zero_mm": round(pad.zero_mm, 3),
            "counts_per_mm": round(pad.counts_per_mm, 4),
            "zero_sd_mm": _up(pad.zero_sd_mm, 1e-3),
            "scale_sd": _up(pad.scale_sd, 1e-4),
            "standoff_sd_mm": _up(math.hypot(pad.standoff_mm, pad.standoff_sd_mm), 1e-3),
        }
        for number, pad in zip(PALMS, found, strict=True)
    }


def _up(value: float, unit: float) -> float:
    return round(math.ceil(value / unit) * unit, 6)
