"""Daemon and emulated rig in one process on virtual time: what may happen is drawn, what must hold is checked."""
