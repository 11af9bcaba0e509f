"""The live observer of a body between three palms: a filter goes on from where a smoother's answer ends.

The smoother sees the whole record, takes its time and says how the body moved, what it is, and whether to believe it.
The loop carries the last answer through all readings since then to the present, and claims it as long as they agree.
Readings are fused some milliseconds late, in the order of their own times: no pad is ever ahead of another.
"""

from __future__ import annotations

import bisect
import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from palmd.events import Event, FloatArray, PadLift, PalmSample, ShapeEstimate
from palmd.model.icosphere import icosphere
from palmd.model.rotation import quaternion
from palmd.observer.smoothing import SmoothingOfOne
from palmd.observer.three_palms import body_filter, kernels
from palmd.observer.three_palms.body import ORDER, inertia
from palmd.observer.three_palms.body_filter import BodyFilter, PlaneReading
from palmd.observer.three_palms.joint_track import STEADY, JointTrack
from palmd.system.three_palms import GAP_S, JOINTS, PALMS, BodyAnswer, BodyEstimate, BodyPlanningBelief, ThreePalmsRig
from palmd.three_palms_quantities import INERTIA_ENTRIES, WORLD_AXES

NAME = "space"
HELD_S = 0.02  # how late readings are fused
KEPT_S = 20.0  # of readings, for an answer that is as old: the first takes up to 14 s
MOST_KEPT = 8192  # of readings, before older ones are let go: some 27 s
A_TICK = 12  # readings that a filter which catches up takes beyond the new ones
NIS_MOST = 1.35  # six of the standard deviations that it has where all is as believed
NIS_FORESEEN = 4.0  # up to which what is believed still tells where the body goes
KNOWN_M = 3e-4  # one-sigma of a contact, above which it is not known where the body is
AWAY_S = 0.5  # without any contact, after which it is another object
LONGEST_S = 1e-2  # of a step ahead of the last reading
TRUNCATED_M, TRUNCATED_RAD_S = 3e-5, 0.01  # what harmonics beyond the last leave open of contacts and spin, at least
FORCE_SHARE = 0.03
SEEN_S = 0.02  # how often it is kept where the palms touch the body


