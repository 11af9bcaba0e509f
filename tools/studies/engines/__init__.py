"""Scenes in independent physics engines, whose logs test palmd's estimators and its emulated rig."""
