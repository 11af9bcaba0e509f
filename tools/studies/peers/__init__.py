"""The same readings and the same model through other people's estimators, and how they compare."""
