"""Validates configurations, motion plans and stored outlines; a plan's limits are those of the configurations given.

What a configuration names is checked with it, and values that can hardly be meant are asked about. `--draw` makes a
picture of what a plan does: angles and rates within their limits, where the palms go, and which limit is nearest.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import re
from collections.abc import Sequence
from pathlib import Path

from palmd.console.errors import BAD_INPUT, CliError
from palmd.console.extras import missing, only_without

PICTURES = (".svg", ".pdf", ".png")
_PLACED = re.compile(r"(.*?):(\d+):(\d+): (.*)", re.DOTALL)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument(
        "files", nargs="+", type=Path, metavar="FILE", help="a configuration or a plan (YAML), an outline (.json, .csv)"
    )
    parser.add_argument("--json", action="store_true", help="print what is wrong as one JSON map")
    parser.add_argument(
        "--draw", type=Path, metavar="OUT.svg", help="a picture of what the one plan among FILE does (or .pdf, .png)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Tells everything that is wrong at once; CliError when anything is."""
    from palmd.motion.check import check_files, shaking_notes
    from palmd.outlinefile import SUFFIXES

    if arguments.draw is not None and arguments.draw.suffix.lower() not in PICTURES:
        raise CliError(BAD_INPUT, f"{arguments.draw}: a picture is {', '.join(PICTURES)}; name it so")
    outlines = [path for path in arguments.files if path.suffix.lower() in SUFFIXES]
    files = [path for path in arguments.files if path not in outlines]
    errors = check_files(files) + _device_errors(files) + _outline_errors(outlines)
    notes = [] if errors else shaking_notes(files)
    if arguments.json:
        told = {"good": not errors, "problems": [problem(each) for each in errors], "notes": notes}
        print(json.dumps(told, indent=2))
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
    """What valid configurations say otherwise than the pads' devices that are there."""
    from palmd.doctor.pad_devices import device_errors
    from palmd.yamlfile import ConfigError, is_plan, parse_config, read_document

    errors = []
    for path in paths:
        with contextlib.suppress(ConfigError):  # that is told already
            document = read_document(path)
            errors += [] if is_plan(document) else device_errors(document, parse_config(document))
    return errors


def problem(error: str) -> dict[str, str | int | None]:
    """An error line as a map; line and column are None where none is told."""
    placed = _PLACED.fullmatch(error)
    if placed is None:
        path, _, text = error.partition(": ")
        return {"file": path, "line": None, "column": None, "text": text}
    return {"file": placed[1], "line": int(placed[2]), "column": int(placed[3]), "text": placed[4]}


def _draw(files: Sequence[Path], output: Path, *, quiet: bool) -> None:
    """The picture of the one plan among the files, on the rig of the one configuration among them, else as shipped."""
    from palmd.console.shipped import shipped
    from palmd.motion.check import motion_limits
    from palmd.motion.plan import compile_plan
    from palmd.yamlfile import is_plan, load_config, load_plan, read_document

    plans = [path for path in files if is_plan(read_document(path))]
    configs = [path for path in files if path not in plans]
    if len(plans) != 1 or len(configs) > 1:
        what = f"there are {len(plans)} plans and {len(configs)} configurations"
        raise CliError(BAD_INPUT, f"--draw: give one plan, and its configuration if it is not the shipped one: {what}")
    try:
        from palmd.report.plan_figure import save
    except ModuleNotFoundError as error:
        only_without("matplotlib", error)
        raise missing("--draw", "matplotlib", "report") from None
    config = load_config(configs[0] if configs else shipped("palmd.yaml"))
    limits = motion_limits(config)
    try:
        said = save(compile_plan(load_plan(plans[0]), limits), limits, config, output)
    except OSError as error:
        raise CliError(BAD_INPUT, f"{output}: cannot be written: {error.strerror or error}") from None
    if not quiet:
        print(f"{output}: {said}")


def _outline_errors(paths: Sequence[Path]) -> list[str]:
    from palmd.outlinefile import OutlineError, read_outline

    errors = []
    for path in paths:
        try:
            read_outline(path)
        except OutlineError as error:
            errors.append(str(error))
    return errors
