"""Live observer of a pivoting grasp: tracks the body's orientation with the outline from a smoother.

The smoother beside the loop estimates the body from all readings. The loop needs no dynamics: with a rigid gripper the
height z = h_P(θ) determines the orientation, its rate is ω0 = −ż/e, and e = h_P′(θ) predicts the pad's reading, so that
every reading tests the estimate.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from palmd.events import Event, PadLift, PadSample, PalmSample, ShapeEstimate
from palmd.observer.observer_of_one import ObserverOfOne
from palmd.observer.pivot.accepted import (
    GAP_S,
    GATE,
    LEAST_LEVER_M,
    LEAST_RECENT,
    AcceptedOutline,
    Gripper,
    OutlinePoint,
)
from palmd.observer.smoothing import SmoothingOfOne
from palmd.system.pivot import PivotAnswer, PivotEstimate, PivotRig, Touching
from palmd.system.reasons import NO_REASON, Code, Reason

NAME = "pivot"
RECENT_S = 0.06  # of readings that a touched point is the mean of
NIS_S, NIS_LIMIT, NIS_INITIAL = 0.5, 3.0, 1.0
LAG_SD_S, RATE_SD_M_S = 4e-3, 1e-4  # of how late the arm does what is planned, and of how even it runs
OUTLINE_SD_LIMIT_M = 1e-4  # 1σ of the outline at the contact, above which the orientation is not accepted
_UNTOUCHED = Reason(Code.UNTOUCHED, "nothing touches the pad")
_UNEXPLORED = Reason(Code.UNEXPLORED, "the outline has not been touched here yet")
_CONTRADICTED = Reason(Code.INCONSISTENT, "the readings contradict the estimated outline")
_NO_ORIENTATION = Reason(Code.INCONSISTENT, "the pivot is above the contact, or the height contradicts the outline")


@dataclass(frozen=True, slots=True)
class Present:
    """State of the body at an instant: orientation, rate, the outline at its contact, and the pad's force.

    z_sd: 1σ of h_P if that is a better estimate of the pivot's height than the arm's report; else NaN.
    """

    at: OutlinePoint
    psi: float
    psi_sd: float
    omega0: float
    omega0_sd: float
    e_sd: float
    force: float
    z_sd: float = math.nan


class PivotObserver(ObserverOfOne[PivotAnswer]):
    """See the module and `observer.observer.LiveObserver`. Safe in the loop."""

    def __init__(self, rig: PivotRig, smoothing: SmoothingOfOne[PivotAnswer]) -> None:
        """`smoothing` estimates the outline; without its answers only measured quantities are known."""
        super().__init__(NAME, smoothing)
        self.backend = "numpy"
        self._rig = rig
        self._t_newest = -math.inf
        self._answer: PivotAnswer | None = None
        self._reason = Reason(Code.NO_OBJECT, "no outline is known yet")
        self.invalid_because = self._reason
        self._body: AcceptedOutline | None = None
        self._gripper: Gripper | None = None
        self._recent: deque[PadSample] = deque()
        self._levers: deque[float] = deque()  # of each reading in `_recent`
        self._touching = False
        self._psi: float | None = None
        self._nis = NIS_INITIAL
        self._contact_start = math.inf  # since when it is

    def warm_up(self) -> None:
        """Nothing to do."""

    def feed(self, event: Event) -> None:
        """Take one event; one more than `GAP_S` older than the newest is counted and dropped."""
        t = event.t_sample
        if not math.isfinite(t) or t < self._t_newest - GAP_S:
            self.late_dropped += 1
            return
        self._t_newest = max(self._t_newest, t)
        self._unsent.append(event)
        if isinstance(event, PalmSample):
            if self._gripper is None:
                self._gripper = Gripper(event, slides=self._rig.vertical == "float")
            else:
                self._gripper.take(event)
        elif isinstance(event, PadLift):
            self._lift()
        else:
            if self._recent and t - self._recent[-1].t_sample > GAP_S:
                self._lift()
            step = event.t_sample - self._recent[-1].t_sample if self._recent else 0.0
            self._take_reading(event)
            self._track(event, step)

    def estimate(self, t: float) -> PivotEstimate:
        """Estimate at time `t` (s); never raises, NaN for what is not known."""
        nan = math.nan
        x, z, sd, e, side = nan, nan, {}, nan, 0
        touched = 0.0 if self._answer is None else float(self._answer.touched.mean()) if self._answer.accepted else 0.0
        if self._recent and t - self._recent[-1].t_sample > GAP_S:
            self._lift()
        if self._gripper is not None:
            (x, vx, _), (z, vz, _) = self._gripper.at(t)
            noise = self._gripper.sd(self._rig.arm_noise)
            sd = {"x": math.hypot(noise, LAG_SD_S * vx), "z": math.hypot(noise, LAG_SD_S * vz)}
            if self._touching and self._recent:
                e = self._recent[-1].s - x
                side = int(math.copysign(1.0, e))
        measured = {"x": x, "z": z, "s": x + e, "e": e, "side": side, "touched": touched, "nis": self._nis}
        unknown = {"psi": nan, "omega0": nan, "f": nan, "mu": nan, "moment": nan}
        body, reason = self._body, self._invalid_reason()
        if body is not None:
            unknown["mu"], sd["mu"] = body.mu
            unknown["moment"], sd["moment"] = body.moment
        if body is None or self._psi is None or reason:
            return self._estimate_of(t, measured | unknown, sd, reason or _UNTOUCHED)
        now = self._present(t, body, self._psi, sd["z"])
        if now is None:
            return self._estimate_of(t, measured | unknown, sd, _NO_ORIENTATION)
        at = now.at
        sd |= {
            "e": now.e_sd,
            "s": math.hypot(now.e_sd, sd["x"]),
            "psi": now.psi_sd,
            "omega0": now.omega0_sd,
            "f": math.hypot(body.force_share, self._lever_share(now)) * abs(now.force),
        }
        values = measured | unknown | {"e": at.e, "s": x + at.e, "psi": now.psi, "omega0": now.omega0, "f": now.force}
        if math.isfinite(now.z_sd):
            values["z"], sd["z"] = at.h, now.z_sd
        return self._estimate_of(t, values, sd, NO_REASON if at.h_sd < OUTLINE_SD_LIMIT_M else _UNEXPLORED)

    def shape(self, t: float) -> ShapeEstimate | None:
        """The outline about the pivot; None without an accepted one."""
        body = self._body
        if body is None:
            return None
        return ShapeEstimate(t, body.theta, body.h, body.answer.h_sd, body.answer.touched > 0)

    @property
    def has_planning_belief(self) -> bool:
        """Whether the gripper's position is known."""
        return self._gripper is not None

    def planning_belief(self, t: float) -> Touching | None:
        """Measured contact for planning drags; None before the gripper's position is known."""
        if self._gripper is None:
            return None
        (x, _, _), (z, _, _) = self._gripper.at(t)
        e = force = math.nan
        if self._touching and len(self._recent) >= LEAST_RECENT:
            e = float(np.mean(self._levers))
            force = float(np.mean([math.nan if each.force is None else each.force for each in self._recent]))
        band = touched = math.nan
        if self._body is not None:
            was_touched = self._body.answer.touched > 0
            band = float(np.sqrt(np.mean(self._body.answer.h_sd[was_touched] ** 2))) if was_touched.any() else math.nan
            touched = float(was_touched.mean())
        t_answer = -math.inf if self._answer is None else self._answer.t
        return Touching(t, x, z, e, force, self._touching, touched, band, t_answer)

    # ---- its parts ---------------------------------------------------------------------------------------

    def _present(self, t: float, body: AcceptedOutline, psi: float, z_sd: float) -> Present | None:
        """State at `t` (s), near orientation `psi`; None near a dead centre or if height and outline disagree."""
        if self._gripper is None:
            return None
        (x, vx, ax), (z, vz, az) = self._gripper.at(t)
        found = body.orientation(psi, x, z)
        if found is None:
            return None
        self._psi = found
        at = body.at(found)
        if abs(at.e) < LEAST_LEVER_M:
            return None
        omega0 = -vz / at.e
        alpha0 = (at.h2 * omega0**2 - az) / at.e
        force = body.force(at, found, omega0, alpha0, (x, vx, ax), az)
        h_sd = math.hypot(at.h_sd, z_sd)
        e_sd = math.hypot(at.e_sd, at.h2 / at.e * h_sd)  # de = h″ dθ, and dθ = dz/e
        omega0_sd = math.hypot(omega0 * e_sd, LAG_SD_S * az, RATE_SD_M_S) / abs(at.e)
        return Present(at, found, h_sd / abs(at.e), omega0, omega0_sd, e_sd, force)

    def _lever_share(self, now: Present) -> float:
        """Relative 1σ of the force from that of the lever."""
        return now.e_sd / abs(now.at.e)

    def _estimate_of(self, t: float, values: Mapping[str, Any], sd: dict[str, float], reason: Reason) -> PivotEstimate:
        self.invalid_because = reason
        return PivotEstimate(
            t=t, valid=not reason, observer=NAME, object_count=self.object_count, reason=reason,
            invalid_reasons=(reason.code,) if reason else (), sd=sd, **values,
        )  # fmt: skip

    def _invalid_reason(self) -> Reason:
        """Why the orientation is not valid now; none if it may be."""
        if self._body is None:
            return self._reason
        if not self._touching:
            return _UNTOUCHED
        if self._psi is None:
            return Reason(Code.ORIENTATION_UNKNOWN, "the orientation in which the body was put down is not known yet")
        return NO_REASON if self._nis < NIS_LIMIT else _CONTRADICTED

    def _lift(self) -> None:
        self._recent.clear()
        self._levers.clear()
        self._touching = False
        self._psi = None
        self._nis = NIS_INITIAL

    def _take_reading(self, sample: PadSample) -> None:
        t = sample.t_sample
        if not self._recent:
            self._contact_start = t
        self._recent.append(sample)
        self._levers.append(math.nan if self._gripper is None else sample.s - self._gripper.at(t)[0][0])
        while self._recent[0].t_sample < t - RECENT_S:
            self._recent.popleft()
            self._levers.popleft()
        self._touching = True

    def _track(self, sample: PadSample, step: float) -> None:
        """Track the orientation to a reading and update the NIS; `step`: time since the reading before (s)."""
        gripper, body = self._gripper, self._body
        if gripper is None or body is None:
            return
        (x, vx, _), (z, vz, _) = gripper.at(sample.t_sample)
        if self._psi is None:
            self._psi = body.locate(x, z, [each.s for each in self._recent])
            return
        psi = body.orientation(self._psi, x, z)
        if psi is None:
            return
        self._psi = psi
        at = body.at(psi)
        omega0 = -vz / at.e if abs(at.e) > LEAST_LEVER_M else 0.0
        innovation = sample.s - body.reading(x, vx, at.e, at.h2, omega0)
        variance = self._rig.pad.reading_variance + at.e_sd**2 + (at.h2 / at.e * self._rig.arm_noise) ** 2
        self._update_nis(innovation**2 / variance, step)

    def _update_nis(self, nis: float, step: float) -> None:
        self._nis += (min(nis, GATE) - self._nis) * -math.expm1(-step / NIS_S)

    def _take_answer(self, answer: PivotAnswer) -> None:
        self._answer = answer
        if not answer.accepted:
            self._reason, self._body, self._psi = Reason(Code(answer.reason_code), answer.reason), None, None
        else:
            self._start_tracking(answer)

    def _start_tracking(self, answer: PivotAnswer) -> None:
        """Start tracking with an accepted outline."""
        self._body, self._nis, self._psi = AcceptedOutline(answer, self._rig), NIS_INITIAL, None
        if self._gripper is None or not self._recent:
            return
        (x, _, _), (z, _, _) = self._gripper.at(self._recent[-1].t_sample)
        if answer.t >= self._contact_start:  # the same touch: from where the body was then along the outline
            self._psi = self._body.orientation_by_steps(answer.psi, x, z)
        else:
            self._psi = self._body.locate(x, z, [each.s for each in self._recent], near=answer.psi)
