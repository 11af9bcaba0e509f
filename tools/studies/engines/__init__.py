"""Worlds of other people's physics engines, whose logs judge palmd's estimators and its emulated rig."""
