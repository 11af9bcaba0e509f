"""Configuration and motion plans as strict, frozen models: units in every key, nothing unknown accepted.

Reading files and saying where an error stands (file:line:col) is `palmd.yamlfile`'s job; these models only
say what is allowed, in words that name the bound.
"""

from __future__ import annotations

import hashlib
import ipaddress
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal
from urllib.parse import urlsplit

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    FiniteFloat,
    PlainValidator,
    SerializerFunctionWrapHandler,
    Tag,
    ValidationInfo,
    field_validator,
    model_serializer,
)

from palmd.events import ObserverName
from palmd.system.description import HingeMode, PadSensor, RigDescription
from palmd.system.mechanism import JOINTS, PALMS
from palmd.systems import TWO_PALMS

BAUDS = (1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200)
SERVO_BAUDS = (115200, 1000000, 2000000, 3000000, 4000000)
SEGMENT_KINDS = ("move", "rate", "hold_s", "sine", "explore")
MAX_DURATION_S = 3600.0


def _one_of(*allowed: int) -> AfterValidator:
    """A whole number out of a short list (Literal would let `true` pass for 1)."""

    def check(value: int) -> int:
        if value not in allowed:
            raise ValueError(f"must be {check.__doc__}; got {value}")
        return value

    check.__doc__ = f"one of {', '.join(map(str, allowed))}"
    return AfterValidator(check)


def _rising_within(low: float, high: float) -> Callable[[tuple[float, float]], tuple[float, float]]:
    def check(pair: tuple[float, float]) -> tuple[float, float]:
        if not low <= pair[0] < pair[1] <= high:
            raise ValueError(f"must be {check.__doc__}; got [{pair[0]:g}, {pair[1]:g}]")
        return pair

    check.__doc__ = f"[low, high] with {low:g} ≤ low < high ≤ {high:g}"
    return check


def _beside_the_file(value: object, info: ValidationInfo) -> Path:
    """A path as text, relative to the folder of the file it stands in (validation context `folder`)."""
    if not isinstance(value, str) or not value.strip():
        raise ValueError("must be a path as text")
    folder: Path = (info.context or {}).get("folder", Path())
    try:
        return folder / Path(value).expanduser()
    except RuntimeError:
        raise ValueError(f"{value}: nobody knows whose home that is; write the path out") from None


def _exists(path: Path) -> bool:
    """Whether there is such a file or folder; raises ValueError where that may not be known."""
    try:
        return path.exists()
    except OSError as error:
        raise ValueError(f"{path}: {error.strerror}") from None


def _host(address: str) -> str | None:
    """The machine in a TCP address, None for a local socket."""
    if address.startswith("ipc://") and len(address) > len("ipc://"):
        return None
    try:
        parts = urlsplit(address)
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port = None, None
    if not address.startswith("tcp://") or not host or not port or parts.path:
        raise ValueError(f"must be tcp://ADDRESS:PORT (port 1 to 65535) or ipc://PATH; got {address!r}")
    return host


def _local_address(address: str) -> str:
    """Loopback TCP or a local socket; anything wider needs keys."""
    host = _host(address)
    if host not in (None, "localhost") and not _is_loopback(host):
        raise ValueError(
            f"{host} can be reached from other machines, which needs CURVE keys, and none are configured;"
            " use tcp://127.0.0.1:PORT or ipc://PATH"
        )
    return address


def _guarded_address(address: str) -> str:
    """Any address of this machine: for a bus with keys."""
    host = _host(address)
    if host not in (None, "localhost") and _ipv4(host) is None:
        raise ValueError(f"must be an IPv4 address of this machine, or 0.0.0.0 for all it has; got {host}")
    return address


def _is_loopback(host: str | None) -> bool:
    ip = _ipv4(host)
    return ip is not None and ip.is_loopback


def _ipv4(host: str | None) -> ipaddress.IPv4Address | None:
    try:
        return ipaddress.IPv4Address(host)
    except ValueError:
        return None


UNITS = {
    "counts_per_mm": "counts/mm", "newtons_per_count": "N/count", "_m_s2": "m/s²", "_deg_s2": "°/s²", "_deg_s": "°/s",
    "_deg": "°", "_mm": "mm", "_mm_per_n": "mm/N", "_hz": "Hz", "_ms": "ms", "_s": "s", "baud": "bit/s",
}  # fmt: skip
"""By how a key ends."""


def unit_of(key: str) -> str:
    """The unit in a key's name, nothing for one without."""
    return next((unit for end, unit in UNITS.items() if key.endswith(end)), "")


