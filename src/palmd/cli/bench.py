"""Studies and comparisons: many runs, in numbers."""

from __future__ import annotations

import argparse

from palmd.cli import subcommands

BENCHES = {
    "montecarlo": "random objects reconstructed blind, scored against their truth and the Cramér–Rao bound",
    "explore": "unknown objects explored in the emulated rig, beside open-loop plans",
    "recognise": "which of twenty similar objects lies on the palms, or none of them",
    "peers": "palmd's estimators beside general-purpose ones",
    "faults": "every fault provoked on the emulated rig: what comes of it, how soon the arm stands",
    "soak": "the demo for an hour with random mischief: leaks, lateness, lost packets",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The bench's name; what follows is for the bench itself."""
    subcommands.add_arguments(parser, BENCHES)


def run(arguments: argparse.Namespace) -> int:
    """Runs the bench; raises SystemExit for usage and help, as argparse does."""
    return subcommands.run("bench", arguments)
