"""Configuration of the touch pads, and its conversion to the observers' description."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    Discriminator,
    Field,
    FiniteFloat,
    SerializerFunctionWrapHandler,
    Tag,
    ValidationInfo,
    field_validator,
    model_serializer,
)

from palmd.config.fields import AnyBaud, Baud, NotNegative, Pair, Plausible, PortPath, Positive, Strict, by_kind, one_of
from palmd.config.tabletop import STRIP_COUNTS_PER_MM, STRIP_LENGTH_MM, STRIP_START_MM
from palmd.system.corrections import STEEPEST, corrections, fault_of
from palmd.system.description import PadSensor


class PressureConfig(Strict):
    """Location of the pressure in a pad's packet: (packet[byte] & mask) >> shift, inverted or not."""

    byte: Annotated[int, Field(ge=0, le=5)] = 5
    """Index of the byte in the packet, from 0."""
    mask: Annotated[int, Field(ge=1, le=0xFF)] = 0x7F
    """Mask of its bits."""
    shift: Annotated[int, Field(ge=0, le=7)] = 0
    """Right shift of the masked byte in bits."""
    invert: bool = False
    """Whether the number decreases with the force."""


_CORRECTIONS_PER_MM = 4.0  # (derivation: linear interpolation errs by 1/500 of the amplitude of a 12 mm wave)


