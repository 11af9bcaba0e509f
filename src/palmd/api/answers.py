"""Estimates of a run: causally, tick by tick, or smoothed over the whole run."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from palmd import observer as observers
from palmd.api.errors import PalmdError, as_palmd_error
from palmd.api.outline import OutlineData, last_of, outline_of
from palmd.api.runs import RunData, open
from palmd.api.table import DataTable, table_of
from palmd.blas import one_thread
from palmd.events import FloatArray
from palmd.outlinefile import read_library
from palmd.record.recognition import Recognition, verdict
from palmd.record.surface import Mesh
from palmd.system.mechanism import RADII


@dataclass(frozen=True, slots=True, eq=False)
class EstimatedRun:
    """An observer's estimates of a run; each tick uses only events up to its time.

    estimates: the fields of `palm/estimate` and `t_s` (s, the log's clock), one row per 10 ms. outlines: one per
    second. verdict: which of the stored outlines the object is, None without any.
    """

    estimates: DataTable
    outlines: tuple[OutlineData, ...]
    verdict: Recognition | None

    @property
    def outline(self) -> OutlineData:
        """The last outline; PalmdError if there is none."""
        return last_of(self.outlines, "the estimate")

    def outline_xy(self) -> FloatArray:
        """Points (361, 2) of the last outline in m, closed, in the object's frame about its centre of mass."""
        return self.outline.xy()


@dataclass(frozen=True, slots=True, eq=False)
class SmoothedRun:
    """Estimate from a whole run; SI units, NaN where there is no value.

    verdict: `accepted`, `partial` (less than a tenth of the normals touched: the estimate holds for these) or
    `rejected`. converged: true for accepted ones; otherwise `reason` says why, and outline and trajectory may be
    missing. coverage: fraction of the normals touched. chi2: per reading. trajectory: `t_s psi_rad omega0_rad_s r1_m
    r2_m`. rho_m: radius of gyration. mu: friction. mass_rest_kg: mass weighed while the object was at rest, which needs
    no outline. `…_sd…`: standard deviation. rig: the rig constants that the run determines, `{name: {value, sd}}`,
    empty if it determines none. shape_class: the simple shape that the outline matches, with its sizes, empty if it
    matches none or cannot be classified. surface: of a body between three palms, instead of an outline. results: all
    of them under the names of `palmd reconstruct`; for another `system` than two palms, the results without a field
    here.
    """

    converged: bool
    verdict: str
    coverage: float
    reason: str
    chi2: float
    outline: OutlineData | None
    trajectory: DataTable
    rho_m: float
    rho_sd_m: float
    mu: float
    mu_sd: float
    mass_kg: float
    mass_sd_kg: float
    mass_rest_kg: float
    mass_rest_sd_kg: float
    rig: Mapping[str, Mapping[str, float]]
    shape_class: str
    surface: Mesh | None
    seconds: float
    system: str
    results: Mapping[str, Any]

    @property
    def told(self) -> Mapping[str, Any]:
        """Former name of `results`, until 2.0."""
        return self.results

    @property
    def looks_like(self) -> str:
        """Former name of `shape_class`, until 2.0."""
        return self.shape_class

    def outline_xy(self) -> FloatArray:
        """Points (361, 2) of the outline in m, closed, about the centre of mass; PalmdError if there is none."""
        if self.outline is None:
            reason = self.reason or f"the results of the system {self.system} are in .results"
            raise PalmdError(f"the reconstruction has no outline: {reason}")
        return self.outline.xy()


@one_thread()
def estimate(
    log: RunData | str | os.PathLike[str],
    observer: observers.ObserverName = "shape",
    shape: str | os.PathLike[str] | None = None,
) -> EstimatedRun:
    """Run the daemon's observer causally over a recorded run; takes about as long as the run itself.

    `shape`: a stored outline, or a folder of them; the object is then one of these or none. Deterministic. Raises
    PalmdError for an unusable log or outline.
    """
    if observer not in observers.OBSERVERS:
        raise PalmdError(f"there is no observer {observer!r}; the observers are {', '.join(observers.OBSERVERS)}")
    if shape is not None and observer != "shape":
        raise PalmdError(f"a stored outline requires the observer shape; {observer} cannot use one")
    run = _opened(log)
    with as_palmd_error():
        outlines = () if shape is None else read_library(Path(shape))
        ticks = list(run.system.estimate(run.log, observer, outlines))
    return EstimatedRun(
        table_of({"t_s": tick.t} | tick.estimate for tick in ticks),
        # outlines of a pivoting grasp are about the pivot; their centre of mass is unknown
        tuple(outline_of(tick.shape, tick.t) for tick in ticks if tick.shape is not None and "h_m" in tick.shape),
        verdict(tick.object for tick in ticks if tick.object is not None),
    )


@one_thread()
def reconstruct(log: RunData | str | os.PathLike[str], seed: int = 0) -> SmoothedRun:
    """Estimate outline and motion from a whole run; takes about a second for ten seconds of readings.

    Deterministic for a given `seed` (of the blind search). If no smooth outline explains the readings, an outline with
    flat sides and corners is searched for, which takes some ten to forty seconds more. Raises PalmdError for an
    unusable log, never because of its readings.
    """
    run = _opened(log)
    with as_palmd_error():
        answer = run.system.reconstruct(run.log, seed)
    line = answer.line
    return SmoothedRun(
        system=run.system.name,
        results=line,
        converged=line["converged"],
        verdict=line["verdict"],
        coverage=line["coverage"],
        reason=line["reason"] or "",
        outline=None if answer.mesh is not None or line.get("h_m") is None else outline_of(line, math.nan),
        trajectory=_trajectory(line.get("trajectory")),
        rig=line.get("rig") or {},
        shape_class=(line.get("shape_class") or {}).get("text") or "",
        surface=answer.mesh,
        **{name: math.nan if line.get(name) is None else line[name] for name in _NUMBERS},
    )


_NUMBERS = (
    *("chi2", "rho_m", "rho_sd_m", "mu", "mu_sd", "mass_kg", "mass_sd_kg", "mass_rest_kg", "mass_rest_sd_kg"),
    "seconds",
)
_TIME = {"t": "t_s"}


def _trajectory(columns: Mapping[str, list[Any]] | None) -> DataTable:
    """Columns as a table; empty columns if there is no trajectory."""
    filled = columns or {name: [] for name in ("t", "psi_rad", "omega0_rad_s", *(f"{name}_m" for name in RADII))}
    return DataTable({_TIME.get(name, name): np.array(values, dtype=np.float64) for name, values in filled.items()})


def _opened(log: RunData | str | os.PathLike[str]) -> RunData:
    return log if isinstance(log, RunData) else open(log)
