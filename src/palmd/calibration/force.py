"""Finds both pads' newtons per count by the weight of a turned cylinder, which a running daemon tips between the palms.

Arms the arm if that has not been done, and then stops it in the end. A hand at the emergency stop.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

from palmd.calibration import cylinder_session
from palmd.calibration.cylinder import tipping_plan
from palmd.calibration.files import writable
from palmd.calibration.pad_force import LEAST_ROUNDS, Forces, pad_forces
from palmd.console.configured import configured
from palmd.console.errors import BAD_INPUT, RIG_FAILED
from palmd.motion.check import motion_limits
from palmd.system.mechanism import PALMS

FORMAT = 1
ROUNDS = 8
"""Eight minutes: the pads' own drift, averaged over fewer, would leave more than the 3 % that are promised."""

_MOST_ROUNDS = 100
_HEAVIEST_G = 5000.0
_NOTICEABLE_OFFSET_N = 0.1
_SURE = 4.0
_MUCH_FRICTION = 0.1
_MUCH_LEFT = 0.1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The calibration's arguments."""
    cylinder_session.add_arguments(parser, "force.yaml")
    add = parser.add_argument
    add("--mass-g", type=cylinder_session.within(_HEAVIEST_G), required=True, metavar="M", help="of the cylinder")
    add("--rounds", type=_rounds, default=ROUNDS, metavar="N", help="through all poses (default: %(default)s)")


def run(arguments: argparse.Namespace) -> int:
    """Writes nothing before both pads are known; CliError when the input is wrong or the rig fails."""
    config, radius_m = configured(arguments.config), arguments.radius_mm * 1e-3
    limits = motion_limits(config)
    weight_n = arguments.mass_g * 1e-3 * config.rig.gravity_m_s2
    with cylinder_session.ending(BAD_INPUT):
        plan, rests = tipping_plan(radius_m, limits, arguments.rounds)
    folder = writable(arguments.output or arguments.config.parent / "calibration")
    events = cylinder_session.heard(arguments, config, plan)
    with cylinder_session.ending(RIG_FAILED):
        pads, curvatures = cylinder_session.pads(config), config.rig.curvatures_per_m
        found = pad_forces(events, pads, weight_n, rests, radius_m=radius_m, curvatures=curvatures)
    print(table(found))
    for remark in remarks(found):
        print(remark, file=sys.stderr)
    kind = {"palmd_pads_force": FORMAT, "radius_mm": arguments.radius_mm, "mass_g": arguments.mass_g}
    told = asdict(found)
    cylinder_session.store(folder / "force.yaml", kind, arguments, config, called_for(found), told)
    return 0


def table(found: Forces) -> str:
    """The result in a few lines for a terminal; one sigma behind each ±."""
    head = f"{found.rests} rests in {found.rounds} rounds, friction at rest {found.friction:.0%} of the normal force"
    rows = [
        f"pad{number}: from {pad.least_n:.2f} to {pad.greatest_n:.2f} N\n"
        f"  newtons_per_count {pad.newtons_per_count:.5f} ± {pad.newtons_per_count_sd:.5f}"
        f" ({pad.newtons_per_count_sd / pad.newtons_per_count:.1%})\n"
        f"  offset            {pad.offset_n:.3f} ± {pad.offset_sd_n:.3f} N\n"
        f"  left              {pad.share_left:.1%} of the force in a rest"
        for number, pad in zip(PALMS, found.pads, strict=True)
    ]
    return "\n".join([head, *rows])


def remarks(found: Forces) -> Iterator[str]:
    """What a person should look into."""
    if found.friction > _MUCH_FRICTION:
        yield (
            f"friction bears {found.friction:.0%} of the normal force at rest: the gains do not depend on it, but wipe"
            " cylinder and pads, and see that nothing but the palms holds the cylinder"
        )
    for number, pad in zip(PALMS, found.pads, strict=True):
        if abs(pad.offset_n) > max(_NOTICEABLE_OFFSET_N, _SURE * pad.offset_sd_n):
            yield (
                f"pad {number}: its pressure is zero at {pad.offset_n:.2f} N, not at nothing: weigh an object like"
                " those to be measured, for newtons_per_count is right near these forces only"
            )
        if pad.share_left > _MUCH_LEFT:
            yield f"pad {number}: {pad.share_left:.0%} of a force are left: is the mass right, the pad sound?"
        if pad.saturated:
            yield f"pad {number}: {pad.saturated} pressures at full scale are left out: take a lighter cylinder"


def called_for(found: Forces) -> dict[str, dict[str, Any]]:
    """What the configuration should say, palm by palm."""
    return {
        f"palm{number}": {"newtons_per_count": round(pad.newtons_per_count, 5)}
        for number, pad in zip(PALMS, found.pads, strict=True)
    }


def _rounds(text: str) -> int:
    value = int(text)
    if not LEAST_ROUNDS <= value <= _MOST_ROUNDS:
        raise argparse.ArgumentTypeError(f"must be {LEAST_ROUNDS} to {_MOST_ROUNDS}, got {text}")
    return value
