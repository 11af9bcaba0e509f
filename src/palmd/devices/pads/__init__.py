"""Kinds of touch pads, one file each: `palmd.devices.pad` finds them by the configuration's `kind`."""
