"""What a smoother has claimed of a body in a pivoting gripper, ready to be asked; and where the gripper is. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from palmd.events import FloatArray, PalmSample
from palmd.model import shape
from palmd.model.friction import mean_direction
from palmd.model.pivot import KINK, ORDER, P
from palmd.system.pivot import PivotAnswer, PivotRig, normal_of

GAP_S = 0.15  # without a reading, after which the body may have been turned
LEAST_FELT = 3  # readings that what is felt is the mean of
STEADY = 0.15  # share of a reported position that corrects the planned way
GATE = 16.0
LEAST_LEVER_M = 1e-3  # nearer to the dead centre the height tells nothing of the orientation
STEPS, CLOSE_M = 6, 1e-9
APART = 9.0  # by how much (squared sigmas) the best place on the outline must beat the others
MANY = 360
WALK_M = 2e-4
MOST_GRIP = 0.97  # of what friction can be, up to which it tells the slip
LEAST_FRICTION = 1e-4  # coefficient, below which there is none


class Gripper:
    """Where the pivot is: reported positions along the planned way; a slide's height goes by no plan."""

    def __init__(self, sample: PalmSample, *, slides: bool) -> None:
        self._t, self._place, self._slides = sample.t_sample, sample.angles, slides
        self._plan(sample)

    def take(self, sample: PalmSample) -> None:
        """A report."""
        ahead = self.at(sample.t_sample)
        along = 1.0 if sample.rates is None else STEADY
        gains = (along, 1.0 if self._slides else along)
        places = zip(gains, ahead, sample.angles, strict=True)
        self._place = tuple(p + gain * (m - p) for gain, (p, _, _), m in places)
        self._t = sample.t_sample
        self._plan(sample)

    def _plan(self, sample: PalmSample) -> None:
        (vx, vz), (ax, az) = sample.rates or (0.0, 0.0), sample.accelerations or (0.0, 0.0)
        self._rates, self._accelerations = ((vx, 0.0), (ax, 0.0)) if self._slides else ((vx, vz), (ax, az))

    def at(self, t: float) -> tuple[tuple[float, float, float], ...]:
        """(place, velocity, acceleration) along x and z."""
        dt = min(max(t - self._t, -GAP_S), GAP_S)
        each = zip(self._place, self._rates, self._accelerations, strict=True)
        return tuple((p + v * dt + 0.5 * a * dt * dt, v + a * dt, a) for p, v, a in each)

    def sd(self, noise: float) -> float:
        """One-sigma of the place (m)."""
        return noise if self._slides else noise * math.sqrt(STEADY / (2.0 - STEADY))


class OutlinePoint:
    """The outline at one orientation: lever e, second derivative of h_P, one-sigmas of h_P and e."""

    __slots__ = ("e", "e_sd", "h", "h2", "h_sd")

    def __init__(self, body: AcceptedOutline, psi: float) -> None:
        rows = _rows(float(normal_of(np.array(psi))))
        self.h, self.e, self.h2 = (float(row @ body.a) for row in rows)
        self.e_sd = math.sqrt(max(float(rows[1] @ body.a_covariance @ rows[1]), 0.0))
        place = float(normal_of(np.array(psi))) / math.tau * MANY % MANY
        self.h_sd = float(body.answer.h_sd[int(place) % MANY])


_K = np.arange(1, ORDER + 1)


def _rows(theta: float) -> FloatArray:
    """(3, 2·ORDER + 1): what maps coefficients to h, h′, h″ at one normal."""
    rows = np.zeros((3, 2 * ORDER + 1))
    cos, sin = np.cos(_K * theta), np.sin(_K * theta)
    rows[0, 0] = 1.0
    rows[0, 1::2], rows[0, 2::2] = cos, sin
    rows[1, 1::2], rows[1, 2::2] = -_K * sin, _K * cos
    rows[2, 1::2], rows[2, 2::2] = -(_K**2) * cos, -(_K**2) * sin
    return rows


