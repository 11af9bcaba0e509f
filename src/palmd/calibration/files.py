"""Result files of calibrations: YAML with the date, the version, and the hash of the proposed settings."""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import Any

import yaml

from palmd import __version__
from palmd.config.any_config import config_hash
from palmd.config.fields import Strict
from palmd.console.errors import BAD_INPUT, CliError
from palmd.console.folders import is_writable_folder, nearest


def provenance(section: Strict) -> dict[str, Any]:
    """Date and version of the measurement, and the hash of the configuration's section with the result."""
    return {
        "date": datetime.datetime.now().astimezone().isoformat(timespec="seconds"),
        "palmd": __version__,
        "settings_sha256": config_hash(section),
    }


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
    try:
        there = nearest(folder)
    except OSError as error:
        raise not_written(folder, error) from None
    if not there.is_dir():
        raise CliError(BAD_INPUT, f"{folder}: cannot be written: {there} is no folder")
    if not is_writable_folder(there):
        raise CliError(BAD_INPUT, f"{folder}: cannot be written: no permission")
    return folder


def write(path: Path, content: dict[str, Any]) -> None:
    """Write a result, creating the folder if needed; an old result stays until the new one is complete. CliError."""
    partial = path.with_suffix(".tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
        partial.replace(path)
    except OSError as error:
        raise not_written(path, error) from None


def not_written(path: Path, error: OSError) -> CliError:
    """The error for a file that cannot be written."""
    return CliError(BAD_INPUT, f"{path}: cannot be written: {error.strerror or error}")
