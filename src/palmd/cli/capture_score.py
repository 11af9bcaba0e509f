"""Reconstructs every recording in a bundle of `palmd capture` and compares it with the caliper table."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Mapping
from typing import Any

from palmd.cli.logs import check_writable, open_output, read_any
from palmd.console.errors import as_cli_error
from palmd.console.progress import working
from palmd.record.calipers import TRUTH, CaliperError, Measured, read_table, scored
from palmd.record.verdict import has_estimate

_NUMBERS = ("estimate", "sd", "measured", "whole", "sigmas")
SURE = 3.0
"""Acceptable error of an estimate in standard deviations."""


def compare(arguments: argparse.Namespace) -> int:
    """Write one JSON object, and a table on standard error; CliError if the bundle is invalid."""
    folder = arguments.log
    with as_cli_error(CaliperError):
        table = read_table(folder)
    check_writable(arguments.output)
    objects = []
    for measured in table:
        system, log = read_any(folder / measured.run, arguments.calibration_sd)
        with working(f"reconstructing {measured.name}") as say:
            result = system.reconstruct(log, arguments.seed, say).line
        objects.append(_row(measured, result))
        print("\n".join(_lines(objects[-1])), file=sys.stderr, flush=True)
    scores = [score for each in objects for score in each["scores"].values()]
    beyond = sum(abs(score["sigmas"]) > SURE for score in scores)
    summary = {"objects": objects, "compared": len(scores), "beyond_3_sigma": beyond}
    with open_output(arguments.output, folder / TRUTH) as stream:
        stream.write(json.dumps(summary, allow_nan=False) + "\n")
    print(f"{len(scores)} compared with {folder / TRUTH}, {beyond} differ by more than {SURE:g} sigma", file=sys.stderr)
    return 0


def _row(measured: Measured, result: Mapping[str, Any]) -> dict[str, Any]:
    scores = scored(result, measured) if has_estimate(result) else {}
    return {
        "object": measured.name,
        "run": measured.run,
        "verdict": result["verdict"],
        "coverage": result["coverage"],
        "reason": result.get("reason"),
        "scores": {name: {key: getattr(score, key) for key in _NUMBERS} for name, score in scores.items()},
    }


def _lines(row: Mapping[str, Any]) -> Iterator[str]:
    yield f"{row['object']}: {row['verdict']}, {row['coverage']:.0%} of the normals touched"
    for name, score in row["scores"].items():
        bound = "" if score["whole"] else ", where touched"
        yield (
            f"  {name:12} {score['estimate']:8.3f} ± {score['sd']:.3f}, measured {score['measured']:.3f}"
            f" ({score['sigmas']:+.1f} sigma{bound})"
        )
    if not row["scores"]:
        yield f"  nothing to compare: {row['reason'] or 'no outline'}"
