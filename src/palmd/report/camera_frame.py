"""A camera's clock, frame and mark by least squares, with standard deviations for correlated residuals. Pure.

With γ the angle between the camera's arrow and ψ, α and T the rotation and translation of the world frame in the
camera's frame, m the mark in the object's frame, R(·) a rotation, c the centre of mass in the world:

    log time = t + offset + drift (t − t_middle)
    angle = ψ + γ        mark = T + R(α) (c + R(ψ) m)        palm 1, palm 2 = φ1 + α, φ12 + α
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares

from palmd.events import FloatArray, PalmSample
from palmd.observer.outline import wrapped
from palmd.observer.palm_path import smoothed_path
from palmd.record.resultfile import Result
from palmd.record.track import MIN_ROWS, CameraTrack
from palmd.system.description import RigDescription

GAP_S = 0.1  # longest gap in the reconstruction that is interpolated


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


DRIFT_MIN_S = 20.0  # smallest overlap for which a clock drift is estimated
ANGLE_SD_RAD, PLACE_SD_M = math.radians(0.3), 2e-4  # initial guesses of the camera's noise
CORRELATION_S = 1.0  # longest correlation time of the residuals

Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class CameraClock:
    """log time = t + offset + drift (t − t_middle), t the camera's time; s and s/s; NaN for a drift not estimated."""

    t_middle: float
    offset: float
    offset_sd: float
    drift: float
    drift_sd: float

    def log_time(self, t: FloatArray) -> FloatArray:
        """The log's time (s) at the camera's times."""
        drift = 0.0 if math.isnan(self.drift) else self.drift
        return np.asarray(t + self.offset + drift * (t - self.t_middle))


@dataclass(frozen=True, slots=True)
class CameraFrame:
    """The world frame in the camera's frame: angle (rad) and translation `place` (m); the mark in the object's frame
    (m); standard deviations."""

    angle: float
    angle_sd: float
    place: tuple[float, float]
    place_sd: tuple[float, float]
    mark: tuple[float, float]
    mark_sd: tuple[float, float]


