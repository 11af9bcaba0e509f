"""Runs the emulated rig alone: pads and arm on pseudo-terminals, whose names are printed in one JSON line."""

from __future__ import annotations

import argparse

from palmd.daemon import realtime
from palmd.rig import app


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    app.add_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run until SIGTERM, SIGINT or the parent's end."""
    realtime.prepare(realtime.RIG_PRIORITY)  # without permission the priority stays unchanged
    return app.run_rig(arguments)
