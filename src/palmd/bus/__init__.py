"""A daemon's sockets from the other side."""
