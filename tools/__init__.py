"""Programs for developers in a checkout; not installed."""
