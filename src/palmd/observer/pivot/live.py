"""The live observer of a pivoting grasp: where the body is at this instant, by an outline that a smoother has told.

The smoother sees all readings at once, takes its time and says what the body is. The loop goes by that at once and
without dynamics: a rigid gripper's height z = h_P(θ) gives the orientation, its rate ω0 = −ż/e, and e = h_P′(θ) is what
the pad must read, so that every reading checks what is claimed.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from palmd.events import Event, PadLift, PadSample, PalmSample, ShapeEstimate
from palmd.observer.pivot.accepted import (
    GAP_S,
    GATE,
    LEAST_FELT,
    LEAST_LEVER_M,
    AcceptedOutline,
    Gripper,
    OutlinePoint,
)
from palmd.observer.smoothing import SmoothingOfOne
from palmd.system.pivot import PivotAnswer, PivotEstimate, PivotRig, Touching

NAME = "pivot"
FELT_S = 0.06  # of readings that what is felt is the mean of
NIS_S, NIS_MOST, NIS_BEGIN = 0.5, 3.0, 1.0
LAG_SD_S, RATE_SD_M_S = 4e-3, 1e-4  # of how late the arm does what is planned, and of how even it runs
KNOWN_M = 1e-4  # one-sigma of the outline at the contact, above which the orientation is not claimed


@dataclass(frozen=True, slots=True)
class Present:
    """How the body is at an instant: orientation and rate, where on its outline it touches, and the pad's force.

    z_sd: of h_P, where that tells the pivot's height over the pad better than the arm does; else NaN.
    """

    at: OutlinePoint
    psi: float
    psi_sd: float
    omega0: float
    omega0_sd: float
    e_sd: float
    force: float
    z_sd: float = math.nan


class PivotObserver:
    """See the module and `observer.observer.LiveObserver`. Safe in the loop."""

    def __init__(self, rig: PivotRig, smoothing: SmoothingOfOne[PivotAnswer]) -> None:
        """`smoothing` tells the outline; without its answers nothing is claimed but what is measured."""
        self.name, self.backend = NAME, "numpy"
        self.object_count, self.late_dropped, self.improvements = 1, 0, 0
        self._rig, self._smoothing = rig, smoothing
        self._waiting: list[Event] = []
        self._t_newest = -math.inf
        self._answer: PivotAnswer | None = None
        self._reason = "nothing is known of the outline yet"
        self._invalid_because = self._reason
        self._body: AcceptedOutline | None = None
        self._gripper: Gripper | None = None
        self._felt: deque[PadSample] = deque()
        self._levers: deque[float] = deque()  # of each that is in `_felt`
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
                self._gripper = Gripper(event, slides=self._rig.vertical == "float")
            else:
                self._gripper.take(event)
        elif isinstance(event, PadLift):
            self._lift()
        else:
            if self._felt and t - self._felt[-1].t_sample > GAP_S:
                self._lift()
            step = event.t_sample - self._felt[-1].t_sample if self._felt else 0.0
            self._feel(event)
            self._follow(event, step)

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
        x, z, sd, e, side = nan, nan, {}, nan, 0
        touched = 0.0 if self._answer is None else float(self._answer.touched.mean()) if self._answer.claimed else 0.0
        if self._felt and t - self._felt[-1].t_sample > GAP_S:
            self._lift()
        if self._gripper is not None:
            (x, vx, _), (z, vz, _) = self._gripper.at(t)
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
        now = self._present(t, body, self._psi, sd["z"])
        if now is None:
            return self._said(t, measured | unknown, sd, _DEAD, valid=False)
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
        why = "" if at.h_sd < KNOWN_M else "the outline has not been felt here yet"
        return self._said(t, values, sd, why, valid=not why)

    def shape(self, t: float) -> ShapeEstimate | None:
        """The outline about the pivot, None while none is claimed."""
        body = self._body
        if body is None:
            return None
        return ShapeEstimate(t, body.theta, body.h, body.answer.h_sd, body.answer.touched > 0)

    @property
    def has_planning_belief(self) -> bool:
        """Whether the gripper's place is known."""
        return self._gripper is not None

    @property
    def invalid_because(self) -> str:
        """The reason that the last estimate gave."""
        return self._invalid_because

    def forget_object(self) -> bool:
        """It cannot."""
        return False

    @property
    def cornered(self) -> bool:
        """Never said: it knows smooth objects only."""
        return False

    def planning_belief(self, t: float) -> Touching | None:
        """What a gripper that drags must go by."""
        if self._gripper is None:
            return None
        (x, _, _), (z, _, _) = self._gripper.at(t)
        e = force = math.nan
        if self._touching and len(self._felt) >= LEAST_FELT:
            e = float(np.mean(self._levers))
            force = float(np.mean([math.nan if each.force is None else each.force for each in self._felt]))
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

    def _present(self, t: float, body: AcceptedOutline, psi: float, z_sd: float) -> Present | None:
        """At `t` (s), from where it was; None near a dead centre, or where the height contradicts the outline."""
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
        """By how much of itself the force is off where the lever is by its one-sigma."""
        return now.e_sd / abs(now.at.e)

    def _said(
        self, t: float, values: Mapping[str, Any], sd: dict[str, float], reason: str, *, valid: bool
    ) -> PivotEstimate:
        count = self.object_count
        self._invalid_because = reason
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
        self._levers.clear()
        self._touching = False
        self._psi = None
        self._nis = NIS_BEGIN

    def _feel(self, sample: PadSample) -> None:
        t = sample.t_sample
        if not self._felt:
            self._t_touched = t
        self._felt.append(sample)
        self._levers.append(math.nan if self._gripper is None else sample.s - self._gripper.at(t)[0][0])
        while self._felt[0].t_sample < t - FELT_S:
            self._felt.popleft()
            self._levers.popleft()
        self._touching = True

    def _follow(self, sample: PadSample, step: float) -> None:
        """Where the body is by a reading, and whether it is explained; `step` is the time since the one before."""
        gripper, body = self._gripper, self._body
        if gripper is None or body is None:
            return
        (x, vx, _), (z, vz, _) = gripper.at(sample.t_sample)
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
        self._judge(miss**2 / variance, step)

    def _judge(self, nis: float, step: float) -> None:
        self._nis += (min(nis, GATE) - self._nis) * -math.expm1(-step / NIS_S)

    def _take(self, answer: PivotAnswer) -> None:
        self._answer = answer
        if not answer.claimed:
            self._reason, self._body, self._psi = answer.reason, None, None
        else:
            self._begin(answer)

    def _begin(self, answer: PivotAnswer) -> None:
        """Go by an outline that is claimed."""
        self._body, self._nis, self._psi = AcceptedOutline(answer, self._rig), NIS_BEGIN, None
        if self._gripper is None or not self._felt:
            return
        (x, _, _), (z, _, _) = self._gripper.at(self._felt[-1].t_sample)
        if answer.t >= self._t_touched:  # the same touch: from where the body was then along the outline
            self._psi = self._body.walked(answer.psi, x, z)
        else:
            self._psi = self._body.found(x, z, [each.s for each in self._felt], near=answer.psi)


_DEAD = "the pivot is over the contact, or the height contradicts the outline"
