"""The paper's quasistatic observer (CMU-CS-01-107, chapter 3), live: (3.33)–(3.35) from the best initial values.

The readings are smoothed by local cubics `LAG_S` behind the present, so that the rates which drive the system come
from readings on both sides. Many initial conditions are integrated side by side (`observer.multi_start`). From time to
time a narrower set is drawn about the likeliest ones and integrated from the stored past, a few steps a tick, until it
replaces the leading set. A set starts at most `WINDOW_S` ago, since the integration drifts.

The model has no friction and no inertia. If friction holds the object off balance, the radii are accurate to a
millimetre or two and the motion is hardly determined, as the standard deviations show; the shape observer is the one to
use. The estimate includes the errors that the paper calls observable, e_f (3.36) and e_c (3.37).
"""

from __future__ import annotations

import dataclasses
import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from palmd.events import Estimate, Event, PadLift, PadSample, PalmMotion, PalmSample, PlanningBelief, ShapeEstimate
from palmd.model import quasistatic as qs
from palmd.model import shape
from palmd.observer.contacts import GONE_S, Contacts, finite
from palmd.observer.coverage import Coverage
from palmd.observer.estimates import BIN_OF_THETA, THETA, empty_estimate, make_estimate
from palmd.observer.local_fit import HALF_WIDTH_S, RecentReadings
from palmd.observer.mass import MassEstimator, resting_forces
from palmd.observer.multi_start import BLOCKS, MOST_RADIUS_M, MultiStart, Spread
from palmd.observer.palms import STILL
from palmd.observer.prior import RADIUS_SD
from palmd.observer.quasistatic_estimate import LeadingSet, named, summarise
from palmd.observer.validity import Evidence, Thresholds, reasons, settled, unmet
from palmd.system.description import RigDescription
from palmd.system.mechanism import OPENING, PALMS

STEP_S = 0.01  # spacing of the nodes
LAG_S = 0.1  # by which the leading set is behind the present
FIRST_S = 0.05  # from the first readings to the first node, where readings can be smoothed
WINDOW_S = 20.0  # longest integration
STEPS_A_TICK = 3  # of the leading set at most, after late ticks
STEPS_BEHIND = 4  # of the succeeding set in a tick, while it catches up
ROUNDS_S = (2.0, 4.0, 8.0)  # times after the start at which a narrower set is drawn; then each `ROUND_EVERY_S`
ROUND_EVERY_S = 8.0
FIRST_WIDTH, FIRST_BALANCE_M = 3 * RADIUS_SD, 2.5e-3  # half-widths of the first set: relative radius, e_f
WIDTH_SDS, LEAST_WIDTH_M = 3.0, 5e-4  # half-width of a narrower set: in 1σ of the weighted set, and at least
# The observer restarts if a reading deviates from the smoothed curve by JUMP_M (the object has jumped), or if the
# conflict stays above AGREEING_M for LOST_FOR_S (friction does not explain that).
JUMP_M = 5e-4
AGREEING_M, LOST_FOR_S = 1.5e-3, 0.3
SETTLED = Thresholds(age_s=2.0, radius_sd_m=2.5e-3, disagreement_m=AGREEING_M)

_ROWS = shape.basis(THETA)


@dataclass(frozen=True, slots=True)
class _Node:
    """One node of the even grid: the smoothed readings, and the leading set's mean at that time."""

    readings: qs.QuasistaticReadings
    mean: float
    balance: float
    psi: float


