"""Errors of estimates against the truth, as used throughout the project. Outlines: COM-centred, best rotation. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray

WRONG_M = 3e-4
"""A contact's r, or an outline, with a larger error is wrong."""

LAST_S = 5.0
"""The end of a run, over which errors are evaluated."""

_ROTATIONS = 720
_REFINED = 8  # candidates, since an outline may be nearly symmetric
_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
_ROTATION_RESOLUTION_RAD = 1e-6
_NEGLIGIBLE_M = 1e-10


@dataclass(frozen=True, slots=True)
class OutlineScore:
    """Errors over the touched normals (m), NaN if there are none; `relative` is e_h over the true mean radius.

    The estimate's normal θ is the truth's normal θ + `rotation` (rad).
    """

    e_h: float
    max_error: float
    relative: float
    touched: float
    rotation: float


def score_outline(
    theta: FloatArray, h: FloatArray, touched: npt.NDArray[np.bool_] | None, true_h: FloatArray
) -> OutlineScore:
    """e_h = RMS over touched normals of ĥ(θ) − h(θ + δ), minimised over all rotations δ.

    theta, h, touched: the estimate's normals (rad), support function (m) and which were touched, None: all. true_h: the
    true support function (m) on evenly spaced normals from 0; interpolated as band-limited. Raises ValueError if the
    lengths differ.
    """
    if touched is None:
        touched = np.ones(len(theta), dtype=np.bool_)
    if not len(theta) == len(h) == len(touched):
        raise ValueError(f"{len(theta)} normals, {len(h)} values of h and {len(touched)} of touched do not fit")
    mean_radius = float(np.mean(true_h))
    if not touched.any():
        return OutlineScore(math.nan, math.nan, math.nan, 0.0, 0.0)
    errors = _Errors(theta[touched], h[touched], true_h)
    rotation = _best_rotation(errors.mean_square)
    error = errors.at(rotation)
    e_h = math.sqrt(float(np.mean(error**2)))
    return OutlineScore(
        e_h=e_h,
        max_error=float(np.max(np.abs(error))),
        relative=e_h / mean_radius,
        touched=float(np.mean(touched)),
        rotation=math.remainder(rotation, math.tau),
    )


def support_at(h: FloatArray, theta: FloatArray) -> FloatArray:
    """The support function (m) at any normals (rad) from evenly spaced values, by band-limited interpolation."""
    coefficients = np.fft.rfft(h) / len(h)
    coefficients[1 : (len(h) + 1) // 2] *= 2.0
    waves = np.exp(1j * np.outer(theta, np.arange(len(coefficients))))
    return np.asarray((waves @ coefficients).real)


def score_shape(shape: Mapping[str, Any], true_h: Sequence[float] | FloatArray, *, all_normals: bool) -> OutlineScore:
    """Score of a `palm/shape` against the true support function (m): on touched or all normals."""
    theta, h = (np.array(shape[name], dtype=np.float64) for name in ("theta_rad", "h_m"))
    touched = None if all_normals else np.array(shape["touched"], dtype=np.bool_)
    return score_outline(theta, h, touched, np.array(true_h, dtype=np.float64))


class _Errors:
    """ĥ(θ) − h(θ + δ) for any rotation δ, the truth being evaluated from its Fourier coefficients."""

    def __init__(self, theta: FloatArray, h: FloatArray, true_h: FloatArray) -> None:
        coefficients = np.fft.rfft(true_h) / len(true_h)
        k = np.arange(len(coefficients))
        coefficients[(k > 0) & (2 * k < len(true_h))] *= 2.0
        self._k = k[np.abs(coefficients) > _NEGLIGIBLE_M]
        self._waves = np.exp(1j * np.outer(theta, self._k)) * coefficients[self._k]
        self._h = h

    def at(self, rotation: float) -> FloatArray:
        return np.asarray(self._h - (self._waves @ np.exp(1j * self._k * rotation)).real)

    def mean_square(self, rotations: FloatArray) -> FloatArray:
        """For several rotations."""
        turned = (self._waves @ np.exp(1j * np.outer(self._k, rotations))).real
        return np.asarray(np.mean((self._h[:, None] - turned) ** 2, axis=0))


def _best_rotation(cost: Callable[[FloatArray], FloatArray]) -> float:
    step = math.tau / _ROTATIONS
    rotations: FloatArray = np.arange(_ROTATIONS, dtype=np.float64) * step
    costs = cost(rotations)
    minima = np.flatnonzero((costs <= np.roll(costs, 1)) & (costs <= np.roll(costs, -1)))
    candidates = minima[np.argsort(costs[minima])][:_REFINED]
    refined = [_golden_section(cost, rotations[i] - step, rotations[i] + step) for i in candidates]
    return min(refined, key=lambda rotation: float(cost(np.array([rotation]))[0]))


def _golden_section(cost: Callable[[FloatArray], FloatArray], low: float, high: float) -> float:
    """Position of the minimum between low and high, to `_ROTATION_RESOLUTION_RAD`."""
    while high - low > _ROTATION_RESOLUTION_RAD:
        inner = _GOLDEN * (high - low)
        left, right = high - inner, low + inner
        at_left, at_right = cost(np.array([left, right]))
        if at_left < at_right:
            high = right
        else:
            low = left
    return (low + high) / 2.0
