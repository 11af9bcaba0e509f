"""The emulated rig: the devices at the far end of the wires. Implemented independently of the observer, to check it."""
