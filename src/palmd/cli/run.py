"""Runs the daemon: reads the pads and the arm, publishes estimates on the bus, and moves the arm on command."""

from __future__ import annotations

import argparse
import gc
import subprocess
from pathlib import Path

from palmd.harness.processes import start_beside


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("config", type=Path, metavar="CONFIG", help="the rig's configuration, palmd.yaml")
    parser.add_argument("--no-record", action="store_true", help="do not start a recorder")


def run(arguments: argparse.Namespace) -> int:
    """Run until SIGTERM or SIGINT, then stop the arm by a planned stop."""

    def recorder() -> subprocess.Popen[bytes]:
        return start_beside(["record", str(arguments.config)])

    gc.disable()  # objects of the start-up are permanent; the loop collects itself after freezing them
    try:
        from palmd.daemon import app

        return app.run(arguments.config) if arguments.no_record else app.run(arguments.config, recorder)
    finally:
        gc.enable()
