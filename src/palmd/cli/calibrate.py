"""Measures what the configuration must know of the rig."""

from __future__ import annotations

import argparse

from palmd.cli import subcommands

CALIBRATIONS = {
    "pad": "one touchpad: noise, resolution, timing, dead band, with a marble rolled over it",
    "arm": "the arm's base and the palms' lengths, while you swing the palms by hand",
    "gravity": "gravity and the arm's yaw, with a ball or cylinder that rolls down the palms",
    "pads": "both touchpads: zero, scale, sign, with a turned cylinder between the palms",
    "force": "both touchpads: newtons per count, by the weight of that cylinder",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What is to be calibrated; what follows is for that calibration itself."""
    subcommands.add_arguments(parser, CALIBRATIONS)


def run(arguments: argparse.Namespace) -> int:
    """Runs the calibration."""
    return subcommands.run("calibrate", arguments)
