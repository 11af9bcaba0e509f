"""Observer of an unknown body between three palms in space."""
