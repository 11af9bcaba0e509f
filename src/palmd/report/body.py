"""Where outline, contacts and centre of mass are, from what runs tell of them. Pure NumPy; metres and radians."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray
from palmd.polygon import normals
from palmd.report.series import OutlineAt, Series
from palmd.system.mechanism import CONTACTS, JOINTS, RADII, SIDES, directions


def points(theta: FloatArray, h: FloatArray) -> FloatArray:
    """The outline's own points (2, n): x = h n + h′ dn/dθ, for h on even normals theta, taken as band-limited."""
    k = np.arange(len(h) // 2 + 1)
    slope = np.fft.irfft(1j * np.where(2 * k == len(h), 0, k) * np.fft.rfft(h), len(h))
    return np.asarray(h * normals(theta).T + slope * normals(theta + math.pi / 2).T)


def turned(at: FloatArray, angle: float) -> FloatArray:
    """Points (2, n) turned about the origin."""
    cos, sin = math.cos(angle), math.sin(angle)
    return np.asarray(np.array([[cos, -sin], [sin, cos]]) @ at)


def closed(curve: FloatArray) -> FloatArray:
    """The curve (2, n) with its first point again at its end."""
    return np.concatenate([curve, curve[:, :1]], axis=1)


@dataclass(frozen=True, slots=True)
class DrawnPose:
    """One estimate as it stands on the palms, seen from the hinge: angles (rad), points (2,) in m."""

    t: float
    directions: tuple[float, ...]  # of the palms
    psi: float
    centre: FloatArray
    contacts: tuple[FloatArray, ...]


def pose_at(series: Series, number: int) -> DrawnPose:
    """The estimate of that number: n_i·c = r_i; contacts s_i along each palm (section 3.1)."""
    t, estimate = series.estimate.t, series.estimate
    angles, radii, places = (
        [float(estimate[f"{name}_{unit}"][number]) for name in names]
        for names, unit in ((JOINTS, "rad"), (RADII, "m"), (CONTACTS, "m"))
    )
    psi, palms = float(estimate["psi_rad"][number]), directions(angles)
    along = [np.array([math.cos(angle), math.sin(angle)]) for angle in palms]
    inward = np.array([side * np.array([-way[1], way[0]]) for side, way in zip(SIDES, along, strict=True)])
    centre = np.linalg.solve(inward, np.array(radii)) if math.sin(angles[-1]) else np.full(2, math.nan)
    return DrawnPose(float(t[number]), palms, psi, centre, tuple(s * way for s, way in zip(places, along, strict=True)))


def felt_points(series: Series, numbers: Iterable[int]) -> FloatArray:
    """Both contacts of these estimates in the object's frame (2, 2n): what an observer without a shape has of it."""
    felt = []
    for number in numbers:
        pose = pose_at(series, int(number))
        both = np.stack(pose.contacts, axis=1) - pose.centre[:, None]
        felt.append(turned(both, -pose.psi))
    return np.concatenate(felt, axis=1) if felt else np.zeros((2, 0))


def frames(series: Series, most: int) -> tuple[int, ...]:
    """Numbers of up to `most` valid estimates, spread as evenly over what was touched as over the time.

    Between them grows the mean of both shares: where the outline grows fast there are more frames.
    """
    valid = np.flatnonzero(series.valid)
    if not len(valid):
        return ()
    t, touched = series.estimate.t[valid], np.nan_to_num(series.estimate["touched"][valid])
    grown = np.concatenate([[0.0], np.cumsum(np.maximum(np.diff(touched), 0.0))])
    progress = _share(t - t[0]) + _share(grown)
    wanted = np.linspace(0.0, progress[-1], most)
    return tuple(int(valid[i]) for i in np.unique(np.searchsorted(progress, wanted).clip(0, len(valid) - 1)))


def outline_known(series: Series, t: float, number: int) -> OutlineAt | None:
    """The last outline of that object told up to `t` (s)."""
    known = [outline for outline in series.outlines if outline.t <= t + 1e-6 and outline.number == number]
    return known[-1] if known else None


def _share(values: FloatArray) -> FloatArray:
    return values / values[-1] if values[-1] > 0.0 else values
