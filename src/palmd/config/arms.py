"""Configuration of the actuators."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Discriminator, Field, FiniteFloat, Tag, ValidationInfo, field_validator

from palmd.config.fields import AngleRange, Baud, NotNegative, PortPath, Positive, ServoBaud, Strict, by_kind, one_of
from palmd.system.description import HingeMode
from palmd.system.mechanism import PALMS


class AdeptConfig(Strict):
    """An Adept controller on a serial line, and the pose of its arm's base in the world frame."""

    kind: Literal["adept"] = Field(default="adept", exclude=True)
    """Kind of actuator; optional."""
    port: PortPath
    """Serial port of the controller."""
    baud: Baud = 38400
    """Baud rate of the serial line."""
    base_x_mm: FiniteFloat = -300.0
    """x of the arm's base in the world frame."""
    base_y_mm: FiniteFloat = 0.0
    """y of the arm's base in the world frame."""
    base_yaw_deg: Annotated[FiniteFloat, Field(ge=-360, le=360)] = 0.0
    """Angle of the arm's x axis in the world frame."""

    @property
    def hinge(self) -> HingeMode:
        """The hinge that it drives."""
        return "arc"

    @property
    def angle_noise_rad(self) -> float:
        """Standard deviation (rad) of the noise of a palm's reported angle."""
        return 2e-4

    @property
    def goal_rounding_rad(self) -> float:
        """Steps (rad) of a palm's angle to which set-points are rounded; negligible on the arm link."""
        return 0.0

    @property
    def play_sd_deg(self) -> float:
        """Standard deviation (°) of the constant error of a palm's angle due to play."""
        return 0.0


class ServoConfig(Strict):
    """One servo, which turns one palm."""

    id: Annotated[int, Field(ge=0, le=252)]
    """Id on the bus; factory default 1."""
    sign: Annotated[int, one_of(1, -1)] = 1
    """1 if its counts increase with the palm's direction, anticlockwise from the world X axis."""
    centre_deg: Annotated[FiniteFloat, Field(ge=-180, le=360)] = 90.0
    """The palm's direction at 2048 counts, the middle of the servo's range."""
    range_deg: AngleRange = (2.0, 178.0)
    """Range of the palm's directions, enforced by the servo."""


class ServosConfig(Strict):
    """Two servos on one bus, for palm 1 and palm 2, about a fixed hinge."""

    port: PortPath
    """Serial port of the bus."""
    baud: ServoBaud = 1000000
    """Baud rate of the bus."""
    servo1: ServoConfig = ServoConfig(id=1)
    """The servo of palm 1."""
    servo2: ServoConfig = ServoConfig(id=2, sign=-1)
    """The servo of the other palm, which faces the first servo."""
    backlash_deg: Annotated[NotNegative, Field(le=5)] = 0.25
    """Total play of the gears between servo and palm."""
    angle_noise_deg: Annotated[Positive, Field(le=1)] = 0.04
    """Standard deviation of the noise of a servo's angle; one count is 0.088°."""

    @field_validator("servo2")
    @classmethod
    def _own_id(cls, servo2: ServoConfig, info: ValidationInfo) -> ServoConfig:
        servo1: ServoConfig | None = info.data.get("servo1")
        if servo1 is not None and servo1.id == servo2.id:
            raise ValueError(f"id {servo2.id} is already used by servo1")
        return servo2

    @property
    def angle_noise_rad(self) -> float:
        """Standard deviation (rad) of the noise of a palm's reported angle."""
        return math.radians(self.angle_noise_deg)

    @property
    def goal_rounding_rad(self) -> float:
        """Steps (rad) of a palm's angle to which set-points are rounded: the servo's counts, 4096 a turn."""
        return math.tau / 4096

    @property
    def servos(self) -> tuple[ServoConfig, ...]:
        """The servos, in the order of their palms."""
        return tuple(getattr(self, f"servo{palm}") for palm in PALMS)

    @property
    def hinge(self) -> HingeMode:
        """The hinge that it drives."""
        return "fixed"

    @property
    def play_sd_deg(self) -> float:
        """Standard deviation (°) of the constant error due to play: weight holds the palm at an unknown end."""
        return 0.5 * self.backlash_deg


class DynamixelConfig(ServosConfig):
    """Two DYNAMIXEL servos of the X series on one bus, for palm 1 and palm 2, about a fixed hinge."""

    kind: Literal["dynamixel"]
    """Kind of actuator."""
    baud: ServoBaud = 1000000
    """Baud rate of the bus; the factory default, 57600, is too slow for 100 cycles a second."""


class FeetechConfig(ServosConfig):
    """Two Feetech STS3215 servos on one bus, for palm 1 and palm 2, about a fixed hinge."""

    kind: Literal["feetech"]
    """Kind of actuator."""
    baud: Annotated[int, one_of(115200, 1000000)] = 1000000
    """Baud rate of the bus; factory default 1000000."""
    backlash_deg: Annotated[NotNegative, Field(le=5)] = 1.0
    """Total play of the gears between servo and palm."""
    friction_deg: Annotated[NotNegative, Field(le=5)] = 0.4
    """Dead band: change of the goal after a reversal before the servo moves."""

    @property
    def goal_rounding_rad(self) -> float:
        """Steps (rad) of a palm's angle to which set-points are rounded: friction prevents smaller ones."""
        return max(math.radians(self.friction_deg), super().goal_rounding_rad)


ArmConfig = Annotated[
    Annotated[AdeptConfig, Tag("<adept>")]
    | Annotated[DynamixelConfig, Tag("<dynamixel>")]
    | Annotated[FeetechConfig, Tag("<feetech>")],
    Discriminator(
        by_kind("adept"),
        custom_error_type="kind",
        custom_error_message="kind must be one of adept, dynamixel, feetech",
    ),
]
"""Union of the kinds of actuators."""
