"""Units of a touch device: configured ones, else those that the device reports. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from palmd.config.pads import PRESSURE_GAIN_STD, EvdevConfig
from palmd.devices.pad import PadRemark
from palmd.devices.touchdevice import NEWTONS_PER_GRAM, TouchDevice

ROUNDING = 0.5
"""Rounding error of reported resolutions, which are integers (1/mm, 1/gram)."""

LARGEST_SCALE_SD = 0.2
"""Upper bound of `scale_sd` in the configuration."""

TRUNCATION_SD = 1.0 / math.sqrt(3.0)
"""RMS truncation error of a reported resolution (1/mm): drivers use integer division."""


class Units:
    """Conversion of a device's counts to position (mm) and force (N); see `PadScale`.

    `missing` describes an unknown unit that positions need, else None. `newtons_per_count` is None if the unit of
    pressure is unknown.
    """

    def __init__(self, config: EvdevConfig, device: TouchDevice | None) -> None:
        """Without a device (recorded or emulated bytes), use the configuration, defaults included."""
        self.zero_mm, self.sign = config.zero_mm, config.sign
        self.length_mm: float = config.length_mm
        self.corrections_mm: Sequence[float] = config.corrections_mm
        self.counts_per_mm: float = config.counts_per_mm
        self.newtons_per_count: float | None = config.newtons_per_count
        self.missing: str | None = None
        if device is None:
            return
        given = config.model_fields_set
        if "counts_per_mm" not in given:
            reported = device.counts_per_mm(config.axis)
            self.counts_per_mm = reported or config.counts_per_mm
            if reported is None:
                self.missing = (
                    f"{config.port} ({device.name}) does not report its resolution:"
                    " set counts_per_mm (palmd calibrate pads measures it)"
                )
        if "newtons_per_count" not in given:
            self.newtons_per_count = device.newtons_per_count


def unit_remarks(config: EvdevConfig, device: TouchDevice) -> Iterator[PadRemark]:
    """Yield the units in use, or what is wrong with them."""
    units = Units(config, device)
    if units.missing is not None:
        yield PadRemark("units", "missing", units.missing)
        return
    wrong = list(contradictions(config, device))
    for key, text in wrong:
        yield PadRemark("units", "mismatch", text, key, f"remove {key}, or measure it with palmd calibrate")
    if not wrong:
        force = units.newtons_per_count if config.pressure else None
        text = "no force" if force is None else f"{force:.4g} N/count"
        yield PadRemark("units", "ok", f"{units.counts_per_mm:g} counts/mm, {text}")


def with_reported_units(config: EvdevConfig, device: TouchDevice) -> EvdevConfig:
    """Return the configuration with omitted units filled in from the device, if it reports them.

    The standard deviation of a reported scale includes its truncation error, unless `scale_sd` is configured.
    """
    units = Units(config, device)
    found: dict[str, float] = {} if units.missing else {"counts_per_mm": units.counts_per_mm}
    if found and not {"counts_per_mm", "scale_sd"} & config.model_fields_set:
        found["scale_sd"] = min(math.hypot(config.scale_sd, TRUNCATION_SD / units.counts_per_mm), LARGEST_SCALE_SD)
    if units.newtons_per_count is not None:
        found["newtons_per_count"] = units.newtons_per_count
    update = {key: value for key, value in found.items() if value != getattr(config, key)}
    return config.model_copy(update=update) if update else config


def contradictions(config: EvdevConfig, device: TouchDevice) -> Iterator[tuple[str, str]]:
    """Yield each unit whose configured value contradicts the reported one: its key, and both values as text.

    They agree if they differ by at most the rounding of the reported value plus three configured standard deviations.
    """
    given, reported = config.model_fields_set, device.counts_per_mm(config.axis)
    if reported is not None and "counts_per_mm" in given:
        allowed = ROUNDING + 3.0 * config.scale_sd * config.counts_per_mm
        if abs(config.counts_per_mm - reported) > allowed:
            yield "counts_per_mm", f"{config.counts_per_mm:g} counts/mm, but {device.name} reports {reported:g}"
    newtons = device.newtons_per_count
    if newtons is not None and config.pressure and "newtons_per_count" in given:
        per_gram, configured = NEWTONS_PER_GRAM / newtons, NEWTONS_PER_GRAM / config.newtons_per_count
        if abs(configured - per_gram) > ROUNDING + 3.0 * PRESSURE_GAIN_STD * configured:
            yield "newtons_per_count", f"{config.newtons_per_count:g} N/count, but {device.name} reports {newtons:.4g}"
