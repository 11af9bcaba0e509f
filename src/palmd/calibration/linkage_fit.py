"""The arm's linkage from the poses that the arm reports while a hand swings the palms. Pure.

The palms are a closed chain: palm 1 is hinged at its far end to the fixed base B, the arm holds palm 2's far end E.
In arm coordinates, with u(a) = (cos a, sin a), the arm reports E and its tool angle θ, which differs from palm 2's by
an angle τ, the tool's mounting error. The hinge between the palms is E − L2·u(θ + τ), and its distance from B is L1 in
all poses:

    |E − L2·u(θ + τ) − B| = L1                                                                              (1)

Five unknowns: B (two), L1, L2, τ. Squared, with p = L2·cos τ and q = L2·sin τ, (1) is linear in seven:

    |E|² = 2p·E·u(θ) + 2q·E·u(θ + π/2) + 2·B·E − 2m·cos θ − 2n·sin θ − c                                    (2)
    m = p·Bx + q·By,   n = p·By − q·Bx,   c = L2² + |B|² − L1²

which gives a start without prior knowledge; (1) then determines the least squares. Nothing here depends on
the arm's orientation in the world: the chain does not determine the arm's yaw.

If one of the palms or the opening between them does not move, E is fixed on a body that turns about P:

    E = P + R(θ)·w                                                                                          (3)

linear in P and w. Poses that fit (3) do not determine the five unknowns, and (1) has wrong solutions that fit exactly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np

from palmd.calibration.solving import solved
from palmd.events import FloatArray

MIN_POSES = 50
MIN_SPAN = math.radians(30.0)
MIN_RESIDUAL = 1e-3
"""m: smallest residual of (3)."""
MIN_NOISE = 1e-5
"""m: lower bound of an arm's noise, even if the poses fit better."""
MAX_LENGTH_SD = 2e-4
"""m: largest accepted 1σ of a length."""


class TooLittleSwingError(ValueError):
    """The poses do not suffice; the text states what is missing and what to do."""


@dataclass(frozen=True, slots=True)
class LinkageFit:
    """B in arm coordinates and the lengths (m), τ (rad), each with its 1σ.

    rms: residual of (1) (m). The spans are those of palm 1, of palm 2 and of the opening between them (rad).
    """

    base_x: float
    base_y: float
    palm1_length: float
    palm2_length: float
    tool: float
    base_x_sd: float
    base_y_sd: float
    palm1_length_sd: float
    palm2_length_sd: float
    tool_sd: float
    rms: float
    poses: int
    span1: float
    span2: float
    span_opening: float


def fit_linkage(poses: FloatArray) -> LinkageFit:
    """The least-squares solution of (1); poses is (n, 3): x, y (m, arm coordinates) and θ (rad, any turn).

    Raises TooLittleSwingError for too few poses, or if they do not determine all five unknowns. The 1σ values assume
    independent errors of the poses.
    """
    if len(poses) < MIN_POSES:
        raise TooLittleSwingError(f"only {len(poses)} different poses of at least {MIN_POSES}: swing for longer")
    theta = np.unwrap(poses[:, 2])
    if np.ptp(theta) < MIN_SPAN:
        raise _too_small("palm 2", float(np.ptp(theta)))
    if _residual_about_one_point(poses) < MIN_RESIDUAL:
        raise TooLittleSwingError(
            "the arm turned about one point, as if one palm stood still or both moved together:"
            " swing both palms, each against the other"
        )
    fit = solved(partial(_residuals, poses), _linear_start(poses))
    x, residuals, jacobian = fit.x, fit.fun, fit.jac
    rms = math.sqrt(float(residuals @ residuals) / (len(residuals) - 5))
    span1, span2, span_opening = _spans(poses, x)
    for what, span in (("palm 1", span1), ("the opening between the palms", span_opening)):
        if span < MIN_SPAN:
            raise _too_small(what, span)
    sd = np.sqrt(np.diag(np.linalg.pinv(jacobian.T @ jacobian))) * max(rms, MIN_NOISE)
    if not (np.isfinite(x).all() and float(sd[:4].max()) < MAX_LENGTH_SD):
        raise TooLittleSwingError(
            f"the lengths are uncertain by {float(sd[:4].max()) * 1e3:.2f} mm: swing both palms further,"
            " each against the other, and without force"
        )
    (bx, by, length1, length2, tool), (bx_sd, by_sd, length1_sd, length2_sd, tool_sd) = map(float, x), map(float, sd)
    return LinkageFit(
        *(bx, by, length1, length2, tool),
        *(bx_sd, by_sd, length1_sd, length2_sd, tool_sd),
        *(rms, len(poses), span1, span2, span_opening),
    )


def _too_small(what: str, span: float) -> TooLittleSwingError:
    return TooLittleSwingError(
        f"{what} was swung through {math.degrees(span):.0f}° only, at least {math.degrees(MIN_SPAN):.0f}° are needed:"
        " swing both palms further, each against the other"
    )


def _residual_about_one_point(poses: FloatArray) -> float:
    """RMS residual of the least-squares fit of (3) (m)."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    one, none = np.ones_like(c), np.zeros_like(c)
    columns = np.concatenate([np.stack([one, none, c, -s], axis=1), np.stack([none, one, s, c], axis=1)])
    positions = np.concatenate([poses[:, 0], poses[:, 1]])
    residuals = positions - columns @ np.linalg.lstsq(columns, positions, rcond=None)[0]
    return math.sqrt(float(residuals @ residuals) / len(poses))


def _linear_start(poses: FloatArray) -> FloatArray:
    """The least-squares solution of (2) as (Bx, By, L1, L2, τ)."""
    ex, ey, theta = poses.T
    c, s = np.cos(theta), np.sin(theta)
    columns = [2 * (ex * c + ey * s), 2 * (ey * c - ex * s), 2 * ex, 2 * ey, -2 * c, -2 * s, -np.ones_like(ex)]
    p, q, bx, by, _, _, constant = np.linalg.lstsq(np.stack(columns, axis=1), ex**2 + ey**2, rcond=None)[0]
    length1 = math.sqrt(max(p * p + q * q + bx * bx + by * by - constant, MIN_NOISE))
    return np.array([bx, by, length1, math.hypot(p, q), math.atan2(q, p)])


def _hinge_from_base(poses: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    bx, by, _, length2, tool = x
    angle = poses[:, 2] + tool
    return poses[:, 0] - length2 * np.cos(angle) - bx, poses[:, 1] - length2 * np.sin(angle) - by


def _residuals(poses: FloatArray, x: FloatArray) -> FloatArray:
    """Left minus right side of (1), m."""
    dx, dy = _hinge_from_base(poses, x)
    return np.asarray(np.hypot(dx, dy) - x[2])


def _spans(poses: FloatArray, x: FloatArray) -> tuple[float, float, float]:
    """Ranges of the angles of palm 1, palm 2 and the opening between them (rad)."""
    dx, dy = _hinge_from_base(poses, x)
    first = np.unwrap(np.arctan2(-dy, -dx))  # the hinge is at B − L1·u, so palm 1 points from it to B
    second = np.unwrap(poses[:, 2])
    return float(np.ptp(first)), float(np.ptp(second)), float(np.ptp(second - first))
