"""Random convex bodies that no finite set of harmonics represents: sums of a ball, ellipsoids and a rounded polytope.

Each is given by its support function about the centre of mass,
H(x) = ρ|x| + Σ √(xᵀAₑx) + (Σ max(0, vⱼ·x)^q)^(1/q) − e·x, whose gradient at a unit vector is the point with that
outward normal, and whose Hessian has the radii of curvature. Arrays hold B bodies.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray

ELLIPSOIDS = 2
VERTICES = 12
MIN_RADIUS = 0.15
"""Smallest radius of curvature, over the mean radius."""


@dataclass(frozen=True, slots=True)
class Bodies:
    """B bodies. ball (B,) ρ; forms (B, E, 3, 3) A; vertices (B, V, 3) v; sharpness (B,) q; offset (B, 3) e; SI.

    inertia: (B, 3, 3) about the centre of mass per unit mass (m²).
    """

    ball: FloatArray
    forms: FloatArray
    vertices: FloatArray
    sharpness: FloatArray
    offset: FloatArray
    inertia: FloatArray

    def support(self, u: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(h (B, N), ∇H (B, N, 3), ∇²H (B, N, 3, 3)) at unit normals u (B, N, 3) of each body."""
        h = self.ball[:, None] - np.einsum("bi,bni->bn", self.offset, u)
        point = self.ball[:, None, None] * u - self.offset[:, None]
        outer = u[..., :, None] * u[..., None, :]
        bend = self.ball[:, None, None, None] * (np.eye(3) - outer)

        pulled = np.einsum("beij,bnj->bnei", self.forms, u)
        root = np.sqrt(np.einsum("bnei,bni->bne", pulled, u))
        along = pulled / root[..., None]
        h = h + root.sum(-1)
        point = point + along.sum(2)
        bend = bend + np.einsum("beij,bne->bnij", self.forms, 1.0 / root)
        bend -= np.einsum("bnei,bnej,bne->bnij", along, along, 1.0 / root)

        q = self.sharpness[:, None]
        reach = np.maximum(0.0, np.einsum("bvi,bni->bnv", self.vertices, u))
        top = reach.max(-1)
        size = top * (((reach / top[..., None]) ** q[..., None]).sum(-1)) ** (1.0 / q)
        share = reach / size[..., None]
        corner = np.einsum("bnv,bvi->bni", share ** (q[..., None] - 1), self.vertices)
        h = h + size
        point = point + corner
        spread = np.einsum("bnv,bvi,bvj->bnij", share ** (q[..., None] - 2), self.vertices, self.vertices)
        bend = bend + ((q - 1) / size)[..., None, None] * (spread - corner[..., :, None] * corner[..., None, :])
        return h, point, bend

    def select(self, indices: FloatArray) -> Bodies:
        """The bodies with these indices."""
        return Bodies(*(getattr(self, name)[indices] for name in self.__dataclass_fields__))


def random_bodies(count: int, random: np.random.Generator) -> Bodies:
    """Bodies with mean radius 14 to 24 mm, up to a fifth from round, and the centre of mass up to 1.5 mm off-centre."""
    drawn = [_draw_body(random) for _ in range(count)]
    return Bodies(*(np.stack([each[i] for each in drawn]) for i in range(6)))


def _draw_body(random: np.random.Generator) -> tuple[FloatArray, ...]:
    while True:
        radius = random.uniform(0.014, 0.024)
        shares = random.dirichlet([4.0, 4.0, 2.5])
        turns = np.linalg.qr(random.normal(size=(ELLIPSOIDS, 3, 3)))[0]
        axes = np.exp(random.normal(0.0, 0.17, (ELLIPSOIDS, 3)))
        forms = np.einsum("eij,ej,ekj->eik", turns, axes**2, turns) * (radius * shares[1] / ELLIPSOIDS) ** 2
        vertices = random.normal(size=(VERTICES, 3))
        vertices /= np.linalg.norm(vertices, axis=1)[:, None]
        vertices *= radius * shares[2] * random.uniform(0.8, 1.2, VERTICES)[:, None]
        sharpness = random.uniform(4.0, 7.5)
        centre = random.normal(0.0, 8e-4, 3)
        ball, none = np.array(radius * shares[0]), np.zeros(3)
        body = Bodies(ball[None], forms[None], vertices[None], np.array([sharpness]), none[None], np.zeros((1, 3, 3)))
        u = spread_directions(600)[None]
        if (np.einsum("bvi,bni->bnv", body.vertices, u).max(-1) <= 1e-4).any():
            continue  # the vertices do not surround the centre
        h, point, bend = body.support(u)
        min_radius = np.linalg.eigvalsh(bend + 1.0 * u[..., :, None] * u[..., None, :])[..., 0]
        if min_radius.min() < MIN_RADIUS * h.mean() or np.ptp(h) > 0.45 * h.mean():
            continue
        # for uniform density: second moment of the solid from cones over its surface
        weight = h[0] * np.linalg.det(bend[0] + u[0, :, :, None] * u[0, :, None, :])
        centroid = 0.75 * (weight[:, None] * point[0]).sum(0) / weight.sum()
        com = centroid + centre
        moment = 0.6 * np.einsum("n,ni,nj->ij", weight, point[0], point[0]) / weight.sum() - np.outer(
            centroid, centroid
        )
        moment = moment * random.uniform(0.85, 1.1) + np.outer(centre, centre)
        return ball, forms, vertices, np.array(sharpness), com, np.trace(moment) * np.eye(3) - moment


def spread_directions(count: int) -> FloatArray:
    """(count, 3) unit vectors, evenly spread over the sphere."""
    z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    angle = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(count)
    across = np.sqrt(1.0 - z**2)
    return np.stack([across * np.cos(angle), across * np.sin(angle), z], axis=1)


def random_rotation(random: np.random.Generator, count: int) -> FloatArray:
    """(count, 3, 3) random rotations."""
    R: FloatArray = np.asarray(np.linalg.qr(random.normal(size=(count, 3, 3)))[0], np.float64)
    R *= np.linalg.det(R)[:, None, None]
    return R
