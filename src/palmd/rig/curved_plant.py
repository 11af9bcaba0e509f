"""The emulated object between two moving arcs: the plant's equations with curved palms. Pure.

The formulation again differs from the observer's model, which uses arc lengths and contact tangents: a palm is the
circle through the hinge on which F(w) = ν·w − κ|w|²/2 is zero, w a position relative to the hinge and ν the palm's
normal there. F equals the distance to the circle except for second-order terms, and is regular for κ → 0, where it is
the gap of the flat plant. The body's gap is the minimum of F over its outline, whose point is found by its normal ϑ;
along the motion

    γ̈ = F̈ at that point of the body − (∂Ḟ/∂ϑ)²/(∂²F/∂ϑ²),

where the second term is due to the motion of the point along the outline. A standoff of an arc is applied to the
outline; a bow is a small change of curvature and a slope at the hinge.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple, Unpack

import numpy as np

from palmd.events import FloatArray, PalmMotion
from palmd.rig.plant import (
    _DRIFT_RATE,
    BodyState,
    FrictionSurface,
    Hinge,
    PadPair,
    PalmFrame,
    Plant,
    PlantSettings,
    _Rates,
    closing_forces,
    palm_frame,
)
from palmd.rig.shapes import Body

_STEPS, _BLIND_STEPS = 4, 40  # of Newton's method for the nearest point, from the last one and from anywhere
_LONGEST_STEP = 0.2  # rad
_NEWTON_TOLERANCE = 1e-12  # rad
_PLACEMENT_STEPS, _PLACEMENT_TOLERANCE_M = 40, 1e-13
_NORMALS = 720
_ORIENTATIONS, _LOWEST_RAD = 180, 1e-5
MAX_CURVATURE_RATIO = 0.8
"""Largest κv, palm curvature times the body's radius of curvature, of bodies that are placed on the palms."""
_TWO_CONTACTS_RATIO = 0.95  # of κv, from which on a body could touch a palm twice


class _Nearest(NamedTuple):
    """The body's point that is nearest to one palm.

    c, s: its outward normal (world). w: the point relative to the hinge, y: relative to the COM (m). n: ν − κw, the
    palm's normal there, of length about 1. gap: F (m). v: the outline's radius of curvature there (m).
    """

    c: float
    s: float
    wx: float
    wy: float
    yx: float
    yy: float
    nx: float
    ny: float
    gap: float
    v: float


class _CurvedContact(NamedTuple):
    """One contact: γ̈ = n·a + lever·α + b, and the effect of a unit normal force: (fx, fy) and a torque."""

    nx: float
    ny: float
    lever: float
    b: float
    fx: float
    fy: float
    torque: float


