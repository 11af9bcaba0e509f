"""The daemon's pure heart: bytes, commands and times in; bytes, answers and messages out.

`Core` never opens a port or a socket and never reads a clock, so the same steps run behind real wires and, in
one process with the emulated plant, faster than real time. One tick is `observe`, `decide`, `report`, in this
order; in between, `receive` takes bytes as they arrive and `transmit` gives the arm its set-points on its own
timer.
"""

from __future__ import annotations

import dataclasses
import logging
import math
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Protocol

import numpy as np

from palmd import __version__
from palmd.config.any_config import AnyConfig
from palmd.daemon.commands import Reply, Request
from palmd.daemon.diagnostics import LOOK_S, ArmDiagnostics, LoopDiagnostics, NisDiagnostics, PadDiagnostics
from palmd.daemon.drivers import ArmDriver, EndName
from palmd.daemon.exploration_requests import Source
from palmd.daemon.exploring import Senses
from palmd.daemon.journal import FaultNotes, Journal, MotionNotes, ObjectNotes, RigNotes
from palmd.daemon.lifecycle import COMMANDED, State
from palmd.daemon.planner import Plan, PlanFolder
from palmd.daemon.setpoints import SetPoints
from palmd.daemon.supervisor import Supervisor
from palmd.daemon.systems import AnySystem, live_system
from palmd.devices.actuator import ArmState
from palmd.devices.port import DevicePort
from palmd.events import Event, Improvement, LiveEstimate, ObjectEstimate, PadLift, PadSample, ShapeEstimate
from palmd.faults import FaultMonitor, Severity
from palmd.messages import (
    Fields,
    contact_fields,
    log_fields,
    motion_fields,
    note_fields,
    object_fields,
    rig_fields,
    state_fields,
)
from palmd.observer.observer import LiveObserver
from palmd.quantities import LOG, NOTE, OBJECT, RIG, STATE, Topic
from palmd.system.rig_constants import said_off

log = logging.getLogger(__name__)

SLOW_TOPIC_S = 1.0 / STATE.rate_hz
_EARLY_S = 1e-3  # ticks jitter; what is due within so much is due now

_MISWIRED = frozenset({"pads-swapped", "pads-mirrored"})
"""Faults of the pads with which no estimate is valid."""


def _always() -> bool:
    return True


class Helper(Protocol):
    """A process beside the loop, as far as it may be at fault."""

    def conditions(self, t: float) -> Iterable[str]:
        """The codes of the fault table that hold at `t` (s)."""


