"""Finds both pads' newtons per count by the weight of a machined cylinder that a running daemon tips on the palms.

Arms the arm if necessary, and then stops it at the end. Keep a hand at the emergency stop.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

from palmd.calibration import cylinder_session
from palmd.calibration.cylinder import CylinderError, tipping_plan
from palmd.calibration.files import report, result_folder
from palmd.calibration.pad_force import MIN_ROUNDS, Forces, pad_forces
from palmd.console.arguments import positive, whole_between
from palmd.console.configured import configured
from palmd.console.errors import RIG_FAILED, as_cli_error
from palmd.motion.check import motion_limits
from palmd.system.mechanism import PALMS

FORMAT = 1
ROUNDS = 8
"""Eight minutes: fewer would not average the pads' drift sufficiently for the documented 3 %."""

_MOST_ROUNDS = 100
_MAX_MASS_G = 5000.0
_MIN_OFFSET_N = 0.1
_SIGNIFICANCE = 4.0
_MAX_FRICTION = 0.1
_MAX_RESIDUAL_SHARE = 0.1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The calibration's arguments."""
    cylinder_session.add_arguments(parser, "force.yaml")
    add = parser.add_argument
    add("--mass-g", type=positive(_MAX_MASS_G), required=True, metavar="M", help="of the cylinder")
    add("--rounds", type=whole_between(MIN_ROUNDS, _MOST_ROUNDS), default=ROUNDS, metavar="N",
        help="through all poses (default: %(default)s)")  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Writes nothing before both pads are measured; CliError if the input is wrong or the rig fails."""
    config, radius_m = configured(arguments.config), arguments.radius_mm * 1e-3
    limits = motion_limits(config)
    weight_n = arguments.mass_g * 1e-3 * config.rig.gravity_m_s2
    with as_cli_error(CylinderError):
        plan, rests = tipping_plan(radius_m, limits, arguments.rounds)
    folder = result_folder(arguments)
    events = cylinder_session.recorded_events(arguments, config, plan)
    with as_cli_error(CylinderError, status=RIG_FAILED):
        found = pad_forces(
            events, config.pads.each(), weight_n, rests, radius_m=radius_m, curvatures=config.rig.curvatures_per_m
        )
    report(table(found), remarks(found))
    header = {"palmd_pads_force": FORMAT, "radius_mm": arguments.radius_mm, "mass_g": arguments.mass_g}
    results = asdict(found)
    cylinder_session.store_result(folder / "force.yaml", header, arguments, config, proposed_settings(found), results)
    return 0


def table(found: Forces) -> str:
    """The result as text for a terminal; 1σ after each ±."""
    head = f"{found.rests} rests in {found.rounds} rounds, friction at rest {found.friction:.0%} of the normal force"
    rows = [
        f"pad{number}: from {pad.least_n:.2f} to {pad.greatest_n:.2f} N\n"
        f"  newtons_per_count {pad.newtons_per_count:.5f} ± {pad.newtons_per_count_sd:.5f}"
        f" ({pad.newtons_per_count_sd / pad.newtons_per_count:.1%})\n"
        f"  offset            {pad.offset_n:.3f} ± {pad.offset_sd_n:.3f} N\n"
        f"  residual          {pad.share_left:.1%} of the force at rest"
        for number, pad in zip(PALMS, found.pads, strict=True)
    ]
    return "\n".join([head, *rows])


def remarks(found: Forces) -> Iterator[str]:
    """Warnings for the operator."""
    if found.friction > _MAX_FRICTION:
        yield (
            f"friction carries {found.friction:.0%} of the normal force at rest: the gains do not depend on it, but"
            " wipe cylinder and pads, and check that nothing but the palms holds the cylinder"
        )
    for number, pad in zip(PALMS, found.pads, strict=True):
        if abs(pad.offset_n) > max(_MIN_OFFSET_N, _SIGNIFICANCE * pad.offset_sd_n):
            yield (
                f"pad {number}: its pressure is zero at {pad.offset_n:.2f} N: newtons_per_count is accurate only near"
                " these forces, use a cylinder of about the weight of the objects to be measured"
            )
        if pad.share_left > _MAX_RESIDUAL_SHARE:
            yield f"pad {number}: residuals of {pad.share_left:.0%} of the force: check the mass and the pad"
        if pad.saturated:
            yield f"pad {number}: {pad.saturated} pressures at full scale are left out: use a lighter cylinder"


def proposed_settings(found: Forces) -> dict[str, dict[str, Any]]:
    """Settings for the configuration, by palm."""
    return {
        f"palm{number}": {"newtons_per_count": round(pad.newtons_per_count, 5)}
        for number, pad in zip(PALMS, found.pads, strict=True)
    }