class CurvedPlant(Plant):
    """As `Plant`, on palms of signed `curvatures` (1/m, > 0 concave)."""

    def __init__(
        self, body: Body, hinge: Hinge, surface: FrictionSurface, curvatures: PadPair, **others: Unpack[PlantSettings]
    ) -> None:
        """As `Plant`; raises ValueError for palms so concave that the body would touch one twice."""
        worst = max(curvatures) * max_curvature_radius(body)
        if worst >= _TWO_CONTACTS_RATIO:
            raise ValueError(
                f"the palms are too concave for the body: kappa v is {worst:.2f}, must be below {_TWO_CONTACTS_RATIO}"
            )
        super().__init__(body, hinge, surface, **others)
        self._bowed, self._planes = False, ((0.0, 0.0), (0.0, 0.0))  # bows are part of the arcs
        (one, two), reach = self._pads, self.reach
        self._standoffs = one.standoff, two.standoff
        self._slopes = 4.0 * one.sagitta / reach[0], -4.0 * two.sagitta / reach[1]
        self._kappa = (
            curvatures[0] - 8.0 * one.sagitta / reach[0] ** 2,
            curvatures[1] - 8.0 * two.sagitta / reach[1] ** 2,
        )
        self._theta = [0.0, 0.0]  # last normals at the nearest points, in the body's frame

    # -- placement and state ------------------------------------------------------------------------------

    def place(self, palms: PalmMotion, psi: float, omega0: float = 0.0) -> None:
        frame = self._frame = palm_frame(self.hinge, palms)
        one, two = frame.palms
        self._theta = [one.out - psi, two.out - psi]
        opening = math.atan2(one.ty * two.tx - one.tx * two.ty, -one.tx * two.tx - one.ty * two.ty)
        mean, middle = self.body.support.at(0.0)[0], math.atan2(one.ty, one.tx) + 0.5 * opening
        distance = mean / math.sin(0.5 * opening)
        state = self.state = BodyState(
            frame.ox + distance * math.cos(middle), frame.oy + distance * math.sin(middle), psi
        )
        state.omega0 = omega0
        for _ in range(_PLACEMENT_STEPS):
            gap1, gap2 = (at.gap for at in self._nearest_points(frame, state, _BLIND_STEPS))
            if max(abs(gap1), abs(gap2)) < _PLACEMENT_TOLERANCE_M:
                break
            dx, dy = self._displacement_for_gaps(frame, state, -gap1, -gap2)
            state.x, state.y = state.x + dx, state.y + dy
        rate1, rate2 = self._gap_rates(frame, state)
        state.vx, state.vy = self._displacement_for_gaps(frame, state, -rate1, -rate2)
        self._on = [True, True]
        self.fallen = False
        self._settle_contacts()

    def contact_rates(self) -> tuple[float, float]:
        frame, q = self._frame, self.state
        rates = []
        for palm, at in enumerate(self._nearest_points(frame, q)):
            w = frame.palms[palm].turn
            px, py = q.vx - frame.vox - q.omega0 * at.yy + w * at.wy, q.vy - frame.voy + q.omega0 * at.yx - w * at.wx
            slip = -at.s * px + at.c * py  # ± ṡ = (slip + v(ω − ω0))/(1 − κv)
            rates.append((slip + at.v * (w - q.omega0)) / (1.0 - self._kappa[palm] * at.v))
        return rates[0], -rates[1]

    def radii(self) -> tuple[float, float]:
        self._nearest_points(self._frame, self.state)
        at = self.body.support.at
        return at(self._theta[0])[0], at(self._theta[1])[0]

    # -- geometry -----------------------------------------------------------------------------------------

    def _normal(self, palm: int, frame: PalmFrame) -> tuple[float, float]:
        nx, ny = -frame.palms[palm].ty, frame.palms[palm].tx
        if slope := self._slopes[palm]:
            c, s = math.cos(slope), math.sin(slope)
            return c * nx - s * ny, s * nx + c * ny
        return nx, ny

    def _nearest(self, palm: int, frame: PalmFrame, q: BodyState, steps: int = _STEPS) -> _Nearest:
        """By Newton's method on the stationarity of F along the outline, (ν − κw)·τ = 0."""
        nux, nuy = self._normal(palm, frame)
        kappa, standoff, at = self._kappa[palm], self._standoffs[palm], self.body.support.at
        rx, ry = q.x - frame.ox, q.y - frame.oy
        theta = self._theta[palm]
        for remaining in range(steps, -1, -1):
            c, s = math.cos(theta + q.psi), math.sin(theta + q.psi)
            h, slope, second = at(theta)
            h += standoff
            v = h + second
            yx, yy = h * c - slope * s, h * s + slope * c
            wx, wy = rx + yx, ry + yy
            nx, ny = nux - kappa * wx, nuy - kappa * wy
            step = (ny * c - nx * s) / (nx * c + ny * s + kappa * v)
            if abs(step) < _NEWTON_TOLERANCE or not remaining:
                break
            theta += max(-_LONGEST_STEP, min(_LONGEST_STEP, step))
        self._theta[palm] = theta
        gap = nux * wx + nuy * wy - 0.5 * kappa * (wx * wx + wy * wy)
        return _Nearest(c, s, wx, wy, yx, yy, nx, ny, gap, v)

    def _nearest_points(self, frame: PalmFrame, q: BodyState, steps: int = _STEPS) -> tuple[_Nearest, _Nearest]:
        return self._nearest(0, frame, q, steps), self._nearest(1, frame, q, steps)

    def _distances(self) -> tuple[float, float]:
        """Arc lengths from the hinge, |w| = s sinc(κs/2); negative behind the hinge."""
        one, two = self._nearest_points(self._frame, self.state)
        return self._arc_length(0, one), self._arc_length(1, two)

    def _arc_length(self, palm: int, at: _Nearest) -> float:
        kappa, outwards = self._kappa[palm], 1.0 if palm == 0 else -1.0
        chord, half = math.hypot(at.wx, at.wy), 0.5 * abs(kappa)
        length = chord if half * chord < 1e-9 else math.asin(min(half * chord, 1.0)) / half
        line = self._frame.palms[palm]
        return math.copysign(length, outwards * (line.tx * at.wx + line.ty * at.wy))

    def _gaps(self, frame: PalmFrame, q: BodyState) -> tuple[float, float]:
        one, two = self._nearest_points(frame, q)
        return one.gap, two.gap

    def _displacement_for_gaps(self, frame: PalmFrame, q: BodyState, a: float, b: float) -> tuple[float, float]:
        one, two = self._nearest_points(frame, q)
        det = one.nx * two.ny - one.ny * two.nx
        return (a * two.ny - b * one.ny) / det, (b * one.nx - a * two.nx) / det

    def _levers(self, frame: PalmFrame, q: BodyState) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        one, two = ((at.nx, at.ny, at.yx * at.ny - at.yy * at.nx) for at in self._nearest_points(frame, q))
        return one, two

    def _gap_rates(self, frame: PalmFrame, q: BodyState) -> tuple[float, float]:
        rates = []
        for palm, at in enumerate(self._nearest_points(frame, q)):
            w, (nux, nuy) = frame.palms[palm].turn, self._normal(palm, frame)
            px, py = q.vx - frame.vox - q.omega0 * at.yy, q.vy - frame.voy + q.omega0 * at.yx
            rates.append(at.nx * px + at.ny * py + w * (nux * at.wy - nuy * at.wx))
        return rates[0], rates[1]

    # -- motion -------------------------------------------------------------------------------------------

    def _solve(self, frame: PalmFrame, q: BodyState) -> _Rates:
        rho2 = self.body.rho**2
        damping = -self.surface.damping * q.omega0 / rho2
        contacts = [self._contact_equations(palm, frame, q) if on else None for palm, on in enumerate(self._on)]
        g = self._gravity_now()

        def gap_response(i: int, j: int) -> float:
            row, column = contacts[i], contacts[j]
            if row is None or column is None:
                return float(i == j)
            return row.nx * column.fx + row.ny * column.fy + row.lever * column.torque / rho2

        b1, b2 = (at.b - at.ny * g + at.lever * damping if at else 0.0 for at in contacts)
        f1, f2 = closing_forces(gap_response(0, 0), gap_response(0, 1), gap_response(1, 0), gap_response(1, 1), b1, b2)
        ax, ay, al = 0.0, -g, damping
        for f, contact in zip((f1, f2), contacts, strict=True):
            if contact:
                ax, ay, al = ax + f * contact.fx, ay + f * contact.fy, al + f * contact.torque / rho2
        return ax, ay, al, f1, f2

    def _contact_equations(self, palm: int, frame: PalmFrame, q: BodyState) -> _CurvedContact:
        vx, vy, w = q.vx, q.vy, q.omega0
        at, (nux, nuy) = self._nearest(palm, frame, q), self._normal(palm, frame)
        wi, al = frame.palms[palm].turn, frame.palms[palm].alpha
        kappa, standoff = self._kappa[palm], self._standoffs[palm]
        c, s, nx, ny = at.c, at.s, at.nx, at.ny
        px, py = vx - frame.vox - w * at.yy, vy - frame.voy + w * at.yx  # of the body's point
        rate_x, rate_y = -wi * nuy, wi * nux  # of ν
        b = (
            (-al * nuy - wi * wi * nux) * at.wx + (al * nux - wi * wi * nuy) * at.wy
            + 2.0 * (rate_x * px + rate_y * py) - kappa * (px * px + py * py)
            - nx * (frame.aox + w * w * at.yx) - ny * (frame.aoy + w * w * at.yy)
        )  # fmt: skip
        length = -(nx * c + ny * s)
        tangential = (rate_y - kappa * py) * c - (rate_x - kappa * px) * s + w * length
        b -= at.v * tangential * tangential / (length - kappa * at.v)
        rate = nx * px + ny * py + rate_x * at.wx + rate_y * at.wy
        b += _DRIFT_RATE * (2.0 * rate + _DRIFT_RATE * at.gap)
        # friction acts at the body's own point, which is nearer to its COM by the standoff
        yx, yy, wx, wy = at.yx - standoff * c, at.yy - standoff * s, at.wx - standoff * c, at.wy - standoff * s
        slip = -s * (vx - frame.vox - w * yy + wi * wy) + c * (vy - frame.voy + w * yx - wi * wx)
        k = self._frictions[palm] * self._friction(slip)
        fx, fy = -c + k * s, -s - k * c
        return _CurvedContact(nx, ny, at.yx * ny - at.yy * nx, b, fx, fy, yx * fy - yy * fx)


