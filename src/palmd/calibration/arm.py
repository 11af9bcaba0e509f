"""Finds the arm's base and the palms' lengths while you swing the palms by hand; the command moves nothing."""

from __future__ import annotations

import argparse
import math
import sys
import time
from dataclasses import asdict

import numpy as np

from palmd.calibration.files import add_config, add_output, document, plain, report, result_folder, store
from palmd.calibration.linkage import adept_arm, arm_base, changed, found, lines
from palmd.calibration.linkage_fit import LinkageFit, TooLittleSwingError, fit_linkage
from palmd.config.two_palms import Config
from palmd.console.arguments import between
from palmd.console.configured import configured
from palmd.console.errors import RIG_FAILED, CliError, as_cli_error
from palmd.console.progress import Progress
from palmd.devices.actuator import ArmState, Pose
from palmd.devices.armlistener import ArmListener
from palmd.devices.port import PortUnavailableError
from palmd.doctor.ports import holders

FORMAT = 1
FIRST_MOTION_S = 20.0
"""Longest time that the arm may stand still at the beginning."""
SILENT_S = 1.0
"""Time (s) without an answer after which the controller does not run."""

BY_HAND = (ArmState.MANUAL, ArmState.POWER_OFF)
"""The controller's states in which only a hand moves the arm."""

_MIN_DISTANCE_M, _MIN_ANGLE_RAD = 1e-3, math.radians(0.5)  # between poses that count as different
_MIN_TOOL_ERROR_RAD = math.radians(0.05)
_MAX_RMS_M = 3e-4


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The calibration's arguments."""
    add_config(parser, "the rig's configuration, palmd.yaml")
    parser.add_argument("--seconds", type=between(3.0, 600.0, " s"), default=40.0, metavar="S",
                        help="from the first motion (default: %(default)g)")  # fmt: skip
    add_output(parser, "arm.yaml")


def run(arguments: argparse.Namespace) -> int:
    """Writes nothing before everything is measured; CliError if the input is wrong or the poses do not suffice."""
    config = configured(arguments.config)
    folder = result_folder(arguments)
    adept_arm(config)
    poses = _listen(config, arguments.seconds)
    with as_cli_error(TooLittleSwingError, status=RIG_FAILED, before="arm: "):
        fit = fit_linkage(np.array([(pose.x_m, pose.y_m, pose.t_rad) for pose in poses]).reshape(-1, 3))
    report(table(fit), remarks(fit))
    settings = proposed_settings(fit, config)
    results: dict[str, float] = {"poses": fit.poses}
    for name, value in asdict(fit).items():
        if name.startswith(("tool", "span")):
            results[f"{name}_deg"] = math.degrees(value)
        elif name != "poses":
            results[f"{name}_mm"] = value * 1e3
    section = changed(config, settings["rig"], settings["arm"])
    store(folder / "arm.yaml", document({"palmd_arm_calibration": FORMAT}, section, settings, plain(results)))
    print(f"{arguments.config}: write in these sections:\n{lines(settings)}")
    return 0


def table(fit: LinkageFit) -> str:
    """The result as text for a terminal."""
    spans = (("palm 1", fit.span1), ("palm 2", fit.span2), ("opening", fit.span_opening))
    rows = {
        "palm 1": found(fit.palm1_length * 1e3, fit.palm1_length_sd * 1e3, "mm long", 3),
        "palm 2": found(fit.palm2_length * 1e3, fit.palm2_length_sd * 1e3, "mm long", 3),
        "hinge B": f"x {found(fit.base_x * 1e3, fit.base_x_sd * 1e3, 'mm', 3)},"
        f" y {found(fit.base_y * 1e3, fit.base_y_sd * 1e3, 'mm', 3)} in arm coordinates",
        "tool": f"mounting error {found(math.degrees(fit.tool), math.degrees(fit.tool_sd), '°', 3)}",
        "swung": ", ".join(f"{name} {math.degrees(span):.0f}°" for name, span in spans),
    }
    head = f"arm: {fit.poses} poses, residual {fit.rms * 1e3:.3f} mm"
    return "\n".join([head, *(f"  {what:8} {text}" for what, text in rows.items())])


def remarks(fit: LinkageFit) -> list[str]:
    """Warnings for the operator."""
    warnings = []
    if abs(fit.tool) > max(3.0 * fit.tool_sd, _MIN_TOOL_ERROR_RAD):
        warnings.append(
            f"arm: the tool angle is {math.degrees(fit.tool):+.2f}° short of palm 2's: correct the controller's TOOL"
            " transform by that much, and calibrate again"
        )
    if fit.rms > _MAX_RMS_M:
        warnings.append(
            f"arm: a residual of {fit.rms * 1e3:.2f} mm fits no linkage: look for play in hinges and gripper"
        )
    return warnings


def proposed_settings(fit: LinkageFit, config: Config) -> dict[str, dict[str, float]]:
    """Settings for the configuration, by section; yaw and the palms' base stay as configured."""
    return {
        "rig": {
            "palm1_length_mm": round(fit.palm1_length * 1e3, 3),
            "palm2_length_mm": round(fit.palm2_length * 1e3, 3),
        },
        "arm": arm_base(config, (fit.base_x * 1e3, fit.base_y * 1e3), adept_arm(config).base_yaw_deg),
    }


def _listen(config: Config, seconds: float) -> list[Pose]:
    """The poses of a swinging arm; CliError if the port fails, the arm is not in manual mode, or it does not move."""
    path = config.arm.port
    for number, name in holders(path):
        if name == "palmd":
            raise CliError(RIG_FAILED, f"arm: {path} is held by palmd (process {number}): stop the daemon first")
    with as_cli_error(PortUnavailableError, status=RIG_FAILED), ArmListener(config.arm) as arm:
        return _record_swing(arm, seconds)


def _record_swing(arm: ArmListener, seconds: float) -> list[Pose]:
    """The arm's poses for that time after its first motion, distinct ones only."""
    poses: list[Pose] = []
    t = t_answer = time.monotonic()
    t_begin, t_end = math.inf, t + FIRST_MOTION_S
    with Progress("arm", math.ceil(seconds), "s") as progress:
        while t < t_end:
            reports, t = arm.read(), time.monotonic()
            t_answer = t if reports else t_answer
            if t - t_answer > SILENT_S:
                raise CliError(
                    RIG_FAILED, f"arm: {arm.port.path} does not answer; is the controller's program running?"
                )
            for report in reports:
                if report.state not in BY_HAND:
                    raise CliError(
                        RIG_FAILED,
                        f"arm: the controller is in state {report.state}: switch it to manual mode (M) or its power"
                        " off (P), so that nothing but your hand moves the arm",
                    )
                if not poses:
                    print("arm: swing both palms by hand through their whole range, each against the other",
                          file=sys.stderr)  # fmt: skip
                if isinstance(report.pose, Pose) and (not poses or _are_distinct(poses[-1], report.pose)):
                    poses.append(report.pose)
                    if len(poses) == 2:
                        t_begin, t_end = t, t + seconds
            progress.at(int(max(t - t_begin, 0.0)))
    if len(poses) < 2:
        raise CliError(RIG_FAILED, f"arm: no motion within {FIRST_MOTION_S:.0f} s: swing the palms by hand")
    return poses


def _are_distinct(a: Pose, b: Pose) -> bool:
    angle = math.remainder(b.t_rad - a.t_rad, math.tau)
    return math.hypot(b.x_m - a.x_m, b.y_m - a.y_m) > _MIN_DISTANCE_M or abs(angle) > _MIN_ANGLE_RAD
