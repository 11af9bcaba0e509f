"""`kind: dynamixel`: two DYNAMIXEL servos on one bus that turn the palms about a fixed hinge."""

from __future__ import annotations

from functools import partial

from palmd.devices.actuator import ActuatorFactory
from palmd.devices.dynamixel import MAKE
from palmd.devices.servohost import ServoHost

DRIVER: ActuatorFactory = partial(ServoHost, make=MAKE)
