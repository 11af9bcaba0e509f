"""The `palmd` command: a table of commands, each a module of its own that is imported when it is called."""

from __future__ import annotations

import argparse
import importlib
import io
import logging
import os
import sys
from collections.abc import Sequence

from palmd import __version__, blas
from palmd.cli.arguments import one_of
from palmd.cli.errors import USAGE, CliError
from palmd.logformat import formatter

COMMANDS = {
    "demo": "emulated rig and daemon together: an unknown object, live estimates",
    "run": "the daemon",
    "record": "keep what a daemon publishes: one file a run",
    "recover": "make a whole recording of one that was cut off",
    "rig": "the emulated rig alone, its ports on pseudo-terminals",
    "ctl": "tell a running daemon what to do: status, arm, start, hold, stop, reset, plan, jog",
    "top": "live status of a running daemon in this terminal",
    "view": "live page of a running daemon for browsers on this machine",
    "jog": "turn the palms by the arrow keys, for as long as one is held",
    "explore": "have a running daemon find the whole outline of what lies on the palms",
    "replay": "publish a recorded run again, or check that the observer still says the same",
    "export": "a recorded run as event log, CSV, MCAP with JSON, or for rerun",
    "keys": "who may listen to a daemon and command it: new, allow, revoke, list",
    "check": "find what is wrong with configurations and motion plans",
    "estimate": "an event log or a recorded run through the daemon's observer",
    "reconstruct": "outline and motion from a whole event log or recorded run at once, offline",
    "recognise": "which of the stored outlines lies on the palms, from an event log or recorded run",
    "calibrate": "measure what the configuration must know: pad, arm, gravity, pads, force",
    "observability": "what the paper's systems can observe: rank and conditioning, maps over the rates",
    "compare": "a reconstruction with a camera's track of the same run",
    "report": "a recorded run as a page or PDF to print; paper: the runs of CMU-CS-01-107 again",
    "bench": "studies of many runs: montecarlo, explore, recognise, peers, faults",
    "latency": "how late the control loop is on this machine, idle and busy, beside a bare timer",
    "doctor": "what is missing and how to mend it; the arm's controller and the pads put to the test",
    "build": "compile the observers now; the first run does it otherwise",
    "install": "services of this palmd for systemd: units, account, udev rules",
}
"""Every command; its module in this package has `add_arguments(parser)` and `run(arguments) -> int`."""

INTERRUPTED = 128 + 2


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status: 0 success, 1 wrong input, 2 usage, 3 the rig failed.

    Raises SystemExit for usage, help and version, as argparse does.
    """
    blas.one_thread_from_here()
    _take_any_terminal()
    parser = _parser()
    chosen = parser.parse_args(argv)
    if chosen.command is None:
        parser.print_help(sys.stderr)
        raise SystemExit(USAGE)
    module = importlib.import_module(f"palmd.cli.{chosen.command}")
    parser = argparse.ArgumentParser(prog=f"palmd {chosen.command}", description=module.__doc__)
    module.add_arguments(parser)
    arguments = parser.parse_args(chosen.arguments)
    _start_logging()
    try:
        status: int = module.run(arguments)
        sys.stdout.flush()
    except CliError as error:
        print(error, file=sys.stderr)
        return error.status
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:  # whoever read our output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    return status


def _take_any_terminal() -> None:
    """A terminal or pipe that is not UTF-8 gets a ? for what it cannot show, instead of a traceback."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")


def _start_logging() -> None:
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(formatter())
    logging.basicConfig(level=logging.INFO, handlers=[handler])


def _parser() -> argparse.ArgumentParser:
    width = max(map(len, COMMANDS))
    parser = argparse.ArgumentParser(
        prog="palmd",
        description="An unknown planar object on two touchpad palms, reconstructed live.",
        epilog="commands:\n"
        + "\n".join(f"  {name:{width}}  {text}" for name, text in COMMANDS.items())
        + "\n\nexit status: 0 success, 1 the input is wrong, 2 usage, 3 the rig failed",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"palmd {__version__}")
    parser.add_argument(
        "command", metavar="COMMAND", nargs="?", type=one_of(COMMANDS), help="one of the commands below"
    )
    parser.add_argument("arguments", metavar="…", nargs=argparse.REMAINDER, help="see: palmd COMMAND --help")
    return parser
