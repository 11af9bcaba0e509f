"""Shared by all commands: argument types, errors, progress, optional packages, and the files shipped with palmd."""