def size(value: float | tuple[float, ...]) -> float:
    """Of a value without its sign, or of the larger one of several."""
    return max(map(abs, value)) if isinstance(value, tuple) else abs(value)


@dataclass(frozen=True, slots=True)
class Plausible:
    """What rigs of this kind have: `low` to `high` in size, or 0 where `or_zero`; of two values the larger counts.

    Another value is taken all the same by whoever reads the configuration. `palmd check` asks whether it is meant.
    """

    low: float
    high: float
    or_zero: bool = False

    def holds(self, value: float | tuple[float, ...]) -> bool:
        """Whether a value, or the larger of two, is one of these."""
        return self.low <= size(value) <= self.high or (self.or_zero and size(value) == 0.0)

    def __str__(self) -> str:
        return ("0, or " if self.or_zero else "") + f"{self.low:g} to {self.high:g}"


Positive = Annotated[FiniteFloat, Field(gt=0)]
NotNegative = Annotated[FiniteFloat, Field(ge=0)]
Baud = Annotated[int, _one_of(*BAUDS)]
ServoBaud = Annotated[int, _one_of(*SERVO_BAUDS)]
PortPath = Annotated[str, Field(min_length=1)]
Pair = Annotated[tuple[FiniteFloat, FiniteFloat], Field(strict=False)]  # a YAML list is not a tuple
OpeningRange = Annotated[Pair, AfterValidator(_rising_within(1.0, 179.0))]
AngleRange = Annotated[Pair, AfterValidator(_rising_within(0.0, 180.0))]
TiltRange = Annotated[Pair, AfterValidator(_rising_within(-30.0, 180.0))]
FilePath = Annotated[Path, PlainValidator(_beside_the_file)]
LocalAddress = Annotated[str, AfterValidator(_local_address)]


class Strict(BaseModel):
    """Base of every model here: unknown keys, wrong types and later changes are errors."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)


# ---------------------------------------------------------------------------------------------- configuration


def _by_kind(usual: str) -> Callable[[Any], str]:
    """The tag of a union of kinds, in angle brackets so that it never looks like a key of the file."""

    def tag(value: Any) -> str:
        kind = value.get("kind", usual) if isinstance(value, dict) else getattr(value, "kind", usual)
        return f"<{kind}>"

    return tag


class PadImperfectionsConfig(Strict):
    """By how much the emulated pad of one palm is off from what it is taken for."""

    zero_mm: Annotated[FiniteFloat, Field(ge=-10, le=10)] = 0.0
    """What it reads more, everywhere."""
    scale: Annotated[FiniteFloat, Field(ge=-0.2, le=0.2)] = 0.0
    """What it reads more, as a share of the distance from the hinge."""
    standoff_mm: Annotated[FiniteFloat, Field(ge=-10, le=10)] = 0.0
    """How far its surface lies above the hinge line, on the object's side."""
    sagitta_mm: Annotated[FiniteFloat, Field(ge=-5, le=5)] = 0.0
    """By how much its middle is higher than its ends."""
    lag_ms: Annotated[FiniteFloat, Field(ge=-10, le=100)] = 0.0
    """How late its readings are."""
    force_mm_per_n: Annotated[FiniteFloat, Field(ge=-10, le=10)] = 0.0
    """What it reads more under each newton."""


class ImperfectionsConfig(Strict):
    """Of the emulated rig: by how much its constants are off from what they are taken for."""

    palm1: PadImperfectionsConfig = PadImperfectionsConfig()
    """The pad of palm 1."""
    palm2: PadImperfectionsConfig = PadImperfectionsConfig()
    """The pad of palm 2."""
    phi1_deg: Annotated[FiniteFloat, Field(ge=-10, le=10)] = 0.0
    """True palm 1 above what the arm's pose tells."""
    phi2_deg: Annotated[FiniteFloat, Field(ge=-10, le=10)] = 0.0
    """The same of the angle between the palms."""
    gravity_deg: Annotated[FiniteFloat, Field(ge=-10, le=10)] = 0.0
    """By how much the table tips: palm 1 is that much steeper against gravity."""
    friction_asymmetry: Annotated[FiniteFloat, Field(gt=-1, lt=1)] = 0.0
    """(μ1 − μ2)/(μ1 + μ2) of the palms' friction."""
    vibration_m_s2: Annotated[FiniteFloat, Field(ge=0, le=5)] = 0.0
    """RMS acceleration with which the table shakes up and down."""


Drawn = Literal["none", "calibrated"]
"""Imperfections of the emulated rig that need not be written out: none at all, or drawn from how well it is known."""


def _imperfections_kind(value: Any) -> str:
    return "<values>" if isinstance(value, dict | ImperfectionsConfig) else "<word>"


