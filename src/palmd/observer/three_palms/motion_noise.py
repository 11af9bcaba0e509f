"""Spectral densities of what the equations of motion of a body between three palms leave out."""

SPIN = 1e-3
"""Of the spin, (rad/s)²/s."""
BY_SPIN = 1e-2
"""Added to it for each |ω|², 1/s."""
TURN = 1e-7
"""Of the rotation, rad²/s."""
