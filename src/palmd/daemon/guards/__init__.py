"""Guards between observer and core: pure functions of what is commanded, reported and felt, and of time."""
