"""A recorded run as one file to read or print."""
