"""Checks machine, configuration and rig, and prints what is missing with the command that fixes it.

It changes nothing and moves nothing. Exit status 0 only if everything is in order.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from palmd.console.configured import INSTALLED, configured, default_path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("config", nargs="?", type=Path, metavar="CONFIG",
                        help=f"the rig's configuration (default: {INSTALLED}, else the shipped one)")  # fmt: skip
    parser.add_argument(
        "--touch", action="store_true", help="find which pad is which and its orientation, by touching them"
    )


def run(arguments: argparse.Namespace) -> int:
    """Return the exit status. CliError for an invalid configuration, and if the rig does not answer."""
    path = default_path(arguments.config)
    if arguments.touch:
        from palmd.doctor.touch import examine_pads

        return examine_pads(path, configured(path).pads)
    from palmd.doctor.findings import examine_all

    return examine_all(path)
