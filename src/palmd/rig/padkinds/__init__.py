"""Emulators of pads, one file per kind: `palmd.rig.pads` finds them by the configuration's `kind`."""
