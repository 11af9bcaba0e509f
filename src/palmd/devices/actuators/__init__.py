"""Kinds of what moves the palms, one file each: `palmd.devices.actuator` finds them by the configuration's `kind`."""
