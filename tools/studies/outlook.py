"""The questions with which CMU-CS-01-107 ends: what curved palms cover, and whether a pivoting grasp is observable."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from palmd.console.arguments import count, seed
from palmd.console.errors import BAD_INPUT, CliError
from palmd.console.extras import drawing
from palmd.console.progress import Progress
from tools.studies import curved_coverage, pivot_observability
from tools.studies.curved_coverage import Covered
from tools.studies.pivot_observability import SWEEPS, ToldByMotion

OBJECTS, SEED = 16, 0
_MASS_OF = 2  # of `SWEEPS`, for the null vector


@dataclass(frozen=True, slots=True)
class OutlookAnswers:
    """Both studies: coverage by curvature, and by sweep what each body's readings tell; the null vector of the mass."""

    coverage: Sequence[Covered]
    pivot: Sequence[Sequence[ToldByMotion]]
    null: tuple[float, Sequence[float]]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    add = parser.add_argument
    add("--objects", type=count, default=OBJECTS, metavar="N", help="on each curvature (default: %(default)s)")
    add("--bodies", type=count, default=pivot_observability.BODIES, metavar="N",
        help="in the gripper (default: %(default)s)")  # fmt: skip
    add("--seed", type=seed, default=SEED, metavar="FIRST", help="the first one's (default: %(default)s)")
    add("-o", "--output", type=Path, metavar="FOLDER", help="also draw outlook_coverage.svg and outlook_pivot.svg")


def run(arguments: argparse.Namespace) -> int:
    """Prints the tables; CliError when a figure cannot be written."""
    told = studied(arguments.objects, arguments.bodies, arguments.seed)
    print(as_text(told), end="")
    if arguments.output is not None and (figures := drawing("tools.studies.outlook_figures")):
        try:
            arguments.output.mkdir(parents=True, exist_ok=True)
            saved = figures.save(told, arguments.output)
        except OSError as error:
            why = error.strerror or error
            raise CliError(BAD_INPUT, f"{arguments.output}: cannot be written: {why}") from None
        print("figures: " + ", ".join(map(str, saved)))
    return 0


def studied(objects: int = OBJECTS, bodies: int = pivot_observability.BODIES, first: int = SEED) -> OutlookAnswers:
    """Both studies, by the seeds from `first` on; the coverage takes some two seconds of processor time an object."""
    curvatures, shapes = curved_coverage.curvatures(), curved_coverage.objects(objects, first)
    covered = []
    with Progress("coverage", len(curvatures), "curvatures") as progress:
        for kappa in curvatures:
            covered.append(curved_coverage.covered(kappa, shapes))
            progress.at(len(covered))
    held = pivot_observability.bodies(bodies, first)
    told = [[pivot_observability.told(body, sweep) for body in held] for sweep in SWEEPS]
    value, direction = pivot_observability.mass_null(held[0], SWEEPS[_MASS_OF])
    return OutlookAnswers(covered, told, (value, direction.tolist()))


def as_text(outlook: OutlookAnswers) -> str:
    """The tables, and what they are of."""
    value, direction = outlook.null
    m, b, k2, c = (f"{each:+.3f}" for each in direction)
    return (
        f"Share of the normals touched on curved palms, {len(outlook.coverage[0].reach)} objects\n"
        f"{curved_coverage.table(outlook.coverage)}\n\n"
        f"What a rigid pivoting grasp tells, medians of {len(outlook.pivot[0])} bodies\n"
        f"{pivot_observability.table(outlook.pivot)}\n"
        f"forces in ln (m, |b|, k², c): least over largest singular value {value:.0e}, its direction"
        f" ({m}, {b}, {k2}, {c})\n"
    )