class Core:
    """See the module. Times are seconds on one monotonic clock, never running backwards."""

    def __init__(
        self,
        config: AnyConfig,
        observer: LiveObserver,
        aside: Executor,
        plan: Plan | None = None,
        notes: Iterable[str] = (),
        folder: Path = Path(),
        explorer: Source | None = None,
        system: AnySystem | None = None,
        smoother: Helper | None = None,
    ) -> None:
        """`aside` compiles plans beside the loop, `notes` are codes of faults that stand throughout.

        `folder` is the configuration's. `explorer` decides where explorations go; without one, plans that explore are
        refused. `system` is what the rig is, if it has been made already. `smoother` is the observer's, where it has
        one in a process beside the loop.
        """
        self._system = system = system or live_system(config)
        self.pads = system.pads()
        self.arm = ArmDriver(config.arm, system.poses, system.guards, system.free)
        self._forces = system.force_guard()
        self.setpoints = SetPoints(system.poses, system.limits, system.free)
        self.faults = FaultMonitor()
        self.journal = Journal()
        self.exploring = system.exploring(self.setpoints, explorer)
        plans = PlanFolder.of(config, folder)
        self.supervisor = Supervisor(
            self.arm,
            self.setpoints,
            self.exploring,
            self.faults,
            self.journal,
            aside,
            plan,
            plans,
            autostart=config.autostart,
            system=system,
            forget_object=observer.forget_object,
        )
        self._smoother = smoother
        self._in_state: tuple[State, float, str] = (self.state, math.nan, "")  # since when (s), and why
        self._observer = observer
        self._estimate: LiveEstimate = system.unknown(-math.inf, observer)
        self._shape: ShapeEstimate | None = None
        self._object: ObjectEstimate | None = None
        self._observer_failed = False
        self._events: list[Event] = []
        self._fed: list[Event] = []
        self._answered: object = None
        self._rig_priors = system.rig_priors
        self._rig, self._rig_sds = np.zeros_like(self._rig_priors), self._rig_priors
        self._contradicted, self._is_contradicted = np.zeros_like(self._rig_priors), False
        self._notes = frozenset(notes)
        self._passing: set[str] = set()  # conditions seen since the last decision
        self._pad_watches = {name: PadDiagnostics(name) for name in self.pads}
        self._arm_watch = ArmDiagnostics()
        self._loop_watch = LoopDiagnostics()
        self._nis_watch = NisDiagnostics()
        self._of_system: frozenset[str] = frozenset()  # conditions that only it knows
        self._ports: dict[EndName, DevicePort] = {}
        self._failure = ""
        self._fault_notes, self._object_notes = FaultNotes(self.journal), ObjectNotes(self.journal)
        self._rig_notes, self._motion_notes = RigNotes(self.journal), MotionNotes(self.journal)
        self._t_look = self._t_state = self._t_shape = self._t_rig = self._t_log = -math.inf
        self._t_decided = -math.inf
        self._felt = self._touching()
        self._logged = 0
        self._told: tuple[object, ...] = ()

    @property
    def state(self) -> State:
        """What the daemon is doing."""
        return self.supervisor.state

    @property
    def in_control(self) -> tuple[str, str, str]:
        """The key of the client that has control."""
        return self.supervisor.control.key

    @property
    def estimate(self) -> LiveEstimate:
        """The last tick's."""
        return self._estimate

    # ---- the lines ---------------------------------------------------------------------------------------

    def ports(self) -> dict[EndName, DevicePort]:
        """What the devices are behind, shut."""
        pads = {name: pad.port() for name, pad in self.pads.items()}
        self._ports = pads | {"arm": self.arm.host.port()}
        return self._ports

    def opened(self, end: EndName, t: float) -> None:
        """A port has been opened at `t` (s)."""
        if end == "arm":
            self.arm.opened()
        else:
            self.pads[end].opened(t)

    def lost(self, end: EndName, t: float) -> None:
        """A port has gone at `t` (s)."""
        if end == "arm":
            self.arm.lost()
        else:
            self._take(self.pads[end].lost(t))

    def receive(self, end: EndName, data: bytes, t: float) -> None:
        """Bytes have been read at `t` (s)."""
        if end != "arm":
            self._take(self.pads[end].feed(data, t))
            return
        self._events += self.arm.feed(data, t)

    def look(self, t: float) -> None:
        """Whether a pad has been let go by `t` (s), between ticks, so that the next set-point brakes already.

        All that had come by then must have been received.
        """
        if self.state is not State.TRACKING:
            return
        for pad in self.pads.values():
            self._take(pad.poll(t))
        if self._touching() != self._felt:
            self.decide(t)

    def _take(self, events: Sequence[PadSample | PadLift]) -> None:
        """What pads have told."""
        self._events += events
        for event in events:
            self._forces.feed(event)

    def due(self) -> float:
        """When (s) `transmit` wants to be called next."""
        return self.arm.host.due() if self.arm.is_open else math.inf

    def transmit(self, t: float) -> bytes:
        """What to write to the arm at `t` (s), empty if nothing is due."""
        host, setpoints, actual = self.arm.host, self.setpoints, self.arm.actual
        if not self.arm.is_open or t < host.due():
            return b""
        if not host.tracking or host.pose is None or actual is None:
            return host.poll(t, None).data
        if setpoints.commanded is None:
            setpoints.stand(actual, host.pose, t)
        if host.state is ArmState.HOLD:
            setpoints.displaced(actual, host.pose)
            self.arm.guards.part(t)
        target = setpoints.target(t)
        sent = host.poll(t, target)
        if target is not None and sent.setpoint == target:
            self.arm.lag.sent(t, setpoints.sent(t))
        return sent.data

    # ---- one tick ----------------------------------------------------------------------------------------

    def observe(self, t: float, between: Callable[[], bool] = _always) -> None:
        """Give the observer what has arrived, in the order of the samples' own times; estimate for `t` (s).

        This is the tick's longest part, so `between` is called between the observer's turns: a set-point may
        have fallen due. When it says that there is no more time, what is left is for the next tick: bytes that
        were held up come all at once, and each sets the observer back to its own time.
        """
        self.journal.t = t
        if not self.journal.count:
            self.journal.add("palmd", "begun", f"palmd {__version__} begins, state {self.state}")
        turning = max(map(abs, self.arm.actual.rates)) if self.arm.actual else 0.0
        for pad in self.pads.values():
            self._take(pad.poll(t, turning))
        events, self._events = sorted(self._events, key=_sample_time), []
        self._fed, self._answered = [], None
        try:
            for number, event in enumerate(events, 1):
                self._fed.append(event)
                self._observer.feed(event)
                if isinstance(event, PadSample):
                    self._system.felt(event)
                if not between():
                    self._events = events[number:] + self._events
                    break
            self._answered = self._observer.improve(t)
            self._estimate = self._observer.estimate(t)
            if t - self._t_shape >= SLOW_TOPIC_S - _EARLY_S:
                between()
                self._shape = self._observer.shape(t)
                self._object = self._observer.identify(t)
                self._t_shape = t
        except Exception as error:  # whatever is wrong with a model, the arm must be stopped in good order
            if not self._observer_failed:
                log.exception("the observer failed; this is told once")
            self._observer_failed = True
            self._failure = repr(error)
            self._passing.add("tick-error")
            self._estimate = self._system.unknown(t, self._observer)
        self._of_system = frozenset(self._system.conditions(t, self.arm.actual))
        if self._estimate.valid and self._of_system & _MISWIRED:
            reasons = tuple(sorted(self._of_system & _MISWIRED))
            self._estimate = dataclasses.replace(self._estimate, valid=False, invalid_reasons=reasons)
        if self._estimate.valid and not self._system.sound(self._estimate):
            self._passing.add("estimate-not-finite")
            self._estimate = dataclasses.replace(self._estimate, valid=False, invalid_reasons=("not-finite",))

    def handle(self, request: Request, t: float) -> None:
        """Do what a valid command asks at `t` (s), or refuse; the answer comes with `replies`."""
        self.journal.t = t
        self.supervisor.estimate = self._estimate
        self.supervisor.handle(request, t)

    def decide(self, t: float) -> None:
        """Faults, state and motion at `t` (s), or when they were judged last if that is later."""
        t = self._t_decided = max(t, self._t_decided)
        self._felt = self._touching()
        under_way = self.setpoints.moving or self.setpoints.held
        self.journal.t = t
        present = self._conditions(t, under_way)
        lifted = {f"{name}-lifted" for name in self.pads}
        sure = lifted if lifted <= present else frozenset[str]()  # both pads say so
        self.faults.update(present, t, armed=self.supervisor.armed, sure=sure, evidence=self._guard_evidence)
        if self.arm.guards.following.stands and self.arm.actual is not None:
            self.setpoints.retreat(self.arm.actual, t)
        self._fault_notes.look(self.faults.active, t, self._evidence)
        self._passing.clear()
        self.supervisor.settle(t, up=self._rig_up(t))
        self._enter(t)
        plan = self.supervisor.plan
        if plan is not None and plan.explores:
            self.exploring.prepare()
        self.exploring.step(t, self._senses(t))
        self._motion_notes.look(
            self.exploring.under_way, self.exploring.reason, self.supervisor.plan_name, self.setpoints.over, t
        )
        untouched = [number for number, felt in enumerate(self._felt, 1) if not felt]
        self._object_notes.look(self._estimate.object_count, self._estimate.valid, untouched, t, self._invalid_because)

    def report(self, t: float) -> list[tuple[Topic, Fields]]:
        """What to publish at `t` (s)."""
        arm, place, system = self.arm.host, self.setpoints.place, self._system
        age = arm.age(t)
        motion = motion_fields(
            self.setpoints.commanded,
            self.arm.actual,
            self.supervisor.plan_name,
            -1 if place is None else place.segment,
            0.0 if place is None else place.progress,
            str(arm.state or ""),
            system.naming,
            self.arm.guards.following.errors,
            self.arm.guards.following.limits,
        )
        pads = [pad.view(t) for pad in self.pads.values()]
        messages = [
            (system.topics.estimate, system.said(self._estimate)),
            (system.topics.contact, contact_fields(pads, age if math.isfinite(age) else math.nan, system.naming)),
            (system.topics.motion, motion),
            (system.topics.events, system.fed(t, self._fed)),
        ]
        if self._answered is not None:
            messages.append(self._system.answered(t, self._answered))
        if isinstance(self._answered, Improvement):
            self._rig, self._rig_sds = self._answered.rig, self._answered.rig_sd
            self._contradicted = self._answered.contradicted
            self._is_contradicted = bool(self._contradicted.any())
            self._rig_notes.look(self._contradicted, self._said_off)
        due = isinstance(self._answered, Improvement) or t - self._t_rig >= 1.0 / RIG.rate_hz - _EARLY_S
        if len(self._rig_priors) and due:
            self._t_rig = t
            messages.append((RIG, rig_fields(self._rig, self._rig_sds, self._rig_priors, self._contradicted)))
        control = self.supervisor.control.name
        unattended = self.supervisor.unattended
        told = (self.state, self.faults.active, self.setpoints.running, self.supervisor.wish, control, unattended)
        if told != self._told or t - self._t_state >= SLOW_TOPIC_S - _EARLY_S:
            self._told, self._t_state = told, t
            messages.append((STATE, self._state_fields(t)))
        messages += [(NOTE, note_fields(said_at, text)) for said_at, text in self.supervisor.taken_notes()]
        if self._shape is not None:
            messages.append(self._system.shaped(self._shape))
            self._shape = None
        if self._object is not None:
            messages.append((OBJECT, object_fields(self._object)))
            self._object = None
        news, since = self.journal.count != self._logged, t - self._t_log
        if since >= (SLOW_TOPIC_S if news else 1.0 / LOG.rate_hz) - _EARLY_S:
            self._logged, self._t_log = self.journal.count, t
            messages.append((LOG, log_fields(self.journal.entries)))
        return messages

    def _state_fields(self, t: float) -> Fields:
        self._enter(t)
        state, since, cause = self._in_state
        running, explored = self.setpoints.running, self.exploring.explored
        wish, control, unattended = self.supervisor.wish, self.supervisor.control.name, self.supervisor.unattended
        faults = self.faults.active
        return state_fields(str(state), faults, cause, wish, t - since, running, explored, control, unattended)

    def _enter(self, t: float) -> None:
        """Keep what has brought the state about, and what speaks for it, while it still does."""
        state, since, _ = self._in_state
        if state is not self.state or math.isnan(since):
            cause = self.supervisor.cause + (self._grounds(t) if self.state in (State.HOLD, State.FAULT) else "")
            self._in_state = (self.state, t, cause)

    def _grounds(self, t: float) -> str:
        """What speaks at `t` (s) for the faults that hold or stop the palms."""
        codes = [fault.code for severity in (Severity.HOLD, Severity.STOP) for fault in self.faults.standing(severity)]
        told = "; ".join(filter(None, (self._evidence(code, t) for code in codes)))
        return f" ({told})" if told else ""

    def replies(self) -> list[Reply]:
        """The answers that have come due since the last call."""
        replies, self.supervisor.replies = self.supervisor.replies, []
        return replies

    def step(self, t: float, requests: Iterable[Request] = ()) -> list[tuple[Topic, Fields]]:
        """A whole tick at once, for a rig without wires."""
        self.observe(t)
        for request in requests:
            self.handle(request, t)
        self.decide(t)
        return self.report(t)

    # ---- beside the ticks --------------------------------------------------------------------------------

    def overran(self, t: float, late_s: float, why: str = "") -> None:
        """The tick that ended at `t` (s) did so `late_s` after its deadline, so that others had to be skipped."""
        self._loop_watch.overran(t, late_s, why)

    def fail(self, t: float, error: Exception) -> None:
        """The tick at `t` (s) raised something unexpected: make for standing still with as little as can be."""
        self._failure = repr(error)
        self.faults.update({"tick-error"}, t, armed=True)
        self.supervisor.fall()

    def close(self) -> None:
        """Make for a planned stop, and take no more commands that move."""
        self.journal.add("palmd", "stopping", "palmd was told to end: a planned stop")
        self.supervisor.close()

    @property
    def at_rest(self) -> bool:
        """Whether the arm is known to stand: never commanded, or reported at rest since."""
        return self.supervisor.at_rest

    def counters(self) -> Fields:
        """What has passed on the lines, by the names of `palm/loop`."""
        counts: Fields = {}
        for name, pad in self.pads.items():
            counts |= {f"{name}_{what}": n for what, n in pad.counts().items()}
        counts |= {f"arm_{what}": n for what, n in self.arm.host.counts().items()}
        counts["arm_bad_poses"] = self.arm.bad_poses
        counts["arm_guard_interventions"] = self.setpoints.interventions
        counts["lag_ms"] = self.arm.lag.lag_s * 1e3
        counts["late_dropped"] = self._observer.late_dropped
        counts["explorer_dropped"] = self.exploring.dropped
        return counts

    def _touching(self) -> tuple[bool, ...]:
        return tuple([pad.touching for pad in self.pads.values()])

    def _senses(self, t: float) -> Senses:
        return Senses(
            tracking=self.state is State.TRACKING,
            touching=all(self._felt),
            known=self._observer.has_planning_belief,
            object_count=self._observer.object_count,
            look=lambda: self._observer.planning_belief(t),
            sticking=self._system.sticking,
            cornered=self._observer.cornered,
        )

    def _conditions(self, t: float, under_way: bool) -> set[str]:
        """The codes of the fault table that hold at `t` (s)."""
        look = t - self._t_look >= LOOK_S
        if look:
            self._t_look = t
        state = self.state
        commanded, held = state in COMMANDED, state is State.HOLD
        present = self._passing | self._notes
        for name, watch in self._pad_watches.items():
            present.update(watch.conditions(self.pads[name], under_way, held, look))
        present.update(self._arm_watch.conditions(self.arm, t, commanded, look))
        present.update(self._loop_watch.conditions(t, self._observer.late_dropped, look))
        present.update(self.supervisor.recorder.conditions(t))
        if self._smoother is not None:
            present.update(self._smoother.conditions(t))
        present.update(self._nis_watch.conditions(self._estimate.nis, self.setpoints.moving, t))
        if commanded and (self.setpoints.violated or self._outside()):
            present.add("limits-violated")
        present.update(self.arm.guards.conditions(t))
        if commanded:
            present.update(self._forces.conditions(under_way=under_way))
        present |= self._of_system
        if self._is_contradicted:
            present.add("rig-contradicted")
        if self.supervisor.plan_refused:
            present.add("plan-refused")
        if self.supervisor.operator_lost:
            present.add("operator-lost")
        if self.exploring.silent:
            present.add("explorer-silent")
        if self.setpoints.moving and all(self._felt) and not self._estimate.valid:
            present.add("estimate-lost")
        return present.difference(self._system.excused(self.exploring))

    def _invalid_because(self) -> str:
        return self._observer.invalid_because

    def _evidence(self, code: str, t: float) -> str:
        """What speaks for a fault that has come up at `t` (s), in words; empty where there is no more to say."""
        end, _, condition = code.partition("-")
        if end in self._ports and condition == "port":
            return self._ports[end].error or ""
        if end in self.pads:
            return self.pads[end].evidence(condition, t)
        match code:
            case "tick-error":
                return self._failure
            case "estimate-not-finite" | "estimate-lost":
                because = self._observer.invalid_because
                return f"object {self._estimate.object_count}" + (f": {because}" if because else "")
            case "limits-violated":
                return self._angles_told()
            case "loop-overrun" | "loop-overruns" | "samples-too-late":
                return self._loop_watch.evidence(code)
            case "plan-refused":
                return self.supervisor.refusal
            case "operator-lost":
                return f"the lease of {self.supervisor.operator_lost} ran out"
            case "estimate-inconsistent":
                return self._nis_watch.evidence
            case "rig-contradicted":
                return "; ".join(self._said_off())
            case "recorder-failed" | "recorder-silent":
                return self.supervisor.recorder.evidence(code, t)
        return self.arm.host.evidence(condition, t) if end == "arm" else ""

    def _guard_evidence(self, code: str) -> str:
        """What speaks for a guard's fault, in words with numbers."""
        if code in ("force-limit", "force-excess"):
            return self._forces.evidence()
        return self.arm.guards.evidence().get(code, "") or self._system.evidence(code)

    def _said_off(self) -> list[str]:
        return said_off(self._rig, self._rig_sds, self._rig_priors, self._contradicted)

    def _angles_told(self) -> str:
        actual = self.arm.actual
        if actual is None:
            return ""
        return self._system.place(actual.angles, self.setpoints.limits.angles)

    def _outside(self) -> bool:
        actual = self.arm.actual
        if actual is None:
            return False
        each = zip(actual.angles, self.setpoints.limits.angles, strict=True)
        off = self._system.outside
        return not all(low - off <= angle <= high + off for angle, (low, high) in each)

    def _rig_up(self, t: float) -> bool:
        return (
            self.arm.is_open
            and all(pad.is_open for pad in self.pads.values())
            and self.arm.host.linked(t)
            and self.arm.linked_since_open
        )


def _sample_time(event: Event) -> float:
    return event.t_sample
