"""The emulated rig alone: far ends of both pads and the arm on pseudo-terminals, told in one JSON line."""

from __future__ import annotations

import argparse

from palmd.daemon import realtime
from palmd.rig import app


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    app.add_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Runs until SIGTERM, SIGINT or the parent's end."""
    realtime.prepare(realtime.RIG_PRIORITY)  # what is not allowed makes it no worse than it was
    return app.run_rig(arguments)
