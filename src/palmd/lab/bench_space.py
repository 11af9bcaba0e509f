"""Unknown bodies between three palms in space reconstructed blind from simulated runs, scored against their truth.

Right is a surface within 0.15 mm (RMS) of the truth within 4 degrees of where it was touched, after the best rotation.
"""

from __future__ import annotations

import argparse
import contextlib
import json
from pathlib import Path

from palmd.console.arguments import count, seconds, seed
from palmd.lab.space import SpaceRow, reconstructed, report
from palmd.lab.space_live import SpaceLiveRow, lived, told
from palmd.rig.three_palms.simulate import KINDS, simulate

ALL = "all"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The bench's arguments."""
    add = parser.add_argument
    add("--runs", type=count, default=8, metavar="N", help="how many of each kind (default: %(default)s)")
    add("--kind", choices=(*KINDS, ALL), default=ALL, help="what sort of run (default: %(default)s)")
    add("--seed", type=seed, default=0, metavar="N", help="of bodies and motions (default: %(default)s)")
    add("--seconds", type=seconds, default=20.0, metavar="S", help="how long each lasts (default: %(default)s)")
    add("--live", action="store_true", help="in the emulated rig, by the shipped plan, judged tick by tick")
    add("-o", "--output", type=Path, default=Path("space.jsonl"), metavar="FILE",
        help="a JSON line for each run (default: %(default)s)")  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Interrupted, it ends with what is finished until then."""
    if arguments.live:
        return _live(arguments)
    kinds = tuple(KINDS) if arguments.kind == ALL else (arguments.kind,)
    rows: list[SpaceRow] = []
    path: Path = arguments.output
    try:
        with path.open("w", encoding="utf-8") as stream:
            for kind in kinds:
                for each in simulate(kind, arguments.runs, arguments.seconds, arguments.seed):
                    rows.append(reconstructed(each))
                    stream.write(json.dumps(rows[-1].line()) + "\n")
                    stream.flush()
    except KeyboardInterrupt:
        pass
    if rows:
        print(f"seed {arguments.seed}, {arguments.seconds:g} s each")
        print(report(rows))
    for row in rows:
        if not row.converged:
            print(f"{row.kind} {row.body}: {row.reason}")
    print(f"written: {path}")
    return 0


def _live(arguments: argparse.Namespace) -> int:
    rows: list[SpaceLiveRow] = []
    path: Path = arguments.output
    with path.open("w", encoding="utf-8") as stream, contextlib.suppress(KeyboardInterrupt):
        for seed_ in range(arguments.seed, arguments.seed + arguments.runs):
            rows.append(lived(seed_, arguments.seconds))
            stream.write(json.dumps(rows[-1].line()) + "\n")
            stream.flush()
    print("\n".join(told(rows)))
    print(f"written: {path}")
    return 0
