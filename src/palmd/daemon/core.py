"""The pure core of the daemon: bytes, commands and times in; bytes, replies and messages out.

`Core` never opens a port or a socket and never reads a clock. The same steps therefore run on real devices and, in one
process with the emulated plant, faster than real time. One tick is `observe`, `decide`, `report`, in this order;
between ticks, `receive` takes bytes as they arrive and `transmit` gives the arm its set-points on its own timer.
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
from palmd.daemon.exploration_requests import DecisionSource
from palmd.daemon.exploring import ExplorationInputs
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
from palmd.system.reasons import Code
from palmd.system.rig_constants import describe_rig_errors

log = logging.getLogger(__name__)

SLOW_TOPIC_S = 1.0 / STATE.rate_hz
_EARLY_S = 1e-3  # ticks jitter; what is due within so much is due now

_MISWIRED = frozenset({"pads-swapped", "pads-mirrored"})
"""Faults of the pads that make every estimate invalid."""


class Helper(Protocol):
    """A process beside the loop, as far as it can raise faults."""

    def conditions(self, t: float) -> Iterable[str]:
        """The fault codes whose condition holds at `t` (s)."""


class Core:
    """See the module. Times are seconds on one monotonic clock that never runs backwards."""

    def __init__(
        self,
        config: AnyConfig,
        observer: LiveObserver,
        background: Executor,
        plan: Plan | None = None,
        notes: Iterable[str] = (),
        folder: Path = Path(),
        explorer: DecisionSource | None = None,
        system: AnySystem | None = None,
        smoother: Helper | None = None,
    ) -> None:
        """`background` compiles plans beside the loop; `notes` are codes of faults that hold throughout.

        `folder` is the configuration's. `explorer` decides where explorations go; without it, plans that explore are
        refused. `system` is made from `config` if not given. `smoother` is the observer's smoother process, if it has
        one.
        """
        self._system = system = system or live_system(config)
        self.pads = system.pads()
        self.arm = ArmDriver(config.arm, system.poses, system.guards, system.free)
        self._forces = system.force_guard()
        self.setpoints = SetPoints(system.poses, system.limits, system.free)
        self.faults = FaultMonitor()
        self.journal = Journal()
        self.exploring = system.exploration_control(self.setpoints, explorer)
        plans = PlanFolder.of(config, folder)
        self.supervisor = Supervisor(
            self.arm,
            self.setpoints,
            self.exploring,
            self.faults,
            self.journal,
            background,
            plan,
            plans,
            autostart=config.autostart,
            system=system,
            forget_object=observer.forget_object,
        )
        self._smoother = smoother
        self._state_entered: tuple[State, float, str] = (self.state, math.nan, "")  # since when (s), and why
        self._observer = observer
        self._estimate: LiveEstimate = system.invalid_estimate(-math.inf, observer)
        self._shape: ShapeEstimate | None = None
        self._object: ObjectEstimate | None = None
        self._observer_failed = False
        self._events: list[Event] = []
        self._fed_events: list[Event] = []
        self._answer: object = None
        self._rig_prior_sds = system.rig_prior_sds
        self._rig, self._rig_sds = np.zeros_like(self._rig_prior_sds), self._rig_prior_sds
        self._contradicted, self._any_contradicted = np.zeros_like(self._rig_prior_sds), False
        self._notes = frozenset(notes)
        self._transient: set[str] = set()  # conditions seen since the last decision
        self._pad_watches = {name: PadDiagnostics(name) for name in self.pads}
        self._arm_watch = ArmDiagnostics()
        self._loop_watch = LoopDiagnostics()
        self._nis_watch = NisDiagnostics()
        self._system_conditions: frozenset[str] = frozenset()  # conditions that only it knows
        self._ports: dict[EndName, DevicePort] = {}
        self._failure = ""
        self._fault_notes, self._object_notes = FaultNotes(self.journal), ObjectNotes(self.journal)
        self._rig_notes, self._motion_notes = RigNotes(self.journal), MotionNotes(self.journal)
        self._t_look = self._t_state = self._t_shape = self._t_rig = self._t_log = -math.inf
        self._t_decided = -math.inf
        self._contacts = self._touching()
        self._logged = 0
        self._published_state: tuple[object, ...] = ()

    @property
    def state(self) -> State:
        """The daemon's lifecycle state."""
        return self.supervisor.state

    @property
    def in_control(self) -> tuple[str, str, str]:
        """The key of the client that has control."""
        return self.supervisor.control.key

    @property
    def estimate(self) -> LiveEstimate:
        """The estimate of the last tick."""
        return self._estimate

    # ---- the lines ---------------------------------------------------------------------------------------

    def ports(self) -> dict[EndName, DevicePort]:
        """The closed ports of all devices."""
        pads = {name: pad.port() for name, pad in self.pads.items()}
        self._ports = pads | {"arm": self.arm.host.port()}
        return self._ports

    def opened(self, end: EndName, t: float) -> None:
        """The port of `end` was opened at `t` (s)."""
        if end == "arm":
            self.arm.opened()
        else:
            self.pads[end].opened(t)

    def lost(self, end: EndName, t: float) -> None:
        """The port of `end` was lost at `t` (s)."""
        if end == "arm":
            self.arm.lost()
        else:
            self._take(self.pads[end].lost(t))

    def receive(self, end: EndName, data: bytes, t: float) -> None:
        """Process bytes of `end` read at `t` (s)."""
        if end != "arm":
            self._take(self.pads[end].feed(data, t))
        else:
            self._events += self.arm.feed(data, t)

    def look(self, t: float) -> None:
        """Check between ticks whether a pad has lost contact by `t` (s), so that the next set-point already brakes.

        All bytes that had arrived by then must have been received.
        """
        if self.state is not State.TRACKING:
            return
        for pad in self.pads.values():
            self._take(pad.poll(t))
        if self._touching() != self._contacts:
            self.decide(t)

    def _take(self, events: Sequence[PadSample | PadLift]) -> None:
        """Queue pad events for the observer and pass them to the force guard."""
        self._events += events
        for event in events:
            self._forces.feed(event)

    def due(self) -> float:
        """When (s) `transmit` must be called next."""
        return self.arm.host.due() if self.arm.is_open else math.inf

    def transmit(self, t: float) -> bytes:
        """Bytes to write to the arm at `t` (s), empty if nothing is due."""
        host, setpoints, actual = self.arm.host, self.setpoints, self.arm.actual
        if not self.arm.is_open or t < host.due():
            return b""
        if not host.tracking or host.pose is None or actual is None:
            return host.poll(t, None).data
        if setpoints.commanded is None:
            setpoints.stand(actual, host.pose, t)
        if host.state is ArmState.HOLD:
            setpoints.restart_at(actual, host.pose)
            self.arm.guards.suspend(t)
        target = setpoints.target(t)
        sent = host.poll(t, target)
        if target is not None and sent.setpoint == target:
            self.arm.lag.sent(t, setpoints.sent(t))
        return sent.data

    # ---- one tick ----------------------------------------------------------------------------------------

    def observe(self, t: float, between: Callable[[], bool] = lambda: True) -> None:
        """Feed the observer with the events that have arrived, ordered by sample time; estimate for `t` (s).

        This is the longest part of the tick, so `between` is called between the observer's steps: a set-point may be
        due. If it returns False, the remaining events are left for the next tick: bytes that were delayed arrive all at
        once, and each such event makes the observer go back to the event's own time.
        """
        self.journal.t = t
        if not self.journal.count:
            self.journal.add("palmd", "begun", f"palmd {__version__} started, state {self.state}")
        turning = max(map(abs, self.arm.actual.rates)) if self.arm.actual else 0.0
        for pad in self.pads.values():
            self._take(pad.poll(t, turning))
        events, self._events = sorted(self._events, key=_sample_time), []
        self._fed_events, self._answer = [], None
        try:
            for number, event in enumerate(events, 1):
                self._fed_events.append(event)
                self._observer.feed(event)
                if isinstance(event, PadSample):
                    self._system.feed_reading(event)
                if not between():
                    self._events = events[number:] + self._events
                    break
            self._answer = self._observer.improve(t)
            self._estimate = self._observer.estimate(t)
            if t - self._t_shape >= SLOW_TOPIC_S - _EARLY_S:
                between()
                self._shape = self._observer.shape(t)
                self._object = self._observer.identify(t)
                self._t_shape = t
        except Exception as error:  # whatever is wrong with a model, the arm must be stopped in good order
            if not self._observer_failed:
                log.exception("the observer failed; further failures are not logged")
            self._observer_failed = True
            self._failure = repr(error)
            self._transient.add("tick-error")
            self._estimate = self._system.invalid_estimate(t, self._observer)
        self._system_conditions = frozenset(self._system.conditions(t, self.arm.actual))
        if self._estimate.valid and self._system_conditions & _MISWIRED:
            reasons = tuple(sorted(self._system_conditions & _MISWIRED))
            self._estimate = dataclasses.replace(self._estimate, valid=False, invalid_reasons=reasons)
        if self._estimate.valid and not self._system.is_finite(self._estimate):
            self._transient.add("estimate-not-finite")
            self._estimate = dataclasses.replace(self._estimate, valid=False, invalid_reasons=(Code.NOT_FINITE,))

    def handle(self, request: Request, t: float) -> None:
        """Execute a valid command at `t` (s), or refuse it; `replies` returns the answer."""
        self.journal.t = t
        self.supervisor.estimate = self._estimate
        self.supervisor.handle(request, t)

    def decide(self, t: float) -> None:
        """Update faults, state and motion at `t` (s), or at the time of the last update if that is later."""
        t = self._t_decided = max(t, self._t_decided)
        self._contacts = self._touching()
        under_way = self.setpoints.moving or self.setpoints.held
        self.journal.t = t
        present = self._conditions(t, under_way)
        lifted = {f"{name}-lifted" for name in self.pads}
        certain = lifted if lifted <= present else frozenset[str]()  # both pads say so
        self.faults.update(present, t, armed=self.supervisor.armed, certain=certain, evidence=self._guard_evidence)
        if self.arm.guards.following.shows_no_motion and self.arm.actual is not None:
            self.setpoints.retreat(self.arm.actual, t)
        self._fault_notes.look(self.faults.active, t, lambda code, at: (self._evidence(code, at), self._finding(code)))
        self._transient.clear()
        self.supervisor.update(t, up=self._rig_up(t))
        self._note_state_entry(t)
        plan = self.supervisor.plan
        if plan is not None and plan.explores:
            self.exploring.prepare()
        self.exploring.step(t, self._exploration_inputs(t))
        self._motion_notes.look(
            self.exploring.under_way, self.exploring.reason, self.supervisor.plan_name, self.setpoints.over, t
        )
        untouched = [number for number, touching in enumerate(self._contacts, 1) if not touching]
        self._object_notes.look(
            self._estimate.object_count, self._estimate.valid, untouched, t, lambda: self._observer.invalid_because
        )

    def report(self, t: float) -> list[tuple[Topic, Fields]]:
        """The messages to publish at `t` (s)."""
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
            (system.topics.estimate, system.estimate_fields(self._estimate)),
            (system.topics.contact, contact_fields(pads, age if math.isfinite(age) else math.nan, system.naming)),
            (system.topics.motion, motion),
            (system.topics.events, system.codec.events_fields(t, self._fed_events)),
        ]
        if self._answer is not None:
            messages.append(self._system.answer_message(t, self._answer))
        if isinstance(self._answer, Improvement):
            self._rig, self._rig_sds = self._answer.rig, self._answer.rig_sd
            self._contradicted = self._answer.contradicted
            self._any_contradicted = bool(self._contradicted.any())
            self._rig_notes.look(self._contradicted, self._rig_findings)
        due = isinstance(self._answer, Improvement) or t - self._t_rig >= 1.0 / RIG.rate_hz - _EARLY_S
        if len(self._rig_prior_sds) and due:
            self._t_rig = t
            messages.append((RIG, rig_fields(self._rig, self._rig_sds, self._rig_prior_sds, self._contradicted)))
        supervisor = self.supervisor
        published = (
            self.state, self.faults.active, self.setpoints.running, supervisor.requested_state, supervisor.control.name,
            supervisor.unattended,
        )  # fmt: skip
        if published != self._published_state or t - self._t_state >= SLOW_TOPIC_S - _EARLY_S:
            self._published_state, self._t_state = published, t
            messages.append((STATE, self._state_fields(t)))
        messages += [(NOTE, note_fields(t_note, text)) for t_note, text in self.supervisor.take_notes()]
        if self._shape is not None:
            messages.append(self._system.shape_message(self._shape))
            self._shape = None
        if self._object is not None:
            messages.append((OBJECT, object_fields(self._object)))
            self._object = None
        has_new_entries, since = self.journal.count != self._logged, t - self._t_log
        if since >= (SLOW_TOPIC_S if has_new_entries else 1.0 / LOG.rate_hz) - _EARLY_S:
            self._logged, self._t_log = self.journal.count, t
            messages.append((LOG, log_fields(self.journal.entries)))
        return messages

    def _state_fields(self, t: float) -> Fields:
        self._note_state_entry(t)
        (state, since, cause), supervisor = self._state_entered, self.supervisor
        explored, control = self.exploring.explored, supervisor.control.name
        return state_fields(
            str(state), self.faults.active, cause, supervisor.requested_state, t - since, self.setpoints.running,
            explored, control, supervisor.unattended,
        )  # fmt: skip

    def _note_state_entry(self, t: float) -> None:
        """When the state changes, keep its cause and the evidence, while it still holds."""
        state, since, _ = self._state_entered
        if state is not self.state or math.isnan(since):
            cause = self.supervisor.cause + (self._fault_evidence(t) if self.state in (State.HOLD, State.FAULT) else "")
            self._state_entered = (self.state, t, cause)

    def _fault_evidence(self, t: float) -> str:
        """The evidence at `t` (s) for the faults that hold or stop the palms, in parentheses."""
        codes = [fault.code for severity in (Severity.HOLD, Severity.STOP) for fault in self.faults.standing(severity)]
        evidence = "; ".join(filter(None, (self._evidence(code, t) for code in codes)))
        return f" ({evidence})" if evidence else ""

    def replies(self) -> list[Reply]:
        """The answers that have become available since the last call."""
        replies, self.supervisor.replies = self.supervisor.replies, []
        return replies

    def step(self, t: float, requests: Iterable[Request] = ()) -> list[tuple[Topic, Fields]]:
        """A whole tick at once, for a rig without ports."""
        self.observe(t)
        for request in requests:
            self.handle(request, t)
        self.decide(t)
        return self.report(t)

    # ---- beside the ticks --------------------------------------------------------------------------------

    def overran(self, t: float, late_s: float, why: str = "") -> None:
        """The tick that ended at `t` (s) was `late_s` after its deadline, so later ticks were skipped."""
        self._loop_watch.overran(t, late_s, why)

    def fail(self, t: float, error: Exception) -> None:
        """The tick at `t` (s) raised an unexpected exception: stop the arm with as little code as possible."""
        self._failure = repr(error)
        self.faults.update({"tick-error"}, t, armed=True)
        self.supervisor.stop_on_fault()

    def close(self) -> None:
        """Begin a planned stop and accept no more moving commands."""
        self.journal.add("palmd", "stopping", "palmd was requested to end: planned stop")
        self.supervisor.close()

    @property
    def at_rest(self) -> bool:
        """Whether the arm is known to be at rest: never commanded, or reported at rest since."""
        return self.supervisor.at_rest

    def counters(self) -> Fields:
        """The counters of all ports, under their names in `palm/loop`."""
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

    def _exploration_inputs(self, t: float) -> ExplorationInputs:
        return ExplorationInputs(
            tracking=self.state is State.TRACKING,
            touching=all(self._contacts),
            known=self._observer.has_planning_belief,
            object_count=self._observer.object_count,
            get_belief=lambda: self._observer.planning_belief(t),
            sticking=self._system.sticking,
            cornered=self._observer.cornered,
        )

    def _conditions(self, t: float, under_way: bool) -> set[str]:
        """The fault codes whose condition holds at `t` (s)."""
        look = t - self._t_look >= LOOK_S
        if look:
            self._t_look = t
        state = self.state
        commanded, held = state in COMMANDED, state is State.HOLD
        present = self._transient | self._notes
        for name, watch in self._pad_watches.items():
            present.update(watch.conditions(self.pads[name], under_way, held, look))
        present.update(self._arm_watch.conditions(self.arm, t, commanded, look))
        present.update(self._loop_watch.conditions(t, self._observer.late_dropped, look))
        present.update(self.supervisor.recorder.conditions(t))
        if self._smoother is not None:
            present.update(self._smoother.conditions(t))
        present.update(self._nis_watch.conditions(self._estimate.nis, self.setpoints.moving, t))
        present.update(self.arm.guards.conditions(t))
        if commanded:
            present.update(self._forces.conditions(under_way=under_way))
        present |= self._system_conditions
        simple = {
            "limits-violated": commanded and (self.setpoints.violated or self._outside()),
            "rig-contradicted": self._any_contradicted,
            "plan-refused": self.supervisor.plan_refused,
            "operator-lost": self.supervisor.operator_lost,
            "explorer-silent": self.exploring.silent,
            "estimate-lost": self.setpoints.moving and all(self._contacts) and not self._estimate.valid,
        }
        present.update(code for code, holds in simple.items() if holds)
        return present.difference(self._system.suppressed_faults(self.exploring))

    def _evidence(self, code: str, t: float) -> str:
        """The evidence for a fault that came up at `t` (s), in words; empty if there is none."""
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
                return self._describe_joints()
            case "loop-overrun" | "loop-overruns" | "samples-too-late":
                return self._loop_watch.evidence(code)
            case "plan-refused":
                return self.supervisor.refusal
            case "operator-lost":
                return f"the lease of {self.supervisor.operator_lost} ran out"
            case "estimate-inconsistent":
                return self._nis_watch.evidence
            case "rig-contradicted":
                return "; ".join(self._rig_findings())
            case "recorder-failed" | "recorder-silent":
                return self.supervisor.recorder.evidence(code, t)
        return self.arm.host.evidence(condition, t) if end == "arm" else ""

    def _finding(self, code: str) -> str:
        """What a device found out about its fault, as a code; empty if nothing."""
        end, _, condition = code.partition("-")
        device = self.arm.host if end == "arm" else self.pads.get(end)
        return "" if device is None else device.finding(condition)

    def _guard_evidence(self, code: str) -> str:
        """The evidence for a guard's fault, in words with numbers."""
        if code in ("force-limit", "force-excess"):
            return self._forces.evidence()
        return self.arm.guards.evidence().get(code, "") or self._system.evidence(code)

    def _rig_findings(self) -> list[str]:
        return describe_rig_errors(self._rig, self._rig_sds, self._rig_prior_sds, self._contradicted)

    def _describe_joints(self) -> str:
        actual = self.arm.actual
        if actual is None:
            return ""
        return self._system.describe_joints(actual.angles, self.setpoints.limits.angles)

    def _outside(self) -> bool:
        actual = self.arm.actual
        if actual is None:
            return False
        pairs = zip(actual.angles, self.setpoints.limits.angles, strict=True)
        tolerance = self._system.limit_tolerance
        return not all(low - tolerance <= angle <= high + tolerance for angle, (low, high) in pairs)

    def _rig_up(self, t: float) -> bool:
        return (
            self.arm.is_open
            and all(pad.is_open for pad in self.pads.values())
            and self.arm.host.linked(t)
            and self.arm.linked_since_open
        )


def _sample_time(event: Event) -> float:
    return event.t_sample
