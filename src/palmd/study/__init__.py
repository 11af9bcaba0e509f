"""Offline work: the whole rig without wires, and studies of many runs."""
