"""Emulators of servo buses, one file per kind: `palmd.rig.servos` finds them by the arm's `kind`."""
