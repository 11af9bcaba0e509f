"""The emulated rig, the far side of the wires: written apart from the observer, so each can be wrong."""
