"""The kinds of actuators that turn the palms."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Discriminator, Field, FiniteFloat, Tag, ValidationInfo, field_validator

from palmd.config.fields import AngleRange, Baud, NotNegative, PortPath, Positive, ServoBaud, Strict, by_kind, one_of
from palmd.system.description import HingeMode
from palmd.system.mechanism import PALMS


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
    sign: Annotated[int, one_of(1, -1)] = 1
    """1 where its counts grow with the palm's direction, counted anticlockwise from the world X axis."""
    centre_deg: Annotated[FiniteFloat, Field(ge=-180, le=360)] = 90.0
    """The palm's direction where the servo counts 2048, the middle of its turn."""
    range_deg: AngleRange = (2.0, 178.0)
    """The palm's directions that the servo itself allows."""


class ServosConfig(Strict):
    """Two servos on one bus, palm 1's and palm 2's, about a fixed hinge."""

    port: PortPath
    """The serial port to the bus."""
    baud: ServoBaud = 1000000
    """Of the bus."""
    servo1: ServoConfig = ServoConfig(id=1)
    """The servo of palm 1."""
    servo2: ServoConfig = ServoConfig(id=2, sign=-1)
    """The other palm's, which faces it."""
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


class DynamixelConfig(ServosConfig):
    """Two DYNAMIXEL servos of the X series on one bus, palm 1's and palm 2's, about a fixed hinge."""

    kind: Literal["dynamixel"]
    """What kind of actuator it is."""
    baud: ServoBaud = 1000000
    """Of the bus; servos leave the factory with 57600, too slow for a hundred cycles a second."""


class FeetechConfig(ServosConfig):
    """Two Feetech STS3215 servos on one bus, palm 1's and palm 2's, about a fixed hinge."""

    kind: Literal["feetech"]
    """What kind of actuator it is."""
    baud: Annotated[int, one_of(115200, 1000000)] = 1000000
    """Of the bus; servos leave the factory with 1000000."""
    backlash_deg: Annotated[NotNegative, Field(le=5)] = 1.0
    """Play of the gears between servo and palm, from end to end."""
    friction_deg: Annotated[NotNegative, Field(le=5)] = 0.4
    """By how much a goal must move before the servo does, from one direction to the other."""

    @property
    def goal_rounding_rad(self) -> float:
        """To what steps of a palm's angle set-points are rounded: friction holds the servo against smaller ones."""
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
"""The kinds of actuators."""
