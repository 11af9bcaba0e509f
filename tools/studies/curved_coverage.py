"""How much of an outline curved palms touch by the same motion, and by the same swing of the contacts' normals.

A question of chapter 5 of CMU-CS-01-107 ("with less manipulation we can cover more of the shape"). Every curvature has
the same objects on it, each in all its stable poses, without friction. The palms go the same rounds about
where a circle as large as the object is touched by tangents 100° apart, with one amplitude after the other. The motion
is that of the observers' own dynamics (`motion.rollout_predictor`), which `tests/oracle/test_curved_palms.py` holds
against a plant of another form.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from palmd.console.columns import aligned
from palmd.events import FloatArray
from palmd.model.outputs import rig_inputs
from palmd.model.rollout import THETA
from palmd.model.shape import coefficients_of
from palmd.model.shape_map import N, Z
from palmd.model.stable_on_arcs import stable_poses_on_arcs
from palmd.model.stable_poses import outline_at
from palmd.model.stable_surface import SurfaceLimits, stable_surface
from palmd.motion.reach import ANYWHERE
from palmd.motion.rollout_predictor import MARGIN_M, Moves, RolloutPredictor
from palmd.rig.shapes import random_body
from palmd.system.arcs import MOST_LYING, joints_of
from palmd.system.description import PadSensor, RigDescription

Bools = npt.NDArray[np.bool_]

RADII_MM = (60.0, 75.0, 90.0, 120.0, 180.0)
AMPLITUDES: FloatArray = np.arange(1, 13, dtype=np.float64) * 0.05  # rad
SHOWN = (0.25, 0.45)  # rad, of these amplitudes
SWINGS = (math.radians(10.0), math.radians(20.0))
OPENING = math.radians(100.0)
MOVE_S = 1.2
DAMPING = 5e-4  # m²/s
_CORNERS = ((1, 0), (0, 1), (-1, 0), (0, -1), (1, 0), (0, -1), (-1, 0), (0, 1), (0, -1), (1, 0), (-1, 0), (0, 0))
"""Of φ1 and φ12: rounds one way, then the other way, then each palm by itself."""
_STREAM = 72
_NORMALS: FloatArray = np.arange(360, dtype=np.float64) * (math.tau / 360)
_LN_DITHER = math.log(1e-2)  # of no account without friction


@dataclass(frozen=True, slots=True)
class Covered:
    """What came of n objects in their poses on palms of one curvature (1/m), for each of `AMPLITUDES`.

    which: (n,) the object. touched: (n, A) share of the normals; swing: (n, A) of the contacts' normals to either side
    (rad); kept: (n, A), whether both contacts were kept on the pads. reach: (objects,) the share that stable poses show
    which the palms come to without a jump, by any motion.
    """

    curvature: float
    which: npt.NDArray[np.intp]
    touched: FloatArray
    swing: FloatArray
    kept: Bools
    reach: FloatArray


def curvatures() -> tuple[float, ...]:
    """Those of the study (1/m), domes first."""
    cradles = [1e3 / radius for radius in RADII_MM]
    return (*(-kappa for kappa in cradles), 0.0, *cradles[::-1])


def objects(count: int, seed: int) -> list[tuple[FloatArray, float]]:
    """So many random objects: coefficients of h and radius of gyration (m)."""
    bodies = [random_body("nominal", np.random.default_rng([each, _STREAM])) for each in range(seed, seed + count)]
    return [(coefficients_of(body.support.sample(_NORMALS)), body.rho) for body in bodies]


def covered(curvature: float, bodies: Sequence[tuple[FloatArray, float]]) -> Covered:
    """Rock each of the objects; one that lies in the palms rather than on them has lost its contact."""
    pads = tuple(PadSensor(curvature=curvature) for _ in range(2))
    rig = RigDescription(hinge="fixed", pads=pads)
    predictor, both = RolloutPredictor(rig_inputs(rig)), (curvature, curvature)
    none = np.full(len(AMPLITUDES), np.nan)
    which, rows, reach = [], [], []
    for number, (outline, rho) in enumerate(bodies):
        if curvature * _widest(outline) >= MOST_LYING:
            which.append(number)
            rows.append((none, none, np.zeros(len(none), dtype=np.bool_)))
            reach.append(math.nan)
            continue
        home = np.array(joints_of(float(outline[0]), ((math.pi - OPENING) / 2, OPENING), both))
        poses = stable_poses_on_arcs(outline, float(home[0]), float(home[1]), both)
        which += [number] * len(poses)
        rows += [_rocked(predictor, _state(outline, rho, float(psi)), home, pads[0].length) for psi in poses]
        reach.append(_reach(outline, both))
    touched, swing, kept = map(np.array, zip(*rows, strict=True))
    return Covered(curvature, np.array(which), touched, swing, kept, np.array(reach))


def _rocked(
    predictor: RolloutPredictor, state: FloatArray, home: FloatArray, length: float
) -> tuple[FloatArray, FloatArray, Bools]:
    ends = home + AMPLITUDES[:, None, None] * np.array([(first, second - first) for first, second in _CORNERS])
    told = predictor.of(state, Moves(home, ends, np.full(ends.shape[:2], MOVE_S)))
    on_pads = (told.nearest[:, -1] > MARGIN_M) & (told.farthest[:, -1] < length - MARGIN_M)
    turned = told.path[..., THETA] + told.path[..., :1]  # θ + ψ, which are the tangents but for a constant
    swing = np.nanmax(turned, axis=1) - np.nanmin(turned, axis=1)
    return told.touched[:, -1].mean(axis=-1), swing.mean(axis=-1) / 2, on_pads & (told.least_force[:, -1] > 0.0)


def _state(outline: FloatArray, rho: float, psi: float) -> FloatArray:
    x = np.zeros(N)
    x[Z.PSI], x[Z.LN_RHO], x[Z.LN_DITHER], x[Z.DAMPING] = psi, math.log(rho), _LN_DITHER, DAMPING
    x[Z.SHAPE :] = outline
    return x


def _reach(outline: FloatArray, both: tuple[float, float]) -> float:
    limits = SurfaceLimits(*ANYWHERE, margin=MARGIN_M, curvatures=both)
    return float(stable_surface(outline, limits).covered[0])


def _widest(outline: FloatArray) -> float:
    """The largest radius of curvature v (m)."""
    return float(outline_at(outline, _NORMALS)[2].max())


# ---------------------------------------------------------------------------------------------- what it comes to


@dataclass(frozen=True, slots=True)
class CoveredShare:
    """Mean share of the normals touched, beside what the same poses' objects have on flat palms; how many were kept."""

    touched: float
    on_flat: float
    kept: float


