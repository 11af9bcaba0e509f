"""Calibrations: measurements of the rig's constants that the configuration needs."""
