"""Daemon and emulated rig in one process in virtual time: random events, and invariants that are checked."""
