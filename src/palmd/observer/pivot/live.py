"""The live observer of a pivoting grasp: where the body is at this instant, by an outline that a smoother has told.

The smoother sees all readings at once, takes its time and says what the body is. The loop goes by that at once and
without dynamics: a rigid gripper's height z = h_P(θ) gives the orientation, its rate ω0 = −ż/e, and e = h_P′(θ) is what
the pad must read, so that every reading checks what is claimed.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from palmd.events import Event, FloatArray, PadLift, PadSample, PalmSample, ShapeEstimate
from palmd.model import shape
from palmd.model.pivot import ORDER, P
from palmd.system.pivot import PivotAnswer, PivotEstimate, PivotRig, Touching, normal_of

NAME = "pivot"
GAP_S = 0.15  # without a reading, after which the body may have been turned
FELT_S, LEAST_FELT = 0.06, 3  # of readings that what is felt is the mean of
STEADY = 0.15  # share of a reported position that corrects the planned way
NIS_S, NIS_MOST, NIS_BEGIN = 0.5, 3.0, 1.0
GATE = 16.0
LAG_SD_S, RATE_SD_M_S = 4e-3, 1e-4  # of how late the arm does what is planned, and of how even it runs
KNOWN_M = 1e-4  # one-sigma of the outline at the contact, above which the orientation is not claimed
LEAST_LEVER_M = 1e-3  # nearer to the dead centre the height tells nothing of the orientation
STEPS, CLOSE_M = 6, 1e-9
APART = 9.0  # by how much (squared sigmas) the best place on the outline must beat the others
MANY = 360
WALK_M = 2e-4


class PivotSmoothing(Protocol):
    """Where the smoother runs; nothing here keeps the loop waiting."""

    def submit(self, t: float, events: Sequence[Event]) -> None:
        """Hand the events of a tick over."""

    def collect(self, t: float) -> PivotAnswer | None:
        """The newest answer that has come by `t` (s), each once."""


class PivotObserver:
    """See the module and `observer.observer.LiveObserver`. Safe in the loop."""

    def __init__(self, rig: PivotRig, smoothing: PivotSmoothing) -> None:
        """`smoothing` tells the outline; without its answers nothing is claimed but what is measured."""
        self.name, self.backend = NAME, "numpy"
        self.object_count, self.late_dropped, self.improvements = 1, 0, 0
        self._rig, self._smoothing = rig, smoothing
        self._waiting: list[Event] = []
        self._t_newest = -math.inf
        self._answer: PivotAnswer | None = None
        self._reason = "nothing is known of the outline yet"
        self._body: _Outline | None = None
        self._gripper: _Gripper | None = None
        self._felt: deque[PadSample] = deque()
        self._touching = False
        self._psi: float | None = None
        self._nis = NIS_BEGIN
        self._t_touched = math.inf  # since when it is

    def warm_up(self) -> None:
        """There is nothing to warm up."""

    def feed(self, event: Event) -> None:
        """Take one event; one that is older than `GAP_S` before the newest is counted and dropped."""
        t = event.t_sample
        if not math.isfinite(t) or t < self._t_newest - GAP_S:
            self.late_dropped += 1
            return
        self._t_newest = max(self._t_newest, t)
        self._waiting.append(event)
        if isinstance(event, PalmSample):
            if self._gripper is None:
                self._gripper = _Gripper(event)
            else:
                self._gripper.take(event)
        elif isinstance(event, PadLift):
            self._lift()
        else:
            if self._felt and t - self._felt[-1].t_sample > GAP_S:
                self._lift()
            self._feel(event)

    def improve(self, t: float) -> PivotAnswer | None:
        """Exchange with the smoother beside the loop; what it has answered, each answer once."""
        events, self._waiting = self._waiting, []
        self._smoothing.submit(t, events)
        answer = self._smoothing.collect(t)
        if answer is not None:
            self.improvements += 1
            self._take(answer)
        return answer

    def estimate(self, t: float) -> PivotEstimate:
        """The answer for time `t`; never raises, NaN where nothing is known."""
        nan = math.nan
        x, z, sd, e, force, side = nan, nan, {}, nan, nan, 0
        touched = 0.0 if self._answer is None else float(self._answer.touched.mean()) if self._answer.claimed else 0.0
        if self._felt and t - self._felt[-1].t_sample > GAP_S:
            self._lift()
        if self._gripper is not None:
            (x, vx, _), (z, vz, az) = self._gripper.at(t)
            noise = self._gripper.sd(self._rig.arm_noise)
            sd = {"x": math.hypot(noise, LAG_SD_S * vx), "z": math.hypot(noise, LAG_SD_S * vz)}
            if self._touching and self._felt:
                e = self._felt[-1].s - x
                side = int(math.copysign(1.0, e))
        measured = {"x": x, "z": z, "s": x + e, "e": e, "side": side, "touched": touched, "nis": self._nis}
        unknown = {"psi": nan, "omega0": nan, "f": nan, "mu": nan, "moment": nan}
        body, reason = self._body, self._doubt()
        if body is not None:
            unknown["mu"], sd["mu"] = body.mu
            unknown["moment"], sd["moment"] = body.moment
        if body is None or self._psi is None or reason:
            return self._said(t, measured | unknown, sd, reason or "nothing touches the pad", valid=False)
        psi = body.orientation(self._psi, x, z)
        if psi is None:
            return self._said(t, measured | unknown, sd, _DEAD, valid=False)
        self._psi = psi
        at = body.at(psi)
        if abs(at.e) < LEAST_LEVER_M:
            return self._said(t, measured | unknown, sd, _DEAD, valid=False)
        omega0 = -vz / at.e
        alpha0 = (at.h2 * omega0**2 - az) / at.e
        force = body.force(at, psi, omega0, alpha0, (x, vx, self._gripper.ax if self._gripper else 0.0), az)
        h_sd = math.hypot(at.h_sd, sd["z"])
        e_sd = math.hypot(at.e_sd, at.h2 / at.e * h_sd)  # de = h″ dθ, and dθ = dz/e
        sd |= {
            "e": e_sd,
            "s": math.hypot(e_sd, sd["x"]),
            "psi": h_sd / abs(at.e),
            "omega0": math.hypot(omega0 * e_sd, LAG_SD_S * az, RATE_SD_M_S) / abs(at.e),
            "f": math.hypot(body.force_share, e_sd / abs(at.e)) * abs(force),
        }
        values = measured | unknown | {"e": at.e, "s": x + at.e, "psi": psi, "omega0": omega0, "f": force}
        why = "" if at.h_sd < KNOWN_M else "the outline has not been felt here yet"
        return self._said(t, values, sd, why, valid=not why)

    def shape(self, t: float) -> ShapeEstimate | None:
        """The outline about the pivot, None while none is claimed."""
        body = self._body
        if body is None:
            return None
        return ShapeEstimate(t, body.theta, body.h, body.answer.h_sd, body.answer.touched > 0)

    @property
    def foresees(self) -> bool:
        """Whether the gripper's place is known."""
        return self._gripper is not None

    def outlook(self, t: float) -> Touching | None:
        """What a gripper that drags must go by."""
        if self._gripper is None:
            return None
        (x, _, _), (z, _, _) = self._gripper.at(t)
        e = force = math.nan
        if self._touching and len(self._felt) >= LEAST_FELT:
            e = float(np.mean([each.s for each in self._felt])) - x
            forces = [each.force for each in self._felt if each.force is not None]
            force = float(np.mean(forces)) if forces else math.nan
        band = touched = math.nan
        if self._body is not None:
            felt = self._body.answer.touched > 0
            band = float(np.sqrt(np.mean(self._body.answer.h_sd[felt] ** 2))) if felt.any() else math.nan
            touched = float(felt.mean())
        return Touching(t, x, z, e, force, self._touching, touched, band)

    def identify(self, t: float) -> None:
        """No outlines are stored of pivoting bodies."""
        del t

    # ---- its parts ---------------------------------------------------------------------------------------

    def _said(
        self, t: float, values: Mapping[str, Any], sd: dict[str, float], reason: str, *, valid: bool
    ) -> PivotEstimate:
        count = self.object_count
        return PivotEstimate(t=t, valid=valid, observer=NAME, object_count=count, reason=reason, sd=sd, **values)

    def _doubt(self) -> str:
        """Why what is believed of the body is not to be believed now; empty when it is."""
        if self._body is None:
            return self._reason
        if not self._touching:
            return "nothing touches the pad"
        if self._psi is None:
            return "it is not known which way the body was put down"
        return "" if self._nis < NIS_MOST else "the readings contradict the outline that was claimed"

    def _lift(self) -> None:
        self._felt.clear()
        self._touching = False
        self._psi = None
        self._nis = NIS_BEGIN

    def _feel(self, sample: PadSample) -> None:
        t, gripper, body = sample.t_sample, self._gripper, self._body
        step = t - self._felt[-1].t_sample if self._felt else 0.0
        if not self._felt:
            self._t_touched = t
        self._felt.append(sample)
        while self._felt[0].t_sample < t - FELT_S:
            self._felt.popleft()
        self._touching = True
        if gripper is None or body is None:
            return
        (x, vx, _), (z, vz, _) = gripper.at(t)
        if self._psi is None:
            self._psi = body.found(x, z, [each.s for each in self._felt])
            return
        psi = body.orientation(self._psi, x, z)
        if psi is None:
            return
        self._psi = psi
        at = body.at(psi)
        omega0 = -vz / at.e if abs(at.e) > LEAST_LEVER_M else 0.0
        miss = sample.s - body.reading(x, vx, at.e, at.h2, omega0)
        variance = self._rig.pad.reading_variance + at.e_sd**2 + (at.h2 / at.e * self._rig.arm_noise) ** 2
        nis = min(miss**2 / variance, GATE)
        self._nis += (nis - self._nis) * -math.expm1(-step / NIS_S)

    def _take(self, answer: PivotAnswer) -> None:
        self._answer = answer
        if not answer.claimed:
            self._reason, self._body, self._psi = answer.reason, None, None
            return
        self._body, self._nis, self._psi = _Outline(answer, self._rig), NIS_BEGIN, None
        if self._gripper is None or not self._felt:
            return
        (x, _, _), (z, _, _) = self._gripper.at(self._felt[-1].t_sample)
        if answer.t >= self._t_touched:  # the same touch: from where the body was then along the outline
            self._psi = self._body.walked(answer.psi, x, z)
        else:
            self._psi = self._body.found(x, z, [each.s for each in self._felt], near=answer.psi)


