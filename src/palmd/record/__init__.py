"""Runs on disk: event logs, and their causal replay through the daemon's observer."""

SUFFIX = ".mcap"
"""Of a recording's file."""
