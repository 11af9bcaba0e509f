"""Actuator drivers, one module per kind; `palmd.devices.actuator` imports them by the configuration's `kind`."""