_DEAD = "the pivot is over the contact, or the height contradicts the outline"


class _Gripper:
    """Where the pivot is: reported positions along the planned way."""

    def __init__(self, sample: PalmSample) -> None:
        self._t, self._place = sample.t_sample, sample.angles
        self._rates = sample.rates or (0.0, 0.0)
        self._accelerations = sample.accelerations or (0.0, 0.0)

    @property
    def ax(self) -> float:
        """Acceleration along the pad (m/s²), planned."""
        return self._accelerations[0]

    def take(self, sample: PalmSample) -> None:
        """A report."""
        ahead = self.at(sample.t_sample)
        gain = 1.0 if sample.rates is None else STEADY
        self._place = tuple(p + gain * (m - p) for (p, _, _), m in zip(ahead, sample.angles, strict=True))
        self._t = sample.t_sample
        self._rates = sample.rates or (0.0, 0.0)
        self._accelerations = sample.accelerations or (0.0, 0.0)

    def at(self, t: float) -> tuple[tuple[float, float, float], ...]:
        """(place, velocity, acceleration) along x and z."""
        dt = min(max(t - self._t, -GAP_S), GAP_S)
        each = zip(self._place, self._rates, self._accelerations, strict=True)
        return tuple((p + v * dt + 0.5 * a * dt * dt, v + a * dt, a) for p, v, a in each)

    def sd(self, noise: float) -> float:
        """One-sigma of the place (m)."""
        return noise * math.sqrt(STEADY / (2.0 - STEADY))