class RigConfig(Strict):
    """Gravity and the palms' linkage, in the world frame."""

    gravity_m_s2: Annotated[FiniteFloat, Field(gt=0, le=30), Plausible(0.1, 12)] = 9.81
    """In the plane of the palms: 9.81 · sin(tilt of the table)."""
    hinge: Literal["arc", "fixed"] = "arc"
    """`arc`: palm 1 is hinged to B, an arm holds the far end of palm 2; `fixed`: both turn about one axis."""
    base_mm: Annotated[Pair, Plausible(5, 2000, or_zero=True)] = (120.0, 0.0)
    """B, the fixed hinge at the far end of palm 1, in the world frame; of an arc hinge only."""
    palm1_length_mm: Annotated[FiniteFloat, Field(gt=0, le=2000), Plausible(20, 1000)] = 120.0
    """From the hinge between the palms to B."""
    palm2_length_mm: Annotated[FiniteFloat, Field(gt=0, le=2000), Plausible(20, 1000)] = 120.0
    """From the hinge between the palms to where the arm holds palm 2."""
    palm1_curvature_per_m: Annotated[FiniteFloat, Field(ge=-100, le=100), Plausible(1, 20, or_zero=True)] = 0.0
    """Of the arc that palm 1 is, from the hinge on: 1/radius, > 0 a concave cradle, < 0 a dome, 0 flat."""
    palm2_curvature_per_m: Annotated[FiniteFloat, Field(ge=-100, le=100), Plausible(1, 20, or_zero=True)] = 0.0
    """Of the arc that palm 2 is."""
    angle_sd_deg: Annotated[NotNegative, Field(le=10), Plausible(0.001, 3, or_zero=True)] = 0.1
    """How well the palms' angles are known, one sigma; this and the other `_sd` are as calibration leaves a rig."""
    gravity_sd_deg: Annotated[NotNegative, Field(le=10), Plausible(0.001, 5, or_zero=True)] = 0.2
    """How well gravity's direction is known, one sigma."""
    friction_asymmetry_sd: Annotated[NotNegative, Field(le=1)] = 0.3
    """How alike the palms rub: one sigma of (μ1 − μ2)/(μ1 + μ2); 0 where both surely have one friction."""
    imperfections: Annotated[
        Annotated[Drawn, Tag("<word>")] | Annotated[ImperfectionsConfig, Tag("<values>")],
        Discriminator(_imperfections_kind),
    ] = Field(default="none", exclude=True)  # excluded: the daemon's rig is the same whatever the emulated one is
    """Of the emulated rig alone: `none`, drawn from all the `_sd` (`calibrated`), or a block of what is off."""

    @property
    def palm_lengths_mm(self) -> tuple[float, ...]:
        """Of each palm."""
        return tuple(getattr(self, f"palm{palm}_length_mm") for palm in PALMS)

    @property
    def curvatures_per_m(self) -> tuple[float, ...]:
        """Of each palm."""
        return tuple(getattr(self, f"palm{palm}_curvature_per_m") for palm in PALMS)


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


_STEEPEST_CURVE = 0.2
"""A pad whose readings run backwards has no place for each."""