class CameraFit:
    """Least-squares fit of all unknowns on the given rows: p = (offset − lag, drift, γ[, α, Tx, Ty, mx, my])."""

    def __init__(self, signals: Signals, rows: Bools, lag: float) -> None:
        self._signals, self._track = signals, signals.track
        self._t = signals.track.t[rows]
        self._angle, self._mark, self._palms = (
            part[rows] for part in (self._track.angle, self._track.mark, self._track.palms)
        )
        self._middle = float(self._t[0] + self._t[-1]) / 2
        self._drifts = bool(self._t[-1] - self._t[0] >= DRIFT_MIN_S)
        self._has_positions = signals.com is not None
        self._sd = np.array([ANGLE_SD_RAD, PLACE_SD_M, ANGLE_SD_RAD])
        self._lag = lag
        p = self._first_guess()
        for _ in range(2):  # the second time with the noise estimated from the first
            found = least_squares(self._whitened_residuals, p, x_scale="jac")
            p = found.x
            self._sd = np.array([max(rms(part[np.isfinite(part)]), 1e-6) for part in self._residuals(p)])
        found = least_squares(self._whitened_residuals, p, x_scale="jac")
        self._p = found.x
        self._sd_p = np.sqrt(self._variances(found.jac, found.fun))

    @property
    def gauge(self) -> float:
        return float(self._p[2])

    def clock(self) -> CameraClock:
        sd = self._sd_p
        drift, drift_sd = (float(self._p[1]), float(sd[1])) if self._drifts else (math.nan, math.nan)
        return CameraClock(self._middle, self._lag + float(self._p[0]), float(sd[0]), drift, drift_sd)

    def frame(self) -> CameraFrame | None:
        if not self._has_positions:
            return None
        p, sd = self._p.tolist(), self._sd_p.tolist()
        return CameraFrame(
            math.remainder(p[3], math.tau), sd[3], (p[4], p[5]), (sd[4], sd[5]), (p[6], p[7]), (sd[6], sd[7])
        )

    def position_residual(self) -> FloatArray:
        """Distance (m) between observed and predicted mark, row by row."""
        return np.asarray(np.hypot(*self._residuals(self._p)[1].T))

    def _log_time(self, p: FloatArray) -> FloatArray:
        return np.asarray(self._t + self._lag + p[0] + (p[1] * (self._t - self._middle) if self._drifts else 0.0))

    def _residuals(self, p: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residuals of angle (n,), mark (n, 2), palms (n, 2); NaN where not observed."""
        t = self._log_time(p)
        psi = self._signals.psi(t)
        angle = wrapped(self._angle - psi - p[2])
        missing = np.full((len(t), 2), np.nan)
        if self._signals.com is None:
            return angle, missing, missing
        mark = self._mark - p[4:6] - _rotated(self._signals.com(t) + _rotated(p[6:8], psi), p[3])
        palms = missing if self._signals.palms is None else wrapped(self._palms - self._signals.palms(t) - p[3])
        return angle, mark, palms

    def _whitened_residuals(self, p: FloatArray) -> FloatArray:
        """Residuals divided by their noise (5 n), 0 where not observed."""
        angle, mark, palms = self._residuals(p)
        whitened = np.concatenate([angle[:, None] / self._sd[0], mark / self._sd[1], palms / self._sd[2]], axis=1)
        return np.where(np.isfinite(whitened), whitened, 0.0).ravel()

    def _first_guess(self) -> FloatArray:
        """Linear solution for a known clock: mark = T + a c + b e^{iψ} in complex numbers, a = e^{iα}, b = a m."""
        t = self._t + self._lag
        psi = self._signals.psi(t)
        gauge = float(np.angle(np.mean(np.exp(1j * (self._angle - psi)))))
        if self._signals.com is None:
            return np.array([0.0, 0.0, gauge])
        com, mark = (part[:, 0] + 1j * part[:, 1] for part in (self._signals.com(t), self._mark))
        columns = np.stack([np.ones_like(com), com, np.exp(1j * psi)], axis=1)
        translation, rotation, lever = np.linalg.lstsq(columns, mark, rcond=None)[0]
        if self._signals.palms is not None:
            difference = self._palms - self._signals.palms(t)
            rotation = np.mean(np.exp(1j * difference[np.isfinite(difference)]))
        rotation = rotation / abs(rotation)
        m = lever / rotation
        return np.array([0.0, 0.0, gauge, np.angle(rotation), translation.real, translation.imag, m.real, m.imag])

    def _variances(self, jacobian: FloatArray, residual: FloatArray) -> FloatArray:
        """Variances of p for residuals correlated over up to `CORRELATION_S` (Newey–West).

        (JᵀJ)⁻¹ S (JᵀJ)⁻¹ with S = Γ0 + Σ w_l (Γ_l + Γ_lᵀ), Γ_l the products of scores l rows apart, w decreasing
        linearly; never less than with Γ0 alone.
        """
        n = len(self._t)
        free = np.abs(jacobian).sum(axis=0) > 0.0
        slopes = jacobian[:, free]
        scores = (slopes * residual[:, None]).reshape(n, -1, slopes.shape[1]).sum(axis=1)
        bread = np.linalg.pinv(slopes.T @ slopes)
        uncorrelated = scores.T @ scores
        meat = uncorrelated.copy()
        lags = min(round(CORRELATION_S / float(np.median(np.diff(self._t)))), n // 4)
        for lag in range(1, lags + 1):
            product = scores[lag:].T @ scores[:-lag]
            meat += (1 - lag / (lags + 1)) * (product + product.T)
        variances = np.zeros(jacobian.shape[1])
        variances[free] = np.maximum(*(np.diagonal(bread @ each @ bread) for each in (uncorrelated, meat)))
        return variances


def _rotated(vectors: FloatArray, angle: FloatArray | float) -> FloatArray:
    """Vectors (n, 2), or one (2,), rotated by one or n angles (rad): (n, 2)."""
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else math.nan
