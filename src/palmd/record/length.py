"""How much there is to do with a run."""

from __future__ import annotations

from mcap.reader import make_reader

from palmd.record.run import AnyRun


def message_count(run: AnyRun) -> int:
    """How many messages it holds: what a finished file says of itself, else counted. Raises RunError, OSError."""
    if run.complete:
        with run.path.open("rb") as stream:
            summary = make_reader(stream).get_summary()
        if summary is not None and summary.statistics is not None:
            return summary.statistics.message_count
    return sum(survey.count for survey in run.survey().values())
