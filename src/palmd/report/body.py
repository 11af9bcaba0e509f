"""Where outline, contacts and centre of mass are, from what runs tell of them. Pure NumPy; metres and radians."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray
from palmd.polygon import normals
from palmd.report.series import OutlineAt, Series


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
    phi1: float
    phi12: float
    psi: float
    centre: FloatArray
    contact1: FloatArray
    contact2: FloatArray


def pose_at(series: Series, number: int) -> DrawnPose:
    """The estimate of that number: n1·c = r1, n2·c = r2; contacts at s1 t1 and −s2 t2 (section 3.1)."""
    t, estimate = series.estimate.t, series.estimate
    phi1, phi2, psi, r1, r2, s1, s2 = (
        float(estimate[name][number]) for name in ("phi1_rad", "phi2_rad", "psi_rad", "r1_m", "r2_m", "s1_m", "s2_m")
    )
    phi12 = phi1 + phi2
    along1, along2 = (np.array([math.cos(angle), math.sin(angle)]) for angle in (phi1, phi12))
    inward = np.array([[-along1[1], along1[0]], [along2[1], -along2[0]]])
    centre = np.linalg.solve(inward, np.array([r1, r2])) if math.sin(phi2) else np.full(2, math.nan)
    return DrawnPose(float(t[number]), phi1, phi12, psi, centre, s1 * along1, s2 * along2)


def felt_points(series: Series, numbers: Iterable[int]) -> FloatArray:
    """Both contacts of these estimates in the object's frame (2, 2n): what an observer without a shape has of it."""
    felt = []
    for number in numbers:
        pose = pose_at(series, int(number))
        both = np.stack([pose.contact1, pose.contact2], axis=1) - pose.centre[:, None]
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
