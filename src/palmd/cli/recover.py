"""Repairs a recording that was cut off or damaged: writes a complete, compressed one.

An unfinished recording is finished in place. If a part cannot be read, or other programs have added messages to a run
that is not packed, RUN is left unchanged, and palmd's readable messages are written to RUN.recovered.mcap beside it, or
to FILE. Exit status 0 if the result has all of RUN, 1 if something is missing, which is reported.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from palmd.console.errors import BAD_INPUT, as_cli_error, writing
from palmd.console.notes import print_notes
from palmd.console.progress import Progress
from palmd.record import SUFFIX
from palmd.record.run import RunError, read_any_run
from palmd.record.runfile import pack

RECOVERED = ".recovered"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("run", type=Path, metavar="RUN", help="the recording (.mcap)")
    parser.add_argument(
        "-o", "--output", type=Path, metavar="FILE",
        help="output; default: in place of RUN, or RUN.recovered.mcap if a part of RUN cannot be read",
    )  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Repair and report; return 1 if something is missing. CliError if nothing is readable or the output fails."""
    source: Path = arguments.run
    target: Path = arguments.output or source
    with as_cli_error(RunError):
        recording = read_any_run(source)
        layout = recording.layout
        finished = layout.finished and layout.packed and not layout.damage.damaged
        if arguments.output is None and (layout.damage.unread_bytes or (layout.foreign and not finished)):
            target = source.with_name(source.name.removesuffix(SUFFIX) + RECOVERED + SUFFIX)
        elif arguments.output is None and finished:
            print(f"{source}: is already complete")
            return 0
        with writing(target), Progress("packing", layout.count, "messages") as bar:
            pack(source, target, bar.at)
    print_notes(recording.damage_notes)
    if layout.foreign:
        added = ", ".join(f"{count:,} of {topic}" for topic, count in sorted(layout.foreign.items()))
        print_notes([f"{source}: messages of other programs are left out: {added}"])
    damage, seconds = layout.damage, (layout.end_ns - layout.begin_ns) * 1e-9
    left_out = f", {damage.torn_bytes} torn bytes at the end left out" if damage.torn_bytes else ""
    print(f"{target}: {layout.count} messages of {seconds:.1f} s saved{left_out}")
    missing = layout.foreign or damage.lost or damage.torn_bytes or damage.preface_bytes
    missing = missing or damage.further_bytes or damage.cut
    return BAD_INPUT if missing else 0
