"""Live observer of a body between three palms: a filter propagates the smoother's last answer to the present.

The smoother beside the loop estimates motion and body from the whole record, and accepts or rejects the estimate. The
filter in the loop fuses all readings since that answer; the live estimate is valid as long as they agree with it.
Readings are fused some milliseconds late, in the order of their own times, across all pads.
"""

from __future__ import annotations

import bisect
import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from palmd.events import Event, FloatArray, PadLift, PalmSample, ShapeEstimate
from palmd.model import three_palms
from palmd.model.icosphere import icosphere
from palmd.model.rotation import quaternion
from palmd.observer.observer_of_one import ObserverOfOne
from palmd.observer.smoothing import SmoothingOfOne
from palmd.observer.three_palms import body_filter
from palmd.observer.three_palms.body import ORDER, inertia
from palmd.observer.three_palms.body_filter import BodyFilter, PlaneReading
from palmd.observer.three_palms.joint_track import REPORT_GAIN, JointTrack
from palmd.system.reasons import NO_REASON, Code, Reason
from palmd.system.three_palms import GAP_S, JOINTS, PALMS, BodyAnswer, BodyEstimate, BodyPlanningBelief, ThreePalmsRig
from palmd.three_palms_quantities import INERTIA_ENTRIES, WORLD_AXES

NAME = "space"
FUSION_DELAY_S = 0.02  # how late readings are fused
KEPT_S = 20.0  # of readings, for an answer that is as old: the first takes up to 14 s
MOST_KEPT = 8192  # of readings, before older ones are let go: some 27 s
CATCH_UP_READINGS = 12  # readings that a filter which catches up takes beyond the new ones
NIS_LIMIT = 1.35  # six of the standard deviations that it has where all is as believed
NIS_PREDICTIVE = 4.0  # up to which the belief still predicts the motion
CONTACT_SD_LIMIT_M = 3e-4  # one-sigma of a contact, above which it is not known where the body is
NEW_OBJECT_S = 0.5  # without any contact, after which it is another object
LONGEST_S = 1e-2  # of a step ahead of the last reading
TRUNCATED_M, TRUNCATED_RAD_S = 3e-5, 0.01  # what harmonics beyond the last leave open of contacts and spin, at least
FORCE_SHARE = 0.03
NORMALS_EVERY_S = 0.02  # how often it is kept where the palms touch the body
_NO_MOTION = Reason(Code.NO_OBJECT, "no motion found yet that explains the readings")
_UNEXPLORED = Reason(Code.UNEXPLORED, "the body rolls onto surface that has not been touched yet")
_CONTRADICTED = Reason(Code.INCONSISTENT, "the readings contradict the estimated motion")