class _At:
    """The outline at one orientation: lever e, second derivative of h_P, one-sigmas of h_P and e."""

    __slots__ = ("e", "e_sd", "h", "h2", "h_sd")

    def __init__(self, body: _Outline, psi: float) -> None:
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


class _Outline:
    """An answer, ready to be asked."""

    def __init__(self, answer: PivotAnswer, rig: PivotRig) -> None:
        self._rig = rig
        p, covariance = answer.p, answer.covariance
        self.answer = answer
        self.a, self.a_covariance = p[P.SHAPE :], covariance[P.SHAPE :, P.SHAPE :]
        self.theta: FloatArray = np.arange(MANY, dtype=np.float64) * (math.tau / MANY)
        self.h: FloatArray = shape.basis(self.theta, ORDER) @ self.a
        self._slope: FloatArray = -shape.tangential_basis(self.theta, ORDER) @ self.a
        self._p = p
        self.mu = friction_of(p, covariance)
        moment = p[P.MOMENT : P.MOMENT + 2]
        size = float(np.hypot(*moment))
        part = covariance[P.MOMENT : P.MOMENT + 2, P.MOMENT : P.MOMENT + 2]
        self.moment = size, math.sqrt(max(float(moment @ part @ moment), 0.0)) / max(size, 1e-30)
        self.force_share = math.hypot(self.moment[1] / max(size, 1e-30), 0.02)

    def at(self, psi: float) -> _At:
        """At an orientation (rad)."""
        return _At(self, psi)

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
        self, at: _At, psi: float, omega0: float, alpha0: float, along: tuple[float, float, float], az: float
    ) -> float:
        """What the pad must give (N), as `model.pivot` has it of a rigid gripper."""
        p, (_, vx, ax) = self._p, along
        mx, my = float(p[P.MOMENT]), float(p[P.MOMENT + 1])
        cos, sin = math.cos(psi), math.sin(psi)
        xi_x, xi_y = cos * mx - sin * my, sin * mx + cos * my
        slip = vx + at.h * omega0
        grip = float(p[P.DRAG]) * slip / math.sqrt(1.0 + float(p[P.SATURATION]) * slip * slip)
        torque = (
            float(p[P.INERTIA]) * alpha0 + float(p[P.DAMPING]) * omega0 + xi_x * (self._rig.gravity + az) - xi_y * ax
        )
        lever = at.e - grip * at.h
        return torque / lever if abs(lever) > 1e-6 else math.nan
