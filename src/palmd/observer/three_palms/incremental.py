"""The smoother of a live body between three palms: rivals that go on as readings come. Not for the loop.

What `reconstruct` does with a whole record is done here with what there is so far, again and again: rivals from a blind
start, laps that end where the record ends now, the same doubts. What lies far behind is folded into a belief, so that a
lap costs no more after an hour than after a quarter of a minute.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from palmd.blas import one_thread
from palmd.config.pads import PRESSURE_GAIN_STD
from palmd.events import Event, FloatArray, PadSample, PalmSample
from palmd.model import rotation
from palmd.model.icosphere import icosphere
from palmd.observer.three_palms import beliefs
from palmd.observer.three_palms.arrow import STATES
from palmd.observer.three_palms.body import FINER_LIVE, ORDER
from palmd.observer.three_palms.driven import ContactCurves
from palmd.observer.three_palms.path import joint_path
from palmd.observer.three_palms.propagation import (
    BEHIND,
    SURE,
    Grown,
    anew,
    apart,
    begun_in_ways,
    finer,
    folded,
    found_again,
    moves_so,
    raced,
    smoothed,
)
from palmd.observer.three_palms.reconstruct import ALONE, doubt, inertia_sd, mass_of, surface
from palmd.observer.three_palms.record import PadReadings
from palmd.observer.three_palms.search import CHANCE, HOPELESS, SPACING_S, Task, rivals
from palmd.observer.three_palms.touched_outline import felt_outline, near
from palmd.system.three_palms import GAP_S, PALMS, BodyAnswer, ThreePalmsRig

REST_S = 0.4  # of a body that rests, before the palms move, that a record begins with
STILL_RAD, MOVED_RAD = 5e-3, 0.1  # of a joint: where it has begun to move, and has moved enough to try
WHOLE_S, WHOLE_WAYS = 5.0, 3  # of a record that it is begun with as a whole, and in how many ways
START_S = 1.3  # of the same that it is begun with in many ways after that
LEAST_S = 3.0  # of a record, before anything is tried
NEWS_S = 0.4  # of readings, before another lap
LONGEST_S, KEPT_S = 14.0, 8.0  # a record so long is folded to that
WORTH_S = 6.0  # of a record that was explained: another start would hardly go further
CONTACTS_S = 2.0  # of readings before what is new, that their smoothed courses begin with
MOST_RIVALS = 2
OTHER_WAYS, AGAIN_LONGER = 2, 1.3  # that are tried in search of the same motion, and when again
SHORT_S, SHORT_UNTIL_S = 1.3, 6.0  # that it begins with then, after the rest, of records no longer than that
FORKED_A_LAP = 1  # windows of each: whoever needs more is found sooner from contacts of the whole record
PROVEN_S = 5.0  # of going on since two starts led to it: whoever is wrong is lost by then
LATENCY_S = 0.7  # that a simulated one takes; its first answer takes longer
FIRST_LATENCY_S = 1.5


@dataclass(slots=True)
class _Heard:
    """All that has come of one record: rows of readings (t, pad, a, b, force), of joints (t, 3 angles, 6 planned)."""

    readings: list[tuple[float, ...]]
    joints: list[tuple[float, ...]]

    def forget(self, before: float) -> None:
        """What is older (s)."""
        self.readings = [row for row in self.readings if row[0] >= before]
        self.joints = [row for row in self.joints if row[0] >= before]


class IncrementalBodySmoother:
    """Gathers events; `answer` goes on with the rivals as far as the events reach."""

    def __init__(self, rig: ThreePalmsRig) -> None:
        self._rig = rig
        self._waiting: list[Event] = []
        self._heard = _Heard([], [])
        self._begun = self._start = math.nan
        self._clear()

    def _clear(self) -> None:
        self._running: list[Grown] = []
        self._attempt = 0
        self._reached = -math.inf
        self._folded, self._looked = False, 0  # intervals when it was last looked for another start to the same
        self._owed = False  # short starts, in the next lap
        self._not_met()
        self._bent = 0.0  # what it cost more before it was given finer harmonics
        self._before = np.zeros(len(icosphere()[0]), dtype=bool)  # touched in what has been folded

    def _not_met(self) -> None:
        """Nothing is believed of who is followed until two starts have come to it."""
        self._met_since = math.inf
        self._believed = False  # claimed since

    def add(self, events: Sequence[Event]) -> None:
        """Events of some ticks; may be called while another thread answers."""
        self._waiting.extend(events)  # in one step, and never another list

    @one_thread()
    def answer(self) -> BodyAnswer | None:
        """What the readings tell, or why they do not; None before there is anything new to say."""
        self._take()
        task = self._task()
        if task is None:
            if not self._running:  # at rest, or not on all palms, for as long as that may be
                newest = max((row[0] for row in (*self._heard.readings[-1:], *self._heard.joints[-1:])), default=0.0)
                self._heard.forget(newest - LONGEST_S)
            return None
        begun, begins = self._begun, not self._running  # giving up forgets it
        if begins and not self._try(task):
            return _unknown(task, begun, "no motion is known yet that explains the readings")
        self._reached = task.end
        before = self._running[0].intervals
        ended = raced(task, self._running, forks=FORKED_A_LAP)
        ended.sort(key=lambda each: (-each.intervals, each.cost))
        first = ended[0]
        if not begins and first.startled(first.intervals - before):  # ways on that differ may all be explained
            first = ended[0] = replace(first, confirmed=0)
            self._looked = 0
            self._not_met()
        if first.lost or first.intervals < task.intervals(task.end - task.start):
            self._give_up(first, task)
            return _unknown(task, begun, "what explained the readings does so no more")
        if first.since_whole > 1.0:  # it was given up before it was smoothed, and smoothed the others cost more
            first = ended[0] = smoothed(task, first)
        if first.found_twice and first.per_number < HOPELESS:
            bent = finer(task, first, FINER_LIVE)
            if bent.order > first.order:
                self._bent += first.cost - bent.cost
            first = ended[0] = bent
        grown = first
        if not begins:  # else the answer would wait for it
            ended = self._found_again(task, ended)
            first = ended[0]
        if not (first.found_twice or first.same_as(grown)):
            self._not_met()
        elif first.found_twice:
            self._met_since = min(self._met_since, float(first.record.t[-1]))
        near_it = [each for each in ended if not each.lost and each.cost < first.cost + BEHIND]
        self._running = near_it[:MOST_RIVALS]
        said = self._answer(task, ended)
        if first.intervals * SPACING_S > LONGEST_S and not first.confirmed:
            self._begin_anew(task.end - KEPT_S)
        elif first.intervals * SPACING_S > LONGEST_S:
            self._folded = True
            more = first.intervals - round(KEPT_S / SPACING_S)
            self._before |= near(first.felt[: len(PALMS) * more])
            self._start, self._running = task.start + more * SPACING_S, [folded(task, first, more, self._before)]
            self._heard.forget(self._start - CONTACTS_S)
        return said

    # ---- its parts ---------------------------------------------------------------------------------------

    def _take(self) -> None:
        """Sort in what has come; pads that fall silent say so by their gaps."""
        events = self._waiting[:]
        del self._waiting[: len(events)]
        for event in events:
            if isinstance(event, PalmSample):
                planned = (*(event.rates or (math.nan,) * 3), *(event.accelerations or (math.nan,) * 3))
                self._heard.joints.append((event.t_sample, *event.angles, *planned))
            elif isinstance(event, PadSample) and event.across is not None:
                force = math.nan if event.force is None else event.force
                self._heard.readings.append((event.t_sample, event.pad - 1, event.across, event.s, force))

    def _begin_anew(self, t: float) -> None:
        """Nothing before t (s) is of the body that there is from now on."""
        self._heard.forget(t)
        self._begun = self._start = math.nan
        self._clear()

    def _task(self) -> Task | None:
        """What there is to explain; None while it is too little, or nothing new."""
        if len(self._heard.joints) < 10 or len(self._heard.readings) < 100:
            return None
        told = np.array(sorted(self._heard.readings))
        joints = np.array(sorted(self._heard.joints))
        joints = joints[np.concatenate([[True], np.diff(joints[:, 0]) > 1e-6])]
        each = [told[told[:, 1] == pad, 0] for pad in range(len(PALMS))]
        if any(len(t) < 10 for t in each):
            return None
        start = max(t[0] for t in (*each, joints[:, 0]))
        gaps = [t[1:][np.diff(t) > GAP_S] for t in (*each, joints[:, 0])]
        if any(len(ends) for ends in gaps):
            start = max(start, *(float(ends[-1]) for ends in gaps if len(ends)))
        if not self._start >= start:
            self._begun = self._start = float(start)
            self._clear()
        end = float(min(t[-1] for t in (*each, joints[:, 0])))
        if not self._running:
            mine = joints[(joints[:, 0] >= start) & (joints[:, 0] <= end)]
            moved = np.abs(mine[:, 1:4] - mine[:1, 1:4]).max(axis=1)
            if not (moved > MOVED_RAD).any():
                return None
            self._start = max(self._start, float(mine[int(np.argmax(moved > STILL_RAD)), 0]) - REST_S)
        if end - self._start < LEAST_S or end - self._reached < NEWS_S:
            return None
        plan = joints[:, 4:].reshape(-1, 2, 3)
        path = joint_path(joints[:, 0], joints[:, 1:4], None if np.isnan(plan).any() else plan, self._rig.angle_noise)
        readings = PadReadings(told[:, 0], told[:, 1].astype(np.int64), told[:, 2:4], told[:, 4])
        since = self._reached - CONTACTS_S if self._running else -math.inf
        contacts = ContactCurves.smoothed(readings.within(since, math.inf))
        return Task(path, readings, contacts, self._rig, self._start, end)

    def _try(self, task: Task) -> bool:
        """Begin from nothing in one manner, another one each time; whether there is a rival.

        All at once, where the first way explains it; with what came since; short starts.
        """
        attempt, self._attempt = self._attempt, (self._attempt + 1) % 3
        if attempt < 2:
            record, ways = task.record(WHOLE_S), islice(beliefs.hypotheses(), WHOLE_WAYS)
            found = anew(task, record, islice(ways, 1) if attempt == 0 else ways)
            if attempt == 0:  # what is strange now may not be so with more
                found = found_again(task, found, ways) if found and found[0].strange <= CHANCE else []
            self._running = [each for each in found if each.per_number < SURE][:MOST_RIVALS]
            self._looked = len(record.middle_palms)
        else:
            short = [each for each in rivals(task, START_S) if each.per_number < HOPELESS]
            self._running = begun_in_ways(task, short, forks=0)[:MOST_RIVALS]
            self._looked = 0
        if not self._running and self._attempt == 0:
            self._begin_anew(task.end - LEAST_S)
        return bool(self._running)

    def _found_again(self, task: Task, ended: list[Grown]) -> list[Grown]:
        """The rivals with what other blind starts lead to, where it is time to look for some.

        Of one kind in a lap, lest the answer waits for all: those of the whole record, then, if the motion is still
        strange, those of its first second.
        """
        first = ended[0]
        short = first.intervals * SPACING_S < SHORT_UNTIL_S
        searched = short or not self._believed  # later on it is what harmonics leave out that is strange
        strange, owed = searched and first.strange > CHANCE, self._owed
        self._owed = False
        if owed and strange and not self._folded:
            ended = self._short_starts(task, ended)
            if ended[0].same_as(first):
                return ended
        elif first.intervals < AGAIN_LONGER * self._looked or (first.found_twice and (self._folded or not strange)):
            return ended
        else:
            self._owed = strange and short
        self._looked = first.intervals
        if self._folded:
            alike = moves_so(task, first, islice(beliefs.hypotheses(), OTHER_WAYS))  # of another frame
            return [replace(first, confirmed=first.intervals) if alike else first, *ended[1:]]
        together = [each for each in ended if each.intervals == first.intervals and not each.lost]
        return found_again(task, together, islice(beliefs.hypotheses(), OTHER_WAYS), believed=self._believed)

    def _short_starts(self, task: Task, ended: list[Grown]) -> list[Grown]:
        """The rivals with what starts in many ways lead to: contacts of all the record may lead nowhere right."""
        first = ended[0]
        whole = replace(task, contacts=ContactCurves.smoothed(task.readings))
        begun = begun_in_ways(whole, rivals(whole, REST_S + SHORT_S), forks=0)
        short = raced(whole, begun, first.cost + BEHIND, FORKED_A_LAP)
        together = [each for each in (*ended, *short) if each.intervals == first.intervals and not each.lost]
        return apart(sorted(together, key=lambda each: each.cost))

    def _give_up(self, first: Grown, task: Task) -> None:
        """None of the rivals goes on: others, of the readings from the beginning or of those since it was lost."""
        lost_at = float(first.record.t[-1])
        self._running = []
        self._not_met()
        if lost_at - task.start > WORTH_S or self._attempt == 0:
            self._begin_anew(max(lost_at, task.end - LEAST_S))

    def _answer(self, task: Task, ended: Sequence[Grown]) -> BodyAnswer:
        first, rig = ended[0], self._rig
        try:
            covariance: FloatArray = np.asarray(np.linalg.inv(first.ahead.information), np.float64)
        except np.linalg.LinAlgError:
            return _unknown(task, self._begun, "the fit is not a minimum")
        x, hollow = first.made_convex(np.concatenate([np.zeros(STATES), first.ahead.mean]), covariance)
        turned, spin, p = rotation.exp(x[:3]) @ first.ahead.R, first.ahead.spin + x[3:STATES], x[STATES:]
        touched = self._before | near(first.felt)  # as it is known now: earlier answers may have erred
        centre_sd = beliefs.missed_sd(task.noise.reading, first.unexplained(self._bent))
        felt, felt_sd = surface(p, covariance[STATES:, STATES:], touched, first.whole.chi2, centre_sd)
        p, covariance = felt_outline(p, covariance, touched, ORDER)
        h, h_sd = surface(p, covariance[STATES:, STATES:], touched, first.whole.chi2, centre_sd)
        h[touched], h_sd[touched] = felt[touched], felt_sd[touched]  # what was felt, as finely as it is known
        covariance = beliefs.with_centre(covariance, STATES, centre_sd)
        proven = float(first.record.t[-1]) - self._met_since > PROVEN_S
        reason = doubt(task, ended, h_sd[touched], hollow, proven=proven)
        if not reason and not first.found_twice:
            reason = ALONE
        if not reason and self._owed:
            reason = "the readings are not explained to their noise, and other starts are still to be tried"
        if not reason:
            self._believed = True
        mass, mass_sd = mass_of(rig, first)
        return BodyAnswer(
            t=float(first.record.t[-1]), begun=self._begun, claimed=not reason, reason=reason,
            hypotheses=len(self._running), R=turned, omega=spin, p=p,
            covariance=0.5 * (covariance + covariance.T), h=h, h_sd=h_sd, touched=touched.astype(np.float64),
            inertia_sd=inertia_sd(p, covariance[STATES:, STATES:]).ravel(),
            mass=mass, mass_sd=math.hypot(mass_sd, PRESSURE_GAIN_STD * mass),
            rough=beliefs.missed_sd(task.noise.reading, max(first.per_number - 1.0, 0.0)),
        )  # fmt: skip


def _unknown(task: Task, begun: float, reason: str) -> BodyAnswer:
    none, square = np.zeros(0), np.zeros((0, 0))
    return BodyAnswer(
        task.end, begun, False, reason, 0, np.zeros((0, 3)), none, none, square, none, none, none, none, math.nan,
        math.nan,
    )  # fmt: skip


class SimulatedIncrementalSmoother:
    """The smoother as it would run beside the loop: its answer comes a fixed time after it was begun."""

    def __init__(self, rig: ThreePalmsRig) -> None:
        self._smoother = IncrementalBodySmoother(rig)
        self._ready: tuple[float, BodyAnswer | None] | None = None
        self._known = False

    def submit(self, t: float, events: Sequence[Event]) -> None:
        """Take the tick's events, and begin when it is free."""
        self._smoother.add(events)
        if self._ready is not None:
            return
        answer = self._smoother.answer()
        if answer is not None:
            known = bool(answer.hypotheses)
            self._ready = (t + (LATENCY_S if known and self._known else FIRST_LATENCY_S), answer)
            self._known = known

    def collect(self, t: float) -> BodyAnswer | None:
        """What was begun at least the latency ago."""
        if self._ready is None or t < self._ready[0]:
            return None
        answer, self._ready = self._ready[1], None
        return answer
