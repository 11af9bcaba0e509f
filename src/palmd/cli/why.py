"""Explains why a recorded run held or stopped, with the evidence: which byte, which age, which limit.

Without a time it explains the last hold or stop by a fault, and lists the others.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

from palmd.console.errors import as_cli_error
from palmd.console.notes import print_notes
from palmd.jsonvalues import or_none
from palmd.record.run import RunError, read_any_run
from palmd.report.why import Explanation, explain, lines


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("run", type=Path, metavar="RUN", help="a recorded run (.mcap), finished or not")
    parser.add_argument(
        "--at", type=_time, metavar="T",
        help="time in s since the first message, as in reports (default: the last hold or stop by a fault)",
    )  # fmt: skip
    parser.add_argument("--json", action="store_true", help="print the answer as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Print the answer; CliError for an invalid run, or a time outside it."""
    with as_cli_error(RunError, OSError):
        recording = read_any_run(arguments.run)
        print_notes(recording.damage_notes)
        answer = explain(recording, arguments.at)
        print(json.dumps(as_json(answer), ensure_ascii=False) if arguments.json else "\n".join(lines(answer)))
    return 0


def as_json(answer: Explanation) -> dict[str, Any]:
    """The answer's fields; null for times that do not exist."""
    fields = asdict(answer) | {"cause": asdict(answer.cause) | {"name": answer.cause.name}}
    return {name: or_none(value) for name, value in fields.items()}


def _time(text: str) -> float:
    with contextlib.suppress(ValueError):
        seconds = float(text)
        if 0.0 <= seconds < math.inf:
            return seconds
    raise argparse.ArgumentTypeError(f"must be a time in the run in s, 0 or more, not {text}")
