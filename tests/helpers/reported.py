"""A run with two objects and a gap, and its report, which is made once because its figures take long."""

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import synthetic_runs

from palmd.cli import main

_KEPT = TemporaryDirectory(prefix="palmd-test-report-")


@cache
def run():
    """The recording's file."""
    return synthetic_runs.write(Path(_KEPT.name), synthetic_runs.messages(2.5, second_from=1.5, lost=range(200, 220)))


@cache
def page():
    """The report's file."""
    target = Path(_KEPT.name) / "report.html"
    assert main(["report", str(run()), "-o", str(target)]) == 0
    return target
