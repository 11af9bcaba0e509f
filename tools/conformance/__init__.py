"""Conformance suites: whether a controller or servos behave as palmd's protocols require. Not part of the wheel."""
