"""Validates configurations, motion plans and stored outlines; plans are checked against the configurations' limits.

Files and devices named in a configuration are checked too, and implausible values are reported. `--draw` draws what a
plan does: angles and rates with their limits, the palms' path, and the nearest limit.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import re
from collections.abc import Sequence
from pathlib import Path

from palmd.console.errors import BAD_INPUT, CliError, writing
from palmd.console.extras import importing

PICTURES = (".svg", ".pdf", ".png")
_PLACED = re.compile(r"(.*?):(\d+):(\d+): (.*)", re.DOTALL)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "files", nargs="+", type=Path, metavar="FILE", help="a configuration or a plan (YAML), an outline (.json, .csv)"
    )
    parser.add_argument("--json", action="store_true", help="print the errors as one JSON map")
    parser.add_argument(
        "--draw", type=Path, metavar="OUT.svg", help="draw the motion of the only plan among FILE (or .pdf, .png)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Report all errors at once; CliError if there are any."""
    from palmd.motion.check import check_files, shaking_notes
    from palmd.outlinefile import SUFFIXES

    if arguments.draw is not None and arguments.draw.suffix.lower() not in PICTURES:
        raise CliError(BAD_INPUT, f"{arguments.draw}: use the suffix {', '.join(PICTURES)} for a picture")
    outlines = [path for path in arguments.files if path.suffix.lower() in SUFFIXES]
    files = [path for path in arguments.files if path not in outlines]
    errors = check_files(files) + _device_errors(files) + _outline_errors(outlines)
    notes = [] if errors else shaking_notes(files)
    if arguments.json:
        report = {"good": not errors, "problems": [problem(each) for each in errors], "notes": notes}
        print(json.dumps(report, indent=2))
        if errors:
            return BAD_INPUT
    if errors:
        raise CliError(BAD_INPUT, "\n".join(errors))
    if not arguments.json:
        for path in arguments.files:
            print(f"{path}: good")
        for note in notes:
            print(f"note: {note}")
    if arguments.draw is not None:
        _draw([path for path in arguments.files if path not in outlines], arguments.draw, quiet=arguments.json)
    return 0


def _device_errors(paths: Sequence[Path]) -> list[str]:
    """Contradictions between valid configurations and connected pads."""
    from palmd.doctor.ports import device_errors
    from palmd.yamlfile import ConfigError, is_plan, parse_config, read_document

    errors = []
    for path in paths:
        with contextlib.suppress(ConfigError):  # already reported
            document = read_document(path)
            errors += [] if is_plan(document) else device_errors(document, parse_config(document))
    return errors


def problem(error: str) -> dict[str, str | int | None]:
    """An error line as a map; line and column are None if it has none."""
    placed = _PLACED.fullmatch(error)
    if placed is None:
        path, _, text = error.partition(": ")
        return {"file": path, "line": None, "column": None, "text": text}
    return {"file": placed[1], "line": int(placed[2]), "column": int(placed[3]), "text": placed[4]}


def _draw(files: Sequence[Path], output: Path, *, quiet: bool) -> None:
    """Draw the only plan among the files, for the only configuration among them, else the shipped one."""
    from palmd.console.shipped import shipped
    from palmd.motion.check import motion_limits
    from palmd.motion.plan import compile_plan
    from palmd.yamlfile import is_plan, load_config, load_plan, read_document

    plans = [path for path in files if is_plan(read_document(path))]
    configs = [path for path in files if path not in plans]
    if len(plans) != 1 or len(configs) > 1:
        what = f"there are {len(plans)} plans and {len(configs)} configurations"
        raise CliError(BAD_INPUT, f"--draw: give one plan, and its configuration if it is not the shipped one: {what}")
    with importing("--draw", "matplotlib", "report"):
        from palmd.report.plan_figure import save
    config = load_config(configs[0] if configs else shipped("palmd.yaml"))
    limits = motion_limits(config)
    with writing(output):
        summary = save(compile_plan(load_plan(plans[0]), limits), limits, config, output)
    if not quiet:
        print(f"{output}: {summary}")


def _outline_errors(paths: Sequence[Path]) -> list[str]:
    from palmd.outlinefile import OutlineError, read_outline

    errors = []
    for path in paths:
        try:
            read_outline(path)
        except OutlineError as error:
            errors.append(str(error))
    return errors
