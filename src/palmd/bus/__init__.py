"""Clients of a daemon's sockets."""
