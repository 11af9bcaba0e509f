"""A camera's clock, frame and mark by least squares, with honest one-sigmas. Pure.

With γ the angle between the camera's arrow and ψ, α the angle and T the place of the world in the camera's frame, m the
mark in the object's frame, R(·) a rotation, c the centre of mass in the world:

    log time = t + offset + drift (t − t_middle)
    angle = ψ + γ        mark = T + R(α) (c + R(ψ) m)        palm 1, palm 2 = φ1 + α, φ12 + α
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from palmd.events import FloatArray
from palmd.observer.outline import wrapped
from palmd.report.camera_signals import Signals

DRIFT_FROM_S = 20.0  # overlap from which on a drift is looked for
ANGLE_SD_RAD, PLACE_SD_M = math.radians(0.3), 2e-4  # of the camera, to begin with
MEMORY_S = 1.0  # over which residuals are correlated at most

Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class CameraClock:
    """log time = t + offset + drift (t − t_middle), t the camera's; s, and s/s; a drift not looked for is NaN."""

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
    """The world in the camera's frame: its angle (rad) and place (m); the mark in the object's frame (m); with sds."""

    angle: float
    angle_sd: float
    place: tuple[float, float]
    place_sd: tuple[float, float]
    mark: tuple[float, float]
    mark_sd: tuple[float, float]


class CameraFit:
    """All unknowns by least squares on the chosen rows: p = (offset − lag, drift, γ[, α, Tx, Ty, mx, my])."""

    def __init__(self, signals: Signals, rows: Bools, lag: float) -> None:
        self._signals, self._track = signals, signals.track
        self._t = signals.track.t[rows]
        self._angle, self._mark, self._palms = (
            part[rows] for part in (self._track.angle, self._track.mark, self._track.palms)
        )
        self._middle = float(self._t[0] + self._t[-1]) / 2
        self._drifts = bool(self._t[-1] - self._t[0] >= DRIFT_FROM_S)
        self._places = signals.com is not None
        self._sd = np.array([ANGLE_SD_RAD, PLACE_SD_M, ANGLE_SD_RAD])
        self._lag = lag
        p = self._first_guess()
        for _ in range(2):  # the second time with the noise that the first has found
            found = least_squares(self._weighed, p, x_scale="jac")
            p = found.x
            self._sd = np.array([max(rms(part[np.isfinite(part)]), 1e-6) for part in self._residuals(p)])
        found = least_squares(self._weighed, p, x_scale="jac")
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
        if not self._places:
            return None
        p, sd = self._p.tolist(), self._sd_p.tolist()
        return CameraFrame(
            math.remainder(p[3], math.tau), sd[3], (p[4], p[5]), (sd[4], sd[5]), (p[6], p[7]), (sd[6], sd[7])
        )

    def place_residual(self) -> FloatArray:
        """How far (m) the mark is from where it was foretold, row by row."""
        return np.asarray(np.hypot(*self._residuals(self._p)[1].T))

    def _log_time(self, p: FloatArray) -> FloatArray:
        return np.asarray(self._t + self._lag + p[0] + (p[1] * (self._t - self._middle) if self._drifts else 0.0))

    def _residuals(self, p: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Of angle (n,), mark (n, 2), palms (n, 2); NaN where nothing is told."""
        t = self._log_time(p)
        psi = self._signals.psi(t)
        angle = wrapped(self._angle - psi - p[2])
        nothing = np.full((len(t), 2), np.nan)
        if self._signals.com is None:
            return angle, nothing, nothing
        mark = self._mark - p[4:6] - _turned(self._signals.com(t) + _turned(p[6:8], psi), p[3])
        palms = nothing if self._signals.palms is None else wrapped(self._palms - self._signals.palms(t) - p[3])
        return angle, mark, palms

    def _rows(self, p: FloatArray) -> FloatArray:
        """Residuals over their noise (n, 5), 0 where nothing is told."""
        angle, mark, palms = self._residuals(p)
        told = np.concatenate([angle[:, None] / self._sd[0], mark / self._sd[1], palms / self._sd[2]], axis=1)
        return np.where(np.isfinite(told), told, 0.0)

    def _weighed(self, p: FloatArray) -> FloatArray:
        return self._rows(p).ravel()

    def _first_guess(self) -> FloatArray:
        """Given the clock, the frame is linear: mark = T + a c + b e^{iψ} in complex numbers, a = e^{iα}, b = a m."""
        t = self._t + self._lag
        psi = self._signals.psi(t)
        gauge = float(np.angle(np.mean(np.exp(1j * (self._angle - psi)))))
        if self._signals.com is None:
            return np.array([0.0, 0.0, gauge])
        com, mark = (part[:, 0] + 1j * part[:, 1] for part in (self._signals.com(t), self._mark))
        columns = np.stack([np.ones_like(com), com, np.exp(1j * psi)], axis=1)
        place, turn, lever = np.linalg.lstsq(columns, mark, rcond=None)[0]
        if self._signals.palms is not None:
            away = self._palms - self._signals.palms(t)
            turn = np.mean(np.exp(1j * away[np.isfinite(away)]))
        turn = turn / abs(turn)
        m = lever / turn
        return np.array([0.0, 0.0, gauge, np.angle(turn), place.real, place.imag, m.real, m.imag])

    def _variances(self, jacobian: FloatArray, residual: FloatArray) -> FloatArray:
        """Variances of p when a row's residuals go with those of the rows before, as far as `MEMORY_S`.

        (JᵀJ)⁻¹ S (JᵀJ)⁻¹ with S = Γ0 + Σ w_l (Γ_l + Γ_lᵀ), Γ_l the products of scores l rows apart, w falling
        linearly; never less than with Γ0 alone.
        """
        n = len(self._t)
        free = np.abs(jacobian).sum(axis=0) > 0.0
        slopes = jacobian[:, free]
        scores = (slopes * residual[:, None]).reshape(n, -1, slopes.shape[1]).sum(axis=1)
        bread = np.linalg.pinv(slopes.T @ slopes)
        alone = scores.T @ scores
        middle = alone.copy()
        lags = min(round(MEMORY_S / float(np.median(np.diff(self._t)))), n // 4)
        for lag in range(1, lags + 1):
            product = scores[lag:].T @ scores[:-lag]
            middle += (1 - lag / (lags + 1)) * (product + product.T)
        variances = np.zeros(jacobian.shape[1])
        variances[free] = np.maximum(*(np.diagonal(bread @ each @ bread) for each in (alone, middle)))
        return variances


def _turned(vectors: FloatArray, angle: FloatArray | float) -> FloatArray:
    """Vectors (n, 2) or one (2,) turned by an angle each or one (rad): (n, 2)."""
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else math.nan
