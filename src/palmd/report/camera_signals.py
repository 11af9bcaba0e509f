"""A reconstructed motion and a camera's track of the same run as functions of time. Pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from palmd.events import FloatArray, PalmSample
from palmd.observer.palm_path import smoothed_path
from palmd.record.resultfile import Result
from palmd.record.track import MIN_ROWS, CameraTrack
from palmd.system.description import RigDescription

GAP_S = 0.1  # longest gap in the reconstruction that is interpolated

Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class KnownMotion:
    """The reconstructed motion at times t (n, s): psi (rad); with a log com (n, 2) in m and palms φ1, φ12 (n, 2)."""

    t: FloatArray
    psi: FloatArray
    com: FloatArray | None
    palms: FloatArray | None


def motion_of(result: Result, rig: RigDescription | None, palms: list[PalmSample]) -> KnownMotion:
    """The reconstructed motion; with the log's palm angles also the centre of mass in the world frame."""
    if rig is None or not palms:
        return KnownMotion(result.t, result.psi, None, None)
    angles = smoothed_path(palms, rig.palm_angle_noise).at(result.t)[:, :2]
    com = com_of(angles, result.radii, rig)
    return KnownMotion(result.t, result.psi, com, np.stack([angles[:, 0], angles.sum(axis=1)], axis=1))


def com_of(angles: FloatArray, radii: FloatArray, rig: RigDescription) -> FloatArray:
    """The centre of mass in the world (n, 2), m: n1·c′ = r1, n2·c′ = r2 about the hinge O = B − L1 t1(φ1) of an arc.

    angles (n, 2): φ1, φ2 (rad); radii (2, n): r1, r2. Since n1·t2 = −sin φ2 and n2·t1 = sin φ2,
    c′ = (r2 t1 − r1 t2) / sin φ2.
    """
    directions = angles.cumsum(axis=1)
    along = np.stack([np.cos(directions), np.sin(directions)], axis=-1)  # t1 and −t2
    from_hinge = (radii[1, :, None] * along[:, 0] + radii[0, :, None] * along[:, 1]) / np.sin(angles[:, 1])[:, None]
    base, length = rig.arc
    return np.asarray(np.array(base) - length * along[:, 0] + from_hinge)


class Signals:
    """Both records as functions of time."""

    def __init__(self, motion: KnownMotion, track: CameraTrack) -> None:
        self.motion, self.track = motion, track
        self.psi = CubicSpline(motion.t, motion.psi)
        self.com = None if motion.com is None else CubicSpline(motion.t, motion.com)
        self.palms = None
        self.seen = np.isfinite(track.angle)
        if motion.palms is not None and (np.isfinite(track.palms) & self.seen[:, None]).sum() >= MIN_ROWS:
            self.palms = CubicSpline(motion.t, motion.palms)
        self._gaps = np.flatnonzero(np.diff(motion.t) > GAP_S)

    def known_at(self, log_t: FloatArray) -> Bools:
        """Whether each time lies outside the gaps of the reconstruction."""
        known = np.ones(len(log_t), dtype=np.bool_)
        for i in self._gaps:
            known &= ~((log_t > self.motion.t[i]) & (log_t < self.motion.t[i + 1]))
        return known

    def gaps(self) -> list[tuple[float, float]]:
        """The gaps of the reconstruction as spans of log time."""
        return [(float(self.motion.t[i]), float(self.motion.t[i + 1])) for i in self._gaps]

    def angles(self, rows: npt.NDArray[np.intp]) -> list[tuple[FloatArray, FloatArray]]:
        """Angles that determine the clock: pairs of the camera's on the given rows and the log's on `motion.t`.

        The palms' angles if the camera sees them, as the log has them independently of the reconstruction; else ψ.
        """
        if self.palms is None or self.motion.palms is None:
            return [(self.track.angle[rows], self.motion.psi)]
        return [(self.track.palms[rows, i], self.motion.palms[:, i]) for i in range(2)]
