"""Export of a recorded run as CSV tables: one file per topic, one row per message, one column per field."""

from __future__ import annotations

import csv
import json
import math
import re
import tempfile
import zipfile
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from palmd.jsonvalues import or_none
from palmd.record.run import AnyRun
from palmd.record.tables import field_examples, flat


def write_csv(run: AnyRun, folder: Path, done: Callable[[], None]) -> None:
    """Write the tables into a new `folder`; `cell` defines the cells. Raises RunError, OSError.

    `done` is called twice for each message.
    """
    folder.mkdir()
    known = field_examples(run, done)
    with ExitStack() as stack:
        tables = {}
        for topic, fields in known.items():
            stream = stack.enter_context((folder / file_name(topic)).open("w", encoding="utf-8", newline=""))
            tables[topic] = csv.DictWriter(stream, [name for name, _ in flat(fields)], restval="")
            tables[topic].writeheader()
        for message in run.messages():
            tables[message.topic].writerow({name: cell(value) for name, value in flat(message.fields)})
            done()


def write_zip(run: AnyRun, path: Path, done: Callable[[], None]) -> None:
    """Write the same files into a ZIP archive. Raises RunError, OSError."""
    with tempfile.TemporaryDirectory(prefix="palmd-export-", dir=path.parent) as scratch:
        folder = Path(scratch) / "tables"
        write_csv(run, folder, done)
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for file in sorted(folder.iterdir()):
                archive.write(file, file.name)


def file_name(topic: str) -> str:
    """`palm-estimate.csv` for `palm/estimate`."""
    return re.sub(r"[^A-Za-z0-9_.-]", "-", topic) + ".csv"


def cell(value: Any) -> Any:
    """One cell: empty for NaN, 1 or 0 for a boolean, JSON text for a list; numbers keep full precision."""
    if isinstance(value, list):
        return json.dumps(or_none(value), allow_nan=False, separators=(",", ":"), ensure_ascii=False)
    if isinstance(value, bool):
        return int(value)
    return "" if isinstance(value, float) and math.isnan(value) else value
