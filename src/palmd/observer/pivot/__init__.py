"""The pivoting grasp seen from its end: outline about the pivot, motion, friction, and what its weight tells."""
