"""Simulation-based calibration: test whether the standard deviations of blind reconstructions are right.

The rig's constants, ρ and friction are drawn from the priors that `reconstruct` uses, outline, mass and motion from the
simulator's kinds, and a record is simulated and reconstructed. If all priors were the same and the posterior right, the
truth's rank in the posterior would be uniform over many draws (Talts et al. 2018, arXiv:1804.06788); here the posterior
is Gaussian and the rank is Φ(z), z = (truth − mean)/sd. Acceptance of a run depends on its readings alone, so the ranks
of accepted runs should be uniform as well. The outlines vary less than their prior: where the readings hardly determine
them, ranks concentrate about the middle although the band is right. The vibration's constants are not tested: the palms
vibrate as described, on mounts that are not drawn from a prior.

Columns, for each quantity: number of runs, mean and standard deviation of z, shares within 1, 2 and 3 sd, and a test of
whether the ranks are uniform. A file with runs is resumed: the same command with more runs does the missing ones and
reports all. Files of several machines can be joined with `cat`.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from scipy import stats
from scipy.interpolate import CubicHermiteSpline

from palmd.events import FloatArray
from palmd.observer import prior
from palmd.observer.criticism import CALIBRATION_SD
from palmd.observer.first_guess import LN_GYRATION_SD
from palmd.observer.reconstruct import reconstruct
from palmd.observer.reconstruction import Reconstruction
from palmd.rig.plant import FrictionSurface, random_surface
from palmd.rig.shapes import KINDS, Body, Kind, random_body
from palmd.score import WRONG_M, support_at
from palmd.system.rig_constants import RIG_NAMES
from tools.studies import harness
from tools.studies.bound import Truth
from tools.studies.harness import Goal, Line, Study, result
from tools.studies.scoring import Bools, outline_errors, rms, truth_of
from tools.studies.simulated import simulated
from tools.studies.uniformity import CONFIDENCE, Uniformity, at_most, table

DRAWN = np.flatnonzero(CALIBRATION_SD)
CONSTANTS = tuple(RIG_NAMES[i] for i in DRAWN)
"""The rig's constants that are drawn."""
NORMALS = 8  # tested normals of the outline, touched ones and as many untouched ones
_FLAT_M2 = 1e-30  # Σ h′² of a circle, which no rotation changes
_LEAST_MU = 0.01  # the prior is Gaussian, but friction is not negative
_STREAM = 31  # random stream of the body, distinct from the motion's
MOST_SIGMAS = 6.0  # error in 1σ above which an accepted run is wrong, whatever its size
TOGETHER = "rig, together"
_ALL_ROUND: FloatArray = np.arange(360, dtype=np.float64) * (math.tau / 360)


@dataclass(frozen=True, slots=True)
class SbcTask:
    """One run: arguments of `simulated`."""

    kind: Kind
    seed: int
    seconds: float


class MarginalPosterior(NamedTuple):
    """A quantity's true value, and mean and standard deviation of its Gaussian posterior; SI units."""

    true: float
    mean: float
    sd: float

    @property
    def z(self) -> float:
        """(truth − mean)/sd; standard normal if the posterior is right."""
        return (self.true - self.mean) / self.sd


@dataclass(frozen=True, slots=True)
class SbcRow(SbcTask):
    """The results of one run; NaN for missing values.

    error: the exception, without any other result. converged, reason, chi2: from `reconstruct`. e_h_m, h_sd_m: RMS over
    the touched normals of the outline's error by `gauge_free_error`, and of its 1σ; best_e_h_m: of the error after the
    best rotation, by `palmd.score`. beyond_m: the largest excess of a touched normal's error over its 1σ; worst_z: the
    largest error in 1σ. rig_distance2: squared Mahalanobis distance of all true `CONSTANTS`, χ² distributed. beliefs:
    posterior of each quantity. contradicted: constants named as contradicted, in 1σ, although the rig is as described.
    """

    error: str = ""
    converged: bool = False
    reason: str = ""
    chi2: float = math.nan
    touched: float = math.nan
    e_h_m: float = math.nan
    best_e_h_m: float = math.nan
    h_sd_m: float = math.nan
    beyond_m: float = math.nan
    worst_z: float = math.nan
    rig_distance2: float = math.nan
    beliefs: Mapping[str, MarginalPosterior] = field(default_factory=dict)
    contradicted: Mapping[str, float] = field(default_factory=dict)


def run(task: SbcTask) -> SbcRow:
    """Simulate, reconstruct and compare."""
    body, surface = drawn_from_prior(task.kind, task.seed)
    log, truth = simulated(task.kind, task.seed, task.seconds, body, "calibrated", surface)
    return row_of(task, truth, reconstruct(log.events, log.rig))


