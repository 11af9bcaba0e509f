"""The arm's linkage from the poses that the arm reports while a hand swings the palms. Pure.

The palms are a closed chain: palm 1 is hinged at its far end to the fixed base B, the arm holds palm 2's far end E.
In arm coordinates, with u(a) = (cos a, sin a), the arm reports E and its tool angle θ, which is that of palm 2 but
for an angle τ by which the tool is mounted askew. The hinge between the palms is E − L2·u(θ + τ), and it stays at
L1 from B however the palms stand:

    |E − L2·u(θ + τ) − B| = L1                                                                              (1)

Five unknowns: B (two), L1, L2, τ. Squared, with p = L2·cos τ and q = L2·sin τ, (1) is linear in seven:

    |E|² = 2p·E·u(θ) + 2q·E·u(θ + π/2) + 2·B·E − 2m·cos θ − 2n·sin θ − c                                    (2)
    m = p·Bx + q·By,   n = p·By − q·Bx,   c = L2² + |B|² − L1²

which gives the start without knowing anything; Gauss–Newton on (1) then finds the least squares. Nothing here depends
on how the arm stands in the world: what the chain cannot tell is the arm's yaw.

Where one of the palms or the opening between them stays as it is, E keeps its place on a body that turns about P:

    E = P + R(θ)·w                                                                                          (3)

linear in P and w. Poses that fit (3) do not tell the five, and (1) has wrong solutions that fit them perfectly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray

LEAST_POSES = 50
LEAST_SPAN = math.radians(30.0)
LEAST_WAY = 1e-3
"""m: what (3) must leave of the poses."""
LEAST_NOISE = 1e-5
"""m: no better is believed of an arm, however well the poses agree."""
MOST_LENGTH_SD = 2e-4
"""m: one sigma of a length beyond which the result is refused."""

_ROUNDS = 50
_SETTLED = 1e-12


class TooLittleSwingError(ValueError):
    """The poses do not suffice; the text says what is missing and what to do."""


@dataclass(frozen=True, slots=True)
class LinkageFit:
    """B in arm coordinates and the lengths (m), τ (rad), each with its one sigma.

    rms: what (1) leaves (m). The spans are those of palm 1, of palm 2 and of the opening between them (rad).
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

    Raises TooLittleSwingError when there are too few poses, or when they do not tell all five. The sigmas take the
    errors of the poses for independent.
    """
    if len(poses) < LEAST_POSES:
        raise TooLittleSwingError(f"only {len(poses)} different poses of at least {LEAST_POSES}: swing for longer")
    theta = np.unwrap(poses[:, 2])
    if np.ptp(theta) < LEAST_SPAN:
        raise _missing("palm 2", float(np.ptp(theta)))
    if _about_one_point(poses) < LEAST_WAY:
        raise TooLittleSwingError(
            "the arm turned about one point, as if one palm stood still or both moved as one:"
            " swing both palms, each against the other"
        )
    x = _linear_start(poses)
    for _ in range(_ROUNDS):
        left, jacobian = _residuals(poses, x), _jacobian(poses, x)
        step = np.linalg.lstsq(jacobian, -left, rcond=None)[0]
        x = x + step
        if float(np.abs(step).max()) < _SETTLED:
            break
    left = _residuals(poses, x)
    rms = math.sqrt(float(left @ left) / (len(left) - 5))
    span1, span2, span_opening = _spans(poses, x)
    for what, span in (("palm 1", span1), ("the opening between the palms", span_opening)):
        if span < LEAST_SPAN:
            raise _missing(what, span)
    jacobian = _jacobian(poses, x)
    sd = np.sqrt(np.diag(np.linalg.pinv(jacobian.T @ jacobian))) * max(rms, LEAST_NOISE)
    if not (np.isfinite(x).all() and float(sd[:4].max()) < MOST_LENGTH_SD):
        raise TooLittleSwingError(
            f"the lengths are only known to {float(sd[:4].max()) * 1e3:.2f} mm: swing both palms more widely,"
            " each against the other, and without force"
        )
    (bx, by, length1, length2, tool), (bx_sd, by_sd, length1_sd, length2_sd, tool_sd) = map(float, x), map(float, sd)
    return LinkageFit(
        *(bx, by, length1, length2, tool),
        *(bx_sd, by_sd, length1_sd, length2_sd, tool_sd),
        *(rms, len(poses), span1, span2, span_opening),
    )


def _missing(what: str, span: float) -> TooLittleSwingError:
    return TooLittleSwingError(
        f"{what} was swung through {math.degrees(span):.0f}° only, and {math.degrees(LEAST_SPAN):.0f}° are the least:"
        " swing both palms more widely, each against the other"
    )


def _about_one_point(poses: FloatArray) -> float:
    """What the least squares of (3) leave (m)."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    one, none = np.ones_like(c), np.zeros_like(c)
    columns = np.concatenate([np.stack([one, none, c, -s], axis=1), np.stack([none, one, s, c], axis=1)])
    places = np.concatenate([poses[:, 0], poses[:, 1]])
    left = places - columns @ np.linalg.lstsq(columns, places, rcond=None)[0]
    return math.sqrt(float(left @ left) / len(poses))


def _linear_start(poses: FloatArray) -> FloatArray:
    """The least squares of (2), solved for (Bx, By, L1, L2, τ)."""
    ex, ey, theta = poses.T
    c, s = np.cos(theta), np.sin(theta)
    columns = [2 * (ex * c + ey * s), 2 * (ey * c - ex * s), 2 * ex, 2 * ey, -2 * c, -2 * s, -np.ones_like(ex)]
    p, q, bx, by, _, _, constant = np.linalg.lstsq(np.stack(columns, axis=1), ex**2 + ey**2, rcond=None)[0]
    length1 = math.sqrt(max(p * p + q * q + bx * bx + by * by - constant, LEAST_NOISE))
    return np.array([bx, by, length1, math.hypot(p, q), math.atan2(q, p)])


def _hinge_from_base(poses: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    bx, by, _, length2, tool = x
    angle = poses[:, 2] + tool
    return poses[:, 0] - length2 * np.cos(angle) - bx, poses[:, 1] - length2 * np.sin(angle) - by


def _residuals(poses: FloatArray, x: FloatArray) -> FloatArray:
    """Left minus right side of (1), m."""
    dx, dy = _hinge_from_base(poses, x)
    return np.asarray(np.hypot(dx, dy) - x[2])


def _jacobian(poses: FloatArray, x: FloatArray) -> FloatArray:
    """Of the residuals by (Bx, By, L1, L2, τ)."""
    dx, dy = _hinge_from_base(poses, x)
    far = np.hypot(dx, dy)
    nx, ny = dx / far, dy / far
    angle = poses[:, 2] + x[4]
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([-nx, -ny, -np.ones_like(nx), -(nx * c + ny * s), x[3] * (nx * s - ny * c)], axis=1)


def _spans(poses: FloatArray, x: FloatArray) -> tuple[float, float, float]:
    """Through which angles palm 1, palm 2 and the opening between them went (rad)."""
    dx, dy = _hinge_from_base(poses, x)
    first = np.unwrap(np.arctan2(-dy, -dx))  # the hinge is at B − L1·u, so palm 1 points from it to B
    second = np.unwrap(poses[:, 2])
    return float(np.ptp(first)), float(np.ptp(second)), float(np.ptp(second - first))
