"""Curved palms: cradles and domes reconstructed blind, and how much more of an outline the same motion touches."""

from __future__ import annotations

import argparse
from pathlib import Path

from palmd.console.arguments import count, seconds, seed
from palmd.lab import curved
from palmd.lab.rows import collected, on_this_machine
from palmd.rig.simulate_curved import CURVED_KINDS

RADII_MM = (50.0, 60.0, 75.0, 90.0, 120.0)
AMPLITUDES = (0.25, 0.45)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The bench's arguments."""
    add = parser.add_argument
    add("--runs", type=count, default=34, metavar="N", help="logs of each kind (default: %(default)s)")
    add("--shapes", type=count, default=24, metavar="N", help="objects on each curvature (default: %(default)s)")
    add("--seed", type=seed, default=0, metavar="FIRST", help="the first run's (default: %(default)s)")
    add("--seconds", type=seconds, default=10.0, metavar="S", help="how long each lasts (default: %(default)s)")
    add("--only", choices=("logs", "coverage"), help="one half of it; default: both")
    add("--figure", type=Path, metavar="OUT.svg", help="draw the touched share against curvature; needs matplotlib")
    add("--jobs", type=count, metavar="J", help="processes on this machine (default: one a processor)")


def run(arguments: argparse.Namespace) -> int:
    """Interrupted, it tells of what is finished until then."""
    status = 0
    seeds = range(arguments.seed, arguments.seed + max(arguments.runs, arguments.shapes))
    if arguments.only != "coverage":
        tasks = [
            curved.LogTask(kind, each, arguments.seconds) for each in seeds[: arguments.runs] for kind in CURVED_KINDS
        ]
        rows, status = collected(
            "curved", tasks, curved.reconstructed, curved.log_failed, on_this_machine(arguments.jobs)
        )
        order = sorted(rows, key=lambda row: (CURVED_KINDS.index(row.kind), row.seed))
        print(f"reconstructed, seeds {seeds[0]}–{seeds[arguments.runs - 1]} of each kind")
        print(curved.log_table(order))
        for row in order:
            if row.error or not row.converged:
                print(f"{row.kind} {row.seed}: {row.error or row.reason}")
    if status == 0 and arguments.only != "logs":
        curvatures = [0.0, *(sign * 1e3 / radius for radius in RADII_MM for sign in (1.0, -1.0))]
        rocks = [
            curved.CoverageTask(kappa, amplitude, each, arguments.seconds)
            for each in seeds[: arguments.shapes]
            for kappa in curvatures
            for amplitude in AMPLITUDES
        ]
        covered, status = collected(
            "coverage", rocks, curved.rocked, curved.coverage_failed, on_this_machine(arguments.jobs)
        )
        print(f"touched share by the same motion, seeds {seeds[0]}–{seeds[arguments.shapes - 1]}")
        print(curved.coverage_table(covered))
        if arguments.figure is not None:
            curved.figure(covered, arguments.figure)
    return status