def drawn_from_prior(kind: Kind, seed: int) -> tuple[Body, FrictionSurface | None]:
    """A body of the kind, with ρ and friction from `reconstruct`'s priors; None for a kind without friction."""
    rng = np.random.default_rng([KINDS.index(kind), seed, _STREAM])
    body = random_body(kind, rng)
    ratio = prior.GYRATION * math.exp(LN_GYRATION_SD * rng.standard_normal())
    body = replace(body, rho=ratio * float(np.mean(body.support.sample(_ALL_ROUND))))
    if not random_surface(kind, rng).mu:
        return body, None
    dither = prior.DITHER * math.exp(prior.LN_DITHER_SD * rng.standard_normal())
    mu = 0.0
    while mu < _LEAST_MU:
        mu = prior.FRICTION + prior.FRICTION_SD * rng.standard_normal()
    return body, FrictionSurface(mu=mu, dither=dither)


def row_of(task: SbcTask, truth_line: Line, answer: Reconstruction) -> SbcRow:
    """The row of a reconstruction, compared with the simulator's truth."""
    row = result(SbcRow, task, reason=answer.reason, chi2=float(answer.chi2))
    truth = truth_of(truth_line)
    scored = outline_errors(answer, truth)
    if scored is None or answer.h is None:
        return row
    first, last = CubicHermiteSpline(truth.t, truth.psi, truth.omega0)(answer.t[[0, -1]]).tolist()
    error = gauge_free_error(answer.theta, answer.h, truth.h, float(answer.psi[0]) - first, scored.touched)
    at = scored.touched
    true_rig = np.array([truth_line["rig"][name] for name in CONSTANTS])
    rig_error = true_rig - answer.rig[DRAWN]
    normals = np.column_stack([answer.h - error, answer.h, scored.h_sd])
    return replace(
        row,
        converged=bool(answer.converged),
        touched=scored.score.touched,
        e_h_m=rms(error[at]),
        best_e_h_m=scored.score.e_h,
        h_sd_m=rms(scored.h_sd[at]),
        beyond_m=float(np.max(np.abs(error[at]) - scored.h_sd[at])),
        worst_z=float(np.max(np.abs(error[at]) / scored.h_sd[at])),
        rig_distance2=float(rig_error @ np.linalg.solve(answer.rig_covariance[np.ix_(DRAWN, DRAWN)], rig_error)),
        beliefs=_of_scalars(answer, truth, last - first)
        | _beliefs(CONSTANTS, np.column_stack([true_rig, answer.rig[DRAWN], answer.rig_sd[DRAWN]]))
        | _of_normals("touched", normals[at])
        | _of_normals("untouched", normals[~at]),
        contradicted={name: z for name, z in zip(RIG_NAMES, answer.contradicted.tolist(), strict=True) if z != 0.0},
    )


