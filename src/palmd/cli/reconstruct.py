"""Reconstructs outline and motion from a whole event log or recorded run, offline; writes one JSON object.

With -o FILE.svg, .dxf or .csv only the outline is written, with its band, in mm; `palmd export` also draws it from
RESULT.json. For a body between three palms, -o FILE.stl, .ply or .obj writes the surface in mm, --mesh FILE in addition
to the result; a PLY is coloured by the band.

LOG may be a bundle of `palmd capture`: each of its recordings is reconstructed and compared with its caliper table.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from palmd.cli.logs import add_calibration_argument, check_writable, drawing, open_output, read_any, write_drawing
from palmd.console.arguments import seed
from palmd.console.errors import BAD_INPUT, CliError
from palmd.console.progress import working
from palmd.record.calipers import TRUTH
from palmd.record.outline_files import SUFFIXES
from palmd.record.surface import MESHES
from palmd.record.systems import Reconstructed


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add = parser.add_argument
    add("log", type=Path, metavar="LOG",
        help="an event log (JSON lines), a recorded run (.mcap) or a bundle of palmd capture")  # fmt: skip
    add("-o", "--output", type=Path, required=True, metavar="RESULT.json",
        help="- for standard output; .svg, .dxf, .csv: the outline as a drawing or points, x and y in mm;"
        " .stl, .ply, .obj: the surface of a body in space, in mm")  # fmt: skip
    add("--mesh", type=Path, metavar="FILE",
        help="also write the surface of a body in space: .stl, .ply (coloured by its band) or .obj, in mm")  # fmt: skip
    add("--seed", type=seed, default=0, metavar="N", help="seed of the blind search (default: %(default)s)")
    add_calibration_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    """Reconstruct first, then write the outputs; CliError if the log is invalid."""
    if (arguments.log / TRUTH).exists() or (arguments.log / "runs").is_dir():  # a bundle of `capture`
        from palmd.cli.capture_score import compare

        return compare(arguments)
    suffix = arguments.output.suffix.lower()
    beside: Path | None = arguments.mesh
    if beside is not None and beside.suffix.lower() not in MESHES:
        raise CliError(BAD_INPUT, f"{beside}: use the suffix {', '.join(MESHES)} for a surface")
    made = drawing(suffix) if suffix in SUFFIXES else None
    system, log = read_any(arguments.log, arguments.calibration_sd)
    for target in (arguments.output, beside):
        if target is not None:
            check_writable(target)
    with working("reconstructing") as say:
        answer = system.reconstruct(log, arguments.seed, say)
    if suffix in MESHES:
        _write_mesh(answer, arguments.output, arguments.log)
    elif made is not None:
        if answer.curves is None:
            why = f"not converged: {answer.reason}: there is no outline to draw"
            raise CliError(BAD_INPUT, f"{arguments.log}: {why}")
        write_drawing(answer.curves(arguments.log.stem), arguments.output, made, arguments.log)
    else:
        with open_output(arguments.output, arguments.log) as stream:
            stream.write(json.dumps(answer.line, allow_nan=False) + "\n")
    if beside is not None:
        _write_mesh(answer, beside, arguments.log)
    print(f"{arguments.log}: {answer.summary}", file=sys.stderr)
    return 0


def _write_mesh(answer: Reconstructed, target: Path, log: Path) -> None:
    """Write the surface; CliError if there is none."""
    if answer.mesh is None:
        why = f"not converged: {answer.reason}" if answer.reason else "a body between two palms has an outline only"
        raise CliError(BAD_INPUT, f"{log}: {why}: there is no surface to write")
    write_drawing(answer.mesh, target, MESHES[target.suffix.lower()], log)
