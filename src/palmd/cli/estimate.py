"""Replays an event log causally through exactly the daemon's observer: one JSON line for each tick of 10 ms."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TextIO

from palmd import observer
from palmd.cli.logs import opened, read
from palmd.cli.progress import Progress
from palmd.record.eventlog import EventLog
from palmd.record.replay import lines, replay, tick_count


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument("log", type=Path, metavar="LOG", help="an event log (JSON lines)")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="OUT.jsonl", help="- for standard output")
    parser.add_argument(
        "--observer",
        type=_observer,
        default=observer.OBSERVERS[0],
        metavar="|".join(observer.OBSERVERS),
        help="default: %(default)s",
    )


def run(arguments: argparse.Namespace) -> int:
    """Reads the whole log before it writes anything; CliError when the log cannot be used."""
    log = read(arguments.log)
    with opened(arguments.output, arguments.log) as stream:
        _replay(log, arguments.observer, stream)
    return 0


def _replay(log: EventLog, name: observer.ObserverName, stream: TextIO) -> None:
    with Progress(f"{name} observer", tick_count(log), "ticks") as progress:
        for tick in replay(log, observer.make(name, log.rig, smoothing=observer.Simulated(log.rig))):
            for line in lines(tick):
                stream.write(json.dumps(line, allow_nan=False) + "\n")
            progress.at(tick.number)


def _observer(name: str) -> str:
    if name in observer.OBSERVERS:
        return name
    known = ", ".join(observer.OBSERVERS)
    if name == "quasistatic":
        raise argparse.ArgumentTypeError(f"quasistatic is not built yet; there are {known}")
    raise argparse.ArgumentTypeError(f"there is no observer {name!r}; there are {known}")
