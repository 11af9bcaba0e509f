"""Reconstructs outline and motion from a whole event log or recorded run at once, offline: one JSON object.

With -o FILE.svg, .dxf or .csv only the outline is written, with its band, in mm; `palmd export` draws it from
RESULT.json too.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path

import numpy as np

from palmd.cli.drawings import curves_of_answer, drawing, write_drawing
from palmd.cli.logs import add_calibration_argument, opened, read
from palmd.console.arguments import seed
from palmd.console.progress import working
from palmd.observer.reconstruct import reconstruct
from palmd.observer.reconstruction import Reconstruction
from palmd.observer.static_mass import mass_at_rest
from palmd.record.outline_files import SUFFIXES
from palmd.record.result import as_line


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument("log", type=Path, metavar="LOG", help="an event log (JSON lines) or a recorded run (.mcap)")
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        metavar="RESULT.json",
        help="- for standard output; .svg, .dxf, .csv: the outline as a drawing or points, x and y in mm",
    )
    parser.add_argument("--seed", type=seed, default=0, metavar="N", help="of the blind start (default: %(default)s)")
    add_calibration_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    """Writes nothing before the answer is there; CliError when the log cannot be used."""
    suffix = arguments.output.suffix.lower()
    made = drawing(suffix) if suffix in SUFFIXES else None
    log = read(arguments.log, arguments.calibration_sd)
    with working("reconstructing"):
        answer = reconstruct(log.events, log.rig, arguments.seed)
        at_rest = mass_at_rest(log.events, log.rig)
    if made is not None:
        write_drawing(curves_of_answer(arguments.log, answer), arguments.output, made, arguments.log)
    else:
        with opened(arguments.output, arguments.log) as stream:
            stream.write(json.dumps(as_line(answer, at_rest), allow_nan=False) + "\n")
    told = summary(answer) if answer.converged else f"not converged: {answer.reason}"
    if math.isfinite(at_rest.value):
        told += f"; at rest {at_rest.value * 1e3:.1f} ± {at_rest.sd * 1e3:.1f} g"
    print(f"{arguments.log}: {told}", file=sys.stderr)
    return 0


def summary(answer: Reconstruction) -> str:
    """One line about an answer that has converged: the outline's band where touched (RMS), the body's constants."""
    if answer.h_sd is None or answer.touched is None:
        raise ValueError("there is no outline")
    band = float(np.sqrt(np.mean(answer.h_sd[answer.touched] ** 2)))
    parts = [
        f"outline ± {band * 1e6:.1f} µm on {np.mean(answer.touched):.0%} of the normals",
        f"rho {answer.rho * 1e3:.2f} ± {answer.rho_sd * 1e3:.2f} mm",
        f"mu {answer.mu:z.4f} ± {answer.mu_sd:.4f}",
        f"mass {answer.mass * 1e3:.1f} ± {answer.mass_sd * 1e3:.1f} g" if math.isfinite(answer.mass) else "no mass",
        *(f"flat side of {1e3 * length:.1f} ± {1e3 * sd:.1f} mm" for _, length, sd in answer.sides.tolist()),
        f"{answer.seconds:.1f} s",
    ]
    return ", ".join(parts)
