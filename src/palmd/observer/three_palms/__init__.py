"""The observer of an unknown body between three palms in space."""
