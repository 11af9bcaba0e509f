"""Incremental smoother of a live body between three palms: propagates hypotheses as readings come. Not for the loop.

Each update does with the readings so far what `reconstruct` does with a whole record: hypotheses from blind starts are
propagated to the newest reading, and the best one has to pass the same tests. Old readings are marginalised, so that an
update costs no more after an hour than after a quarter of a minute.
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
from palmd.observer.smoothing import SimulatedSmoothingOfOne
from palmd.observer.three_palms import beliefs
from palmd.observer.three_palms.arrow import STATES
from palmd.observer.three_palms.body import FINER_ORDERS_LIVE, ORDER
from palmd.observer.three_palms.driven import ContactCurves
from palmd.observer.three_palms.path import joint_path
from palmd.observer.three_palms.propagation import (
    PRUNE_COST,
    TRUNCATION_COST,
    BodyHypothesis,
    branch_starts,
    confirm_by_restarts,
    fit_blind_starts,
    marginalised,
    merge_duplicates,
    propagate_and_prune,
    refine_outline,
    refit,
    restart_has_motion,
)
from palmd.observer.three_palms.reconstruct import UNCONFIRMED, inertia_sd, mass_of, rejection_reason, surface
from palmd.observer.three_palms.record import PadReadings
from palmd.observer.three_palms.search import CHANCE_SD, HOPELESS_COST, SPACING_S, Task, start_candidates
from palmd.observer.three_palms.touched_outline import directions_near, touched_outline
from palmd.system.reasons import Code, Reason
from palmd.system.three_palms import GAP_S, PALMS, BodyAnswer, ThreePalmsRig

REST_S = 0.4  # rest before the palms move that a record begins with
STILL_RAD, MOVED_RAD = 5e-3, 0.1  # rad; turn of a joint from which it moves, and from which a search begins
WHOLE_S, WHOLE_START_ASSUMPTIONS = 5.0, 3  # length of a start on the whole record; number of start assumptions
SHORT_START_S = 1.3  # length of the short starts that are branched afterwards
LEAST_S = 3.0  # record length before anything is tried
UPDATE_EVERY_S = 0.4  # new readings before the next update
MARGINALISE_AFTER_S, KEPT_S = 14.0, 8.0  # a record longer than the first is marginalised to the second
LONG_EXPLAINED_S = 6.0  # a hypothesis that explained so long a record is not followed by others on the same readings
CONTACT_OVERLAP_S = 2.0  # readings before the new ones that are included in the smoothed contacts
MOST_HYPOTHESES = 2  # hypotheses kept between updates
RESTART_ASSUMPTIONS, RESTART_GROWTH = 2, 1.3  # restarts for confirmation; growth of the record until they are repeated
SHORT_S, SHORT_UNTIL_S = 1.3, 6.0  # length of short restarts after the rest; record length up to which they are tried
BRANCHINGS_PER_UPDATE = 1  # windows per hypothesis; more are slower than a start on the whole record
PROVEN_S = 5.0  # prediction after the confirmation; wrong hypotheses are lost by then
LATENCY_S = 0.7  # of a simulated smoother
FIRST_LATENCY_S = 1.5  # of its first answer


@dataclass(slots=True)
class _EventBuffer:
    """Received rows: readings (t, pad, a, b, force), joints (t, 3 angles, 3 planned rates, 3 planned accelerations)."""

    readings: list[tuple[float, ...]]
    joints: list[tuple[float, ...]]

    def forget(self, before: float) -> None:
        """Drop rows from before the time `before` (s)."""
        self.readings = [row for row in self.readings if row[0] >= before]
        self.joints = [row for row in self.joints if row[0] >= before]


class IncrementalBodySmoother:
    """Collects events; `answer` propagates the hypotheses to the newest one."""

    def __init__(self, rig: ThreePalmsRig) -> None:
        self._rig = rig
        self._incoming: list[Event] = []
        self._buffer = _EventBuffer([], [])
        self._record_start = self._start = math.nan
        self._clear()

    def _clear(self) -> None:
        self._hypotheses: list[BodyHypothesis] = []
        self._attempt = 0
        self._processed_until = -math.inf
        # whether readings were marginalised; length of the record in intervals when restarts were last tried
        self._marginalised, self._restarts_tried_at = False, 0
        self._short_starts_due = False  # short starts are due in the next update
        self._reset_confirmation()
        self._hidden_cost = 0.0  # cost that finer harmonics have absorbed
        self._touched_before = np.zeros(len(icosphere()[0]), dtype=bool)  # touched in the marginalised part

    def _reset_confirmation(self) -> None:
        """Require a new confirmation by an independent restart."""
        self._confirmed_since = math.inf
        self._accepted = False  # whether an answer has been accepted since the confirmation

    def add(self, events: Sequence[Event]) -> None:
        """Add the events of some ticks; may be called while another thread runs `answer`."""
        self._incoming.extend(events)  # atomic; the list object must not be replaced

    @one_thread()
    def answer(self) -> BodyAnswer | None:
        """Update the estimate: an answer, accepted or with the reason why not; None without enough new readings."""
        self._sort_events()
        task = self._task()
        if task is None:
            if not self._hypotheses:  # at rest, or not on all palms, possibly for long
                newest = max((row[0] for row in (*self._buffer.readings[-1:], *self._buffer.joints[-1:])), default=0.0)
                self._buffer.forget(newest - MARGINALISE_AFTER_S)
            return None
        record_start, is_new = self._record_start, not self._hypotheses  # before `_give_up` resets it
        if is_new and not self._start_search(task):
            return _unknown_answer(task, record_start, Code.NO_OBJECT, "no motion found yet that explains the readings")
        self._processed_until = task.end
        before = self._hypotheses[0].intervals
        ended = propagate_and_prune(task, self._hypotheses, branchings=BRANCHINGS_PER_UPDATE)
        ended.sort(key=lambda each: (-each.intervals, each.cost))
        first = ended[0]
        if not is_new and first.failed_innovation_test(first.intervals - before):
            first = ended[0] = replace(first, confirmed=0)  # other continuations may explain the readings, too
            self._restarts_tried_at = 0
            self._reset_confirmation()
        if first.lost or first.intervals < task.intervals(task.end - task.start):
            self._give_up(first, task)
            return _unknown_answer(task, record_start, Code.UNEXPLAINED, "the motion no longer explains the readings")
        if first.growth_since_refit > 1.0:  # it was pruned before its refit, and the others cost more after theirs
            first = ended[0] = refit(task, first)
        if first.is_confirmed and first.cost_per_number < HOPELESS_COST:
            refined = refine_outline(task, first, FINER_ORDERS_LIVE)
            if refined.order > first.order:
                self._hidden_cost += first.cost - refined.cost
            first = ended[0] = refined
        propagated = first
        if not is_new:  # not in the first update, whose answer it would delay
            ended = self._confirm(task, ended)
            first = ended[0]
        if not (first.is_confirmed or first.is_duplicate_of(propagated)):
            self._reset_confirmation()
        elif first.is_confirmed:
            self._confirmed_since = min(self._confirmed_since, float(first.record.t[-1]))
        near_best = [each for each in ended if not each.lost and each.cost < first.cost + PRUNE_COST]
        self._hypotheses = near_best[:MOST_HYPOTHESES]
        answer = self._make_answer(task, ended)
        if first.intervals * SPACING_S > MARGINALISE_AFTER_S and not first.confirmed:
            self._restart_record(task.end - KEPT_S)
        elif first.intervals * SPACING_S > MARGINALISE_AFTER_S:
            self._marginalised = True
            more = first.intervals - round(KEPT_S / SPACING_S)
            self._touched_before |= directions_near(first.touched_normals[: len(PALMS) * more])
            self._start, self._hypotheses = (
                task.start + more * SPACING_S,
                [marginalised(task, first, more, self._touched_before)],
            )
            self._buffer.forget(self._start - CONTACT_OVERLAP_S)
        return answer

    # ---- its parts ---------------------------------------------------------------------------------------

    def _sort_events(self) -> None:
        """Move new events to the buffer; the end of a contact shows as a gap in the readings."""
        events = self._incoming[:]
        del self._incoming[: len(events)]
        for event in events:
            if isinstance(event, PalmSample):
                planned = (*(event.rates or (math.nan,) * 3), *(event.accelerations or (math.nan,) * 3))
                self._buffer.joints.append((event.t_sample, *event.angles, *planned))
            elif isinstance(event, PadSample) and event.across is not None:
                force = math.nan if event.force is None else event.force
                self._buffer.readings.append((event.t_sample, event.pad - 1, event.across, event.s, force))

    def _restart_record(self, t: float) -> None:
        """Start a new record at t (s), dropping older events."""
        self._buffer.forget(t)
        self._record_start = self._start = math.nan
        self._clear()

    def _task(self) -> Task | None:
        """The record so far; None if it is too short or has too few new readings."""
        if len(self._buffer.joints) < 10 or len(self._buffer.readings) < 100:
            return None
        readings_rows = np.array(sorted(self._buffer.readings))
        joints = np.array(sorted(self._buffer.joints))
        joints = joints[np.concatenate([[True], np.diff(joints[:, 0]) > 1e-6])]
        each = [readings_rows[readings_rows[:, 1] == pad, 0] for pad in range(len(PALMS))]
        if any(len(t) < 10 for t in each):
            return None
        start = max(t[0] for t in (*each, joints[:, 0]))
        gaps = [t[1:][np.diff(t) > GAP_S] for t in (*each, joints[:, 0])]
        if any(len(ends) for ends in gaps):
            start = max(start, *(float(ends[-1]) for ends in gaps if len(ends)))
        if not self._start >= start:
            self._record_start = self._start = float(start)
            self._clear()
        end = float(min(t[-1] for t in (*each, joints[:, 0])))
        if not self._hypotheses:
            mine = joints[(joints[:, 0] >= start) & (joints[:, 0] <= end)]
            moved = np.abs(mine[:, 1:4] - mine[:1, 1:4]).max(axis=1)
            if not (moved > MOVED_RAD).any():
                return None
            self._start = max(self._start, float(mine[int(np.argmax(moved > STILL_RAD)), 0]) - REST_S)
        if end - self._start < LEAST_S or end - self._processed_until < UPDATE_EVERY_S:
            return None
        plan = joints[:, 4:].reshape(-1, 2, 3)
        path = joint_path(joints[:, 0], joints[:, 1:4], None if np.isnan(plan).any() else plan, self._rig.angle_noise)
        readings = PadReadings(
            readings_rows[:, 0], readings_rows[:, 1].astype(np.int64), readings_rows[:, 2:4], readings_rows[:, 4]
        )
        since = self._processed_until - CONTACT_OVERLAP_S if self._hypotheses else -math.inf
        contacts = ContactCurves.smoothed(readings.within(since, math.inf))
        return Task(path, readings, contacts, self._rig, self._start, end)

    def _start_search(self, task: Task) -> bool:
        """Search for hypotheses by one of three methods, in turn; returns whether there is one.

        Methods: the whole start with the first assumption, accepted if that explains it; the whole start with all
        assumptions; short starts with branches.
        """
        attempt, self._attempt = self._attempt, (self._attempt + 1) % 3
        if attempt < 2:
            record, assumptions = task.record(WHOLE_S), islice(beliefs.start_assumptions(), WHOLE_START_ASSUMPTIONS)
            found = fit_blind_starts(task, record, islice(assumptions, 1) if attempt == 0 else assumptions)
            if attempt == 0:  # a cost that is too high now may not be with more readings
                found = (
                    confirm_by_restarts(task, found, assumptions) if found and found[0].excess_sd <= CHANCE_SD else []
                )
            self._hypotheses = [each for each in found if each.cost_per_number < TRUNCATION_COST][:MOST_HYPOTHESES]
            self._restarts_tried_at = len(record.middle_palms)
        else:
            short = [each for each in start_candidates(task, SHORT_START_S) if each.cost_per_number < HOPELESS_COST]
            self._hypotheses = branch_starts(task, short, branchings=0)[:MOST_HYPOTHESES]
            self._restarts_tried_at = 0
        if not self._hypotheses and self._attempt == 0:
            self._restart_record(task.end - LEAST_S)
        return bool(self._hypotheses)

    def _confirm(self, task: Task, ended: list[BodyHypothesis]) -> list[BodyHypothesis]:
        """Try to confirm the best hypothesis by restarts when they are due; returns all hypotheses.

        Only one kind of restart per update, so that the answer is not delayed: on the whole record, then, if the cost
        is still too high, on its first second.
        """
        first = ended[0]
        short = first.intervals * SPACING_S < SHORT_UNTIL_S
        may_search = short or not self._accepted  # afterwards, truncated harmonics are the cause of a high cost
        cost_too_high, short_starts_due = may_search and first.excess_sd > CHANCE_SD, self._short_starts_due
        self._short_starts_due = False
        if short_starts_due and cost_too_high and not self._marginalised:
            ended = self._short_starts(task, ended)
            if ended[0].is_duplicate_of(first):
                return ended
        elif first.intervals < RESTART_GROWTH * self._restarts_tried_at or (
            first.is_confirmed and (self._marginalised or not cost_too_high)
        ):
            return ended
        else:
            self._short_starts_due = cost_too_high and short
        self._restarts_tried_at = first.intervals
        if self._marginalised:  # restarts have another frame
            same_motion = restart_has_motion(task, first, islice(beliefs.start_assumptions(), RESTART_ASSUMPTIONS))
            return [replace(first, confirmed=first.intervals) if same_motion else first, *ended[1:]]
        together = [each for each in ended if each.intervals == first.intervals and not each.lost]
        return confirm_by_restarts(
            task, together, islice(beliefs.start_assumptions(), RESTART_ASSUMPTIONS), accepted=self._accepted
        )

    def _short_starts(self, task: Task, ended: list[BodyHypothesis]) -> list[BodyHypothesis]:
        """Add hypotheses from short starts with branches: starts on the whole record may all have failed."""
        first = ended[0]
        whole_task = replace(task, contacts=ContactCurves.smoothed(task.readings))
        branches = branch_starts(whole_task, start_candidates(whole_task, REST_S + SHORT_S), branchings=0)
        short = propagate_and_prune(whole_task, branches, first.cost + PRUNE_COST, BRANCHINGS_PER_UPDATE)
        together = [each for each in (*ended, *short) if each.intervals == first.intervals and not each.lost]
        return merge_duplicates(sorted(together, key=lambda each: each.cost))

    def _give_up(self, first: BodyHypothesis, task: Task) -> None:
        """Drop all hypotheses; search again on the whole record, or on a new one from where the best was lost."""
        lost_at = float(first.record.t[-1])
        self._hypotheses = []
        self._reset_confirmation()
        if lost_at - task.start > LONG_EXPLAINED_S or self._attempt == 0:
            self._restart_record(max(lost_at, task.end - LEAST_S))

    def _make_answer(self, task: Task, ended: Sequence[BodyHypothesis]) -> BodyAnswer:
        first, rig = ended[0], self._rig
        try:
            covariance: FloatArray = np.asarray(np.linalg.inv(first.end_belief.information), np.float64)
        except np.linalg.LinAlgError:
            text = "the fit did not converge to a minimum"
            return _unknown_answer(task, self._record_start, Code.NOT_CONVERGED, text)
        x, hollow = first.made_convex(np.concatenate([np.zeros(STATES), first.end_belief.mean]), covariance)
        turned, spin, p = rotation.exp(x[:3]) @ first.end_belief.R, first.end_belief.spin + x[3:STATES], x[STATES:]
        # recomputed, as earlier answers may have been wrong
        touched = self._touched_before | directions_near(first.touched_normals)
        centre_sd = beliefs.unexplained_sd(task.noise.reading, first.excess_cost_per_number(self._hidden_cost))
        fine_h, fine_sd = surface(p, covariance[STATES:, STATES:], touched, first.whole_fit.chi2, centre_sd)
        p, covariance = touched_outline(p, covariance, touched, ORDER)
        h, h_sd = surface(p, covariance[STATES:, STATES:], touched, first.whole_fit.chi2, centre_sd)
        h[touched], h_sd[touched] = fine_h[touched], fine_sd[touched]  # with all harmonics where touched
        covariance = beliefs.widen_centre(covariance, STATES, centre_sd)
        proven = float(first.record.t[-1]) - self._confirmed_since > PROVEN_S
        reason = rejection_reason(task, ended, h_sd[touched], hollow, proven=proven)
        if not reason and not first.is_confirmed:
            reason = UNCONFIRMED
        if not reason and self._short_starts_due:
            reason = Reason(Code.UNEXPLAINED, "the readings are not explained to their noise, and restarts are pending")
        self._accepted |= not reason
        mass, mass_sd = mass_of(rig, first)
        return BodyAnswer(
            t=float(first.record.t[-1]), record_start=self._record_start, accepted=not reason, reason=reason,
            hypotheses=len(self._hypotheses), R=turned, omega=spin, p=p,
            covariance=0.5 * (covariance + covariance.T), h=h, h_sd=h_sd, touched=touched.astype(np.float64),
            inertia_sd=inertia_sd(p, covariance[STATES:, STATES:]).ravel(),
            mass=mass, mass_sd=math.hypot(mass_sd, PRESSURE_GAIN_STD * mass),
            unexplained_sd=beliefs.unexplained_sd(task.noise.reading, max(first.cost_per_number - 1.0, 0.0)),
            reason_code=reason.code,
        )  # fmt: skip


def _unknown_answer(task: Task, record_start: float, code: Code, text: str) -> BodyAnswer:
    none, square = np.zeros(0), np.zeros((0, 0))
    return BodyAnswer(
        task.end, record_start, False, text, 0, np.zeros((0, 3)), none, none, square, none, none, none, none,
        math.nan, math.nan, reason_code=code,
    )  # fmt: skip


class SimulatedIncrementalSmoother(SimulatedSmoothingOfOne[BodyAnswer]):
    """Simulates the smoother beside the loop, whose first answers take longer."""

    def __init__(self, rig: ThreePalmsRig) -> None:
        smoother = IncrementalBodySmoother(rig)
        super().__init__(smoother.add, smoother.answer, _latency_s)


def _latency_s(answer: BodyAnswer, before: BodyAnswer | None) -> float:
    known = before is not None and before.hypotheses and answer.hypotheses
    return LATENCY_S if known else FIRST_LATENCY_S