class PadBase(Strict):
    """What every kind of touchpad has: its port, and how counts become s = zero_mm + sign · counts / counts_per_mm.

    Where readings are not proportional, what `curve_mm` has for that s is added.
    """

    port: PortPath
    """The serial port; a name that lasts is best (`/dev/serial/by-id/…`)."""
    axis: Literal["x", "y"] = "x"
    """Which of the pad's axes lies along the palm."""
    sign: Annotated[int, _one_of(1, -1)] = 1
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
    lag_sd_ms: Annotated[NotNegative, Field(le=100), Plausible(0.05, 50, or_zero=True)] = 2.0
    """How well the time of a reading is known, one sigma."""
    force_sd_mm_per_n: Annotated[NotNegative, Field(le=10), Plausible(0.0005, 2, or_zero=True)] = 0.05
    """By how much a reading may move with the contact's force, one sigma."""

    @field_validator("curve_mm")
    @classmethod
    def _gentle(cls, curve_mm: tuple[float, ...], info: ValidationInfo) -> tuple[float, ...]:
        if len(curve_mm) == 1:
            raise ValueError("must have two places or more, evenly from the hinge to the pad's end, or none")
        steepest = max((abs(after - before) for before, after in pairwise(curve_mm)), default=0.0)
        if steepest * (len(curve_mm) - 1) > _STEEPEST_CURVE * info.data.get("length_mm", math.inf):
            raise ValueError(f"must change by {_STEEPEST_CURVE:.0%} of the way between two places at most")
        return curve_mm

    @model_serializer(mode="wrap")
    def _without_no_curve(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """A pad without a curve hashes as it did before there were any."""
        told: dict[str, Any] = handler(self)
        if not self.curve_mm:
            told.pop("curve_mm", None)
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
    def across(self) -> tuple[float, int] | None:
        """Of a pad that is read both ways, its other coordinate where it counts 0 (mm) and its sign."""
        return None

    @property
    def report_s(self) -> float:
        """How long a report of six bytes takes on the line (s)."""
        return 6 * (10.0 / self.baud)


class StripConfig(PadBase):
    """A force-sensing strip read by a microcontroller on a USB serial port: `tools/strip/`."""

    kind: Literal["strip"]
    """What kind of pad it is."""
    zero_mm: Annotated[FiniteFloat, Field(ge=-1000, le=1000), Plausible(0.1, 300, or_zero=True)] = -1.5
    """Distance from the hinge of the place where the strip counts 0."""
    counts_per_mm: Annotated[FiniteFloat, Field(gt=0, le=1000), Plausible(5, 1000)] = 273.0
    """The strip's scale: 16383 counts over 60 mm."""
    newtons_per_count: Annotated[Positive, Plausible(0.00005, 0.05)] = 0.002
    """What one count of force is worth."""
    noise_mm: Annotated[FiniteFloat, Field(gt=0, le=5), Plausible(0.002, 2)] = 0.15
    """One sigma of a position, its rounding not counted."""
    baud: Baud = 115200
    """Of the serial line; without meaning on a board whose own USB it is."""

    @property
    def report_s(self) -> float:
        """How far apart reports are (s)."""
        return 0.01


class EvdevConfig(PadBase):
    """Any touch device that the kernel's input layer knows: `/dev/input/by-path/…`."""

    kind: Literal["evdev"]
    """What kind of pad it is."""
    pressure: bool = True
    """Whether the device's pressure is a force; `false`: no mass and no forces are claimed."""

    @property
    def report_s(self) -> float:
        """How far apart reports are while the contact moves (s)."""
        return 0.01


PadConfig = Annotated[
    Annotated[VersaPadConfig, Tag("<versapad>")]
    | Annotated[StripConfig, Tag("<strip>")]
    | Annotated[EvdevConfig, Tag("<evdev>")],
    Discriminator(
        _by_kind("versapad"),
        custom_error_type="kind",
        custom_error_message="kind must be one of versapad, strip, evdev",
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


class PadsConfig(AnyPads):
    """Both touchpads."""

    palm1: PadConfig
    """The pad of palm 1."""
    palm2: PadConfig
    """The pad of palm 2; not on the same port."""

    def of(self, palm: int) -> PadConfig:
        """The pad of the palm of that number."""
        pad: PadConfig = getattr(self, f"palm{palm}")
        return pad


class AdeptConfig(Strict):
    """The serial line of an Adept controller, and where its arm's base stands in the world frame."""

    kind: Literal["adept"] = Field(default="adept", exclude=True)
    """What kind of actuator it is; may be left out."""
    port: PortPath
    """The serial port to the controller."""
    baud: Baud = 38400
    """Of the serial line."""
    base_x_mm: FiniteFloat = -300.0
    """Where the arm's base stands in the world frame."""
    base_y_mm: FiniteFloat = 0.0
    """Its other coordinate."""
    base_yaw_deg: Annotated[FiniteFloat, Field(ge=-360, le=360)] = 0.0
    """By how much the arm's own x axis is turned from the world's."""

    @property
    def hinge(self) -> HingeMode:
        """Which hinge it can drive."""
        return "arc"

    @property
    def angle_noise_rad(self) -> float:
        """One sigma of a palm's reported angle by itself."""
        return 2e-4

    @property
    def goal_rounding_rad(self) -> float:
        """To what steps of a palm's angle set-points are rounded: the link's are too fine to matter."""
        return 0.0

    @property
    def play_sd_deg(self) -> float:
        """One sigma of what play adds to a palm's angle, all along."""
        return 0.0


class ServoConfig(Strict):
    """One servo, which turns one palm against the base."""

    id: Annotated[int, Field(ge=0, le=252)]
    """Its number on the bus; new ones are all 1."""
    sign: Annotated[int, _one_of(1, -1)] = 1
    """1 where its counts grow with the palm's direction, counted anticlockwise from the world X axis."""
    centre_deg: Annotated[FiniteFloat, Field(ge=-180, le=360)] = 90.0
    """The palm's direction where the servo counts 2048, the middle of its turn."""
    range_deg: AngleRange = (2.0, 178.0)
    """The palm's directions that the servo itself allows."""


class DynamixelConfig(Strict):
    """Two DYNAMIXEL servos of the X series on one bus, palm 1's and palm 2's, about a fixed hinge."""

    kind: Literal["dynamixel"]
    """What kind of actuator it is."""
    port: PortPath
    """The serial port to the bus."""
    baud: ServoBaud = 1000000
    """Of the bus; servos leave the factory with 57600, too slow for a hundred cycles a second."""
    servo1: ServoConfig = ServoConfig(id=1)
    """The servo of palm 1."""
    servo2: ServoConfig = ServoConfig(id=2, sign=-1)
    """The servo of palm 2, which faces the other one."""
    backlash_deg: Annotated[NotNegative, Field(le=5)] = 0.25
    """Play of the gears between servo and palm, from end to end."""
    angle_noise_deg: Annotated[Positive, Field(le=1)] = 0.04
    """One sigma of a servo's angle by itself: a count is 0.088°, and flickers."""

    @field_validator("servo2")
    @classmethod
    def _own_id(cls, servo2: ServoConfig, info: ValidationInfo) -> ServoConfig:
        servo1: ServoConfig | None = info.data.get("servo1")
        if servo1 is not None and servo1.id == servo2.id:
            raise ValueError(f"id {servo2.id} is already that of servo1")
        return servo2

    @property
    def angle_noise_rad(self) -> float:
        """One sigma of a palm's reported angle by itself."""
        return math.radians(self.angle_noise_deg)

    @property
    def goal_rounding_rad(self) -> float:
        """To what steps of a palm's angle set-points are rounded: the servo's counts, 4096 a turn."""
        return math.tau / 4096

    @property
    def servos(self) -> tuple[ServoConfig, ...]:
        """In the order of their palms."""
        return tuple(getattr(self, f"servo{palm}") for palm in PALMS)

    @property
    def hinge(self) -> HingeMode:
        """Which hinge it can drive."""
        return "fixed"

    @property
    def play_sd_deg(self) -> float:
        """One sigma of what play adds to a palm's angle: weight holds it at one end, nobody knows at which."""
        return 0.5 * self.backlash_deg


ArmConfig = Annotated[
    Annotated[AdeptConfig, Tag("<adept>")] | Annotated[DynamixelConfig, Tag("<dynamixel>")],
    Discriminator(
        _by_kind("adept"), custom_error_type="kind", custom_error_message="kind must be one of adept, dynamixel"
    ),
]
"""The kinds of actuators."""


class LimitsConfig(Strict):
    """What the palms may do; the same rate and acceleration hold for each palm angle."""

    phi1_deg: Annotated[TiltRange, Plausible(10, 180)] = (6.0, 150.0)
    """Palm 1 from the world X axis; below 0 where it is a cradle, whose tangent points up where it is touched."""
    phi2_deg: Annotated[OpeningRange, Plausible(10, 180)] = (35.0, 155.0)
    """Palm 2 from palm 1."""
    rate_deg_s: Annotated[FiniteFloat, Field(gt=0, le=2000), Plausible(3, 720)] = 120.0
    """Of each palm angle."""
    acceleration_deg_s2: Annotated[FiniteFloat, Field(gt=0, le=50000), Plausible(20, 20000)] = 900.0
    """Of each palm angle."""
    stop_deceleration_deg_s2: Annotated[FiniteFloat, Field(gt=0, le=50000), Plausible(100, 20000)] | None = None
    """Of each palm angle when the motion is held, never more than the arm itself allows; left out: as much as that."""

    @property
    def angles_deg(self) -> tuple[tuple[float, float], ...]:
        """Of each joint."""
        return tuple(getattr(self, f"{joint}_deg") for joint in JOINTS)


class LoopConfig(Strict):
    """The control loop."""

    rate_hz: Annotated[FiniteFloat, Field(ge=10, le=1000), Plausible(20, 500)] = 100.0
    """How many ticks a second."""


class ObserverConfig(Strict):
    """Which observer gives the published estimate."""

    primary: ObserverName = "shape"
    """Whose estimate is published."""
    smoother: bool = True
    """Beside the loop, in a process of its own; for the shape map of an unknown outline only."""
    shape: FilePath | None = None
    """A stored outline, or a folder of them: the object is one of these, or none."""

    @field_validator("shape")
    @classmethod
    def _usable(cls, path: Path | None, info: ValidationInfo) -> Path | None:
        if path is not None and not _exists(path):
            raise ValueError(f"{path} does not exist; name an outline file or a folder of them")
        if path is not None and info.data.get("primary", "shape") != "shape":
            raise ValueError(f"needs primary: shape; the observer {info.data['primary']} cannot use a stored outline")
        return path


class BusConfig(Strict):
    """The ZeroMQ addresses; without a folder of keys on this machine only."""

    keys: FilePath | None = None
    """A folder of CURVE keys; with it other machines may listen and command."""
    publish: str = "tcp://127.0.0.1:9872"
    """Where everything is published."""
    command: str = "tcp://127.0.0.1:9873"
    """Where commands are taken."""

    @field_validator("publish", "command")
    @classmethod
    def _not_for_strangers(cls, address: str, info: ValidationInfo) -> str:
        guarded = info.data.get("keys", "wrong, which is said at its own place") is not None
        return _guarded_address(address) if guarded else _local_address(address)

    @field_validator("command")
    @classmethod
    def _own_address(cls, command: str, info: ValidationInfo) -> str:
        if command == info.data.get("publish"):
            raise ValueError(f"{command} is already the publish address")
        return command


class RecordConfig(Strict):
    """Where runs are recorded."""

    directory: FilePath = Field(default="runs", validate_default=True)
    """Where runs are put."""


class AnyConfig(Strict):
    """What the configurations of all systems have; each is a model of its own.

    Paths are those of the file, joined to the file's folder.
    """

    system: ClassVar[str]
    """Whose it is, by the table of `palmd.systems`."""

    rig: Any
    """Geometry and gravity; of the emulated rig alone there are `imperfections` in it."""
    pads: AnyPads
    """The touchpads."""
    arm: ArmConfig
    """The robot arm."""
    limits: Any
    """What may be done with it."""
    loop: LoopConfig = LoopConfig()
    """The control loop."""
    bus: BusConfig = BusConfig()
    """The addresses."""
    record: RecordConfig = Field(default_factory=dict, validate_default=True)  # its default needs the folder
    """Recordings."""
    plan: FilePath | None = None
    """The motion plan that `start` runs, unless another is chosen."""
    autostart: bool = False
    """Whether the rig moves without having been told to."""

    @field_validator("arm")
    @classmethod
    def _own_port(cls, arm: ArmConfig, info: ValidationInfo) -> ArmConfig:
        pads: AnyPads | None = info.data.get("pads")
        ports = [] if pads is None else [pad.port for pad in pads.each()]
        if arm.port in ports:
            raise ValueError(f"port {arm.port} is already that of {'a' if len(ports) > 1 else 'the'} pad")
        return arm

    @property
    def outlines(self) -> Path | None:
        """Where stored outlines are; None where none are compared with."""
        return None

    @property
    def explores(self) -> bool:
        """Whether its observer knows an outline to explore by."""
        return True


class Config(AnyConfig):
    """The whole of a `palmd.yaml` of two palms."""

    system: ClassVar[str] = TWO_PALMS

    rig: RigConfig = RigConfig()
    """Geometry and gravity."""
    pads: PadsConfig
    """The touchpads."""
    arm: ArmConfig
    """The robot arm."""
    limits: LimitsConfig = LimitsConfig()
    """What the palms may do."""
    observer: ObserverConfig = ObserverConfig()
    """Who estimates."""

    @field_validator("pads")
    @classmethod
    def _on_arcs(cls, pads: PadsConfig, info: ValidationInfo) -> PadsConfig:
        rig: RigConfig | None = info.data.get("rig")
        for palm, (kappa, pad) in enumerate(zip(rig.curvatures_per_m if rig else (), pads.each(), strict=False), 1):
            if abs(kappa) * pad.length_mm * 1e-3 > math.pi / 2:
                raise ValueError(f"rig.palm{palm}_curvature_per_m bends the pad by more than a quarter turn")
        return pads

    @field_validator("limits")
    @classmethod
    def _points_up(cls, limits: LimitsConfig, info: ValidationInfo) -> LimitsConfig:
        rig: RigConfig | None = info.data.get("rig")
        if limits.phi1_deg[0] < 0.0 and rig is not None and rig.palm1_curvature_per_m <= 0.0:
            raise ValueError("phi1_deg must not begin below 0: only a cradle may point downwards at its hinge")
        return limits

    @field_validator("observer")
    @classmethod
    def _knows_arcs(cls, observer: ObserverConfig, info: ValidationInfo) -> ObserverConfig:
        rig: RigConfig | None = info.data.get("rig")
        if rig is None or not any(rig.curvatures_per_m):
            return observer
        if observer.primary != "shape":
            raise ValueError(f"{observer.primary} knows flat palms only; these are curved: set primary to shape")
        return observer

    @field_validator("arm")
    @classmethod
    def _own_hinge(cls, arm: ArmConfig, info: ValidationInfo) -> ArmConfig:
        rig: RigConfig | None = info.data.get("rig")
        if rig is not None and rig.hinge != arm.hinge:
            raise ValueError(f"kind {arm.kind} drives hinge: {arm.hinge}, but rig.hinge is {rig.hinge}")
        return arm

    @property
    def outlines(self) -> Path | None:
        """As configured."""
        return self.observer.shape

    @property
    def explores(self) -> bool:
        """The `shape` observer does."""
        return self.observer.primary == "shape"


def from_here(address: str) -> str:
    """Where a program on the daemon's own machine connects to what the daemon binds at `address`."""
    return address.replace("tcp://0.0.0.0:", "tcp://127.0.0.1:")


def config_hash(config: Strict) -> str:
    """Sha256 (hex) of an effective configuration or a section of one, defaults included, as canonical JSON."""
    canonical = json.dumps(config.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(canonical.encode()).hexdigest()


PRESSURE_GAIN_STD = 0.03
"""How far a resistive pad's pressure, as a whole, is off its calibration: it creeps, and drifts within a minute."""


def rig_description(config: Config) -> RigDescription:
    """What an observer must know of the configured rig (SI)."""
    return RigDescription(
        gravity=config.rig.gravity_m_s2,
        hinge=config.rig.hinge,
        palm1_length=config.rig.palm1_length_mm * 1e-3,
        base=(config.rig.base_mm[0] * 1e-3, config.rig.base_mm[1] * 1e-3),
        palm_angle_noise=config.arm.angle_noise_rad,
        goal_rounding=config.arm.goal_rounding_rad,
        angle_sd=math.radians(math.hypot(config.rig.angle_sd_deg, config.arm.play_sd_deg)),
        gravity_sd=math.radians(config.rig.gravity_sd_deg),
        friction_sd=config.rig.friction_asymmetry_sd,
        pads=tuple(
            pad_sensor(pad, kappa) for pad, kappa in zip(config.pads.each(), config.rig.curvatures_per_m, strict=True)
        ),
    )


def pad_sensor(pad: PadConfig, curvature: float) -> PadSensor:
    """What an observer must know of a configured pad (SI), on a palm of this curvature (1/m)."""
    return PadSensor(
        curvature=curvature,
        length=pad.length_mm * 1e-3,
        noise=pad.noise_mm * 1e-3,
        resolution=1e-3 / pad.counts_per_mm,
        force_resolution=pad.newtons_per_count,
        force_gain_std=PRESSURE_GAIN_STD,
        zero_sd=pad.zero_sd_mm * 1e-3,
        scale_sd=pad.scale_sd,
        standoff_sd=pad.standoff_sd_mm * 1e-3,
        sagitta_sd=pad.sagitta_sd_mm * 1e-3,
        lag_sd=pad.lag_sd_ms * 1e-3,
        force_sd=pad.force_sd_mm_per_n * 1e-3,
    )


# ------------------------------------------------------------------------------------------------------ plans


def _repeat(value: object) -> int | Literal["forever"]:
    """A whole number from 1 to 10000, or forever."""
    if value == "forever":
        return "forever"
    if type(value) is int and 1 <= value <= 10_000:
        return value
    raise ValueError(f"must be a whole number from 1 to 10000, or forever; got {value!r}")


def _for_both_palms(value: Any) -> Any:
    return value if isinstance(value, list) else [value, value]


Duration = Annotated[FiniteFloat, Field(gt=0, le=MAX_DURATION_S)]
SwingFrequency = Annotated[FiniteFloat, Field(gt=0, le=5)]
SwingFrequencies = Annotated[
    tuple[SwingFrequency, SwingFrequency], Field(strict=False), BeforeValidator(_for_both_palms)
]
Repeat = Annotated[int | Literal["forever"], PlainValidator(_repeat)]


class JointValues(Strict):
    """One value for each joint."""

    def each(self) -> tuple[float | None, ...]:
        """Them, in the order of the joints."""
        return tuple(getattr(self, name) for name in type(self).model_fields)


class PalmAngles(JointValues):
    """Where palm angles shall go; an angle that is left out stays."""

    phi1_deg: FiniteFloat | None = None
    """Palm 1 from the world X axis."""
    phi2_deg: FiniteFloat | None = None
    """Palm 2 from palm 1."""

    @field_validator("*", mode="before")
    @classmethod
    def _written(cls, value: Any) -> Any:
        if value is None:
            raise ValueError("has no value: write one or leave the key out")
        return value


class PalmRates(JointValues):
    """Constant rates of the palm angles; zero where left out."""

    phi1_deg_s: FiniteFloat = 0.0
    """Of φ1."""
    phi2_deg_s: FiniteFloat = 0.0
    """Of φ2."""


class PalmAmplitudes(JointValues):
    """Amplitudes about the pose where a sine starts; zero where left out, negative for opposite phase."""

    phi1_deg: Annotated[FiniteFloat, Field(ge=-90, le=90)] = 0.0
    """Of φ1."""
    phi2_deg: Annotated[FiniteFloat, Field(ge=-90, le=90)] = 0.0
    """Of φ2."""


class MoveSpec(Strict):
    """From rest to rest on a minimum-jerk path."""

    move: PalmAngles
    """Where to; an angle that is left out stays."""
    duration_s: Duration
    """How long it takes."""

    @field_validator("move")
    @classmethod
    def _goes_somewhere(cls, move: PalmAngles) -> PalmAngles:
        if all(angle is None for angle in move.each()):
            raise ValueError("needs phi1_deg, phi2_deg or both")
        return move


class RateSpec(Strict):
    """Constant rates until one palm angle is reached, where the palms come to rest."""

    rate: PalmRates
    """How fast."""
    until: PalmAngles
    """The one angle that ends it."""

    @field_validator("rate")
    @classmethod
    def _turns(cls, rate: PalmRates) -> PalmRates:
        if not any(rate.each()):
            raise ValueError("needs a rate other than 0 for phi1_deg_s or phi2_deg_s")
        return rate

    @field_validator("until")
    @classmethod
    def _one_end(cls, until: PalmAngles) -> PalmAngles:
        if sum(angle is not None for angle in until.each()) != 1:
            raise ValueError("needs exactly one of phi1_deg, phi2_deg")
        return until


class HoldSpec(Strict):
    """Stand still."""

    hold_s: Duration
    """For how long."""


class SineSpec(Strict):
    """Swing about the pose where it starts, growing in and dying away."""

    sine: PalmAmplitudes
    """How far to either side."""
    frequency_hz: SwingFrequencies
    """Of both palms, or one for each."""
    duration_s: Duration
    """How long it takes, growing in and dying away included."""


class ExploreGoal(Strict):
    """When an exploration has seen enough."""

    coverage: Annotated[FiniteFloat, Field(gt=0, le=1)] = 0.95
    """Share of the normals that can be reached."""
    band_mm: Annotated[FiniteFloat, Field(gt=0, le=10)] | None = None
    """One sigma of the outline, all over them; left out, coverage alone counts."""
    time_limit_s: Duration = 60.0
    """When to give up."""


class ExploreSpec(Strict):
    """Closed-loop motion that seeks the parts of the outline not touched yet."""

    explore: ExploreGoal
    """When it has seen enough; must be the last segment."""


def one_key_of(kinds: tuple[str, ...]) -> Discriminator:
    """Tells which of several segments is meant by the one of these keys that it has."""

    def kind(value: Any) -> str | None:
        """The union's tag; in angle brackets so that it never looks like a key of the file."""
        found = [each for each in kinds if each in value] if isinstance(value, dict) else []
        return f"<{found[0]}>" if len(found) == 1 else None

    text = f"a segment needs exactly one of the keys {', '.join(kinds)}"
    return Discriminator(kind, custom_error_type="segment_kind", custom_error_message=text)


SegmentSpec = Annotated[
    Annotated[MoveSpec, Tag("<move>")]
    | Annotated[RateSpec, Tag("<rate>")]
    | Annotated[HoldSpec, Tag("<hold_s>")]
    | Annotated[SineSpec, Tag("<sine>")]
    | Annotated[ExploreSpec, Tag("<explore>")],
    one_key_of(SEGMENT_KINDS),
]


class DitherSpec(Strict):
    """A small vibration of both palm angles on top of the whole plan, to break friction."""

    amplitude_deg: Annotated[FiniteFloat, Field(gt=0, le=5)]
    """Of both angles."""
    frequency_hz: Annotated[FiniteFloat, Field(gt=0, le=20)]
    """Of both angles."""


class AnyPlanSpec(Strict):
    """What the motion plans of all systems have; each is a model of its own."""

    name: Annotated[str, Field(min_length=1, max_length=60)]
    """What it is called on the bus."""
    segments: Annotated[list[Any], Field(min_length=1, max_length=200)]
    """Motions, one after the other."""


class PlanSpec(AnyPlanSpec):
    """A motion plan as it stands in its file; `palmd.motion.plan` makes a trajectory of it."""

    repeat: Repeat = 1
    """How often the segments are run."""
    segments: Annotated[list[SegmentSpec], Field(min_length=1, max_length=200)]
    """Motions, one after the other."""
    dither: DitherSpec | None = None
    """A small vibration on top of it all, to break friction."""
