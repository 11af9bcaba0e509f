"""The emulated rig of three palms in space: bodies, their motion, and logs."""
