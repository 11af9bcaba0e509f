"""Finds the amplitude V of the palms' speed along themselves from an accelerometer on a vibrating pad.

Measure on the pad, along the palm, while the shaker runs; the amplitude is √2 times the RMS value. The relation between
the palms and the ripple transmission are not measured and stay as configured. Nothing moves, and no daemon is needed.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

from palmd.calibration.files import add_config, add_output, document, plain, report, result_folder, store
from palmd.calibration.linkage import found
from palmd.config.any_config import AnyConfig
from palmd.config.vibration import MOST_HZ, VibrationConfig, vibration_of
from palmd.console.arguments import positive
from palmd.console.configured import any_configured
from palmd.console.errors import BAD_INPUT, CliError
from palmd.motion.shaking import shaking_of
from palmd.system.vibration import vibration_line

FORMAT = 1
FILE = "vibration.yaml"
_MOST_M_S2 = 1e4  # (derivation: 1 m/s at 1.6 kHz, more than `rig.vibration` allows)
_MOST_SHARE = 0.5  # largest standard deviation of a speed over the speed (convention)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The calibration's arguments."""
    add_config(parser, "the configuration of the rig, palmd.yaml")
    add = parser.add_argument
    add("--acceleration-m-s2", type=positive(_MOST_M_S2), required=True, metavar="A",
        help="amplitude (peak, not RMS) of the pad's acceleration along the palm")  # fmt: skip
    add("--acceleration-sd-m-s2", type=positive(_MOST_M_S2), required=True, metavar="SD",
        help="one standard deviation of it; includes the difference between the palms")  # fmt: skip
    add("--frequency-hz", type=positive(MOST_HZ), required=True, metavar="F", help="of the vibration")
    add("--frequency-sd-hz", type=positive(MOST_HZ), metavar="SD",
        help="one standard deviation of it (default: known exactly)")  # fmt: skip
    add_output(parser, FILE)


def run(arguments: argparse.Namespace) -> int:
    """CliError, and nothing is written, if the palms do not vibrate or the figures give no usable speed."""
    config = any_configured(arguments.config)
    if config.rig.vibration.relation == "none":
        raise CliError(
            BAD_INPUT,
            f"{arguments.config}: rig.vibration.relation is none: palms without a shaker have no speed to measure; set"
            " the relation of the shakers first",
        )
    folder = result_folder(arguments)
    frequency, frequency_sd = arguments.frequency_hz, arguments.frequency_sd_hz
    speed, sd = speed_from_acceleration(
        (arguments.acceleration_m_s2, arguments.acceleration_sd_m_s2), (frequency, frequency_sd or 0.0)
    )
    if sd > _MOST_SHARE * speed:
        raise CliError(
            BAD_INPUT, f"vibration: {_shown(speed, sd)} is too uncertain to be of use: measure the acceleration again"
        )
    values = {"frequency_hz": frequency, "speed_m_s": _rounded(speed), "speed_sd_m_s": _rounded(sd)}
    values |= {} if frequency_sd is None else {"frequency_sd_hz": frequency_sd}
    changed = with_vibration(config, values, arguments.config)
    report(table(speed, sd, config), [f"{arguments.config}: {note}" for note in shaking_of(changed)])
    inputs = {key: getattr(arguments, key) for key in ("acceleration_m_s2", "acceleration_sd_m_s2")}
    results = plain({"speed_mm_s": speed * 1e3, "speed_sd_mm_s": sd * 1e3})
    settings = {"rig": {"vibration": values}}
    store(folder / FILE, document({"palmd_vibration": FORMAT}, changed.rig, settings, results, inputs))
    print(f"{arguments.config}: write in rig.vibration:")
    for key, value in values.items():
        print(f"  {key}: {value}")
    return 0


def speed_from_acceleration(acceleration: tuple[float, float], frequency: tuple[float, float]) -> tuple[float, float]:
    """V = a/(2πf) (m/s) and its standard deviation, to first order.

    acceleration: amplitude (m/s²) and frequency (Hz) of a sinusoidal vibration, each with its standard deviation.
    """
    (a, a_sd), (f, f_sd) = acceleration, frequency
    speed = a / (math.tau * f)
    return speed, speed * math.hypot(a_sd / a, f_sd / f)


def table(speed: float, sd: float, config: AnyConfig) -> str:
    """The result as text for a terminal, and what stays unchanged."""
    known = vibration_of(config.rig.vibration)
    given = "transmission" in vibration_line(known)
    transmission = found(known.nominal_transmission, known.nominal_transmission_sd, "", 2)
    return (
        f"vibration: speed {_shown(speed, sd)}\n"
        f"  not measured: relation (stays {known.relation}),"
        f" transmission (stays {transmission}, {'as configured' if given else 'the default'})"
    )


def with_vibration(config: AnyConfig, values: dict[str, Any], path: Path) -> AnyConfig:
    """The configuration with these values in `rig.vibration`; CliError if it does not allow them."""
    before = config.rig.vibration
    try:
        vibration = VibrationConfig.model_validate(before.model_dump(exclude_unset=True) | values)
    except ValueError:
        raise CliError(
            BAD_INPUT,
            f"{path}: rig.vibration does not allow a speed of {values['speed_m_s']:g} m/s at"
            f" {values['frequency_hz']:g} Hz: is the acceleration in m/s²?",
        ) from None
    return config.model_copy(update={"rig": config.rig.model_copy(update={"vibration": vibration})})


def _shown(speed: float, sd: float) -> str:
    return found(speed * 1e3, sd * 1e3, "mm/s", 2)


def _rounded(value: float) -> float:
    """Round to four digits, so that no small speed or sd becomes 0."""
    return float(f"{value:.4g}")
