"""Finds both pads' zero, scale and sign with a machined cylinder; a running daemon opens and closes the palms.

Arms the arm if necessary, and then stops it at the end. Keep a hand at the emergency stop.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import asdict
from functools import partial
from typing import Any

from palmd.calibration import cylinder_session
from palmd.calibration.files import report
from palmd.calibration.pad_scale import PadScaleResult, pad_scales
from palmd.config.pads import PadConfig
from palmd.config.two_palms import Config

FORMAT = 1
Scales = tuple[PadScaleResult, PadScaleResult]

_MIN_BEND_MM = 0.05
_SIGNIFICANCE = 4.0  # standard deviations
_MIN_SCALE_ERROR, _SAME_SCALE_ERROR = 0.02, 0.005
_MAX_OUTLIER_SHARE = 0.01


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The calibration's arguments."""
    cylinder_session.add_arguments(parser, "pads.yaml")
    parser.add_argument(
        "--curve", action="store_true", help="also find curve_mm, for readings that are not proportional"
    )


def run(arguments: argparse.Namespace) -> int:
    """Writes nothing before both pads are measured; CliError if the input is wrong or the rig fails."""
    config, folder, found = cylinder_session.turn_and_measure(arguments, partial(pad_scales, curved=arguments.curve))
    report(table(found), remarks(found, config))
    header = {"palmd_pads_scale": FORMAT, "radius_mm": arguments.radius_mm}
    results = {f"palm{number}": asdict(pad) for number, pad in enumerate(found, 1)}
    cylinder_session.store_result(folder / "pads.yaml", header, arguments, config, proposed_settings(found), results)
    return 0


def table(found: Scales) -> str:
    """The result as text for a terminal; 1σ after each ±, for an exact radius."""
    return "\n".join(
        f"pad{number}: {pad.readings} readings from {pad.low_mm:.1f} to {pad.high_mm:.1f} mm\n"
        f"  zero_mm       {pad.zero_mm:.3f} ± {pad.zero_sd_mm:.3f}\n"
        f"  counts_per_mm {pad.counts_per_mm:.4f} ± {pad.counts_per_mm_sd:.4f}\n"
        f"  sign          {pad.sign}\n"
        f"{_curve(pad)}"
        f"  residual      {pad.noise_mm:.3f} mm per reading, bend {pad.bend_mm:.3f} ± {pad.bend_sd_mm:.3f} mm"
        for number, pad in enumerate(found, 1)
    )


def _curve(pad: PadScaleResult) -> str:
    return f"  curve_mm      from {min(pad.curve_mm):+.3f} to {max(pad.curve_mm):+.3f}\n" if pad.curve_mm else ""


def remarks(found: Scales, config: Config) -> Iterator[str]:
    """Warnings for the operator."""
    configured: tuple[PadConfig, ...] = config.pads.each()
    ratios = [pad.counts_per_mm / old.counts_per_mm for pad, old in zip(found, configured, strict=True)]
    if min(abs(ratio - 1.0) for ratio in ratios) > _MIN_SCALE_ERROR and abs(ratios[0] - ratios[1]) < _SAME_SCALE_ERROR:
        yield (
            f"both pads' counts_per_mm differ by {ratios[0] - 1.0:+.1%} from the configured ones: is the radius right?"
        )
    is_bent = [pad.bend_mm > _MIN_BEND_MM and pad.bend_mm > _SIGNIFICANCE * pad.bend_sd_mm for pad in found]
    if all(is_bent):
        yield "both pads' readings deviate from a line: check the palms' lengths and the arm before the pads"
    for number, (pad, bend) in enumerate(zip(found, is_bent, strict=True), 1):
        if bend and not all(is_bent):
            yield f"pad {number}'s readings deviate by {pad.bend_mm:.2f} mm from a line: is the pad flat and clean?"
        if pad.noise_mm > 3.0 * configured[number - 1].noise_mm:
            yield (
                f"pad {number}: {pad.noise_mm:.2f} mm residual per reading, much more than its noise_mm of"
                f" {configured[number - 1].noise_mm:g}: look for vibration"
            )
        if pad.spoilt > _MAX_OUTLIER_SHARE * pad.readings:
            yield f"pad {number}: {pad.spoilt} outliers are left out: check that nothing else touches the pad"


def proposed_settings(found: Scales) -> dict[str, dict[str, Any]]:
    """Settings for the configuration, by palm."""
    return {
        f"palm{number}": {
            "sign": pad.sign,
            "zero_mm": round(pad.zero_mm, 3),
            "counts_per_mm": round(pad.counts_per_mm, 4),
            **({"curve_mm": list(pad.curve_mm)} if pad.curve_mm else {}),
        }
        for number, pad in enumerate(found, 1)
    }
