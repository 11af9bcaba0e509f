"""Description of the rig: mechanism, palms, sensors, and the names of their quantities."""
