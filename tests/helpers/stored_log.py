"""Event logs stored in tests/data."""

from __future__ import annotations

import lzma
from pathlib import Path

from palmd.record.eventlog import EventLog, read_log

DATA = Path(__file__).parents[1] / "data"


def stored_log(name: str, folder: Path) -> EventLog:
    """The log of that name, unpacked into `folder`."""
    path = folder / "run.jsonl"
    path.write_bytes(lzma.decompress((DATA / f"{name}.jsonl.xz").read_bytes()))
    return read_log(path)
