"""Positions of outline, contacts and centre of mass from the estimates of a run. Pure NumPy; metres and radians."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from palmd import polygon
from palmd.events import FloatArray
from palmd.polygon import boundary
from palmd.report.series import OutlineAt, Series
from palmd.system.arcs import palm_points, tangents
from palmd.system.mechanism import CONTACTS, JOINTS, RADII, SIDES, directions

_ARC_POINTS = 25


def points(theta: FloatArray, h: FloatArray) -> FloatArray:
    """Points (2, n) of the outline for band-limited h on evenly spaced normals theta."""
    return turned(boundary(h).T, float(theta[0]))


def turned(at: FloatArray, angle: float) -> FloatArray:
    """Points (2, n) rotated about the origin by `angle` (rad)."""
    return np.asarray((at.T @ polygon.turned(angle)).T)


def closed(curve: FloatArray) -> FloatArray:
    """The curve (2, n) with its first point repeated at the end."""
    return np.concatenate([curve, curve[:, :1]], axis=1)


@dataclass(frozen=True, slots=True)
class DrawnPose:
    """The pose of one estimate relative to the hinge: angles (rad), points (2,) in m.

    directions: angles of the palms at the hinge. curvatures: of the palms (1/m).
    """

    t: float
    directions: tuple[float, ...]
    psi: float
    centre: FloatArray
    contacts: tuple[FloatArray, ...]
    curvatures: tuple[float, ...]

    def palms(self, length: float) -> list[FloatArray]:
        """The palms as lines (2, n) of `length` (m) from the hinge; curved ones of at most a quarter turn."""
        joints = [angle - before for before, angle in pairwise((0.0, *self.directions))]
        lengths = [min(length, 0.5 * math.pi / abs(kappa)) if kappa else length for kappa in self.curvatures]
        along = [np.linspace(0.0, each, _ARC_POINTS if any(self.curvatures) else 2) for each in lengths]
        return [points.T for points in palm_points(joints, along, self.curvatures)]


def pose_at(series: Series, number: int) -> DrawnPose:
    """The pose of estimate `number`: solves n_i·(c − p_i) = r_i, contacts p_i at s_i on the palms (section 3.1)."""
    t, estimate, curvatures = series.estimate.t, series.estimate, series.run.rig.curvatures
    angles, radii, distances = (
        [float(estimate[f"{name}_{unit}"][number]) for name in names]
        for names, unit in ((JOINTS, "rad"), (RADII, "m"), (CONTACTS, "m"))
    )
    contacts = palm_points(angles, distances, curvatures)
    along = [
        np.array([math.cos(angle), math.sin(angle)]) for angle in directions(tangents(angles, distances, curvatures))
    ]
    inward = np.array([side * np.array([-way[1], way[0]]) for side, way in zip(SIDES, along, strict=True)])
    offsets = [r + normal @ contact for r, normal, contact in zip(radii, inward, contacts, strict=True)]
    centre = np.linalg.solve(inward, np.array(offsets)) if np.linalg.det(inward) else np.full(2, math.nan)
    psi = float(estimate["psi_rad"][number])
    return DrawnPose(float(t[number]), directions(angles), psi, centre, tuple(contacts), curvatures)


def contact_points(series: Series, numbers: Iterable[int]) -> FloatArray:
    """Both contacts of the given estimates in the object's frame (2, 2n); the outline for observers without a shape."""
    contacts = []
    for number in numbers:
        pose = pose_at(series, int(number))
        both = np.stack(pose.contacts, axis=1) - pose.centre[:, None]
        contacts.append(turned(both, -pose.psi))
    return np.concatenate(contacts, axis=1) if contacts else np.zeros((2, 0))


def frames(series: Series, most: int) -> tuple[int, ...]:
    """Numbers of up to `most` valid and finite estimates, evenly spaced in time plus touched fraction (scaled to 1).

    Frames are denser where the touched fraction grows fast.
    """
    names = ("psi_rad", *(f"{name}_rad" for name in JOINTS), *(f"{name}_m" for name in (*RADII, *CONTACTS)))
    finite = np.all([np.isfinite(series.estimate[name]) for name in names], axis=0)  # user observers may publish NaN
    valid = np.flatnonzero(series.valid & finite)
    if not len(valid):
        return ()
    t, touched = series.estimate.t[valid], np.nan_to_num(series.estimate["touched"][valid])
    grown = np.concatenate([[0.0], np.cumsum(np.maximum(np.diff(touched), 0.0))])
    progress = _share(t - t[0]) + _share(grown)
    wanted = np.linspace(0.0, progress[-1], most)
    return tuple(int(valid[i]) for i in np.unique(np.searchsorted(progress, wanted).clip(0, len(valid) - 1)))


def outline_known(series: Series, t: float, number: int) -> OutlineAt | None:
    """The last outline of object `number` published up to `t` (s); None if there is none."""
    known = [outline for outline in series.outlines if outline.t <= t + 1e-6 and outline.number == number]
    return known[-1] if known else None


def _share(values: FloatArray) -> FloatArray:
    return values / values[-1] if values[-1] > 0.0 else values
