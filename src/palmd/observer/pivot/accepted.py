"""An accepted estimate of a body in a pivoting gripper, prepared for queries; and the gripper's position. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from palmd.events import FloatArray, PalmSample
from palmd.model import shape
from palmd.model.friction import mean_direction
from palmd.model.pivot import KINK, ORDER, P
from palmd.system.pivot import PivotAnswer, PivotRig, normal_of

GAP_S = 0.15  # gap in the readings after which the body may have been turned
LEAST_RECENT = 3  # least number of readings in a mean
REPORT_GAIN = 0.15  # gain with which reported positions correct the planned motion
GATE = 16.0  # gate of a squared normalised innovation
LEAST_LEVER_M = 1e-3  # lever e below which the height does not determine the orientation
STEPS, HEIGHT_TOLERANCE_M = 6, 1e-9  # Newton iterations and their tolerance
UNIQUE_CHI2 = 9.0  # least χ² margin of the best position on the outline over all others
NORMALS = 360  # normals of the outline
HEIGHT_STEP_M = 2e-4  # height step of `orientation_by_steps`
MOST_FRICTION_SHARE = 0.97  # largest share of the friction limit from which slip is computed
LEAST_FRICTION = 1e-4  # least friction coefficient


class Gripper:
    """Position of the pivot: the planned motion corrected by reports; a slide's height follows no plan."""

    def __init__(self, sample: PalmSample, *, slides: bool) -> None:
        self._t, self._place, self._slides = sample.t_sample, sample.angles, slides
        self._plan(sample)

    def take(self, sample: PalmSample) -> None:
        """Take a report."""
        ahead = self.at(sample.t_sample)
        along = 1.0 if sample.rates is None else REPORT_GAIN
        gains = (along, 1.0 if self._slides else along)
        places = zip(gains, ahead, sample.angles, strict=True)
        self._place = tuple(p + gain * (m - p) for gain, (p, _, _), m in places)
        self._t = sample.t_sample
        self._plan(sample)

    def _plan(self, sample: PalmSample) -> None:
        (vx, vz), (ax, az) = sample.rates or (0.0, 0.0), sample.accelerations or (0.0, 0.0)
        self._rates, self._accelerations = ((vx, 0.0), (ax, 0.0)) if self._slides else ((vx, vz), (ax, az))

    def at(self, t: float) -> tuple[tuple[float, float, float], ...]:
        """(position, velocity, acceleration) along x and along z at `t` (s)."""
        dt = min(max(t - self._t, -GAP_S), GAP_S)
        each = zip(self._place, self._rates, self._accelerations, strict=True)
        return tuple((p + v * dt + 0.5 * a * dt * dt, v + a * dt, a) for p, v, a in each)

    def sd(self, noise: float) -> float:
        """1σ of the position (m) for this noise of a report."""
        return noise if self._slides else noise * math.sqrt(REPORT_GAIN / (2.0 - REPORT_GAIN))


class OutlinePoint:
    """The outline at one orientation: h_P, lever e = h_P′, second derivative h2, 1σ of h_P and e."""

    __slots__ = ("e", "e_sd", "h", "h2", "h_sd")

    def __init__(self, body: AcceptedOutline, psi: float) -> None:
        rows = _rows(float(normal_of(np.array(psi))))
        self.h, self.e, self.h2 = (float(row @ body.a) for row in rows)
        self.e_sd = math.sqrt(max(float(rows[1] @ body.a_covariance @ rows[1]), 0.0))
        place = float(normal_of(np.array(psi))) / math.tau * NORMALS % NORMALS
        self.h_sd = float(body.answer.h_sd[int(place) % NORMALS])


_K = np.arange(1, ORDER + 1)


def _rows(theta: float) -> FloatArray:
    """(3, 2·ORDER + 1) rows that map coefficients to h, h′, h″ at one normal (rad)."""
    rows = np.zeros((3, 2 * ORDER + 1))
    cos, sin = np.cos(_K * theta), np.sin(_K * theta)
    rows[0, 0] = 1.0
    rows[0, 1::2], rows[0, 2::2] = cos, sin
    rows[1, 1::2], rows[1, 2::2] = -_K * sin, _K * cos
    rows[2, 1::2], rows[2, 2::2] = -(_K**2) * cos, -(_K**2) * sin
    return rows


def friction_of(p: FloatArray, covariance: FloatArray) -> tuple[float, float]:
    """μ and its 1σ from an answer's constants and their covariance."""
    drag, bend = float(p[P.DRAG]), float(p[P.SATURATION])
    gradient = np.array([1 / math.sqrt(bend), -0.5 * drag / bend**1.5])
    at = [P.DRAG, P.SATURATION]
    return drag / math.sqrt(bend), math.sqrt(max(float(gradient @ covariance[np.ix_(at, at)] @ gradient), 0.0))