class BodyObserver(ObserverOfOne[BodyAnswer]):
    """See the module and `observer.observer.LiveObserver`. Safe in the loop."""

    def __init__(self, rig: ThreePalmsRig, smoothing: SmoothingOfOne[BodyAnswer]) -> None:
        """`smoothing` estimates motion and shape; without its answers only the joints are estimated."""
        super().__init__(NAME, smoothing)
        self._rig = rig
        self._joints: JointTrack | None = None
        self._pending: list[PlaneReading] = []  # not fused yet, by their times
        self._fused: list[PlaneReading] = []  # fused, by their times
        self._fused_until = -math.inf
        self._contact_times = [-math.inf] * len(PALMS)
        self._lifted: set[int] = set()  # palms whose pads say that nothing touches them
        self._contact_start = -math.inf  # of what is on the palms: answers about what was there before are of no use
        self._answer: BodyAnswer | None = None
        self._filter: BodyFilter | None = None
        self._catching_up: BodyFilter | None = None  # catches up
        self._previous: BodyFilter | None = None  # of a record that was given up: by it the next one's frame is known
        # Which frame, of which record, and from that record's own into that of the first one in it.
        self._frame, self._frame_of, self._turn = 0, -math.inf, np.eye(3)
        self._published_shape_of: BodyAnswer | None = None
        self._predictive = False
        # normals in the body
        self._normals: deque[tuple[float, FloatArray]] = deque(maxlen=round(KEPT_S / NORMALS_EVERY_S))

    @property
    def backend(self) -> str:
        """What runs the kernels."""
        return three_palms.library(ORDER).backend

    def warm_up(self) -> None:
        """Load the kernels and compute the surface's directions."""
        icosphere()
        body_filter.filter_steps(ORDER, self._rig)

    def feed(self, event: Event) -> None:
        """Take one event; a reading that is too late to be fused is counted and dropped."""
        t = event.t_sample
        if not math.isfinite(t):
            self.late_dropped += 1
            return
        self._unsent.append(event)
        if isinstance(event, PalmSample):
            if self._joints is None:
                self._joints = JointTrack(event)
            else:
                self._joints.take(event)
        elif isinstance(event, PadLift):
            self._lifted.add(event.pad)
        elif event.across is not None:
            self._take_reading(PlaneReading(t, event.pad - 1, event.across, event.s))

    def improve(self, t: float) -> BodyAnswer | None:
        """As `ObserverOfOne.improve`, and fuse the readings."""
        answer = super().improve(t)
        self._advance(t - FUSION_DELAY_S)
        return answer

    def estimate(self, t: float) -> BodyEstimate:
        """Estimate at time `t` (s); never raises, NaN for what is not known."""
        values, sd = self._joint_values(t)
        answer, filtered = self._answer, self._filter
        known = answer if answer is not None and answer.hypotheses else None
        rotation: tuple[float, ...] = (math.nan,) * 4
        attitude: tuple[float, ...] = (math.nan,) * 3
        missing, reason = self._missing_input(t), self._invalid_reason(t)
        self._predictive = False
        if filtered is not None and known is not None and self._joints is not None and t - filtered.t < GAP_S:
            now = self._predicted(filtered, t)
            if np.isfinite(now.P).all() and np.isfinite(now.R).all():
                body_values, body_sd = self._body_values(now, known, t)
                values |= body_values
                sd |= body_sd
                spread = np.sqrt(np.maximum(np.diagonal(now.P)[:3], 0.0))
                rotation, attitude = quaternion(now.R), tuple(spread.tolist())
                worst = max(body_sd[f"{side}{palm}_m"] for palm in PALMS for side in "ab")
                if not reason and not worst < CONTACT_SD_LIMIT_M:
                    reason = _UNEXPLORED
                self._predictive = not missing and filtered.nis < NIS_PREDICTIVE and worst < CONTACT_SD_LIMIT_M
                self._store_normals(now, t)
            else:
                reason, self._filter = Reason(Code.INCONSISTENT, "the filter has diverged"), None
        self.invalid_because = reason
        return BodyEstimate(
            t=t, valid=not reason, observer=NAME, object_count=self.object_count,
            nis=1.0 if filtered is None else filtered.nis, sd=sd, values=values, quaternion=rotation,
            attitude_sd=attitude, touched=0.0 if known is None else float(known.touched.mean()),
            hypotheses=0 if answer is None else answer.hypotheses, reason=reason,
            invalid_reasons=(reason.code,) if reason else (),
        )  # fmt: skip

    def shape(self, t: float) -> ShapeEstimate | None:
        """Surface of the last answer; each answer's once."""
        answer = self._answer
        if answer is None or not answer.hypotheses or answer is self._published_shape_of:
            return None
        self._published_shape_of = answer
        return ShapeEstimate(t, icosphere()[0], answer.h, answer.h_sd, answer.touched > 0)

    @property
    def has_planning_belief(self) -> bool:
        """Whether the estimate, valid or not, is good enough for predictions."""
        return self._predictive

    def planning_belief(self, t: float) -> BodyPlanningBelief | None:
        """Belief about the body at `t` (s) for planning; None if it is not good enough."""
        answer, filtered = self._answer, self._filter
        if not self._predictive or answer is None or filtered is None:
            return None
        now = self._predicted(filtered, t)
        normals_since = [normals for at, normals in self._normals if at > answer.t]
        return BodyPlanningBelief(
            t, self.object_count, answer.record_start, not self._invalid_reason(t), answer.mass,
            now.R, now.omega, now.p, now.P, answer.touched > 0,
            np.array(normals_since).reshape(-1, len(PALMS), 3), self._frame, self._turn,
        )  # fmt: skip

    # ---- its parts ---------------------------------------------------------------------------------------

    def _take_reading(self, reading: PlaneReading) -> None:
        last_contact = max(self._contact_times)
        if reading.t - last_contact > NEW_OBJECT_S and math.isfinite(last_contact):
            self.object_count += 1
        if reading.t - self._contact_times[reading.pad] > GAP_S:
            self._reset_motion(reading.t)
        self._contact_times[reading.pad] = max(reading.t, self._contact_times[reading.pad])
        self._lifted.discard(reading.pad + 1)
        if reading.t <= self._fused_until:
            self.late_dropped += 1
            return
        bisect.insort(self._pending, reading, key=_time)

    def _reset_motion(self, t: float) -> None:
        """Discard the estimate of the motion after a palm lost contact; t: time of the new contact (s)."""
        self._contact_start = max(t, self._contact_start)
        self._filter = self._catching_up = self._previous = self._answer = None
        for each in (self._pending, self._fused, self._normals):
            each.clear()

    def _take_answer(self, answer: BodyAnswer) -> None:
        too_old = bool(self._fused) and self._fused[0].t > answer.t
        if answer.record_start < self._contact_start or (answer.hypotheses and too_old):
            return
        if not answer.hypotheses or (self._answer is not None and answer.record_start != self._answer.record_start):
            self._previous, self._filter, self._catching_up = self._filter or self._previous, None, None
            self._normals.clear()
        self._answer = answer
        if not answer.hypotheses:
            return
        if self._catching_up is None or self._filter is not None or self._catching_up.t < answer.t:
            self._catching_up = BodyFilter(answer, self._rig)

    def _advance(self, until: float) -> None:
        """Advance the filters to `until` (s), or towards it."""
        ready = bisect.bisect_right(self._pending, until, key=_time)
        new, self._pending = self._pending[:ready], self._pending[ready:]
        self._fused_until = max(until, self._fused_until)
        self._fused += new
        if len(self._fused) > MOST_KEPT:
            del self._fused[: bisect.bisect_left(self._fused, until - KEPT_S, key=_time)]
        if self._joints is None:
            return
        if self._filter is not None:
            self._propagate(self._filter, new, until)
        if self._previous is not None:
            self._propagate(self._previous, new, until)
            if not self._previous.nis < NIS_PREDICTIVE:
                self._previous = None
        if self._catching_up is not None:
            self._catch_up(self._catching_up, until, CATCH_UP_READINGS + len(new))

    def _catch_up(self, behind: BodyFilter, until: float, limit: int) -> None:
        begin = bisect.bisect_right(self._fused, behind.t, key=_time)
        batch, is_last = self._fused[begin : begin + limit], begin + limit >= len(self._fused)
        self._propagate(behind, batch, until if is_last else batch[-1].t)
        if is_last:
            self._filter, self._catching_up = behind, None
            if self._answer is not None and self._answer.record_start != self._frame_of:
                self._place_frame(self._answer.record_start, behind)

    def _place_frame(self, record_start: float, first: BodyFilter) -> None:
        """Relate the frame of a new record, whose filter `first` is now at the present, to the previous record's.

        Without a filter of the previous record a new frame begins.
        """
        if self._previous is None:
            self._frame, self._turn = self._frame + 1, np.eye(3)
        else:
            self._turn = self._turn @ self._previous.R.T @ first.R
        self._frame_of, self._previous = record_start, None

    def _propagate(self, filtered: BodyFilter, readings: Sequence[PlaneReading], until: float) -> None:
        if self._joints is not None:
            filtered.propagate([each for each in readings if each.t > filtered.t], until, self._joints)

    def _predicted(self, filtered: BodyFilter, t: float) -> BodyFilter:
        """Copy of the filter, predicted to time t (s)."""
        now = filtered.copy()
        if self._joints is not None:
            now.propagate([], t, self._joints, LONGEST_S)
        return now

    def _invalid_reason(self, t: float) -> Reason:
        """Why the estimate is not valid now; none if it may be."""
        missing, answer = self._missing_input(t), self._answer
        if missing or answer is None:
            return missing
        if not answer.accepted:
            return Reason(Code(answer.reason_code), answer.reason)
        if self._filter is None:
            return Reason(Code.CATCHING_UP, "the filter is catching up with the readings since the smoother's answer")
        return NO_REASON if self._filter.nis < NIS_LIMIT else _CONTRADICTED

    def _missing_input(self, t: float) -> Reason:
        """Which input is missing now; none if all are there."""
        contact_times = zip(PALMS, self._contact_times, strict=True)
        untouched = [palm for palm, at in contact_times if t - at > GAP_S or palm in self._lifted]
        if untouched:
            return Reason(Code.UNTOUCHED, f"nothing touches palm {', '.join(map(str, untouched))}")
        if self._joints is None or t - self._joints.t > GAP_S:
            return Reason(Code.NO_ARM_REPORTS, "the joints are not reported")
        return _NO_MOTION if self._answer is None else NO_REASON

    def _store_normals(self, now: BodyFilter, t: float) -> None:
        """Store the contact normals, in the body's frame."""
        if self._joints is not None and (not self._normals or t - self._normals[-1][0] >= NORMALS_EVERY_S):
            self._normals.append((t, -self._joints.palms(np.array([t])).normal[0] @ now.R))

    def _joint_values(self, t: float) -> tuple[dict[str, float], dict[str, float]]:
        if self._joints is None:
            return {}, {}
        angle, rate, _ = (each[0].tolist() for each in self._joints.at(np.array([t])))
        values = {f"{joint}_rad": value for joint, value in zip(JOINTS, angle, strict=True)}
        values |= {f"{joint}_rate_rad_s": value for joint, value in zip(JOINTS, rate, strict=True)}
        noise = self._rig.angle_noise * math.sqrt(REPORT_GAIN / (2.0 - REPORT_GAIN))
        return values, {f"{joint}_rad": noise for joint in JOINTS}

    def _body_values(self, now: BodyFilter, answer: BodyAnswer, t: float) -> tuple[dict[str, float], dict[str, float]]:
        assert self._joints is not None
        outputs = now.outputs(self._joints, t)
        diagonal = np.sqrt(np.maximum(np.diagonal(now.P), 0.0))
        truncation_sd = math.hypot(TRUNCATED_M, answer.unexplained_sd)  # open, by what harmonics leave out
        spin_truncation_sd = TRUNCATED_RAD_S * truncation_sd / TRUNCATED_M
        body_inertia, inertia_sd = inertia(now.p), answer.inertia_sd.reshape(3, 3)
        values: dict[str, float] = {}
        sd: dict[str, float] = {}

        def put(name: str, value: float, value_sd: float) -> None:
            values[name], sd[name] = float(value), float(value_sd)

        for k, axis in enumerate(WORLD_AXES):
            put(f"omega_{axis}_rad_s", now.omega[k], math.hypot(diagonal[3 + k], spin_truncation_sd))
            put(f"com_{axis}_m", outputs.centre[0][k], math.hypot(outputs.centre[1][k], truncation_sd))
        for i, palm in enumerate(PALMS):
            for k, side in enumerate("ab"):
                put(f"{side}{palm}_m", outputs.contacts[0][i, k], math.hypot(outputs.contacts[1][i, k], truncation_sd))
            put(f"h{palm}_m", outputs.heights[0][i], math.hypot(outputs.heights[1][i], truncation_sd))
            if math.isfinite(answer.mass):
                force = answer.mass * float(outputs.force[i])
                put(f"f{palm}_n", force, abs(force) * math.hypot(answer.mass_sd / answer.mass, FORCE_SHARE))
        for entry in INERTIA_ENTRIES:
            at = tuple("xyz".index(axis) for axis in entry)
            put(f"inertia_{entry}_m2", body_inertia[at], inertia_sd[at])
        put("mu", now.p[-2], diagonal[-2])
        if math.isfinite(answer.mass):
            put("mass_kg", answer.mass, answer.mass_sd)
        return values, sd


def _time(reading: PlaneReading) -> float:
    return reading.t
