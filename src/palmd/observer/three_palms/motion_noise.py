"""Process noise of the equations of motion of a body between three palms, as spectral densities."""

SPIN = 1e-3
"""Of the spin, (rad/s)²/s."""
BY_SPIN = 1e-2
"""Added to `SPIN` times |ω|², 1/s."""
TURN = 1e-7
"""Of the rotation, rad²/s."""
