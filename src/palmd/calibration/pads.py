"""Finds both pads' zero, scale and sign by a turned cylinder; a running daemon opens and closes the palms about it.

Arms the arm if that has not been done, and then stops it in the end. A hand at the emergency stop.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import asdict
from functools import partial
from typing import Any

from palmd.calibration import cylinder_session
from palmd.calibration.pad_scale import PadScale, pad_scales
from palmd.config.pads import PadConfig
from palmd.config.two_palms import Config

FORMAT = 1
Scales = tuple[PadScale, PadScale]

_NOTICEABLE_BEND_MM = 0.05
_SURE = 4.0  # standard deviations
_OFF_ALIKE, _ALIKE = 0.02, 0.005
_SPOILT_SHARE = 0.01


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The calibration's arguments."""
    cylinder_session.add_arguments(parser, "pads.yaml")
    parser.add_argument("--curve", action="store_true", help="the readings are not proportional: find curve_mm too")


def run(arguments: argparse.Namespace) -> int:
    """Writes nothing before both pads are known; CliError when the input is wrong or the rig fails."""
    config, folder, found = cylinder_session.turned(arguments, partial(pad_scales, curved=arguments.curve))
    print(table(found))
    for remark in remarks(found, config):
        print(remark, file=sys.stderr)
    kind = {"palmd_pads_scale": FORMAT, "radius_mm": arguments.radius_mm}
    told = {f"palm{number}": asdict(pad) for number, pad in enumerate(found, 1)}
    cylinder_session.store(folder / "pads.yaml", kind, arguments, config, called_for(found), told)
    return 0


def table(found: Scales) -> str:
    """The result in a few lines for a terminal; one sigma behind each ±, the radius taken for exact."""
    return "\n".join(
        f"pad{number}: {pad.readings} readings from {pad.low_mm:.1f} to {pad.high_mm:.1f} mm\n"
        f"  zero_mm       {pad.zero_mm:.3f} ± {pad.zero_sd_mm:.3f}\n"
        f"  counts_per_mm {pad.counts_per_mm:.4f} ± {pad.counts_per_mm_sd:.4f}\n"
        f"  sign          {pad.sign}\n"
        f"{_curve(pad)}"
        f"  left          {pad.noise_mm:.3f} mm of each reading, a bend of {pad.bend_mm:.3f} ± {pad.bend_sd_mm:.3f} mm"
        for number, pad in enumerate(found, 1)
    )


def _curve(pad: PadScale) -> str:
    return f"  curve_mm      from {min(pad.curve_mm):+.3f} to {max(pad.curve_mm):+.3f}\n" if pad.curve_mm else ""


def remarks(found: Scales, config: Config) -> Iterator[str]:
    """What a person should look into."""
    before: tuple[PadConfig, ...] = cylinder_session.pads(config)
    ratios = [pad.counts_per_mm / old.counts_per_mm for pad, old in zip(found, before, strict=True)]
    if min(abs(ratio - 1.0) for ratio in ratios) > _OFF_ALIKE and abs(ratios[0] - ratios[1]) < _ALIKE:
        yield (
            f"both pads' counts_per_mm are {ratios[0] - 1.0:+.1%} from the configured ones, alike: is the radius right?"
        )
    bent = [pad.bend_mm > _NOTICEABLE_BEND_MM and pad.bend_mm > _SURE * pad.bend_sd_mm for pad in found]
    if all(bent):
        yield "both pads' readings bend away from a line: look at the palms' lengths, and at the arm, before the pads"
    for number, (pad, bend) in enumerate(zip(found, bent, strict=True), 1):
        if bend and not all(bent):
            yield f"pad {number}'s readings bend by {pad.bend_mm:.2f} mm away from a line: is the pad flat and clean?"
        if pad.noise_mm > 3.0 * before[number - 1].noise_mm:
            yield (
                f"pad {number}: {pad.noise_mm:.2f} mm are left of each reading, much more than its noise_mm of"
                f" {before[number - 1].noise_mm:g}: does anything shake?"
            )
        if pad.spoilt > _SPOILT_SHARE * pad.readings:
            yield f"pad {number}: {pad.spoilt} readings were far off and are left out: does anything else touch it?"


def called_for(found: Scales) -> dict[str, dict[str, Any]]:
    """What the configuration should say, palm by palm."""
    return {
        f"palm{number}": {
            "sign": pad.sign,
            "zero_mm": round(pad.zero_mm, 3),
            "counts_per_mm": round(pad.counts_per_mm, 4),
            **({"curve_mm": list(pad.curve_mm)} if pad.curve_mm else {}),
        }
        for number, pad in enumerate(found, 1)
    }
