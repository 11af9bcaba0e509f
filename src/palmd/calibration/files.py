"""What all calibrations share: CONFIG and the folder of the result, the report, and the result's file.

A result is YAML with the date, the version, and the hash of the proposed settings.
"""

from __future__ import annotations

import argparse
import datetime
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import yaml

from palmd import __version__
from palmd.config.any_config import config_hash
from palmd.config.fields import Strict
from palmd.console.errors import BAD_INPUT, CliError, writing
from palmd.console.folders import is_writable_folder, nearest


def add_config(parser: argparse.ArgumentParser, text: str) -> None:
    """The argument CONFIG, with its help."""
    parser.add_argument("config", type=Path, metavar="CONFIG", help=text)


def add_output(parser: argparse.ArgumentParser, files: str) -> None:
    """The option for the folder of the result; `files` names what is written there."""
    text = f"for {files}, which {'are' if ' and ' in files else 'is'} overwritten (default: calibration/ beside CONFIG)"
    parser.add_argument("-o", "--output", type=Path, metavar="FOLDER", help=text)


def result_folder(arguments: argparse.Namespace) -> Path:
    """The folder for the result; CliError unless it can be written."""
    return writable(arguments.output or arguments.config.parent / "calibration")


def report(table: str, remarks: Iterable[str]) -> None:
    """Print the result, and the warnings for the operator on standard error."""
    print(table)
    for remark in remarks:
        print(remark, file=sys.stderr)


def document(
    header: Mapping[str, Any],
    section: Strict,
    settings: Mapping[str, Any],
    found: Mapping[str, Any],
    inputs: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """The stored result: `header` with the format, date and version, `inputs`, proposed `settings`, and what was found.

    The hash is that of the configuration's `section` with the settings.
    """
    return {
        **header,
        "date": datetime.datetime.now().astimezone().isoformat(timespec="seconds"),
        "palmd": __version__,
        "settings_sha256": config_hash(section),
        **(inputs or {}),
        "configuration": dict(settings),
        "found": dict(found),
    }


def store(path: Path, content: dict[str, Any]) -> None:
    """Write a result and print where it is; CliError."""
    write(path, content)
    print(f"written: {path}")


def plain(value: Any) -> Any:
    """Convert to maps, lists and rounded numbers only."""
    if isinstance(value, dict):
        return {key: plain(each) for key, each in value.items()}
    if isinstance(value, tuple):
        return [plain(each) for each in value]
    return round(value, 5) if isinstance(value, float) else value


def writable(folder: Path) -> Path:
    """Check the folder before the calibration begins; CliError unless `write` can create it and write to it.

    Nothing is created yet, so that a calibration that fails leaves nothing.
    """
    with writing(folder):
        there = nearest(folder)
    if not there.is_dir():
        raise CliError(BAD_INPUT, f"{folder}: cannot be written: {there} is no folder")
    if not is_writable_folder(there):
        raise CliError(BAD_INPUT, f"{folder}: cannot be written: no permission")
    return folder


def write(path: Path, content: dict[str, Any]) -> None:
    """Write a result, creating the folder if needed; an old result stays until the new one is complete. CliError."""
    partial = path.with_suffix(".tmp")
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
        partial.replace(path)