class BodyObserver:
    """See the module and `observer.observer.LiveObserver`. Safe in the loop."""

    def __init__(self, rig: ThreePalmsRig, smoothing: SmoothingOfOne[BodyAnswer]) -> None:
        """`smoothing` tells motion and shape; without its answers nothing is claimed but the joints."""
        self.name = NAME
        self.object_count, self.late_dropped, self.improvements = 1, 0, 0
        self._rig, self._smoothing = rig, smoothing
        self._waiting: list[Event] = []
        self._joints: JointTrack | None = None
        self._pending: list[PlaneReading] = []  # not fused yet, by their times
        self._kept: list[PlaneReading] = []  # fused, by their times
        self._fused_until = -math.inf
        self._felt_at = [-math.inf] * len(PALMS)
        self._silent: set[int] = set()  # palms whose pads say that nothing touches them
        self._begun = -math.inf  # of what is on the palms: answers about what was there before are of no use
        self._answer: BodyAnswer | None = None
        self._filter: BodyFilter | None = None
        self._next: BodyFilter | None = None  # catches up
        self._before: BodyFilter | None = None  # of a record that was given up: by it the next one's frame is known
        # Which frame, of which record, and from that record's own into that of the first one in it.
        self._frame, self._frame_of, self._turn = 0, -math.inf, np.eye(3)
        self._shape_of: BodyAnswer | None = None
        self._foresees = False
        self._invalid_because = ""
        self._seen: deque[tuple[float, FloatArray]] = deque(maxlen=round(KEPT_S / SEEN_S))  # normals in the body

    @property
    def backend(self) -> str:
        """What runs the kernels."""
        return kernels.backend(ORDER)

    def warm_up(self) -> None:
        """Load the kernels, and the directions of a surface."""
        icosphere()
        body_filter.steps(ORDER, self._rig)

    def feed(self, event: Event) -> None:
        """Take one event; a reading of a time that has been fused already is counted and dropped."""
        t = event.t_sample
        if not math.isfinite(t):
            self.late_dropped += 1
            return
        self._waiting.append(event)
        if isinstance(event, PalmSample):
            if self._joints is None:
                self._joints = JointTrack(event)
            else:
                self._joints.take(event)
        elif isinstance(event, PadLift):
            self._silent.add(event.pad)
        elif event.across is not None:
            self._take(PlaneReading(t, event.pad - 1, event.across, event.s))

    def improve(self, t: float) -> BodyAnswer | None:
        """Exchange with the smoother beside the loop; what it has answered, each answer once."""
        events, self._waiting = self._waiting, []
        self._smoothing.submit(t, events)
        answer = self._smoothing.collect(t)
        if answer is not None:
            self.improvements += 1
            self._hear(answer)
        self._fuse(t - HELD_S)
        return answer

    def estimate(self, t: float) -> BodyEstimate:
        """The answer for time `t`; never raises, NaN where nothing is known."""
        values, sd = self._of_joints(t)
        answer, filtered = self._answer, self._filter
        told = answer if answer is not None and answer.hypotheses else None
        turn: tuple[float, ...] = (math.nan,) * 4
        attitude: tuple[float, ...] = (math.nan,) * 3
        absent, reason = self._absent(t), self._doubt(t)
        self._foresees = False
        if filtered is not None and told is not None and self._joints is not None and t - filtered.t < GAP_S:
            now = self._ahead(filtered, t)
            if np.isfinite(now.P).all() and np.isfinite(now.R).all():
                of_body, bands = self._of_body(now, told, t)
                values |= of_body
                sd |= bands
                spread = np.sqrt(np.maximum(np.diagonal(now.P)[:3], 0.0))
                turn, attitude = quaternion(now.R), tuple(spread.tolist())
                worst = max(bands[f"{side}{palm}_m"] for palm in PALMS for side in "ab")
                if not reason and not worst < KNOWN_M:
                    reason = "the body rolls onto what has not been felt yet"
                self._foresees = not absent and filtered.nis < NIS_FORESEEN and worst < KNOWN_M
                self._see(now, t)
            else:
                reason, self._filter = "the filter has lost it", None
        self._invalid_because = reason
        return BodyEstimate(
            t=t, valid=not reason, observer=NAME, object_count=self.object_count,
            nis=1.0 if filtered is None else filtered.nis, sd=sd, values=values, quaternion=turn,
            attitude_sd=attitude, touched=0.0 if told is None else float(told.touched.mean()),
            hypotheses=0 if answer is None else answer.hypotheses, reason=reason,
        )  # fmt: skip

    def shape(self, t: float) -> ShapeEstimate | None:
        """The surface of each answer, once."""
        answer = self._answer
        if answer is None or not answer.hypotheses or answer is self._shape_of:
            return None
        self._shape_of = answer
        return ShapeEstimate(t, icosphere()[0], answer.h, answer.h_sd, answer.touched > 0)

    @property
    def has_planning_belief(self) -> bool:
        """Whether what is believed, claimed or not, still tells about what the readings are."""
        return self._foresees

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

    def planning_belief(self, t: float) -> BodyPlanningBelief | None:
        """What is believed of the body at `t` (s); None unless it `foresees`."""
        answer, filtered = self._answer, self._filter
        if not self._foresees or answer is None or filtered is None:
            return None
        now = self._ahead(filtered, t)
        felt = [normals for at, normals in self._seen if at > answer.t]
        return BodyPlanningBelief(
            t, self.object_count, answer.begun, not self._doubt(t), answer.mass, now.R, now.omega, now.p, now.P,
            answer.touched > 0, np.array(felt).reshape(-1, len(PALMS), 3), self._frame, self._turn,
        )  # fmt: skip

    def identify(self, t: float) -> None:
        """No bodies in space are stored."""
        del t

    # ---- its parts ---------------------------------------------------------------------------------------

    def _take(self, reading: PlaneReading) -> None:
        last = max(self._felt_at)
        if reading.t - last > AWAY_S and math.isfinite(last):
            self.object_count += 1
        if reading.t - self._felt_at[reading.pad] > GAP_S:
            self._part(reading.t)
        self._felt_at[reading.pad] = max(reading.t, self._felt_at[reading.pad])
        self._silent.discard(reading.pad + 1)
        if reading.t <= self._fused_until:
            self.late_dropped += 1
            return
        bisect.insort(self._pending, reading, key=_time)

    def _part(self, t: float) -> None:
        """A palm has been let go at t (s): what was known of the motion ends."""
        self._begun = max(t, self._begun)
        self._filter = self._next = self._before = self._answer = None
        for each in (self._pending, self._kept, self._seen):
            each.clear()

    def _hear(self, answer: BodyAnswer) -> None:
        forgotten = bool(self._kept) and self._kept[0].t > answer.t
        if answer.begun < self._begun or (answer.hypotheses and forgotten):
            return
        if not answer.hypotheses or (self._answer is not None and answer.begun != self._answer.begun):
            self._before, self._filter, self._next = self._filter or self._before, None, None
            self._seen.clear()
        self._answer = answer
        if not answer.hypotheses:
            return
        if self._next is None or self._filter is not None or self._next.t < answer.t:
            self._next = BodyFilter(answer, self._rig)

    def _fuse(self, until: float) -> None:
        """Bring the filters to `until` (s), or nearer to it."""
        ready = bisect.bisect_right(self._pending, until, key=_time)
        new, self._pending = self._pending[:ready], self._pending[ready:]
        self._fused_until = max(until, self._fused_until)
        self._kept += new
        if len(self._kept) > MOST_KEPT:
            del self._kept[: bisect.bisect_left(self._kept, until - KEPT_S, key=_time)]
        if self._joints is None:
            return
        if self._filter is not None:
            self._carry(self._filter, new, until)
        if self._before is not None:
            self._carry(self._before, new, until)
            if not self._before.nis < NIS_FORESEEN:
                self._before = None
        if self._next is not None:
            self._catch_up(self._next, until, A_TICK + len(new))

    def _catch_up(self, behind: BodyFilter, until: float, most: int) -> None:
        begin = bisect.bisect_right(self._kept, behind.t, key=_time)
        some, all_of_it = self._kept[begin : begin + most], begin + most >= len(self._kept)
        self._carry(behind, some, until if all_of_it else some[-1].t)
        if all_of_it:
            self._filter, self._next = behind, None
            if self._answer is not None and self._answer.begun != self._frame_of:
                self._place_frame(self._answer.begun, behind)

    def _place_frame(self, begun: float, first: BodyFilter) -> None:
        """A record's first filter is at the present: its frame is known by the record before, or it is another."""
        if self._before is None:
            self._frame, self._turn = self._frame + 1, np.eye(3)
        else:
            self._turn = self._turn @ self._before.R.T @ first.R
        self._frame_of, self._before = begun, None

    def _carry(self, filtered: BodyFilter, readings: Sequence[PlaneReading], until: float) -> None:
        if self._joints is not None:
            filtered.carry([each for each in readings if each.t > filtered.t], until, self._joints)

    def _ahead(self, filtered: BodyFilter, t: float) -> BodyFilter:
        """The filter's belief about time t."""
        now = filtered.copy()
        if self._joints is not None:
            now.carry([], t, self._joints, LONGEST_S)
        return now

    def _doubt(self, t: float) -> str:
        """Why what is believed is not to be believed now; empty when it is."""
        absent, answer = self._absent(t), self._answer
        if absent or answer is None:
            return absent
        if not answer.claimed:
            return answer.reason
        if self._filter is None:
            return "the readings since the smoother's answer are being caught up with"
        return "" if self._filter.nis < NIS_MOST else "the readings contradict the motion that was claimed"

    def _absent(self, t: float) -> str:
        """Why nothing can be said of now; empty when something can."""
        felt = zip(PALMS, self._felt_at, strict=True)
        untouched = [palm for palm, at in felt if t - at > GAP_S or palm in self._silent]
        if untouched:
            return f"nothing touches palm {', '.join(map(str, untouched))}"
        if self._joints is None or t - self._joints.t > GAP_S:
            return "the joints are not reported"
        return "no motion is known yet that explains the readings" if self._answer is None else ""

    def _see(self, now: BodyFilter, t: float) -> None:
        """Keep where the palms touch the body."""
        if self._joints is not None and (not self._seen or t - self._seen[-1][0] >= SEEN_S):
            self._seen.append((t, -self._joints.palms(np.array([t])).normal[0] @ now.R))

    def _of_joints(self, t: float) -> tuple[dict[str, float], dict[str, float]]:
        if self._joints is None:
            return {}, {}
        angle, rate, _ = (each[0].tolist() for each in self._joints.at(np.array([t])))
        values = {f"{joint}_rad": value for joint, value in zip(JOINTS, angle, strict=True)}
        values |= {f"{joint}_rate_rad_s": value for joint, value in zip(JOINTS, rate, strict=True)}
        noise = self._rig.angle_noise * math.sqrt(STEADY / (2.0 - STEADY))
        return values, {f"{joint}_rad": noise for joint in JOINTS}

    def _of_body(self, now: BodyFilter, answer: BodyAnswer, t: float) -> tuple[dict[str, float], dict[str, float]]:
        assert self._joints is not None
        seen = now.seen(self._joints, t)
        diagonal = np.sqrt(np.maximum(np.diagonal(now.P), 0.0))
        left = math.hypot(TRUNCATED_M, answer.rough)  # open, by what harmonics leave out
        of_spin = TRUNCATED_RAD_S * left / TRUNCATED_M
        of_inertia, inertia_sd = inertia(now.p), answer.inertia_sd.reshape(3, 3)
        values: dict[str, float] = {}
        sd: dict[str, float] = {}

        def tell(name: str, value: float, band: float) -> None:
            values[name], sd[name] = float(value), float(band)

        for k, axis in enumerate(WORLD_AXES):
            tell(f"omega_{axis}_rad_s", now.omega[k], math.hypot(diagonal[3 + k], of_spin))
            tell(f"com_{axis}_m", seen.centre[0][k], math.hypot(seen.centre[1][k], left))
        for i, palm in enumerate(PALMS):
            for k, side in enumerate("ab"):
                tell(f"{side}{palm}_m", seen.contacts[0][i, k], math.hypot(seen.contacts[1][i, k], left))
            tell(f"h{palm}_m", seen.heights[0][i], math.hypot(seen.heights[1][i], left))
            if math.isfinite(answer.mass):
                force = answer.mass * float(seen.force[i])
                tell(f"f{palm}_n", force, abs(force) * math.hypot(answer.mass_sd / answer.mass, FORCE_SHARE))
        for entry in INERTIA_ENTRIES:
            at = tuple("xyz".index(axis) for axis in entry)
            tell(f"inertia_{entry}_m2", of_inertia[at], inertia_sd[at])
        tell("mu", now.p[-2], diagonal[-2])
        if math.isfinite(answer.mass):
            tell("mass_kg", answer.mass, answer.mass_sd)
        return values, sd


def _time(reading: PlaneReading) -> float:
    return reading.t
