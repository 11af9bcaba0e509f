"""The table of studies, and what runs one of them by its name."""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Sequence
from types import ModuleType

from palmd.cli import status_of
from palmd.cli.table import STUDIES as PROGRAM
from palmd.console.arguments import Parser, one_of
from palmd.console.extras import missing

OPTIONAL = ("matplotlib", "filterpy", "distributed")
"""What only some studies need: the extra `studies`."""

STUDIES = {
    "montecarlo": ("bench_montecarlo", "random objects reconstructed blind, against truth and Cramér–Rao bound"),
    "sbc": ("bench_sbc", "simulation-based calibration of blind reconstructions"),
    "off": ("bench_off", "reconstructions while one property of the rig is not as configured"),
    "explore": ("bench_explore", "unknown objects explored on the emulated rig, beside an explorer that knows them"),
    "curved": ("bench_curved", "curved palms: reconstruction, exploration and coverage"),
    "pivot": ("bench_pivot", "objects in a pivoting grasp, offline and live"),
    "space": ("bench_space", "bodies between three palms in space, offline, live and explored"),
    "things": ("bench_things", "dice, nuts, coins and blocks: how often a live estimate is wrong"),
    "speed": ("bench_speed", "time of kernels, routines and records, as ratios to references beside them"),
    "engines": ("bench_engines", "logs and contact forces of independent physics engines"),
    "field": ("bench_field", "benchmark of 200 runs with truth, baselines and a scorer"),
    "faults": ("bench_faults", "each fault provoked on the emulated rig: reaction and time to standstill"),
    "simulate": ("bench_simulate", "daemon and rig in virtual time with random faults: invariants that must hold"),
    "false-alarms": ("false_alarms", "ordinary operation in virtual time: which guard holds or stops it"),
    "soak": ("bench_soak", "the demo for an hour with random faults: leaks, lateness, lost packets"),
    "observability": ("observability", "rank and conditioning of the paper's systems at random states"),
    "paper": ("paper", "the runs behind the figures of CMU-CS-01-107, by its method and by palmd's"),
}
"""By name: the module, which has `add_arguments(parser)` and `run(arguments) -> int`, and the description."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one study; returns the exit status as `palmd` does. Raises SystemExit for usage and help."""
    return status_of(lambda: _asked_for(argv))


def loaded(name: str) -> ModuleType:
    """The study's module; raises CliError, with what to install, where an optional package is missing."""
    try:
        return importlib.import_module(f"tools.studies.{STUDIES[name][0]}")
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package not in OPTIONAL:
            raise
        raise missing(f"the study {name}", package, "studies") from None


def _asked_for(argv: Sequence[str] | None) -> tuple[ModuleType, argparse.Namespace]:
    width = max(map(len, STUDIES))
    parser = Parser(
        prog=PROGRAM,
        description="Studies of palmd; each repeats the figures of a page in docs/results or docs/theory.",
        epilog="studies:\n" + "\n".join(f"  {name:{width}}  {text}" for name, (_, text) in STUDIES.items()),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("name", metavar="NAME", type=one_of(STUDIES), help="one of the studies below")
    parser.add_argument("arguments", metavar="…", nargs=argparse.REMAINDER, help=f"see: {PROGRAM} NAME --help")
    chosen = parser.parse_args(argv)
    module = loaded(chosen.name)
    own = Parser(prog=f"{PROGRAM} {chosen.name}", description=module.__doc__)
    module.add_arguments(own)
    return module, own.parse_args(chosen.arguments)
