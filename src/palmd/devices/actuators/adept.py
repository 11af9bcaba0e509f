"""`kind: adept`: a V+ program on an Adept controller, connected by a serial line."""

from __future__ import annotations

from palmd.devices.actuator import ActuatorFactory
from palmd.devices.armhost import ArmHost

DRIVER: ActuatorFactory = ArmHost