def by_motion(of: Covered, flat: Covered, amplitude: float) -> CoveredShare:
    """At equal motion, by the amplitude (rad)."""
    column = int(np.argmin(np.abs(AMPLITUDES - amplitude)))
    return _share(of, flat, lambda each: np.where(each.kept[:, column], each.touched[:, column], np.nan))


def by_swing(of: Covered, flat: Covered, swing: float) -> CoveredShare:
    """At equal swing of the contacts' normals (rad): between the amplitudes that lead to less and to more."""
    return _share(of, flat, lambda each: np.array([_at_swing(each, row, swing) for row in range(len(each.which))]))


def _at_swing(of: Covered, row: int, swing: float) -> float:
    beyond = np.flatnonzero(of.swing[row] >= swing)
    if not len(beyond) or not of.kept[row, : beyond[0] + 1].all():
        return math.nan
    last = slice(max(beyond[0] - 1, 0), beyond[0] + 1)
    return float(np.interp(swing, of.swing[row, last], of.touched[row, last]))


def _share(of: Covered, flat: Covered, told: Callable[[Covered], FloatArray]) -> CoveredShare:
    """Objects count alike, however many poses they have; beside flat palms only those that both kept in some pose."""
    own, beside = (_of_objects(each.which, told(each), len(flat.reach)) for each in (of, flat))
    both = np.isfinite(own[0]) & np.isfinite(beside[0])
    if not both.any():
        return CoveredShare(math.nan, math.nan, float(np.mean(own[1])))
    return CoveredShare(float(own[0][both].mean()), float(beside[0][both].mean()), float(np.mean(own[1])))


def _of_objects(which: npt.NDArray[np.intp], touched: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """(the mean over each object's kept poses, NaN without one; the share of its poses that were kept), (count,)."""
    kept = np.isfinite(touched)
    poses = np.bincount(which, minlength=count)
    held = np.bincount(which, kept, minlength=count)
    sums = np.bincount(which, np.where(kept, touched, 0.0), minlength=count)
    with np.errstate(invalid="ignore"):
        return np.where(held > 0, sums / np.maximum(held, 1), np.nan), held / np.maximum(poses, 1)


def table(rows: Sequence[Covered]) -> str:
    """A line a curvature: touched, that over flat palms, and kept, at equal motion and at equal swing; reach."""
    (flat,) = (row for row in rows if not row.curvature)
    titles = [f"± {amplitude:g} rad" for amplitude in SHOWN] + [f"swing ± {math.degrees(each):.0f}°" for each in SWINGS]
    head = ("palms", [cell for title in titles for cell in (title, "of flat", "kept")] + ["in all"])
    lines = [head]
    for row in sorted(rows, key=lambda each: -each.curvature):
        shares = [by_motion(row, flat, each) for each in SHOWN] + [by_swing(row, flat, each) for each in SWINGS]
        cells = [cell for share in shares for cell in _cells(share)]
        lines.append((radius_words(row.curvature), [*cells, f"{np.nanmean(row.reach):.2f}"]))
    return aligned(lines)


def _cells(share: CoveredShare) -> tuple[str, str, str]:
    if math.isnan(share.touched):
        return "–", "–", f"{share.kept:.0%}"
    return f"{share.touched:.3f}", f"× {share.touched / share.on_flat:.2f}", f"{share.kept:.0%}"


def radius_words(curvature: float) -> str:
    """A palm of that curvature (1/m) in words."""
    if not curvature:
        return "flat"
    return f"{'cradle' if curvature > 0 else 'dome'} R {1e3 / abs(curvature):.0f} mm"
