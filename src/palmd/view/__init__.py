"""The live page: a server process that relays a daemon's messages to browsers, and their commands to the daemon."""
