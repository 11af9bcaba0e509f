"""The emulated far sides of buses of servos, a file a kind: `palmd.rig.servos` finds them by the arm's `kind`."""