def max_curvature_radius(body: Body) -> float:
    """The largest radius of curvature of a body's outline (m); concave palms must have a larger one."""
    at = body.support.at
    values = (at(math.tau * i / _NORMALS) for i in range(_NORMALS))
    return max(h + second for h, _, second in values)


def stable_on_arcs(body: Body, palms: PalmMotion, curvatures: PadPair) -> list[float]:
    """The angles ψ in [0, 2π) at which the COM's height has a local minimum (rad), the lowest first."""
    plant = CurvedPlant(body, Hinge("fixed", base=(0.0, 0.0)), FrictionSurface(), curvatures)

    def height(psi: float) -> float:
        plant.place(palms, psi)
        return plant.state.y

    psi: FloatArray = np.linspace(0.0, math.tau, _ORIENTATIONS, endpoint=False)
    heights = np.array([height(float(each)) for each in psi])
    lowest = np.flatnonzero((heights < np.roll(heights, 1)) & (heights <= np.roll(heights, -1)))
    step = math.tau / _ORIENTATIONS
    return [_lowest(height, float(psi[i]) - step, float(psi[i]) + step) for i in lowest[np.argsort(heights[lowest])]]


def _lowest(height: Callable[[float], float], low: float, high: float) -> float:
    """The height's minimum by golden section, to `_LOWEST_RAD`."""
    golden = (math.sqrt(5.0) - 1.0) / 2.0
    while high - low > _LOWEST_RAD:
        a, b = high - golden * (high - low), low + golden * (high - low)
        low, high = (low, b) if height(a) < height(b) else (a, high)
    return (0.5 * (low + high)) % math.tau