class AcceptedOutline:
    """An accepted answer, prepared for queries."""

    def __init__(self, answer: PivotAnswer, rig: PivotRig) -> None:
        self._rig = rig
        p, covariance = answer.p, answer.covariance
        self.answer = answer
        self.a, self.a_covariance = p[P.SHAPE :], covariance[P.SHAPE :, P.SHAPE :]
        self.theta: FloatArray = np.arange(NORMALS, dtype=np.float64) * (math.tau / NORMALS)
        self.h: FloatArray = shape.basis(self.theta, ORDER) @ self.a
        self._slope: FloatArray = -shape.tangential_basis(self.theta, ORDER) @ self.a
        self._p, self._averaged = p, rig.vibration.law == "averaged"
        self.mu = friction_of(p, covariance)
        self._friction = max(self.mu[0], LEAST_FRICTION)
        moment = p[P.MOMENT : P.MOMENT + 2]
        size = float(np.hypot(*moment))
        moment_covariance = covariance[P.MOMENT : P.MOMENT + 2, P.MOMENT : P.MOMENT + 2]
        self.moment = size, math.sqrt(max(float(moment @ moment_covariance @ moment), 0.0)) / max(size, 1e-30)
        # relative 1σ of the force: from that of the moment, or under a slide from that of the weight
        relative_sd = self.moment[1] / max(size, 1e-30)
        if rig.vertical == "float":
            relative_sd = math.sqrt(max(float(covariance[P.MASS, P.MASS]), 0.0)) / (
                float(p[P.MASS]) + rig.carriage_mass
            )
        self.force_share = math.hypot(relative_sd, 0.02)

    def at(self, psi: float) -> OutlinePoint:
        """The outline at an orientation (rad)."""
        return OutlinePoint(self, psi)

    def height(self, x: float, z: float) -> float:
        """h_P with the pivot at x and z (m)."""
        return z - float(self._p[P.STANDOFF] + self._p[P.SLOPE] * x)

    def reading(self, x: float, vx: float, e: float, h2: float, omega0: float) -> float:
        """Predicted reading of the pad (m)."""
        zero, scale, lag = (float(self._p[i]) for i in (P.ZERO, P.SCALE, P.LAG))
        return zero + (1 + scale) * (x + e - lag * (vx - h2 * omega0))

    def orientation(self, psi: float, x: float, z: float) -> float | None:
        """Orientation near `psi` at which the body touches the pad, with the pivot at x, z; None past a dead centre."""
        target, initial = self.height(x, z), psi
        side = 0.0
        for _ in range(STEPS):
            h, e, _ = (float(row @ self.a) for row in _rows(float(normal_of(np.array(psi)))))
            side = side or math.copysign(1.0, e)
            if abs(e) < 0.2 * LEAST_LEVER_M or e * side < 0.0:
                return None
            step = (h - target) / e  # dh/dψ = −e
            psi += step
            if abs(h - target) < HEIGHT_TOLERANCE_M:
                break
        return psi if abs(psi - initial) < 0.5 else None

    def orientation_by_steps(self, psi: float, x: float, z: float) -> float | None:
        """As `orientation`, but from farther away: follows the outline in small steps of the height."""
        target, begin = self.height(x, z), float(_rows(float(normal_of(np.array(psi))))[0] @ self.a)
        here: float | None = psi
        count = math.ceil(abs(target - begin) / HEIGHT_STEP_M)
        for k in range(1, count + 1):
            here = None if here is None else self.orientation(here, x, z - (target - begin) * (1.0 - k / count))
        return here

    def locate(self, x: float, z: float, s: Sequence[float], near: float = 0.0) -> float | None:
        """Orientation that explains z and the pad's readings `s`, if it is unambiguous; else None.

        near: orientation (rad) within half a turn of which it is returned.
        """
        if len(s) < LEAST_RECENT:
            return None
        target, e = self.height(x, z), float(np.mean(s)) - x - float(self._p[P.ZERO])
        difference = self.h - target
        cross = np.flatnonzero(np.sign(difference) != np.sign(np.roll(difference, -1)))
        variance = self._rig.pad.reading_variance / len(s) + (3e-4) ** 2  # the body moves meanwhile
        places = []
        for i in cross.tolist():
            share = difference[i] / (difference[i] - difference[(i + 1) % NORMALS])
            slope = self._slope[i] + share * (self._slope[(i + 1) % NORMALS] - self._slope[i])
            spread = variance + self.answer.h_sd[i] ** 2 * 4
            places.append(((slope - e) ** 2 / spread, self.theta[i] + share * math.tau / NORMALS))
        places.sort()
        if not places or places[0][0] > GATE or (len(places) > 1 and places[1][0] < places[0][0] + UNIQUE_CHI2):
            return None
        psi = -0.5 * math.pi - places[0][1]
        return near + math.remainder(psi - near, math.tau)

    def force(
        self, at: OutlinePoint, psi: float, omega0: float, alpha0: float, along: tuple[float, float, float], az: float
    ) -> float:
        """Normal force (N) of a rigid gripper, as in `model.pivot`."""
        _, vx, ax = along
        ahead, behind = at.e + self._friction * at.h, at.e - self._friction * at.h
        lever = at.e - self._friction * self._effective(self._direction(vx + at.h * omega0), ahead, behind) * at.h
        return self.resisting(psi, omega0, alpha0, ax, az) / lever if abs(lever) > 1e-6 else math.nan

    def slide_force(self, at: OutlinePoint, psi: float, omega0: float) -> float:
        """Normal force (N) under a slide, for zero angular acceleration."""
        rig = self._rig
        weight = (float(self._p[P.MASS]) + rig.carriage_mass) * (rig.gravity + at.h2 * omega0**2)
        return weight - rig.carriage_damping * at.e * omega0 - self._xi(psi)[1] * omega0**2

    def _direction(self, slip: float) -> float:
        """σ of a slip (m/s), as in `model.pivot`."""
        ratio = slip * math.sqrt(float(self._p[P.SATURATION]))
        return (
            ratio / math.hypot(1.0, ratio) if self._averaged else float(mean_direction(math.pi / 2 * ratio, np, KINK))
        )

    def _effective(self, sigma: float, forward: float, backward: float) -> float:
        if self._averaged:
            return sigma
        ahead, behind = (1.0 + sigma) * forward, (1.0 - sigma) * backward
        return sigma + float(self._p[P.TRANSMISSION]) * ((ahead - behind) / (ahead + behind) - sigma)

    def slip(self, at: OutlinePoint, psi: float, omega0: float, grip: float, ax: float) -> float:
        """Slip (m/s) at which friction over normal force is `grip` under a slide; `grip` is limited."""
        dither = float(self._p[P.SATURATION]) ** -0.5
        share = min(max(grip / self._friction, -MOST_FRICTION_SHARE), MOST_FRICTION_SHARE)
        if self._averaged:
            return float(dither * share / math.sqrt(1.0 - share * share))
        forward, backward = (self._slide_force_of(at, psi, omega0, sign, ax) for sign in (1.0, -1.0))
        # ratio of the normal forces while slipping backward and forward; λ interpolates to a steady force
        ratio = backward / forward if forward > 0.0 and backward > 0.0 else 1.0
        ratio **= float(self._p[P.TRANSMISSION])
        ahead = ratio * (1.0 + share)
        sigma = 2.0 * ahead / (1.0 - share + ahead) - 1.0
        return float(2.0 / math.pi * dither * math.sin(math.pi / 2 * sigma))

    def _slide_force_of(self, at: OutlinePoint, psi: float, omega0: float, sign: float, ax: float) -> float:
        """Normal force (N) under a slide while the body slips in the direction `sign`, without residual torque."""
        p, rig, xi_x = self._p, self._rig, self._xi(psi)[0]
        lever = at.e - sign * self._friction * at.h
        still = self.slide_force(at, psi, omega0)
        by_turning = xi_x - at.e * (float(p[P.MASS]) + rig.carriage_mass)
        resisting = self.resisting(psi, omega0, 0.0, ax, at.h2 * omega0**2)
        alpha = (resisting - still * lever) / (by_turning * lever - float(p[P.INERTIA]) + at.e * xi_x)
        return still + by_turning * alpha

    def resisting(self, psi: float, omega0: float, alpha0: float, ax: float, az: float) -> float:
        """Torque about the pivot that the pad must exert (N m)."""
        p, (xi_x, xi_y) = self._p, self._xi(psi)
        turning = float(p[P.INERTIA]) * alpha0 + float(p[P.DAMPING]) * omega0
        return turning + xi_x * (self._rig.gravity + az) - xi_y * ax

    def _xi(self, psi: float) -> tuple[float, float]:
        mx, my = float(self._p[P.MOMENT]), float(self._p[P.MOMENT + 1])
        cos, sin = math.cos(psi), math.sin(psi)
        return cos * mx - sin * my, sin * mx + cos * my
