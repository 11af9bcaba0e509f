"""Studies and comparisons: many runs, in numbers."""

from __future__ import annotations

import argparse
import importlib

BENCHES = {
    "montecarlo": "random objects reconstructed blind, scored against their truth and the Cramér–Rao bound",
    "peers": "palmd's estimators beside general-purpose ones",
}
"""Every bench; its module `bench_NAME` in this package has `add_arguments(parser)` and `run(arguments) -> int`."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The bench's name; what follows is for the bench itself."""
    width = max(map(len, BENCHES))
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = "benches:\n" + "\n".join(f"  {name:{width}}  {text}" for name, text in BENCHES.items())
    parser.add_argument("bench", metavar="NAME", choices=BENCHES, help="one of the benches below")
    parser.add_argument("arguments", metavar="…", nargs=argparse.REMAINDER, help="see: palmd bench NAME --help")


def run(arguments: argparse.Namespace) -> int:
    """Runs the bench; raises SystemExit for usage and help, as argparse does."""
    module = importlib.import_module(f"palmd.cli.bench_{arguments.bench}")
    parser = argparse.ArgumentParser(prog=f"palmd bench {arguments.bench}", description=module.__doc__)
    module.add_arguments(parser)
    status: int = module.run(parser.parse_args(arguments.arguments))
    return status