def friction_of(p: FloatArray, covariance: FloatArray) -> tuple[float, float]:
    """μ and its one-sigma, from an answer's constants and their covariance."""
    drag, bend = float(p[P.DRAG]), float(p[P.SATURATION])
    wanted = np.array([1 / math.sqrt(bend), -0.5 * drag / bend**1.5])
    at = [P.DRAG, P.SATURATION]
    return drag / math.sqrt(bend), math.sqrt(max(float(wanted @ covariance[np.ix_(at, at)] @ wanted), 0.0))


class AcceptedOutline:
    """An answer, ready to be asked."""

    def __init__(self, answer: PivotAnswer, rig: PivotRig) -> None:
        self._rig = rig
        p, covariance = answer.p, answer.covariance
        self.answer = answer
        self.a, self.a_covariance = p[P.SHAPE :], covariance[P.SHAPE :, P.SHAPE :]
        self.theta: FloatArray = np.arange(MANY, dtype=np.float64) * (math.tau / MANY)
        self.h: FloatArray = shape.basis(self.theta, ORDER) @ self.a
        self._slope: FloatArray = -shape.tangential_basis(self.theta, ORDER) @ self.a
        self._p, self._averaged = p, rig.vibration.law == "averaged"
        self.mu = friction_of(p, covariance)
        self._friction = max(self.mu[0], LEAST_FRICTION)
        moment = p[P.MOMENT : P.MOMENT + 2]
        size = float(np.hypot(*moment))
        part = covariance[P.MOMENT : P.MOMENT + 2, P.MOMENT : P.MOMENT + 2]
        self.moment = size, math.sqrt(max(float(moment @ part @ moment), 0.0)) / max(size, 1e-30)
        told = self.moment[1] / max(size, 1e-30)  # of the force, by the moment; under a slide by the weight
        if rig.vertical == "float":
            told = math.sqrt(max(float(covariance[P.MASS, P.MASS]), 0.0)) / (float(p[P.MASS]) + rig.carriage_mass)
        self.force_share = math.hypot(told, 0.02)

    def at(self, psi: float) -> OutlinePoint:
        """At an orientation (rad)."""
        return OutlinePoint(self, psi)

    def height(self, x: float, z: float) -> float:
        """h_P when the pivot is believed at x and z (m)."""
        return z - float(self._p[P.STANDOFF] + self._p[P.SLOPE] * x)

    def reading(self, x: float, vx: float, e: float, h2: float, omega0: float) -> float:
        """What the pad reads then (m)."""
        zero, scale, lag = (float(self._p[i]) for i in (P.ZERO, P.SCALE, P.LAG))
        return zero + (1 + scale) * (x + e - lag * (vx - h2 * omega0))

    def orientation(self, psi: float, x: float, z: float) -> float | None:
        """The orientation near `psi` at which the body touches with the pivot at x, z; None beyond a dead centre."""
        wanted, began = self.height(x, z), psi
        side = 0.0
        for _ in range(STEPS):
            h, e, _ = (float(row @ self.a) for row in _rows(float(normal_of(np.array(psi)))))
            side = side or math.copysign(1.0, e)
            if abs(e) < 0.2 * LEAST_LEVER_M or e * side < 0.0:
                return None
            step = (h - wanted) / e  # dh/dψ = −e
            psi += step
            if abs(h - wanted) < CLOSE_M:
                break
        return psi if abs(psi - began) < 0.5 else None

    def walked(self, psi: float, x: float, z: float) -> float | None:
        """As `orientation`, from farther away: along the outline, in small steps of the height."""
        wanted, begin = self.height(x, z), float(_rows(float(normal_of(np.array(psi))))[0] @ self.a)
        here: float | None = psi
        count = math.ceil(abs(wanted - begin) / WALK_M)
        for k in range(1, count + 1):
            here = None if here is None else self.orientation(here, x, z - (wanted - begin) * (1.0 - k / count))
        return here

    def found(self, x: float, z: float, s: Sequence[float], near: float = 0.0) -> float | None:
        """The orientation at which z and the pad's readings are explained, where that is beyond doubt; else None."""
        if len(s) < LEAST_FELT:
            return None
        wanted, e = self.height(x, z), float(np.mean(s)) - x - float(self._p[P.ZERO])
        off = self.h - wanted
        cross = np.flatnonzero(np.sign(off) != np.sign(np.roll(off, -1)))
        variance = self._rig.pad.reading_variance / len(s) + (3e-4) ** 2  # the body moves while it is found
        places = []
        for i in cross.tolist():
            share = off[i] / (off[i] - off[(i + 1) % MANY])
            slope = self._slope[i] + share * (self._slope[(i + 1) % MANY] - self._slope[i])
            spread = variance + self.answer.h_sd[i] ** 2 * 4
            places.append(((slope - e) ** 2 / spread, self.theta[i] + share * math.tau / MANY))
        places.sort()
        if not places or places[0][0] > GATE or (len(places) > 1 and places[1][0] < places[0][0] + APART):
            return None
        psi = -0.5 * math.pi - places[0][1]
        return near + math.remainder(psi - near, math.tau)

    def force(
        self, at: OutlinePoint, psi: float, omega0: float, alpha0: float, along: tuple[float, float, float], az: float
    ) -> float:
        """What the pad must give (N), as `model.pivot` has it of a rigid gripper."""
        _, vx, ax = along
        ahead, behind = at.e + self._friction * at.h, at.e - self._friction * at.h
        lever = at.e - self._friction * self._effective(self._direction(vx + at.h * omega0), ahead, behind) * at.h
        return self.resisting(psi, omega0, alpha0, ax, az) / lever if abs(lever) > 1e-6 else math.nan

    def slide_force(self, at: OutlinePoint, psi: float, omega0: float) -> float:
        """The same under a slide, where the body turns evenly."""
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
        """The slip (m/s) at which friction is such a share of a slide's force, or nearly all that it can be."""
        dither = float(self._p[P.SATURATION]) ** -0.5
        wanted = min(max(grip / self._friction, -MOST_GRIP), MOST_GRIP)
        if self._averaged:
            return float(dither * wanted / math.sqrt(1.0 - wanted * wanted))
        forward, backward = (self._slide_force_of(at, psi, omega0, sign, ax) for sign in (1.0, -1.0))
        # of the normal force, the share pushed while the body slips backward; λ blends that with a steady force
        ratio = backward / forward if forward > 0.0 and backward > 0.0 else 1.0
        ratio **= float(self._p[P.TRANSMISSION])
        ahead = ratio * (1.0 + wanted)
        sigma = 2.0 * ahead / (1.0 - wanted + ahead) - 1.0
        return float(2.0 / math.pi * dither * math.sin(math.pi / 2 * sigma))

    def _slide_force_of(self, at: OutlinePoint, psi: float, omega0: float, sign: float, ax: float) -> float:
        """The force (N) while the body on a slide slips one way and turns as it must."""
        p, rig, xi_x = self._p, self._rig, self._xi(psi)[0]
        lever = at.e - sign * self._friction * at.h
        still = self.slide_force(at, psi, omega0)
        by_turning = xi_x - at.e * (float(p[P.MASS]) + rig.carriage_mass)
        resisting = self.resisting(psi, omega0, 0.0, ax, at.h2 * omega0**2)
        alpha = (resisting - still * lever) / (by_turning * lever - float(p[P.INERTIA]) + at.e * xi_x)
        return still + by_turning * alpha

    def resisting(self, psi: float, omega0: float, alpha0: float, ax: float, az: float) -> float:
        """Torque about the pivot that the pad must give (N m)."""
        p, (xi_x, xi_y) = self._p, self._xi(psi)
        turning = float(p[P.INERTIA]) * alpha0 + float(p[P.DAMPING]) * omega0
        return turning + xi_x * (self._rig.gravity + az) - xi_y * ax

    def _xi(self, psi: float) -> tuple[float, float]:
        mx, my = float(self._p[P.MOMENT]), float(self._p[P.MOMENT + 1])
        cos, sin = math.cos(psi), math.sin(psi)
        return cos * mx - sin * my, sin * mx + cos * my
