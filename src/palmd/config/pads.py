"""The kinds of touchpads, and what an observer must know of one."""

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

from palmd.config.fields import AnyBaud, Baud, NotNegative, Plausible, PortPath, Positive, Strict, by_kind, one_of
from palmd.config.tabletop import TABLETOP
from palmd.system.corrections import STEEPEST, corrections, fault_of
from palmd.system.description import PadSensor


class PressureConfig(Strict):
    """Where a pad's packet carries the pressure: (packet[byte] & mask) >> shift, inverted or not."""

    byte: Annotated[int, Field(ge=0, le=5)] = 5
    """Which byte of the packet, from 0."""
    mask: Annotated[int, Field(ge=1, le=0xFF)] = 0x7F
    """Which bits of it."""
    shift: Annotated[int, Field(ge=0, le=7)] = 0
    """How many bits the masked byte is shifted to the right."""
    invert: bool = False
    """Whether a firm touch gives a small number."""


_Pair = Annotated[tuple[FiniteFloat, FiniteFloat], Field(strict=False)]
_CORRECTIONS_PER_MM = 4.0  # (derivation: a line between them is off a wave of 12 mm by 1/500 of its amplitude)


class PadBase(Strict):
    """What every kind of touchpad has: its port, and how counts become s = zero_mm + sign · counts / counts_per_mm.

    Where readings are not proportional, what `curve_mm` and `map` have for that s is added.
    """

    port: PortPath
    """The serial port; a name that lasts is best (`/dev/serial/by-id/…`)."""
    axis: Literal["x", "y"] = "x"
    """Which of the pad's axes lies along the palm."""
    sign: Annotated[int, one_of(1, -1)] = 1
    """1 where the counts grow away from the hinge."""
    zero_mm: Annotated[FiniteFloat, Field(ge=-1000, le=1000), Plausible(0.1, 300, or_zero=True)] = 28.0
    """Distance from the hinge of the place where the pad counts 0."""
    counts_per_mm: Annotated[FiniteFloat, Field(gt=0, le=1000), Plausible(0.5, 150)] = 7.874
    """The pad's scale; 200 counts per inch."""
    newtons_per_count: Annotated[Positive, Plausible(0.0005, 0.5)] = 0.02
    """What one count of pressure is worth."""
    length_mm: Annotated[FiniteFloat, Field(gt=0, le=1000), Plausible(10, 500)] = 55.5
    """How far from the hinge the pad reaches."""
    curve_mm: Annotated[tuple[FiniteFloat, ...], Field(strict=False, max_length=64)] = ()
    """What is added to a reading at so many even places from the hinge to the pad's end, two or more; none: nothing."""
    map: Annotated[tuple[_Pair, ...], Field(strict=False, max_length=256)] = ()
    """What is added to a reading: pairs of a distance from the hinge and a correction [mm], a cubic through them."""
    noise_mm: Annotated[FiniteFloat, Field(gt=0, le=5), Plausible(0.002, 2)] = 0.1
    """One sigma of a position, its rounding not counted."""
    zero_sd_mm: Annotated[NotNegative, Field(le=10), Plausible(0.001, 5, or_zero=True)] = 0.1
    """How well the zero is known, one sigma."""
    scale_sd: Annotated[NotNegative, Field(le=0.2), Plausible(0.00001, 0.05, or_zero=True)] = 0.003
    """How well the scale is known, one sigma, as a share of it."""
    standoff_sd_mm: Annotated[NotNegative, Field(le=10), Plausible(0.001, 5, or_zero=True)] = 0.2
    """By how much the pad's surface may lie off the hinge line, one sigma; only what rolls tells it, in part."""
    sagitta_sd_mm: Annotated[NotNegative, Field(le=5), Plausible(0.001, 2, or_zero=True)] = 0.03
    """By how much the pad's middle may be higher than its ends, one sigma."""
    map_sd_mm: Annotated[NotNegative, Field(le=5), Plausible(0.001, 1, or_zero=True)] = 0.07
    """What is left of the pad's smooth error of place, one sigma; 0: there is none."""
    map_length_mm: Annotated[FiniteFloat, Field(gt=0, le=100), Plausible(0.5, 30)] = 3.0
    """Correlation length of that error, about a sixth of its wavelength."""
    lag_sd_ms: Annotated[NotNegative, Field(le=100), Plausible(0.05, 50, or_zero=True)] = 2.0
    """How well the time of a reading is known, one sigma."""
    force_sd_mm_per_n: Annotated[NotNegative, Field(le=10), Plausible(0.0005, 2, or_zero=True)] = 0.05
    """By how much a reading may move with the contact's force, one sigma."""

    @property
    def reading_noise_mm(self) -> float:
        """One sigma of a position as an observer weighs it, with what the kind knows of errors that are no noise."""
        return self.noise_mm

    @field_validator("curve_mm")
    @classmethod
    def _gentle(cls, curve_mm: tuple[float, ...], info: ValidationInfo) -> tuple[float, ...]:
        if len(curve_mm) == 1:
            raise ValueError("must have two places or more, evenly from the hinge to the pad's end, or none")
        steepest = max((abs(after - before) for before, after in pairwise(curve_mm)), default=0.0)
        if steepest * (len(curve_mm) - 1) > STEEPEST * info.data.get("length_mm", math.inf):
            raise ValueError(f"must change by {STEEPEST:.0%} of the way between two places at most")
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
        """What curve and map add together to a reading, at even places from the hinge to the pad's end; or nothing."""
        if not self.map:
            return self.curve_mm
        places = np.linspace(0.0, self.length_mm, 1 + math.ceil(_CORRECTIONS_PER_MM * self.length_mm))
        added = corrections(self.map, places)
        if self.curve_mm:
            added += np.interp(places, np.linspace(0.0, self.length_mm, len(self.curve_mm)), self.curve_mm)
        return tuple(added.tolist())

    @model_serializer(mode="wrap")
    def _without_no_curve(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """A pad without a curve or a map hashes as it did before there were any."""
        told: dict[str, Any] = handler(self)
        for name in ("curve_mm", "map"):
            if not getattr(self, name):
                told.pop(name, None)
        return told


class VersaPadConfig(PadBase):
    """A VersaPad on a serial line."""

    kind: Literal["versapad"] = Field(default="versapad", exclude=True)  # excluded: it is where it is stored
    """What kind of pad it is; may be left out."""
    baud: Baud = 9600
    """Of the serial line."""
    handshake: Literal["none", "break", "break_twice"] = "none"
    """What the pad wants before it talks: nothing, a break, or two."""
    pressure: PressureConfig = PressureConfig()
    """Where the pressure is in a packet."""

    @property
    def full_scale_n(self) -> float:
        """The force at which its readings saturate."""
        return (self.pressure.mask >> self.pressure.shift) * self.newtons_per_count

    @property
    def across(self) -> tuple[float, int] | None:
        """Of a pad that is read both ways, its other coordinate where it counts 0 (mm) and its sign."""
        return None

    @property
    def report_s(self) -> float:
        """How long a report of six bytes takes on the line (s)."""
        return 6 * (10.0 / self.baud)


_STRIP_FORCE_MAX = 4095
"""Counts: twelve bits of the firmware's report."""


class StripConfig(PadBase):
    """A force-sensing strip read by a microcontroller on a USB serial port: `tools/strip/`."""

    kind: Literal["strip"]
    """What kind of pad it is."""
    zero_mm: Annotated[FiniteFloat, Field(ge=-1000, le=1000), Plausible(0.1, 300, or_zero=True)] = TABLETOP.strip_start
    """Distance from the hinge of the place where the strip counts 0."""
    counts_per_mm: Annotated[FiniteFloat, Field(gt=0, le=1000), Plausible(5, 1000)] = TABLETOP.counts_per_mm
    """The strip's scale: 16383 counts over 60 mm."""
    length_mm: Annotated[FiniteFloat, Field(gt=0, le=1000), Plausible(10, 500)] = TABLETOP.strip_end
    """How far from the hinge the strip reaches."""
    newtons_per_count: Annotated[Positive, Plausible(0.00005, 0.05)] = 0.002
    """What one count of force is worth."""
    noise_mm: Annotated[FiniteFloat, Field(gt=0, le=5), Plausible(0.002, 2)] = 0.15
    """One sigma of a position, its rounding not counted."""
    baud: Baud = 115200
    """Of the serial line; without meaning on a board whose own USB it is."""

    @property
    def full_scale_n(self) -> float:
        """The force at which its readings saturate."""
        return _STRIP_FORCE_MAX * self.newtons_per_count

    @property
    def report_s(self) -> float:
        """How far apart reports are (s)."""
        return 0.01


class EvdevConfig(PadBase):
    """Any touch device that the kernel's input layer knows: `/dev/input/by-path/…`."""

    kind: Literal["evdev"]
    """What kind of pad it is."""
    counts_per_mm: Annotated[FiniteFloat, Field(gt=0, le=1000), Plausible(0.5, 150)] = 7.874
    """The pad's scale; left out, it is the resolution that the device reports. The default is an emulated device's."""
    newtons_per_count: Annotated[Positive, Plausible(0.0005, 0.5)] = 0.02
    """What one count of pressure is worth; left out, it is as the device reports it, else there is no force."""
    pressure: bool = True
    """Whether the device's pressure is a force; `false`: no mass and no forces are estimated."""

    @property
    def full_scale_n(self) -> float:
        """Only the device itself knows."""
        return math.inf

    @property
    def report_s(self) -> float:
        """How far apart reports are while the contact moves (s)."""
        return 0.01


TaxelProtocolName = Literal["tsf85", "st0001", "text"]

_TAXEL_BAUD: Mapping[TaxelProtocolName, int] = {"tsf85": 115200, "st0001": 4000000, "text": 115200}
_TAXEL_FULL_SCALE: Mapping[TaxelProtocolName, int] = {"tsf85": 65535, "st0001": 65535, "text": 4095}
_TAXEL_FRAME_BYTES: Mapping[TaxelProtocolName, Callable[[int], int]] = {
    "tsf85": lambda taxels: 4 + 86 * (taxels // 28),  # a module's pressures and its other fields
    "st0001": lambda taxels: 6 + 2 * taxels,
    "text": lambda taxels: 5 * taxels + 1,  # four digits each
}
_LINE_SHARE = 0.96  # of its time that a line may be busy
TSF85_COLUMNS, TSF85_ROWS, ST0001_TAXELS = 4, (7, 14), 60
_READINGS_PER_MM = 50.0
"""Readings that one error of place spoils alike, for each mm of its correlation length (docs/reference/devices.md)."""


class TaxelsConfig(PadBase):
    """An array of pressure sensors, rows along the palm by columns across it, on a serial line."""

    kind: Literal["taxels"]
    """What kind of pad it is."""
    axis: Literal["x"] = "x"
    """Rows always lie along the palm."""
    protocol: TaxelProtocolName
    """What it speaks: `tsf85` serial frames of modules of 7 x 4, `st0001` Modbus RTU of 60 taxels, `text` lines."""
    rows: Annotated[int, Field(ge=3, le=64)]
    """How many taxels lie along the palm."""
    columns: Annotated[int, Field(ge=1, le=64)]
    """How many lie across it."""
    pitch_mm: Annotated[FiniteFloat, Field(gt=0, le=20), Plausible(0.5, 10)]
    """Distance between the centres of neighbouring taxels."""
    contact_width_mm: Annotated[FiniteFloat, Field(gt=0, le=20), Plausible(0.3, 8)] = 2.0
    """How far the skin spreads the pressure of a contact along the palm, one sigma of the profile."""
    taxel_gain_sd: Annotated[NotNegative, Field(le=0.5)] = 0.05
    """How unlike the taxels' sensitivities are, one sigma of each as a share of it."""
    rest_counts: Annotated[FiniteFloat, Field(ge=0, le=65535)] = 0.0
    """What each taxel counts without a touch."""
    taxel_full_scale: Annotated[int, Field(ge=1, le=65535)] | None = None
    """The count at which a taxel saturates; left out: 65535, of text 4095."""
    touch_n: Annotated[Positive, Field(le=5), Plausible(0.01, 1)] = 0.05
    """The force of the whole array that is a touch; below half of it the touch is over."""
    zero_mm: Annotated[FiniteFloat, Field(ge=-1000, le=1000), Plausible(0.1, 300, or_zero=True)] = 0.0
    """Distance from the hinge of the first row's middle."""
    counts_per_mm: Annotated[FiniteFloat, Field(gt=0, le=2000), Plausible(900, 1100)] = 1000.0
    """Places are counted in micrometres by the pitch; a calibration corrects the pitch here."""
    newtons_per_count: Annotated[Positive, Plausible(0.00001, 0.1)] = 0.001
    """What one count of a taxel is worth; `st0001` counts millinewtons."""
    baud: AnyBaud | None = None
    """Of the serial line; left out: 115200, of `st0001` 4000000."""

    @field_validator("columns")
    @classmethod
    def _as_the_protocol_has_it(cls, columns: int, info: ValidationInfo) -> int:
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
    def _reaches_the_pads_end(cls, pitch_mm: float, info: ValidationInfo) -> float:
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
        """Of the serial line."""
        return _TAXEL_BAUD[self.protocol] if self.baud is None else self.baud

    @property
    def full_scale_counts(self) -> int:
        """The count at which a taxel saturates."""
        return _TAXEL_FULL_SCALE[self.protocol] if self.taxel_full_scale is None else self.taxel_full_scale

    @property
    def full_scale_n(self) -> float:
        """The force of a contact between whose rows the strongest taxel saturates."""
        share = min(self.pitch_mm / (4.0 * self.profile_scale_mm), 1.0) / self.columns
        return (self.full_scale_counts - self.rest_counts) * self.newtons_per_count / share

    @property
    def profile_scale_mm(self) -> float:
        """Scale of the logistic profile of that width: its density falls by e over so much, far out."""
        return self.contact_width_mm * math.sqrt(3.0) / math.pi

    @property
    def grid_sd_mm(self) -> float:
        """One sigma of the error that the grid makes, which repeats with the pitch.

        A centroid of cells errs by (pitch/π)·φ·sin(2π s/pitch), φ the profile's characteristic function at 2π/pitch: of
        a logistic profile x/sinh x with x = 2π²·scale/pitch; of a parabola, which ends sharply, at most
        3/(2π·reach/pitch)² with reach = √5·width. The skin's true profile is not known: the larger of both.
        """
        x = 2.0 * math.pi**2 * self.profile_scale_mm / self.pitch_mm
        sharp = 3.0 / (2.0 * math.pi * math.sqrt(5.0) * self.contact_width_mm / self.pitch_mm) ** 2
        phi = min(max(x / math.sinh(min(x, 700.0)), sharp), 1.0)
        return self.pitch_mm / (math.sqrt(2.0) * math.pi) * phi

    @property
    def gain_sd_mm(self) -> float:
        """One sigma of the error that unlike taxels make: g·√(pitch·width/(4√π·columns))."""
        return self.taxel_gain_sd * math.sqrt(
            self.pitch_mm * self.contact_width_mm / (4.0 * math.sqrt(math.pi) * self.columns)
        )

    @property
    def reading_noise_mm(self) -> float:
        """With both errors, each by as many readings as it spoils alike: its correlation length times 50 a mm."""
        grid = self.grid_sd_mm**2 * self.pitch_mm / 6.0
        gains = self.gain_sd_mm**2 * math.sqrt(2.0 / 3.0) * self.contact_width_mm
        return math.sqrt(self.noise_mm**2 + _READINGS_PER_MM * (grid + gains))

    @property
    def report_s(self) -> float:
        """How far apart reports are (s): 10 ms, or as many whole ones as the line needs for a frame."""
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
"""The kinds of touchpads."""


class AnyPads(Strict):
    """The touchpads of whichever system, a field each, called `palm1` and so on; no two on one port."""

    @field_validator("*")
    @classmethod
    def _own_port(cls, pad: PadConfig, info: ValidationInfo) -> PadConfig:
        for palm, other in info.data.items():
            if other.port == pad.port:
                raise ValueError(f"port {pad.port} is already that of {palm}")
        return pad

    def each(self) -> tuple[PadConfig, ...]:
        """They, in the order of their numbers."""
        return tuple(getattr(self, name) for name in type(self).model_fields)


PRESSURE_GAIN_STD = 0.03
"""How far a resistive pad's pressure, as a whole, is off its calibration: it creeps, and drifts within a minute."""


def pad_sensor(pad: PadConfig, curvature: float) -> PadSensor:
    """What an observer must know of a configured pad (SI), on a palm of this curvature (1/m)."""
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
