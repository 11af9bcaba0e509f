"""The daemon: both pads and the arm on their ports, estimates on the bus, motion when it is asked for."""

from __future__ import annotations

import argparse
import gc
import subprocess
from pathlib import Path

from palmd.harness.processes import start_beside


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument("config", type=Path, metavar="CONFIG", help="the rig's configuration, palmd.yaml")
    parser.add_argument("--no-record", action="store_true", help="start no recorder beside it")


def run(arguments: argparse.Namespace) -> int:
    """Runs until SIGTERM or SIGINT, then brings the arm to a planned stop."""

    def recorder() -> subprocess.Popen[bytes]:
        return start_beside(["record", str(arguments.config)])

    gc.disable()  # what a start makes stays; the loop has its collector once it is frozen
    try:
        from palmd.daemon import app

        return app.run(arguments.config) if arguments.no_record else app.run(arguments.config, recorder)
    finally:
        gc.enable()