class QuasistaticObserver:
    """Events in, estimates out. `feed` and `estimate` take bounded time and are safe inside the loop."""

    name = "quasistatic"
    backend = "numpy"
    improvements = 0

    def __init__(self, rig: RigDescription):
        """Deterministic for given events and times."""
        self._rig = rig
        self._palms_seen = self._t_node = -math.inf
        self._t_first = math.inf
        self.reset()

    def reset(self) -> None:
        """Back to the initial state, as if nothing had been fed."""
        self.object_count = 0
        self.late_dropped = 0
        self._contacts = Contacts()
        self.invalid_because = "no initial condition explains the contacts yet"
        self._palms = RecentReadings(4 * HALF_WIDTH_S)
        self._pads = {pad: RecentReadings(4 * HALF_WIDTH_S) for pad in PALMS}
        self._stop()

    def warm_up(self) -> None:
        """Pay the costs of first calls now; ends with a `reset`."""
        for i in range(100):
            t = i * 0.01
            self.feed(PalmSample(t, (0.8, 1.6)))
            for pad in PALMS:
                self.feed(PadSample(t, pad, 0.02, 1.0))
            self.estimate(t)
            self.shape(t)
        self.reset()

    def feed(self, event: Event) -> None:
        """Take one event; an event that is too late to matter is counted and dropped."""
        if isinstance(event, PadLift):
            self._contacts.lift(event.pad)
            return
        if not finite(event) or event.t_sample < self._t_node - HALF_WIDTH_S:
            self.late_dropped += 1
            return
        if isinstance(event, PalmSample):
            self._palms.add(event.t_sample, *event.angles)
            self._palms_seen = max(self._palms_seen, event.t_sample)
        else:
            self._pads[event.pad].add(event.t_sample, event.s)
            self._contacts.read(event)
        if math.isinf(self._t_first) and min(self._contacts.least_recent, self._palms_seen) > -math.inf:
            self._t_first = event.t_sample

    def estimate(self, t: float) -> Estimate:
        """The estimate from the likeliest initial conditions for time `t` (s); never raises, NaN where unknown."""
        if t - min(self._palms_seen, self._contacts.least_recent) > GONE_S and self._contacts.any:
            self._stop()
        self._advance(t)
        found, present = self._found, self._smoothed_readings(t)
        self.invalid_because = "no initial condition explains the contacts yet"
        if found is None or present is None:
            return empty_estimate(t, self.name, self.object_count, None if present is None else _motion(present[0]))
        now, _ = present
        y, sd = named(self._rig, self._nodes[-1].readings, found, now, t - self._t_node)
        if found.conflict < AGREEING_M:
            self._t_agreed = t
        elif t - self._t_agreed > LOST_FOR_S:
            self._restart(t)
            return empty_estimate(t, self.name, self.object_count, _motion(now))
        evidence = Evidence(
            touching=self._contacts.touching(t),
            palms_known=True,
            resumed_for_s=math.inf,
            finite=bool(np.isfinite(y[:11]).all()),
            consistent=True,
            age_s=t - self._t_first,
            radius_sd_m=max(sd[0], sd[1]),
            disagreement_m=found.conflict,
            rig_known=True,
            explained=True,
        )
        valid = settled(evidence, SETTLED)
        self.invalid_because = "" if valid else "; ".join(unmet(evidence, SETTLED, 1.0))
        for pad, f in zip(PALMS, resting_forces(self._rig.gravity, np.array(now.joints)), strict=True):
            self._mass.weigh(self._contacts.last(pad), f)
        if valid:
            self._marks.mark(t, 0, y, lambda: np.zeros(1))
        estimate = make_estimate(
            t,
            valid,
            self.name,
            self.object_count,
            y.tolist(),
            sd.tolist(),
            self._mass,
            math.nan,
            math.nan,
            self._marks.fraction,
            () if valid else reasons(evidence, SETTLED),
        )
        return dataclasses.replace(estimate, e_f=found.e_f, e_c=found.e_c)

    def forget_object(self) -> bool:
        """Drop all readings and sets, as when the object leaves the palms."""
        self._stop()
        return True

    def shape(self, t: float) -> ShapeEstimate | None:
        """The outline of the likeliest initial condition on `DIRECTIONS` normals, None while there is none."""
        found = self._found
        if found is None or self._leader is None:
            return None
        coefficients, covariance = self._leader.outline(found.best)
        variance = ((_ROWS @ covariance) * _ROWS).sum(axis=1) + float(found.sds[:2].max()) ** 2
        return ShapeEstimate(t, THETA, _ROWS @ coefficients, np.sqrt(variance), self._marks.marks[BIN_OF_THETA])

    def improve(self, t: float) -> None:
        """Nothing to do: there is no smoother."""

    @property
    def has_planning_belief(self) -> bool:
        """False: there is never a belief for planning."""
        return False

    @property
    def cornered(self) -> bool:
        """False: corners are not detected."""
        return False

    def planning_belief(self, t: float) -> PlanningBelief | None:  # noqa: ARG002
        """None: the state is not sufficient to predict motions."""
        return None

    def identify(self, t: float) -> None:
        """None: there are no stored objects."""

    # ---- the even grid and the sets of initial conditions on it

    def _stop(self) -> None:
        """Drop all readings and sets: the object has left the palms, or the readings have gaps."""
        self._contacts.clear()
        self._palms_seen = -math.inf
        self._palms.clear()
        for readings in self._pads.values():
            readings.clear()
        self._restart(math.inf)

    def _restart(self, t: float) -> None:
        """Drop all sets after they have diverged; start again with the readings from `t` (s) on."""
        self._t_first, self._t_node, self._t_agreed = t, -math.inf, math.inf
        self._nodes: deque[_Node] = deque(maxlen=round(WINDOW_S / STEP_S))
        self._leader: MultiStart | None = None
        self._found: LeadingSet | None = None
        self._successor: MultiStart | None = None  # a narrower set that catches up with the leader
        self._ahead: deque[qs.QuasistaticReadings] = deque()  # nodes from the successor to the leader
        self._level = 0  # ticks for which the successor has been at the leader's node
        self._rounds = 0
        self._mass = MassEstimator(self._rig.pads)
        self._marks = Coverage()

    def _smoothed_readings(self, t: float) -> tuple[qs.QuasistaticReadings, float] | None:
        """Smoothed readings at `t` (s), and the pads' largest residual (m); None if there are too few readings."""
        pads = [fit for pad in PALMS if (fit := self._pads[pad].at(t)) is not None]
        palms = self._palms.at(t)
        if len(pads) < len(PALMS) or palms is None:
            return None
        angles, rates = palms.value.tolist(), palms.rate.tolist()
        if not 0.0 < angles[OPENING] < math.pi:
            return None
        contacts, sliding = [float(pad.value[0]) for pad in pads], [float(pad.rate[0]) for pad in pads]
        readings = qs.QuasistaticReadings(*contacts, *angles, *sliding, *rates)
        return readings, float(max(pad.misfit[0] for pad in pads))

    def _advance(self, t: float) -> None:
        """Integrate the leading set to `t` − `LAG_S`, and its successor by a few steps."""
        if self._leader is None:
            self._begin(t)
        for _ in range(STEPS_A_TICK):
            if self._leader is None or self._t_node + STEP_S > t - LAG_S:
                break
            smoothed = self._smoothed_readings(self._t_node + STEP_S)
            if smoothed is None:
                self._stop()
                break
            readings, residual = smoothed
            if residual > JUMP_M:
                self._restart(t)
                break
            self._leader.step(self._nodes[-1].readings, readings)
            self._leader.judge()
            self._t_node += STEP_S
            self._add_node(self._leader, readings)
        if self._leader is not None:
            self._advance_successor(self._leader)

    def _begin(self, t: float) -> None:
        start = self._t_first + FIRST_S
        if t - LAG_S < start:
            return
        first = self._smoothed_readings(start)
        if first is None:
            return
        readings, residual = first
        circle = float(sum(readings.contacts) / 2 * np.tan(readings.joints[OPENING] / 2))
        if residual > JUMP_M or not circle < MOST_RADIUS_M:  # infinite for parallel palms
            self._t_first = t
            return
        self._circle = circle
        spread = Spread(self._circle, FIRST_WIDTH * self._circle, 0.0, FIRST_BALANCE_M)
        self._leader = MultiStart(spread, readings, 0.0, self._circle, STEP_S)
        self.object_count += 1
        self._t_node = start
        self._add_node(self._leader, readings)

    def _add_node(self, leader: MultiStart, readings: qs.QuasistaticReadings) -> None:
        """Store a new node with these smoothed `readings`, at which the leader has arrived."""
        self._ahead.append(readings)
        if not leader.judged:
            self._nodes.append(_Node(readings, self._circle, 0.0, 0.0))
            return
        weights = leader.weights()
        if not np.isfinite(weights).all():  # all initial conditions have diverged
            self._restart(self._t_node + LAG_S)
            return
        self._found = found = summarise(leader, readings, weights)
        *radii, psi = found.values[:3].tolist()
        self._nodes.append(_Node(readings, sum(radii) / 2, float(weights @ leader.balance), psi))

    def _advance_successor(self, leader: MultiStart) -> None:
        """Draw a narrower set when it is due, and let it catch up; then it becomes the leader."""
        if self._successor is None:
            if leader.judged and self._t_node - self._t_first > self._next_round():
                self._rounds += 1
                self._draw(leader)
            return
        for _ in range(STEPS_BEHIND):
            if len(self._ahead) > 1:
                here = self._ahead.popleft()
                self._successor.step(here, self._ahead[0])
        self._successor.judge()
        self._level = self._level + 1 if len(self._ahead) == 1 else 0
        if self._level > BLOCKS:
            self._leader, self._successor = self._successor, None

    def _draw(self, leader: MultiStart) -> None:
        """Draw a set about the likeliest initial conditions, from the oldest stored node."""
        first, weights = self._nodes[0], leader.weights()
        balance, mean_then = float(weights @ leader.balance), float(weights @ leader.mean)
        mean = mean_then if leader.steps == len(self._nodes) - 1 else first.mean
        widths = [
            max(WIDTH_SDS * math.sqrt(float(weights @ (values - centre) ** 2)), LEAST_WIDTH_M)
            for values, centre in ((leader.mean, mean_then), (leader.balance, balance))
        ]
        self._successor = MultiStart(
            Spread(mean, widths[0], balance, widths[1]), first.readings, first.psi, self._circle, STEP_S
        )
        self._ahead = deque(node.readings for node in self._nodes)
        self._level = 0

    def _next_round(self) -> float:
        later = self._rounds - len(ROUNDS_S)
        return ROUNDS_S[self._rounds] if later < 0 else ROUNDS_S[-1] + (later + 1) * ROUND_EVERY_S


def _motion(readings: qs.QuasistaticReadings) -> PalmMotion:
    return PalmMotion(tuple(map(float, readings.joints)), tuple(map(float, readings.joint_rates)), STILL)
