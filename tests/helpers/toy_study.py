"""A study that takes almost no time, for tests of the harness: its runs sleep briefly, and one of them raises."""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import dataclass

from tools.studies import harness
from tools.studies.cells import count, errors, quantiles, runs
from tools.studies.harness import Goal, Study, result

KINDS = ("flat", "bent")
RAISES = 12


@dataclass(frozen=True, slots=True)
class ToyTask:
    kind: str
    seed: int
    seconds: float


@dataclass(frozen=True, slots=True)
class ToyRow(ToyTask):
    error: str = ""
    value: float = math.nan


def run(task: ToyTask) -> ToyRow:
    time.sleep(0.02 * (4 - task.seed % 4))  # later seeds finish first
    if task.seed == RAISES:
        raise ValueError("no ground")
    return result(ToyRow, task, value=float(task.seed))


draw = harness.of_kinds(KINDS, lambda kind, seed, arguments: ToyTask(kind, seed, arguments.seconds))


def study(**changes) -> Study[ToyTask, ToyRow]:
    parts = {
        "order": lambda row: (KINDS.index(row.kind), row.seed),
        "by": lambda row: row.kind,
        "columns": [("runs", runs), ("errors", errors), ("large", count(lambda row: row.value > 10.0)),
                    ("median", quantiles(lambda row: row.value))],
        "goals": [Goal("no value is above 20", lambda rows: not any(row.value > 20.0 for row in rows))],
    }  # fmt: skip
    return Study("toy", draw, run, ToyRow, **parts | changes)


def asked(*argv: str, output: str | None = "toy.jsonl") -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    harness.add_arguments(parser, runs=4, seconds_each=1.0, output=output, kinds=KINDS)
    return parser.parse_args(list(map(str, argv)))
