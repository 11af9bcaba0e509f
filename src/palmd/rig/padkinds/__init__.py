"""The emulated far sides of pads, a file a kind: `palmd.rig.pads` finds them by the configuration's `kind`."""
