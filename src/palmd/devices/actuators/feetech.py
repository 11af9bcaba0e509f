"""`kind: feetech`: two Feetech STS3215 servos on one bus that turn the palms about a fixed hinge."""

from __future__ import annotations

from functools import partial

from palmd.devices.actuator import ActuatorFactory
from palmd.devices.feetech import MAKE
from palmd.devices.servohost import ServoHost

DRIVER: ActuatorFactory = partial(ServoHost, make=MAKE)
