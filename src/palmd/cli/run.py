"""The daemon: both pads and the arm on their ports, estimates on the bus, motion when it is asked for."""

from __future__ import annotations

import argparse
import os
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument("config", type=Path, metavar="CONFIG", help="the rig's configuration, palmd.yaml")


def run(arguments: argparse.Namespace) -> int:
    """Runs until SIGTERM or SIGINT, then brings the arm to a planned stop."""
    # the loop's matrices are small: threads of the linear algebra library would only compete with it
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from palmd.daemon import app

    return app.run(arguments.config)
