"""Diagnosis of machine and rig: what is missing or wrong, each with the command that fixes it."""