class PadBase(Strict):
    """Keys of all kinds of pads: the port, and the conversion s = zero_mm + sign · counts / counts_per_mm.

    For readings that are not proportional, the corrections `curve_mm` and `map` at that s are added.
    """

    port: PortPath
    """The serial port; use a persistent name (`/dev/serial/by-id/…`)."""
    axis: Literal["x", "y"] = "x"
    """The pad's axis along the palm."""
    sign: Annotated[int, one_of(1, -1)] = 1
    """1 if the counts increase away from the hinge."""
    zero_mm: Annotated[FiniteFloat, Field(ge=-1000, le=1000), Plausible(0.1, 300, or_zero=True)] = 28.0
    """Distance from the hinge at which the pad counts 0."""
    counts_per_mm: Annotated[FiniteFloat, Field(gt=0, le=1000), Plausible(0.5, 150)] = 7.874
    """The pad's scale; 200 counts per inch."""
    newtons_per_count: Annotated[Positive, Plausible(0.0005, 0.5)] = 0.02
    """Force of one count of pressure."""
    length_mm: Annotated[FiniteFloat, Field(gt=0, le=1000), Plausible(10, 500)] = 55.5
    """Distance of the pad's far end from the hinge."""
    curve_mm: Annotated[tuple[FiniteFloat, ...], Field(strict=False, max_length=64)] = ()
    """Corrections of the reading at evenly spaced positions from hinge to pad's end, two or more; empty: none."""
    map: Annotated[tuple[Pair, ...], Field(strict=False, max_length=256)] = ()
    """Corrections of the reading: pairs of a distance from the hinge and a correction [mm], interpolated by a cubic."""
    noise_mm: Annotated[FiniteFloat, Field(gt=0, le=5), Plausible(0.002, 2)] = 0.1
    """Standard deviation of a position, without its rounding."""
    zero_sd_mm: Annotated[NotNegative, Field(le=10), Plausible(0.001, 5, or_zero=True)] = 0.1
    """Standard deviation of the zero."""
    scale_sd: Annotated[NotNegative, Field(le=0.2), Plausible(0.00001, 0.05, or_zero=True)] = 0.003
    """Relative standard deviation of the scale."""
    standoff_sd_mm: Annotated[NotNegative, Field(le=10), Plausible(0.001, 5, or_zero=True)] = 0.2
    """Standard deviation of the pad's height over the hinge line; only partly observable, by rolling objects."""
    sagitta_sd_mm: Annotated[NotNegative, Field(le=5), Plausible(0.001, 2, or_zero=True)] = 0.03
    """Standard deviation of the height of the pad's middle over its ends."""
    map_sd_mm: Annotated[NotNegative, Field(le=5), Plausible(0.001, 1, or_zero=True)] = 0.07
    """Standard deviation of the pad's residual smooth position error; 0: none."""
    map_length_mm: Annotated[FiniteFloat, Field(gt=0, le=100), Plausible(0.5, 30)] = 3.0
    """Correlation length of the residual position error, about a sixth of its wavelength."""
    lag_sd_ms: Annotated[NotNegative, Field(le=100), Plausible(0.05, 50, or_zero=True)] = 2.0
    """Standard deviation of a reading's delay."""
    force_sd_mm_per_n: Annotated[NotNegative, Field(le=10), Plausible(0.0005, 2, or_zero=True)] = 0.05
    """Standard deviation of the shift of a reading with the contact force."""

    @property
    def reading_noise_mm(self) -> float:
        """Standard deviation (mm) of a position for an observer, including known errors that are not noise."""
        return self.noise_mm

    @field_validator("curve_mm")
    @classmethod
    def _limited_slope(cls, curve_mm: tuple[float, ...], info: ValidationInfo) -> tuple[float, ...]:
        if len(curve_mm) == 1:
            raise ValueError("must have two values or more, evenly spaced from the hinge to the pad's end, or none")
        steepest = max((abs(after - before) for before, after in pairwise(curve_mm)), default=0.0)
        if steepest * (len(curve_mm) - 1) > STEEPEST * info.data.get("length_mm", math.inf):
            raise ValueError(f"must not change by more than {STEEPEST:.0%} of the distance between two positions")
        return curve_mm

    @field_validator("map")
    @classmethod
    def _single_valued(cls, points: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        fault = fault_of(points) if points else ""
        if fault:
            raise ValueError(fault)
        return points

    @property
    def corrections_mm(self) -> tuple[float, ...]:
        """Sum of both corrections (mm) at evenly spaced positions from hinge to pad's end; empty if there are none."""
        if not self.map:
            return self.curve_mm
        positions = np.linspace(0.0, self.length_mm, 1 + math.ceil(_CORRECTIONS_PER_MM * self.length_mm))
        added = corrections(self.map, positions)
        if self.curve_mm:
            added += np.interp(positions, np.linspace(0.0, self.length_mm, len(self.curve_mm)), self.curve_mm)
        return tuple(added.tolist())

    @model_serializer(mode="wrap")
    def _omit_empty_corrections(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Omit an empty curve or map, so that hashes are the same as before these keys existed."""
        dumped: dict[str, Any] = handler(self)
        for name in ("curve_mm", "map"):
            if not getattr(self, name):
                dumped.pop(name, None)
        return dumped


class VersaPadConfig(PadBase):
    """A VersaPad on a serial line."""

    kind: Literal["versapad"] = Field(default="versapad", exclude=True)  # excluded from hashes and stored files
    """Kind of pad; optional."""
    baud: Baud = 9600
    """Baud rate of the serial line."""
    handshake: Literal["none", "break", "break_twice"] = "none"
    """Start-up of the pad: none, one break, or two."""
    pressure: PressureConfig = PressureConfig()
    """Location of the pressure in a packet."""

    @property
    def full_scale_n(self) -> float:
        """Force (N) at which its readings saturate."""
        return (self.pressure.mask >> self.pressure.shift) * self.newtons_per_count

    @property
    def across(self) -> tuple[float, int] | None:
        """For a pad that reads both coordinates: the other one where it counts 0 (mm), and its sign; else None."""
        return None

    @property
    def report_s(self) -> float:
        """Duration (s) of a report of six bytes on the line."""
        return 6 * (10.0 / self.baud)


_STRIP_FORCE_MAX = 4095
"""Largest force count: twelve bits in the firmware's report."""


class StripConfig(PadBase):
    """A force-sensing strip read by a microcontroller on a USB serial port: `tools/strip/`."""

    kind: Literal["strip"]
    """Kind of pad."""
    zero_mm: Annotated[FiniteFloat, Field(ge=-1000, le=1000), Plausible(0.1, 300, or_zero=True)] = STRIP_START_MM
    """Distance from the hinge at which the strip counts 0."""
    counts_per_mm: Annotated[FiniteFloat, Field(gt=0, le=1000), Plausible(5, 1000)] = STRIP_COUNTS_PER_MM
    """The strip's scale: 16383 counts over 60 mm."""
    length_mm: Annotated[FiniteFloat, Field(gt=0, le=1000), Plausible(10, 500)] = STRIP_START_MM + STRIP_LENGTH_MM
    """Distance of the strip's far end from the hinge."""
    newtons_per_count: Annotated[Positive, Plausible(0.00005, 0.05)] = 0.002
    """Force of one count."""
    noise_mm: Annotated[FiniteFloat, Field(gt=0, le=5), Plausible(0.002, 2)] = 0.15
    """Standard deviation of a position, without its rounding."""
    baud: Baud = 115200
    """Baud rate of the serial line; without effect on boards with native USB."""

    @property
    def full_scale_n(self) -> float:
        """Force (N) at which its readings saturate."""
        return _STRIP_FORCE_MAX * self.newtons_per_count

    @property
    def report_s(self) -> float:
        """Time between reports (s)."""
        return 0.01


class EvdevConfig(PadBase):
    """Any touch device of the kernel's input layer: `/dev/input/by-path/…`."""

    kind: Literal["evdev"]
    """Kind of pad."""
    counts_per_mm: Annotated[FiniteFloat, Field(gt=0, le=1000), Plausible(0.5, 150)] = 7.874
    """The pad's scale; if omitted, the resolution that the device reports. The default is an emulated device's."""
    newtons_per_count: Annotated[Positive, Plausible(0.0005, 0.5)] = 0.02
    """Force of one count of pressure; if omitted, as the device reports it, else there is no force."""
    pressure: bool = True
    """Whether the device's pressure is a force; `false`: no mass and no forces are estimated."""

    @property
    def full_scale_n(self) -> float:
        """Infinite: only the device knows it."""
        return math.inf

    @property
    def report_s(self) -> float:
        """Time (s) between reports while the contact moves."""
        return 0.01


TaxelProtocolName = Literal["tsf85", "st0001", "text"]

_TAXEL_BAUD: Mapping[TaxelProtocolName, int] = {"tsf85": 115200, "st0001": 4000000, "text": 115200}
_TAXEL_FULL_SCALE: Mapping[TaxelProtocolName, int] = {"tsf85": 65535, "st0001": 65535, "text": 4095}
_TAXEL_FRAME_BYTES: Mapping[TaxelProtocolName, Callable[[int], int]] = {
    "tsf85": lambda taxels: 4 + 86 * (taxels // 28),  # a module's pressures and its other fields
    "st0001": lambda taxels: 6 + 2 * taxels,
    "text": lambda taxels: 5 * taxels + 1,  # four digits each
}
_LINE_SHARE = 0.96  # largest share of time in which a line may be busy
TSF85_COLUMNS, TSF85_ROWS, ST0001_TAXELS = 4, (7, 14), 60
_READINGS_PER_MM = 50.0
"""Readings with the same position error per mm of its correlation length (docs/reference/devices.md)."""


class TaxelsConfig(PadBase):
    """An array of pressure sensors on a serial line; rows lie along the palm, columns across it."""

    kind: Literal["taxels"]
    """Kind of pad."""
    axis: Literal["x"] = "x"
    """Rows always lie along the palm."""
    protocol: TaxelProtocolName
    """Its protocol: `tsf85` serial frames of modules of 7 x 4, `st0001` Modbus RTU of 60 taxels, `text` lines."""
    rows: Annotated[int, Field(ge=3, le=64)]
    """Number of taxels along the palm."""
    columns: Annotated[int, Field(ge=1, le=64)]
    """Number of taxels across the palm."""
    pitch_mm: Annotated[FiniteFloat, Field(gt=0, le=20), Plausible(0.5, 10)]
    """Distance between the centres of neighbouring taxels."""
    contact_width_mm: Annotated[FiniteFloat, Field(gt=0, le=20), Plausible(0.3, 8)] = 2.0
    """Width of the pressure profile of a contact along the palm, as its standard deviation; it depends on the skin."""
    taxel_gain_sd: Annotated[NotNegative, Field(le=0.5)] = 0.05
    """Relative standard deviation of the taxels' sensitivities."""
    rest_counts: Annotated[FiniteFloat, Field(ge=0, le=65535)] = 0.0
    """Counts of each taxel without a touch."""
    taxel_full_scale: Annotated[int, Field(ge=1, le=65535)] | None = None
    """Count at which a taxel saturates; default 65535, for `text` 4095."""
    touch_n: Annotated[Positive, Field(le=5), Plausible(0.01, 1)] = 0.05
    """Total force of the array from which on it is touched; the touch ends below half of it."""
    zero_mm: Annotated[FiniteFloat, Field(ge=-1000, le=1000), Plausible(0.1, 300, or_zero=True)] = 0.0
    """Distance of the first row's middle from the hinge."""
    counts_per_mm: Annotated[FiniteFloat, Field(gt=0, le=2000), Plausible(900, 1100)] = 1000.0
    """Positions are counted in micrometres by the pitch; a calibration corrects the pitch by this scale."""
    newtons_per_count: Annotated[Positive, Plausible(0.00001, 0.1)] = 0.001
    """Force of one count of a taxel; `st0001` counts millinewtons."""
    baud: AnyBaud | None = None
    """Baud rate of the serial line; default 115200, for `st0001` 4000000."""

    @field_validator("columns")
    @classmethod
    def _matches_protocol(cls, columns: int, info: ValidationInfo) -> int:
        protocol, rows = info.data.get("protocol"), info.data.get("rows", 0)
        if protocol == "tsf85" and (columns != TSF85_COLUMNS or rows not in TSF85_ROWS):
            raise ValueError(
                f"tsf85 has {TSF85_COLUMNS} columns, and 7 rows for each of one or two modules; got {rows} x {columns}"
            )
        if protocol == "st0001" and rows * columns != ST0001_TAXELS:
            raise ValueError(f"st0001 has {ST0001_TAXELS} taxels; got {rows} x {columns}")
        return columns

    @field_validator("pitch_mm")
    @classmethod
    def _reaches_pad_end(cls, pitch_mm: float, info: ValidationInfo) -> float:
        known = info.data
        if known.get("sign") != 1 or not {"zero_mm", "length_mm", "rows"} <= known.keys():
            return pitch_mm
        end_mm = known["zero_mm"] + (known["rows"] - 0.5) * pitch_mm
        if end_mm < known["length_mm"]:
            reach = f"{known['rows']} rows of it end at {end_mm:g} mm from the hinge"
            raise ValueError(f"{reach}, before length_mm, which is {known['length_mm']:g}: the pad ends with the array")
        return pitch_mm

    @property
    def line_baud(self) -> int:
        """Baud rate of the serial line."""
        return _TAXEL_BAUD[self.protocol] if self.baud is None else self.baud

    @property
    def full_scale_counts(self) -> int:
        """Count at which a taxel saturates."""
        return _TAXEL_FULL_SCALE[self.protocol] if self.taxel_full_scale is None else self.taxel_full_scale

    @property
    def full_scale_n(self) -> float:
        """Force (N) of a contact at which its strongest taxel saturates."""
        share = min(self.pitch_mm / (4.0 * self.profile_scale_mm), 1.0) / self.columns
        return (self.full_scale_counts - self.rest_counts) * self.newtons_per_count / share

    @property
    def profile_scale_mm(self) -> float:
        """Scale (mm) of the logistic profile of that width: in its tails, the density falls by e over this length."""
        return self.contact_width_mm * math.sqrt(3.0) / math.pi

    @property
    def grid_sd_mm(self) -> float:
        """Standard deviation (mm) of the grid error, which repeats with the pitch.

        A centroid of cells errs by (pitch/π)·φ·sin(2π s/pitch), φ the profile's characteristic function at 2π/pitch:
        for a logistic profile x/sinh x with x = 2π²·scale/pitch; for a parabola, which ends abruptly, at most
        3/(2π·reach/pitch)² with reach = √5·width. The skin's true profile is unknown: the larger of both is used.
        """
        x = 2.0 * math.pi**2 * self.profile_scale_mm / self.pitch_mm
        sharp = 3.0 / (2.0 * math.pi * math.sqrt(5.0) * self.contact_width_mm / self.pitch_mm) ** 2
        phi = min(max(x / math.sinh(min(x, 700.0)), sharp), 1.0)
        return self.pitch_mm / (math.sqrt(2.0) * math.pi) * phi

    @property
    def gain_sd_mm(self) -> float:
        """Standard deviation (mm) of the error due to different taxel gains g: g·√(pitch·width/(4√π·columns))."""
        return self.taxel_gain_sd * math.sqrt(
            self.pitch_mm * self.contact_width_mm / (4.0 * math.sqrt(math.pi) * self.columns)
        )

    @property
    def reading_noise_mm(self) -> float:
        """Noise with both errors, each variance times the number of readings that share it: 50 per mm of its length."""
        grid = self.grid_sd_mm**2 * self.pitch_mm / 6.0
        gains = self.gain_sd_mm**2 * math.sqrt(2.0 / 3.0) * self.contact_width_mm
        return math.sqrt(self.noise_mm**2 + _READINGS_PER_MM * (grid + gains))

    @property
    def report_s(self) -> float:
        """Time between reports (s): 10 ms, or the duration of a frame on the line rounded up to ms."""
        line_s = _TAXEL_FRAME_BYTES[self.protocol](self.rows * self.columns) * 10.0 / self.line_baud
        return max(10, math.ceil(line_s / _LINE_SHARE * 1e3)) * 1e-3


PadConfig = Annotated[
    Annotated[VersaPadConfig, Tag("<versapad>")]
    | Annotated[StripConfig, Tag("<strip>")]
    | Annotated[EvdevConfig, Tag("<evdev>")]
    | Annotated[TaxelsConfig, Tag("<taxels>")],
    Discriminator(
        by_kind("versapad"),
        custom_error_type="kind",
        custom_error_message="kind must be one of versapad, strip, evdev, taxels",
    ),
]
"""Union of the kinds of pads."""


class AnyPads(Strict):
    """The pads of a system, one field each, `palm1` and so on; all on different ports."""

    @field_validator("*")
    @classmethod
    def _own_port(cls, pad: PadConfig, info: ValidationInfo) -> PadConfig:
        for palm, other in info.data.items():
            if other.port == pad.port:
                raise ValueError(f"port {pad.port} is already used by {palm}")
        return pad

    def each(self) -> tuple[PadConfig, ...]:
        """The pads, in the order of their numbers."""
        return tuple(getattr(self, name) for name in type(self).model_fields)


PRESSURE_GAIN_STD = 0.03
"""Relative standard deviation of a resistive pad's force scale: it creeps, and drifts within a minute."""


def pad_sensor(pad: PadConfig, curvature: float) -> PadSensor:
    """Convert a pad's configuration to the observers' description (SI), on a palm of this curvature (1/m)."""
    return PadSensor(
        curvature=curvature,
        length=pad.length_mm * 1e-3,
        noise=pad.reading_noise_mm * 1e-3,
        resolution=1e-3 / pad.counts_per_mm,
        force_resolution=pad.newtons_per_count,
        force_gain_std=PRESSURE_GAIN_STD,
        zero_sd=pad.zero_sd_mm * 1e-3,
        scale_sd=pad.scale_sd,
        standoff_sd=pad.standoff_sd_mm * 1e-3,
        sagitta_sd=pad.sagitta_sd_mm * 1e-3,
        map_sd=pad.map_sd_mm * 1e-3,
        map_length=pad.map_length_mm * 1e-3,
        lag_sd=pad.lag_sd_ms * 1e-3,
        force_sd=pad.force_sd_mm_per_n * 1e-3,
    )
