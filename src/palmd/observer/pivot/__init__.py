"""Estimators of the pivoting grasp: outline about the pivot, motion, friction, and mass where it is observable."""
