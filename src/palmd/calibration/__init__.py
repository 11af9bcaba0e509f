"""What the configuration must know of a rig, measured."""
