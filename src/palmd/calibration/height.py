"""Finds the height of a gripper's pivot over the pad, and its position along it, by a cylinder of known radius.

The cylinder is held off its axis, like a body, so that it turns freely, and an exploring plan drags it over the pad.
This command reads the recorded run or its event log: nothing moves, and no daemon is needed.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from palmd.calibration.cylinder_session import add_radius
from palmd.calibration.files import add_config, add_output, document, plain, report, result_folder, store
from palmd.calibration.pivot_height import HeightError, PivotHeight, pivot_height
from palmd.config.pivot import PivotConfig, pivot_rig
from palmd.console.configured import any_configured
from palmd.console.errors import BAD_INPUT, CliError, as_cli_error
from palmd.events import Event
from palmd.observer.pivot.incremental import as_fed
from palmd.record import RunError, is_recording
from palmd.record.eventlog import LogError
from palmd.record.run import read_any_run
from palmd.record.systems import read_log_of_any
from palmd.system.pivot import PAD, SYSTEM

FORMAT = 1
FILE = "height.yaml"
_SIGNIFICANCE = 4.0  # standard deviations
_PALM = f"palm{PAD}"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The calibration's arguments."""
    add_config(parser, "the configuration that the run was recorded with, palmd.yaml")
    parser.add_argument(
        "run", type=Path, metavar="RUN", help="a recorded run (.mcap) with the cylinder, or its event log"
    )
    add_radius(parser)
    add_output(parser, FILE)


def run(arguments: argparse.Namespace) -> int:
    """CliError, and nothing is written, if the input is wrong or the run does not determine the height."""
    config = any_configured(arguments.config)
    if not isinstance(config, PivotConfig):
        raise CliError(BAD_INPUT, f"{arguments.config}: is not of a pivoting grasp; two palms have no pivot")
    folder = result_folder(arguments)
    events = _events(arguments.run, arguments.config, config)
    with as_cli_error(HeightError, before=f"{arguments.run}: "):
        found = pivot_height(events, pivot_rig(config), arguments.radius_mm * 1e-3)
    report(table(found), remarks(found))
    settings = proposed_settings(found, config)
    header = {"palmd_height": FORMAT, "radius_mm": arguments.radius_mm}
    section = config.arm.model_copy(update=settings["arm"])
    store(folder / FILE, document(header, section, settings, plain(asdict(found))))
    print(f"{arguments.config}: write in these sections:")
    print(f"  arm: base_x_mm: {settings['arm']['base_x_mm']}, base_y_mm: {settings['arm']['base_y_mm']}")
    print(f"  pads.{_PALM}: standoff_sd_mm: {settings['pads'][_PALM]['standoff_sd_mm']}")
    return 0


def table(found: PivotHeight) -> str:
    """The result as text for a terminal; 1σ after each ±, for an exact radius."""
    return (
        f"pivot: {found.readings} readings, the cylinder held {found.off_axis_mm:.2f} mm off its axis\n"
        f"  height    {found.height_mm:+.3f} ± {found.height_sd_mm:.3f} mm higher as configured than true\n"
        f"  along     {found.along_mm:+.3f} ± {found.along_sd_mm:.3f} mm of the contact ahead of the pivot\n"
        f"  residual  {found.left:.2f} times the readings' noise"
    )


def remarks(found: PivotHeight) -> Iterator[str]:
    """Warnings for the operator."""
    if found.slope_sd_deg and abs(found.slope_deg) > _SIGNIFICANCE * found.slope_sd_deg:
        yield (
            f"the pad rises by {found.slope_deg:+.3f} ± {found.slope_sd_deg:.3f}° along the arm's x: level it, or"
            " change arm.base_yaw_deg, and calibrate again"
        )
    if found.spoilt > 0.05 * (found.spoilt + found.readings):
        yield f"{found.spoilt} more readings are outliers: check that nothing else touches the pad"


def proposed_settings(found: PivotHeight, config: PivotConfig) -> dict[str, Any]:
    """Settings for the configuration: the arm's base corrected by the pivot's error, and the height's accuracy."""
    arm = {
        "base_x_mm": round(config.arm.base_x_mm + found.along_mm, 3),
        "base_y_mm": round(config.arm.base_y_mm - found.height_mm, 3),
    }
    return {"arm": arm, "pads": {_PALM: {"standoff_sd_mm": max(math.ceil(found.height_sd_mm * 1e3) / 1e3, 1e-3)}}}


def _events(path: Path, config_path: Path, config: PivotConfig) -> list[Event]:
    """The events of a run; CliError for another system, or if it was recorded with another base of the arm."""
    with as_cli_error(LogError, RunError):
        if not is_recording(path):
            system, log = read_log_of_any(path)
            system_name, events = system.name, [as_fed(event) for event in log.events] if system.name == SYSTEM else []
        else:
            recording = read_any_run(path)
            system_name = recording.system
            events = [event for tick in recording.ticks() for event in tick.events] if system_name == SYSTEM else []
    if system_name != SYSTEM:
        raise CliError(BAD_INPUT, f"{path}: is not of a pivoting grasp")
    if is_recording(path):
        for key in ("base_x_mm", "base_y_mm", "base_yaw_deg"):
            recorded, configured = (getattr(each.arm, key) for each in (recording.config, config))
            if recorded != configured:
                raise CliError(
                    BAD_INPUT,
                    f"{path}: was recorded with arm.{key} {recorded:g}, but {config_path} has {configured:g}: use the"
                    " configuration of the recording",
                )
    return events