def gauge_free_error(
    theta: FloatArray, h: FloatArray, true_h: FloatArray, rotation: float, touched: Bools
) -> FloatArray:
    """ĥ(θ) − h(θ + rotation) − ĥ′(θ) ε (m), with ε the small rotation by least squares over the touched normals.

    To first order `h_sd` is the 1σ of this error, see `observer.outline.gauge_free_sd`. `rotation`: between the frames
    of ψ (rad). theta, h: on evenly spaced normals from 0.
    """
    error = h - support_at(true_h, theta + rotation)
    slope = np.fft.irfft(1j * np.arange(len(h) // 2 + 1) * np.fft.rfft(h), len(h))
    slopes = slope[touched]
    return np.asarray(error - slope * float(slopes @ error[touched]) / max(float(slopes @ slopes), _FLAT_M2))


def _of_scalars(answer: Reconstruction, truth: Truth, turned_rad: float) -> dict[str, MarginalPosterior]:
    """Posteriors of ln ρ and ln mass, in which the smoother is Gaussian, of the turn, and of μ if there is friction."""
    found = {
        "ln_rho": _logarithm(truth.rho, answer.rho, answer.rho_sd),
        "ln_mass": _logarithm(truth.mass, answer.mass, answer.mass_sd),
        "turned_rad": MarginalPosterior(turned_rad, float(answer.psi[-1] - answer.psi[0]), answer.turned_sd),
    }
    return found | {"mu": MarginalPosterior(truth.mu, answer.mu, answer.mu_sd)} if truth.mu else found


def _logarithm(true: float, mean: float, sd: float) -> MarginalPosterior:
    return MarginalPosterior(math.log(true), math.log(mean), sd / mean)


def _of_normals(name: str, normals: FloatArray) -> dict[str, MarginalPosterior]:
    """Posteriors of h at `NORMALS` evenly chosen rows of (true h, h, its 1σ)."""
    chosen = np.floor((np.arange(NORMALS) + 0.5) * len(normals) / NORMALS).astype(np.intp)
    names = [f"h_{name}_{number}_m" for number in range(1, NORMALS + 1)]
    return _beliefs(names, normals[chosen]) if len(normals) >= NORMALS else {}


def _beliefs(names: Iterable[str], rows: FloatArray) -> dict[str, MarginalPosterior]:
    return {name: MarginalPosterior(*row) for name, row in zip(names, rows.tolist(), strict=True)}


# ------------------------------------------------------------------------------------------------ written


def row_from(line: Line) -> SbcRow:
    """The row of a JSON object; raises AttributeError, KeyError, TypeError or ValueError for anything else."""
    beliefs = {
        name: MarginalPosterior(*(math.nan if x is None else float(x) for x in each))
        for name, each in line["beliefs"].items()
    }
    return harness.row_of(SbcRow, line | {"beliefs": beliefs})


# ---------------------------------------------------------------------------------------------------- the study


def accepted_of(rows: Iterable[SbcRow]) -> list[SbcRow]:
    """The accepted runs."""
    return [row for row in rows if row.converged]


def wrong(row: SbcRow) -> bool:
    """Whether a touched normal's error exceeds its band by more than `WRONG_M`."""
    return row.beyond_m > WRONG_M


def far(row: SbcRow, sigmas: float = MOST_SIGMAS) -> list[str]:
    """Quantities with errors above `sigmas` 1σ."""
    found = [name for name, belief in row.beliefs.items() if abs(belief.z) > sigmas]
    return [*found, "a touched normal"] if row.worst_z > sigmas else found


def uniformities(rows: Sequence[SbcRow]) -> dict[str, Uniformity]:
    """Uniformity of each quantity estimated by accepted runs; the rig's constants together come last."""
    accepted = accepted_of(rows)
    names = dict.fromkeys(name for row in accepted for name in row.beliefs)
    all_z = {name: [row.beliefs[name].z for row in accepted if name in row.beliefs] for name in names}
    distances = np.array([row.rig_distance2 for row in accepted])
    all_z[TOGETHER] = stats.norm.isf(stats.chi2.sf(distances, len(CONSTANTS))).tolist()
    finite = {name: np.array(z)[np.isfinite(z)] for name, z in all_z.items()}
    return {name: Uniformity.of(z) for name, z in finite.items() if len(z)}


def report(rows: Sequence[SbcRow]) -> str:
    """For each kind of run and for all: seeds, accepted runs, a line for each quantity."""
    kinds: list[tuple[str, Sequence[SbcRow]]] = [(kind, [row for row in rows if row.kind == kind]) for kind in KINDS]
    kinds = [each for each in kinds if each[1]]
    return "\n\n".join(_of_kind(*each) for each in ([*kinds, ("all kinds", rows)] if len(kinds) > 1 else kinds))


def remarks_on(row: SbcRow) -> list[str]:
    """On a run that is accepted and wrong, or that contradicts the correct description of the rig."""
    found = []
    if row.converged and wrong(row):
        found.append(f"accepted, error {row.beyond_m * 1e3:.2f} mm beyond its band")
    if row.converged and far(row):
        found.append(f"accepted, errors above {MOST_SIGMAS:g} sd: {', '.join(far(row))}")
    if row.contradicted:
        found.append("contradicted: " + ", ".join(f"{name} ({z:+.1f} sd)" for name, z in row.contradicted.items()))
    return found


def _of_kind(kind: str, rows: Sequence[SbcRow]) -> str:
    accepted = accepted_of(rows)
    marks: list[tuple[str, Callable[[SbcRow], bool], Sequence[SbcRow]]] = [
        (f"accepted, error of a touched normal more than {WRONG_M * 1e3:g} mm beyond its band", wrong, accepted),
        (f"accepted, any error above {MOST_SIGMAS:g} sd", lambda row: bool(far(row)), accepted),
        ("accepted, error of a touched normal above 3 sd", lambda row: row.worst_z > 3.0, accepted),
        ("a constant named contradicted", lambda row: bool(row.contradicted), rows),
    ]
    lines = [f"{kind}: seeds {harness.numbers(row.seed for row in rows)}"]
    lines.append(f"  accepted: {len(accepted)} of {len(rows)}")
    rejections = Counter(row.error or row.reason for row in rows if not row.converged)
    lines += [f"  not accepted: {count}: {why}" for why, count in rejections.most_common()]
    lines += [f"  {what}: {_share(sum(map(mark, of)), len(of))}" for what, mark, of in marks if of]
    return "\n".join(lines) + ("\n" + table(uniformities(rows)) if accepted else "")


def _share(part: int, of: int) -> str:
    return f"{part} of {of} (at most {100.0 * at_most(part, of):.2g} %, with {100.0 * CONFIDENCE:g} % confidence)"


STUDY = Study(
    "calibration",
    harness.of_kinds(KINDS, lambda kind, seed, arguments: SbcTask(kind, seed, arguments.seconds)),
    run,
    SbcRow,
    order=lambda row: (KINDS.index(row.kind), row.seed),
    report=report,
    remark=remarks_on,
    goals=[Goal("no accepted touched normal has an error more than 0.3 mm beyond its band",
                lambda rows: not any(map(wrong, accepted_of(rows))))],
    resumes=True,
    row_of=row_from,
)  # fmt: skip


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The study's arguments."""
    harness.add_arguments(parser, runs=500, seconds_each=10.0, output="sbc.jsonl", kinds=KINDS)
