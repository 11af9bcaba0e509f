"""The emulated rig of three palms in space: bodies, how they move, and the logs that they leave."""
