"""Rotation matrices (…, 3, 3) and vectors (…, 3), vectorised; increments are in the world frame, R ← exp[δ]R."""

from __future__ import annotations

import math

import numpy as np

from palmd.events import FloatArray


def skew(v: FloatArray) -> FloatArray:
    """The matrix [v] with [v]w = v × w."""
    matrix = np.zeros((*v.shape, 3))
    matrix[..., 0, 1], matrix[..., 0, 2], matrix[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return matrix - np.swapaxes(matrix, -1, -2)


def exp(v: FloatArray) -> FloatArray:
    """The rotation by the vector v."""
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    S = skew(v)
    rotation: FloatArray = np.eye(3) + np.sinc(angle / np.pi) * S + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * (S @ S)
    return rotation


def log(R: FloatArray) -> FloatArray:
    """Rotation vector of a rotation by less than π."""
    axis = 0.5 * np.stack(
        [R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], axis=-1
    )
    cosine = 0.5 * (np.trace(R, axis1=-2, axis2=-1) - 1.0)
    angle = np.arctan2(np.linalg.norm(axis, axis=-1), cosine)
    vector: FloatArray = axis / np.sinc(angle / np.pi)[..., None]
    return vector


def left_inverse(v: FloatArray) -> FloatArray:
    """Inverse left Jacobian ∂ log(exp[δ]exp[v])/∂δ, to third order in v; for −v it is the inverse right Jacobian."""
    S = skew(v)
    matrix: FloatArray = np.eye(3) - 0.5 * S + S @ S / 12.0
    return matrix


def quaternion(R: FloatArray) -> tuple[float, ...]:
    """Quaternion x, y, z, w of one rotation (3, 3), w ≥ 0."""
    # from the largest of its four squares (Shepperd 1978)
    (a, b, c), (d, e, f), (g, h, i) = R.tolist()
    squares = 1 + a - e - i, 1 - a + e - i, 1 - a - e + i, 1 + a + e + i
    rows = (
        (squares[0], b + d, c + g, h - f), (b + d, squares[1], f + h, c - g),
        (c + g, f + h, squares[2], d - b), (h - f, c - g, d - b, squares[3]),
    )  # fmt: skip
    q = rows[squares.index(max(squares))]
    length = math.copysign(math.hypot(*q), q[3])
    return tuple(each / length for each in q)


def quaternions(R: FloatArray) -> FloatArray:
    """(K, 4) quaternions x, y, z, w of rotations (K, 3, 3), continuous in sign."""
    from scipy.spatial.transform import Rotation

    q = Rotation.from_matrix(R).as_quat()
    flips = np.cumprod(np.where((q[1:] * q[:-1]).sum(-1) < 0.0, -1.0, 1.0))
    q[1:] *= flips[:, None]
    return np.asarray(q)
