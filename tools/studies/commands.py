"""The table of studies, and the command that runs one of them by its name."""

from __future__ import annotations

import argparse
import importlib
import inspect
import sys
import textwrap
from collections.abc import Iterator, Sequence
from types import ModuleType, SimpleNamespace
from typing import cast

from palmd.cli import status_of
from palmd.cli.table import STUDIES as PROGRAM
from palmd.console.arguments import Parser, one_of
from palmd.console.extras import missing

STUDIES = {
    "montecarlo": "random objects reconstructed blind, against truth and Cramér–Rao bound",
    "sbc": "simulation-based calibration of blind reconstructions",
    "miscalibration": "reconstructions with one rig property different from the configuration",
    "explore": "unknown objects explored on the emulated rig, compared with random moves",
    "pivot": "objects in a pivoting grasp, offline and live",
    "space": "bodies between three palms in space, offline, live and explored",
    "paper": "the runs behind the figures of CMU-CS-01-107, by its method and by palmd's",
    "test-objects": "dice, nuts, coins and blocks on the emulated rig: how often an estimate is wrong",
    "engines": "logs and contact forces of independent physics engines",
    "engines-daemon": "the whole daemon in closed loop with MuJoCo as the emulated rig's plant",
    "faults": "each fault provoked on the emulated rig: reaction and time to standstill",
    "simulate": "daemon and rig in virtual time with random faults: invariants that must hold",
    "false-alarms": "ordinary operation in virtual time: which guard holds or stops it",
    "soak": "the demo for an hour with random faults: leaks, lateness, lost packets",
}
"""Names and topics. A study's module has `add_arguments(parser)`, and a `STUDY` or `conduct(arguments) -> int`.

A module that conducts one of two studies names them `OFFLINE` and `LIVE`.
"""

FORMER = {"off": "miscalibration", "things": "test-objects"}
"""Former names of studies, which work with a note, and their present names."""

MODULES = {"engines": "engines.study", "engines-daemon": "engines.daemon"}
"""Modules of studies that are not named after their study."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one study; returns the exit status as `palmd` does. Raises SystemExit for usage and help."""
    return status_of(lambda: _requested(argv))


def _study(word: str) -> str:
    """The study with this name or former name."""
    if word in FORMER:
        print(f"{PROGRAM} {word} is now: {PROGRAM} {FORMER[word]}", file=sys.stderr)
    return one_of(STUDIES)(FORMER.get(word, word))


def loaded(name: str) -> ModuleType:
    """The study's module; if an optional package is missing, raises CliError that names it."""
    try:
        return importlib.import_module(f"tools.studies.{MODULES.get(name, name.replace('-', '_'))}")
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package != "matplotlib":
            raise
        raise missing(f"the study {name}", package, "studies") from None


def _columns(module: ModuleType) -> Iterator[str]:
    """The columns of the study's tables, and the fields of the lines in its files."""
    for study in (getattr(module, name) for name in ("STUDY", "OFFLINE", "LIVE") if hasattr(module, name)):
        if study.columns:
            yield textwrap.fill(f"columns, {study.name}: {'; '.join(title for title, _ in study.columns)}", 100)
        task, row = (inspect.getdoc(of) for of in (study.row.__base__, study.row))
        yield f"fields of a line, {study.name}: {task}\n{row}"


def _requested(argv: Sequence[str] | None) -> tuple[ModuleType, argparse.Namespace]:
    width = max(map(len, STUDIES))
    parser = Parser(
        prog=PROGRAM,
        description="Studies of palmd; each repeats the figures of a page in docs/results or docs/theory.",
        epilog="studies:\n" + "\n".join(f"  {name:{width}}  {text}" for name, text in STUDIES.items()),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("name", metavar="NAME", type=_study, help="one of the studies below")
    parser.add_argument("arguments", metavar="…", nargs=argparse.REMAINDER, help=f"see: {PROGRAM} NAME --help")
    chosen = parser.parse_args(argv)
    module = loaded(chosen.name)
    own = Parser(
        prog=f"{PROGRAM} {chosen.name}", description=module.__doc__, epilog="\n\n".join(_columns(module)),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    module.add_arguments(own)
    conduct = module.STUDY.conduct if hasattr(module, "STUDY") else module.conduct
    return cast(ModuleType, SimpleNamespace(run=conduct)), own.parse_args(chosen.arguments)
