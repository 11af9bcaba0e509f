"""Runs of the emulated plant as event logs, read as from disk."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from palmd.config.two_palms import DrawnImperfections
from palmd.record.eventlog import EventLog, read_log
from palmd.rig.plant import FrictionSurface
from palmd.rig.shapes import Body, Kind
from palmd.rig.simulate import CALIBRATION, simulate_log


def simulated(
    kind: Kind,
    seed: int,
    seconds: float,
    body: Body | None = None,
    imperfections: DrawnImperfections = "none",
    surface: FrictionSurface | None = None,
) -> tuple[EventLog, dict[str, Any]]:
    """The log, and the truth in the fields of a `*.truth.json`; the same arguments give the same run."""
    lines, truth = simulate_log(
        kind, seed, seconds, body=body, surface=surface, calibration_sd=CALIBRATION[imperfections]
    )
    return log_of(lines), truth


def log_of(lines: Iterable[Mapping[str, Any]]) -> EventLog:
    """The log with these lines."""
    with written(lines) as path:
        return read_log(path)


@contextmanager
def written(lines: Iterable[Mapping[str, Any]]) -> Iterator[Path]:
    """A temporary log file with these lines, deleted on exit."""
    with TemporaryDirectory(prefix="palmd-") as folder:
        path = Path(folder) / "run.jsonl"
        path.write_text("".join(json.dumps(line) + "\n" for line in lines), encoding="utf-8")
        yield path
