"""Shared by the calibrations of arm and gravity: the sections that they change, and the position of the arm's base."""

from __future__ import annotations

import math

from palmd.config.arms import AdeptConfig, ArmConfig
from palmd.config.fields import Strict
from palmd.config.two_palms import Config, RigConfig
from palmd.console.errors import BAD_INPUT, CliError


class Sections(Strict):
    """The sections that determine the palms' position, and gravity."""

    rig: RigConfig
    arm: ArmConfig


def adept_arm(config: Config) -> AdeptConfig:
    """The arm that holds the palms; CliError if servos turn them, which have no linkage to calibrate."""
    if not isinstance(config.arm, AdeptConfig):
        raise CliError(
            BAD_INPUT,
            f"arm.kind {config.arm.kind} turns the palms about a fixed hinge, which has no linkage to calibrate:"
            " use `palmd calibrate self`, which finds the servos' centre_deg",
        )
    return config.arm


def changed(config: Config, rig: dict[str, float], arm: dict[str, float]) -> Sections:
    """The configuration's sections with these values."""
    return Sections(rig=config.rig.model_copy(update=rig), arm=config.arm.model_copy(update=arm))


def lines(settings: dict[str, dict[str, float]]) -> str:
    """The settings in the syntax of the configuration file."""
    return "\n".join(
        f"  {section}: {{{', '.join(f'{key}: {value}' for key, value in values.items())}}}"
        for section, values in settings.items()
    )


def palm_base_in_arm(config: Config) -> tuple[float, float]:
    """B in arm coordinates (mm) as configured: R(−yaw)·(B − base)."""
    arm = adept_arm(config)
    yaw = math.radians(arm.base_yaw_deg)
    dx, dy = config.rig.base_mm[0] - arm.base_x_mm, config.rig.base_mm[1] - arm.base_y_mm
    return math.cos(yaw) * dx + math.sin(yaw) * dy, math.cos(yaw) * dy - math.sin(yaw) * dx


def arm_base(config: Config, palm_base: tuple[float, float], yaw_deg: float) -> dict[str, float]:
    """Position of the arm's base in the world for B at `palm_base` in arm coordinates (mm): B − R(yaw)·palm_base."""
    yaw = math.radians(yaw_deg)
    (bx, by), (x, y) = config.rig.base_mm, palm_base
    return {
        "base_x_mm": round(bx - math.cos(yaw) * x + math.sin(yaw) * y, 3),
        "base_y_mm": round(by - math.sin(yaw) * x - math.cos(yaw) * y, 3),
    }


def found(value: float, sd: float, unit: str, digits: int) -> str:
    """A value with its 1σ, for a table."""
    return f"{value:.{digits}f} ± {sd:.{digits}f} {unit}".rstrip()
