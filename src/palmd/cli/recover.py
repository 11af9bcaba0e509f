"""Make a whole, compressed recording of one that was cut off: by a crash, a full disk or a lost machine."""

from __future__ import annotations

import argparse
from pathlib import Path

from palmd.console.errors import BAD_INPUT, CliError
from palmd.console.progress import Progress
from palmd.record.mcapfile import is_packed
from palmd.record.run import AnyRun, RunError, read_any_run
from palmd.record.runfile import pack


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument("run", type=Path, metavar="RUN", help="the recording (.mcap)")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="where to; default: in place of RUN")


def run(arguments: argparse.Namespace) -> int:
    """Says how much was saved; CliError when nothing can be, or the output cannot be written."""
    source: Path = arguments.run
    target: Path = arguments.output or source
    try:
        recording = read_any_run(source)
        if target == source and is_packed(source):
            print(f"{source}: is whole already")
            return 0
        print(_packed(recording, target))
    except RunError as error:
        raise CliError(BAD_INPUT, str(error)) from None
    except OSError as error:
        raise CliError(BAD_INPUT, f"{target}: cannot be written: {error.strerror or error}") from None
    return 0


def _packed(recording: AnyRun, target: Path) -> str:
    """Pack it; what was saved, in words."""
    surveys = recording.survey().values()
    total = sum(survey.count for survey in surveys)
    seconds = (max(survey.end_ns for survey in surveys) - min(survey.begin_ns for survey in surveys)) * 1e-9
    with Progress("packing", total, "messages") as bar:
        count, torn = pack(recording.path, target, bar.at)
    left_out = f", {torn} torn bytes at the end left out" if torn else ""
    return f"{target}: {count} messages of {seconds:.1f} s saved{left_out}"
