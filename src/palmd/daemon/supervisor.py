"""The supervisor of commands, faults and lifecycle states: which commands are allowed when, and their execution. Pure.

Answers that depend on the arm, or on a plan being compiled, come later; all of them are collected in `replies`.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from functools import partial
from typing import Any

from palmd.aliases import STATUS, with_former_names
from palmd.daemon.commands import COMMANDS, Reply, Request
from palmd.daemon.drivers import RESTING, ArmDriver
from palmd.daemon.exploring import ExplorationControl
from palmd.daemon.journal import Journal
from palmd.daemon.lifecycle import COMMANDED, State, Trigger, next_state
from palmd.daemon.ownership import ALWAYS_OBEYED, Client, Control, client_of
from palmd.daemon.planner import Plan, PlanFolder, plan_in
from palmd.daemon.recorder_watch import RecorderWatch
from palmd.daemon.setpoints import SetPoints
from palmd.daemon.systems import AnySystem
from palmd.devices.actuator import ArmState, Reach
from palmd.events import LiveEstimate
from palmd.faults import TABLE, Fault, FaultMonitor, Severity
from palmd.messages import log_fields
from palmd.motion.limits import MotionLimits
from palmd.motion.segments import Angles
from palmd.motion.trajectory_executor import MotionError
from palmd.system.mechanism import JOINTS

log = logging.getLogger(__name__)

ARMING_S = 1.0
RESET_S = 1.0
SETTLED_S = 1.0
"""How long the rig must be up before `autostart` arms it."""

STATUS_LOG_ENTRIES = 8
"""Number of the newest log entries in the status."""

LOST_REPORTED_S = 2.0
"""A lost operator is reported for this time after a client has control again, for clients that poll once a second."""

JOG_PAUSE_S = 1.0
"""Jog steps closer together than this are one jog, logged once."""

_AUTOSTART_ID = "autostart"

_ENDING_MOTION = frozenset({Trigger.HOLD, Trigger.STOP, Trigger.STOP_FAULT})
_REQUESTS = frozenset({Trigger.HOLD, Trigger.STOP})


class RefusedError(Exception):
    """A command that cannot be executed now; states why and what would help."""


@dataclass(frozen=True, slots=True)
class _Job:
    """Slow work beside the loop for a request, and what to do with its result."""

    request: Request
    future: Future[Plan]
    limits: MotionLimits
    done: Callable[[Plan, Request], None]


@dataclass(frozen=True, slots=True)
class _Wait:
    """A request whose answer depends on the arm: how long to wait (s), and the faults active when it came."""

    request: Request
    t_end: float
    faults: tuple[Fault, ...]


class Supervisor:
    """Holds the state and acts on arm and set-points; see the module. Times are seconds."""

    def __init__(
        self,
        arm: ArmDriver,
        setpoints: SetPoints,
        exploring: ExplorationControl,
        faults: FaultMonitor,
        journal: Journal,
        background: Executor,
        plan: Plan | None,
        plans: PlanFolder,
        *,
        autostart: bool,
        system: AnySystem,
        forget_object: Callable[[], bool],
    ) -> None:
        """`background` does slow work beside the loop; plans sent without their text are loaded from `plans`.

        `forget_object` makes the observer start a new object; it returns False if the observer cannot.
        """
        self._forget_object = forget_object
        self.state = State.IDLE
        self.plan = plan
        self.plan_refused = False
        self.refusal = ""
        self.cause = ""
        self.requested_state = ""  # hold or stop, from when somebody asks for it until arm, start or reset is granted
        self.at_rest = True
        self.replies: list[Reply] = []
        self.estimate: LiveEstimate | None = None
        self.recorder = RecorderWatch(journal)
        self.control = Control()
        self.operator_lost = ""  # the client whose lease has run out in motion, until somebody has had control again
        self._arm = arm
        self._setpoints = setpoints
        self._exploring = exploring
        self._faults = faults
        self._journal = journal
        self._background = background
        self._plans = plans
        self._system = system
        self._autostart = ["arm", "start"] if autostart else []
        self._closing = False
        self._reach: Reach | None = None
        self._arming: _Wait | None = None
        self._resetting: _Wait | None = None
        self._job: _Job | None = None
        self._notes: list[tuple[float, str]] = []
        self._t_up = math.inf
        self._t_jog = -math.inf
        self._t = -math.inf
        self._t_regained = math.inf  # since when somebody has control after that
        self._commands: dict[str, Callable[[Request, float], dict[str, Any] | None]] = {
            "status": self._status,
            "arm": self._start_arming,
            "start": self._start,
            "hold": self._hold,
            "stop": self._stop,
            "reset": self._reset,
            "plan": self._load_plan,
            "jog": self._jog,
            "note": self._note,
            "new_object": self._new_object,
            "recorder": self._update_recorder,
            "alive": self._alive,
        }

    @property
    def armed(self) -> bool:
        """Whether the arm is commanded, or being armed."""
        return self.state in COMMANDED or self._arming is not None

    @property
    def plan_name(self) -> str:
        """The name of the loaded plan, empty without one."""
        return self._setpoints.plan or (self.plan.name if self.plan is not None else "")

    @property
    def unattended(self) -> bool:
        """Whether a plan moves the palms while no client with a declared lease has control."""
        return self.state is State.TRACKING and self._setpoints.running and not self.control.attended

    def handle(self, request: Request, t: float) -> None:
        """Execute a valid command at `t` (s), or refuse it; the answer is added to `replies`, now or later."""
        self._t = t
        self._expire_control(t)
        client = client_of(request)
        self.control.renew(client, t, request.lease_s)
        try:
            self._check_control(request, client)
            result = self._commands[request.name](request, t)
        except (RefusedError, MotionError) as error:
            self._answer(request, f"{request.name} refused: {error}")
        else:
            if result is not None:
                self._answer(request, None, result)

    def update(self, t: float, *, up: bool) -> None:
        """Apply the effects of faults and of the rig's presence at `t` (s). Call once a tick."""
        self._t = t
        self._expire_control(t)
        self._learn_workspace()
        self._finish_job()
        self._finish_arming(t)
        self._finish_reset(t)
        if up and self.state is State.IDLE:  # before the faults: with one that is latched no command finds it ready
            self._change(Trigger.RIG_UP, str(Trigger.RIG_UP))
        if self._faults.standing(Severity.STOP):
            if self.state in COMMANDED or self._faults.latched(Severity.STOP):
                self.stop_on_fault()
        elif self.state is State.TRACKING and self._faults.standing(Severity.HOLD):
            self._change(Trigger.HOLD, self._standing(Severity.HOLD))
            self._setpoints.hold()
        if not up:
            self._change(Trigger.RIG_DOWN, str(Trigger.RIG_DOWN))
        self._t_up = min(self._t_up, t) if up else math.inf
        self._enforce(t)
        self._autostart_step(t)

    def stop_on_fault(self) -> None:
        """React to a stop fault: a planned stop in any state."""
        self._autostart.clear()  # a reset must not start a motion
        self._change(Trigger.STOP_FAULT, self._standing(Severity.STOP))
        self._stand_down("a fault occurred; see status")

    def close(self) -> None:
        """Begin a planned stop and accept no more moving commands."""
        self._closing = True
        self._autostart.clear()
        self._change(Trigger.STOP, "palmd is stopping")
        self._stand_down("palmd is stopping")

    # ---- control -----------------------------------------------------------------------------------------

    def _expire_control(self, t: float) -> None:
        """Hold moving palms if the client in control has let its declared lease run out by `t` (s)."""
        if self.operator_lost and t - self._t_regained > LOST_REPORTED_S:
            self.operator_lost = ""
        lost = self.control.expire(t)
        if lost is None or self.state is not State.TRACKING:
            return
        if self._setpoints.moving or self._setpoints.held or self._compiles_start():
            self.operator_lost, self._t_regained = lost.name, math.inf
            self._change(Trigger.HOLD, f"the lease of {lost.name} ran out while the palms moved")
            self._setpoints.hold()

    def _check_control(self, request: Request, client: Client) -> None:
        """Refuse a command that another client's control forbids; `take`, `hold` and `stop` take control."""
        if request.name in ALWAYS_OBEYED:
            self._give_control(client)
            return
        other = self.control.other(client) or self._busy_for_another(client)
        if request.args.get("take"):
            if other is not None:
                self._journal.add("control", "taken", f"{client.name} took control from {other.name}", who=request.who)
            self._give_control(client)
        elif COMMANDS[request.name].moves and other is not None:
            raise RefusedError(f"{other.name} has control; args {{take: true}} takes control")

    def _busy_for_another(self, client: Client) -> Client | None:
        """The client of a moving command that is being executed, if it is another one."""
        for pending in (self._arming, self._resetting, self._job):
            if pending is not None and (other := client_of(pending.request)).key != client.key:
                return other
        return None

    def _refuse_if_overtaken(self, request: Request) -> None:
        other = self.control.other(client_of(request))
        if other is not None:
            raise RefusedError(f"{other.name} has control now")

    def _give_control(self, client: Client) -> None:
        self.control.gain(client, self._t)
        self._t_regained = min(self._t_regained, self._t)

    def _alive(self, _request: Request, _t: float) -> dict[str, Any]:
        return {"control": self.control.name}

    def _compiles_start(self) -> bool:
        return self._job is not None and self._job.done == self._run

    # ---- commands ----------------------------------------------------------------------------------------

    def _status(self, _request: Request, t: float) -> dict[str, Any]:
        host, place, faults = self._arm.host, self._setpoints.place, self._faults.active
        explored, recorder = self._exploring.summary(), self.recorder.last(t)
        status = {
            "state": str(self.state),
            "cause": self.cause,
            "requested_state": self.requested_state,
            "control": self.control.name,
            "unattended": self.unattended,
            "faults": [fault.code for fault in faults],
            "severities": [str(fault.severity) for fault in faults],
            "hints": [fault.hint for fault in faults],
            "plan": self.plan_name,
            "segment": -1 if place is None else place.segment,
            "doing": "" if place is None else place.label,
            "progress": 0.0 if place is None else place.progress,
            "moving": self._setpoints.moving,
            "over": self._setpoints.over,
            "arm_state": str(host.state or ""),
            "arm_error": host.error,
            "arm_linked": host.linked(t),
            "t_s": t,
            "log": log_fields(self._journal.entries[-STATUS_LOG_ENTRIES:]),
        }
        if self.estimate is not None:
            status["estimate"] = self._system.codec.estimate_summary(self.estimate)
        if self._arm.actual is not None:
            status |= dict(zip(self._system.joints, self._arm.actual.angles, strict=True))
        optional = {"explored": explored, "recorder": recorder}
        status |= {name: value for name, value in optional.items() if value is not None}
        return with_former_names(STATUS, status)

    def _update_recorder(self, request: Request, t: float) -> dict[str, Any]:
        self.recorder.update(request.args, t)
        return {}

    def _start_arming(self, request: Request, t: float) -> None:
        host, actual = self._arm.host, self._arm.actual
        if self._closing:
            raise RefusedError("palmd is stopping")
        if self.state not in COMMANDED:
            self._refuse_contradiction()
        if self.state is not State.READY or actual is None:
            raise RefusedError(f"the state is {self.state}, it must be ready")
        if self._arming is not None:
            raise RefusedError("arming is already in progress")
        self._refuse_faults(Severity.STOP)
        if host.state is not ArmState.READY or host.busy:
            raise RefusedError(f"the controller is in state {_state_name(host.state)}, it must be R (READY)")
        problems = self._setpoints.tracking_problems(actual)
        if problems:
            raise RefusedError(f"{'; '.join(problems)}: move the palms inside the limits with the pendant")
        host.request_tracking()
        self.at_rest = False
        self._arming = _Wait(request, t + ARMING_S, self._faults.active)

    def _start(self, request: Request, _t: float) -> dict[str, Any] | None:
        setpoints, commanded = self._setpoints, self._setpoints.commanded
        self._refuse_unless_commanded()
        self._refuse_faults(Severity.HOLD)
        if self.state is State.HOLD and setpoints.held:
            setpoints.resume()
            self._change(Trigger.START, "start", request)
            return self._state_result()
        if setpoints.moving or setpoints.held:
            raise RefusedError("the palms are moving already")
        plan = self.plan
        if plan is None:
            raise RefusedError("there is no plan: load one with the plan command")
        if plan.explores and not self._exploring.possible:
            raise RefusedError("exploring needs an estimated outline: set observer.primary to shape")
        assert commanded is not None, "the arm follows"
        limits, start = setpoints.limits, commanded.angles
        if plan.is_valid_for(limits, start):
            self._run(plan, request)
            return self._state_result()
        self._begin(request, partial(plan.compiled, limits, start), limits, self._run)
        return None

    def _run(self, plan: Plan, request: Request) -> None:
        self._refuse_if_overtaken(request)
        self._refuse_unless_commanded()
        self._refuse_faults(Severity.HOLD)
        self._setpoints.start(plan.trajectory)
        self.plan = plan
        self.plan_refused = False
        self._change(Trigger.START, "start", request)

    def _hold(self, request: Request, _t: float) -> dict[str, Any]:
        self._refuse_unless_commanded()
        self._change(Trigger.HOLD, "hold was requested", request)
        self._setpoints.hold()
        return self._state_result()

    def _stop(self, request: Request, _t: float) -> dict[str, Any]:
        self._autostart.clear()
        self._change(Trigger.STOP, "stop was requested", request)
        self._stand_down("stop came first")
        return self._state_result()

    def _reset(self, request: Request, t: float) -> None:
        if self._arming is not None or self._resetting is not None:
            raise RefusedError("another command is in progress")
        host = self._arm.host
        if host.state is ArmState.FAULT and not self._closing:
            host.request_reset()
        self._resetting = _Wait(request, t + RESET_S, self._faults.active)

    def _load_plan(self, request: Request, _t: float) -> None:
        self._refuse_while_moving()
        name, text = request.args["path"], request.args.get("text")
        plans, limits, actual = self._plans, self._setpoints.limits, self._arm.actual
        start = None if actual is None else self._setpoints.nearest(actual).angles
        read = partial(plans.load, name) if text is None else partial(plan_in, text, name)
        self._begin(request, partial(read, limits, start), limits, self._adopt)

    def _adopt(self, plan: Plan, request: Request) -> None:
        self._refuse_if_overtaken(request)
        self._refuse_while_moving()
        self._setpoints.discard_plan()
        self.plan = plan
        self.plan_refused = False

    def _jog(self, request: Request, t: float) -> dict[str, Any]:
        self._refuse_unless_commanded()
        if not self._system.can_jog:
            raise RefusedError("jogging turns palms, and this rig has none to turn: load a plan with a move")
        has_total = any(name.startswith("whole_") for name in request.args)
        clipped = self._setpoints.jog(_turn(request, ""), t, _turn(request, "whole_") if has_total else None)
        return self._state_result() | ({"clipped": clipped} if clipped else {})

    def take_notes(self) -> list[tuple[float, str]]:
        """Notes given since the last call, with their times (s)."""
        notes, self._notes = self._notes, []
        return notes

    def _new_object(self, _request: Request, _t: float) -> dict[str, Any]:
        if not self._forget_object():
            raise RefusedError("this system's observer cannot forget its object: take it off and put it back")
        return self._state_result()

    def _note(self, request: Request, t: float) -> dict[str, Any]:
        self._notes.append((t, request.args["text"]))
        return {}

    def _state_result(self) -> dict[str, Any]:
        return {"state": str(self.state)}

    def _refuse_while_moving(self) -> None:
        if self._setpoints.moving:
            raise RefusedError("the palms are moving: hold or stop them first")

    def _refuse_unless_commanded(self) -> None:
        if self.state not in COMMANDED or self._setpoints.commanded is None:
            raise RefusedError(f"the state is {self.state}, it must be tracking or hold: arm first")

    def _refuse_contradiction(self) -> None:
        """Refuse to arm an arm whose pose contradicts the configured rig, before checking anything else."""
        contradiction, row = self._arm.guards.contradiction, TABLE["pose-contradicts-rig"]
        if contradiction:
            raise RefusedError(f"{row.code}: {row.text}: {contradiction}: {row.hint}")

    def _refuse_faults(self, severity: Severity) -> None:
        faults = self._faults.standing(severity)
        if faults:
            raise RefusedError("; ".join(f"{fault.text}: {fault.hint}" for fault in faults))

    # ---- what comes of them later ------------------------------------------------------------------------

    def _begin(
        self, request: Request, work: Callable[[], Plan], limits: MotionLimits, done: Callable[[Plan, Request], None]
    ) -> None:
        """Compute a plan within `limits` by the picklable call `work` beside the loop."""
        if self._job is not None:
            raise RefusedError("another plan is still being checked")
        self._job = _Job(request, self._background.submit(work), limits, done)

    def _finish_job(self) -> None:
        job = self._job
        if job is None or not job.future.done():
            return
        self._job = None
        try:
            plan = job.future.result().with_limits(job.limits)
        except Exception as error:  # a plan from outside may be wrong in any way; the loop goes on
            if job.done == self._run:
                self.plan_refused, self.refusal = True, str(error)
            self._answer(job.request, f"{job.request.name} refused: {error}")
            return
        try:
            job.done(plan, job.request)
        except (RefusedError, MotionError) as error:
            self._answer(job.request, f"{job.request.name} refused: {error}")
        else:
            self._answer(job.request, None, {**self._state_result(), "plan": plan.name})

    def _finish_arming(self, t: float) -> None:
        wait, host = self._arming, self._arm.host
        if wait is None:
            return
        if self._faults.standing(Severity.STOP):
            self._stand_down("a fault occurred; see status")
        elif host.tracking:
            self._arming = None
            self._change(Trigger.ARMED, "arm", wait.request)
            self._answer(wait.request, None, self._state_result())
        elif not host.busy:
            self._arming = None
            self._answer(wait.request, host.refusal or "arm refused: the controller did something else")
        elif t > wait.t_end:
            self._stand_down("the controller does not answer")

    def _finish_reset(self, t: float) -> None:
        wait = self._resetting
        if wait is None:
            return
        self._faults.reset()
        remaining = self._faults.standing(Severity.STOP)
        if remaining and self._arm.host.busy and t <= wait.t_end:
            return
        self._resetting = None
        if remaining:
            reasons = "; ".join(f"{fault.text}: {fault.hint}" for fault in remaining)
            self._answer(wait.request, f"reset refused: {reasons}")
        else:
            self._change(Trigger.CLEARED, "reset", wait.request)
            cleared = [fault.code for fault in wait.faults if fault not in self._faults.active]
            self._answer(wait.request, None, {**self._state_result(), "cleared": cleared})

    def _stand_down(self, reason: str) -> None:
        """Planned stop if the arm is commanded; an `arm` in progress is refused."""
        host = self._arm.host
        if self._setpoints.retreating:
            pass  # `_enforce` stops the arm when the set-point is back
        elif host.tracking or self._arming is not None:
            host.request_stop()
            self._setpoints.leave()
        if self._arming is not None:
            wait, self._arming = self._arming, None
            self._answer(wait.request, f"arm refused: {reason}")

    # ---- keeping order -----------------------------------------------------------------------------------

    def _learn_workspace(self) -> None:
        reach = self._arm.host.reach
        if self.armed or reach is None or reach == self._reach:
            return
        self._reach = reach
        self._setpoints.set_workspace(self._setpoints.poses.workspace(reach))

    def _enforce(self, t: float) -> None:
        """Make the arm comply with the state, whatever has happened."""
        host = self._arm.host
        if host.tracking and not self.armed and self._setpoints.retreated(t):
            host.request_stop()
        if host.tracking:
            self._setpoints.freeze(host.frozen(t))
            return
        self._setpoints.leave()
        if not self.armed and not host.busy and (host.state in RESTING or host.state is ArmState.MANUAL):
            self.at_rest = True

    def _autostart_step(self, t: float) -> None:
        if not self._autostart:
            return
        ready = self.state is State.READY and not self._faults.standing(Severity.STOP)
        if (self._autostart[0] == "arm" and ready and t - self._t_up >= SETTLED_S) or (
            self._autostart[0] == "start" and self.state is State.TRACKING and self._setpoints.commanded
        ):
            self.handle(Request(self._autostart.pop(0), id=_AUTOSTART_ID, who="autostart"), t)

    def _change(self, trigger: Trigger, reason: str, request: Request | None = None) -> None:
        if trigger in _ENDING_MOTION:
            self._forget_start(trigger)
        if request is not None:
            self.requested_state = request.name if trigger in _REQUESTS else ""
        before, self.state = self.state, next_state(self.state, trigger) or self.state
        if self.state is not before:
            who = "" if request is None else request.who or "an unnamed client"
            self.cause = f"{reason}, by {who}" if who else reason
            self._journal.add("state", str(self.state), f"{before} -> {self.state}: {self.cause}", who=who)

    def _forget_start(self, trigger: Trigger) -> None:
        """Cancel a start whose plan is still being compiled: it was given before the command that ends the motion."""
        job = self._job
        if job is not None and self._compiles_start():
            self._job = None
            self._answer(job.request, f"start refused: {trigger} came first")

    def _standing(self, severity: Severity) -> str:
        return "; ".join(fault.text for fault in self._faults.standing(severity))

    def _answer(self, request: Request, error: str | None, result: dict[str, Any] | None = None) -> None:
        if error is not None and request.id == _AUTOSTART_ID and request.route is None:
            self._autostart.clear()
            log.warning("autostart: %s", error)
        if error is None and COMMANDS[request.name].moves:
            client = client_of(request)
            if self.control.other(client) is None:
                self._give_control(client)
        done = request.args["text"] if request.name == "note" else "done"
        self._log_command(request, done if error is None else error)
        self.replies.append(Reply(request, error, result))

    def _log_command(self, request: Request, outcome: str) -> None:
        """Log a command and its result; of a jog, only its begin."""
        if not COMMANDS[request.name].logged:
            return
        if request.name == "jog":
            t_before, self._t_jog = self._t_jog, self._journal.t
            if self._t_jog - t_before < JOG_PAUSE_S:
                return
        self._journal.add("command", request.name, outcome, who=request.who or "an unnamed client")


def _turn(jog: Request, of: str) -> Angles:
    """The rotation (rad) that a jog requests: its step (`of` empty), or the sum of all its steps."""
    return tuple(math.radians(jog.args.get(f"{of}{joint}_deg", 0.0)) for joint in JOINTS)


def _state_name(state: ArmState | None) -> str:
    return "unknown" if state is None else f"{state} ({state.name})"
