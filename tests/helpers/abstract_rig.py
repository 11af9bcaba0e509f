"""The daemon's supervisor, fault monitor, diagnostics and journal on an abstract rig, to explore all its states.

The controller is reduced to its state letter and to pending requests, which it may answer or not. A motion is standing,
moving or held. There is one fault of each severity and latch. Time advances by one tick, or far enough for every
time-out to expire. Everything else is the daemon's own code.
"""

import io
import math
import pickle
from types import SimpleNamespace

from palmd.daemon.commands import Request
from palmd.daemon.diagnostics import ArmDiagnostics
from palmd.daemon.journal import Journal
from palmd.daemon.lifecycle import State
from palmd.daemon.supervisor import Supervisor
from palmd.devices.actuator import ArmState, Pose
from palmd.events import PalmMotion
from palmd.faults import TABLE, FaultMonitor, Severity
from palmd.harness.rules import Rules
from palmd.motion.trajectory_executor import MotionError

FAULTS = ("following-error", "pad1-silent")
"""A latching stop while armed, during which the set-point may retreat, and a hold.

The arm's own faults, one of which always latches, follow from its state.
"""

COMMANDS = {
    "arm": {}, "start": {}, "hold": {}, "stop": {}, "reset": {}, "jog": {"phi1_deg": 0.1},
    "plan": {"path": "p", "text": "t"},
}  # fmt: skip
"""Commands that change something; `test_refused_moves_nothing` tries the others."""
REQUESTS = {name: Request(name, args, id=name) for name, args in COMMANDS.items()}

SYSTEM = SimpleNamespace(
    can_jog=True, joints=("phi1_rad", "phi2_rad"), codec=SimpleNamespace(estimate_summary=lambda _estimate: {})
)

TICK_S, LONG_S = 0.01, 2.0


class Host:
    """Abstract actuator; see `palmd.devices.actuator.Actuator`."""

    def __init__(self):
        self.state, self.refusal, self.error, self.reach = None, None, "", None
        self.pose = Pose(0.0, 0.0, 0.0)
        self.tracking = False
        self.pending = None
        self.there = False

    @property
    def busy(self):
        return self.pending is not None

    def linked(self, _t):
        return self.there

    def lost(self, _t):
        return not self.there

    def frozen(self, _t):
        return False

    def health(self, _look):
        return iter(())

    def request_tracking(self):
        self.ask("G")

    def request_stop(self):
        self.tracking = False
        self.ask("P")

    def request_reset(self):
        if not self.tracking:
            self.ask("R")

    def ask(self, what):
        if not self.there:
            self.refusal = "no link"
        elif self.pending == "P":
            if what != "P":
                self.refusal = "a stop is under way"
        else:
            self.refusal, self.pending = None, what

    def answer(self, granted):
        """Answer of the controller."""
        what, self.pending = self.pending, None
        if not granted:
            self.refusal = "refused"
        elif what == "G" and self.state is ArmState.READY:
            self.state, self.tracking = ArmState.TRACKING, True
        elif what == "G":
            self.refusal = "wrong state"
        elif self.state in {"P": (ArmState.TRACKING, ArmState.HOLD), "R": (ArmState.FAULT,)}[what]:
            self.state = ArmState.READY

    def turn(self, state):
        """The controller changes its state by itself."""
        self.state = state
        if state not in (ArmState.TRACKING, ArmState.HOLD):
            self.tracking = False

    def unlink(self):
        self.there, self.state, self.tracking, self.pending = False, None, False, None


class Motion:
    """Abstract set-points; see `palmd.daemon.setpoints.SetPoints`."""

    limits, violated, place, exploration = None, False, None, None

    def __init__(self):
        self.commanded = None
        self.moving = self.held = self.jogging = self.over = False
        self.frozen = False
        self.plan = None
        self.may_retreat, self.left = False, None  # remaining ticks of the retreat

    @property
    def retreating(self):
        return self.left is not None and self.commanded is not None

    def retreated(self, _t):
        return not self.left

    def retreat(self):
        if self.left:
            self.left -= 1
        elif self.may_retreat and self.commanded is not None:
            self.may_retreat, self.left = False, 1

    @property
    def running(self):
        return self.moving and not self.jogging

    def tracking_problems(self, _pose):
        return []

    def nearest(self, pose):
        return pose

    def leave(self):
        self.commanded, self.plan, self.left = None, None, None
        self.moving = self.held = self.jogging = self.over = False

    def follow(self):
        """The first set-point has been sent."""
        if self.commanded is None:
            self.commanded, self.may_retreat = PalmMotion.at_rest((0.5, 1.5)), True

    def start(self, _trajectory):
        if self.moving:
            raise MotionError("moving")
        self.moving, self.held, self.jogging, self.over, self.plan = True, False, False, False, "p"

    def hold(self):
        if self.running:
            self.moving, self.held = False, True

    def resume(self):
        if self.held:
            self.moving, self.held = True, False

    def freeze(self, frozen):
        self.frozen = frozen

    def discard_plan(self):
        self.held, self.plan = False, None

    def jog(self, _steps, _t, _whole=None):
        if self.running or self.frozen:
            raise MotionError("not now")
        self.held, self.plan, self.moving, self.jogging = False, None, True, True

    def end(self):
        """The motion ends."""
        self.over = self.running
        self.moving = self.jogging = False


class Guards:
    """Guards of an arm whose poses always fit the rig."""

    contradiction = ""


class Arm:
    """The driver without its geometry."""

    def __init__(self):
        self.host, self.guards = Host(), Guards()
        self.is_open = self.linked_since_open = False
        self.actual = PalmMotion.at_rest((0.5, 1.5))


class Exploring:
    possible = True

    def summary(self):
        return None


class Plan:
    """A plan that fits at once or has to be compiled first."""

    name, explores, trajectory = "p", False, None

    def __init__(self, fits):
        self.fits = fits

    def is_valid_for(self, _limits, _start):
        return self.fits

    def compiled(self, _limits, _start):
        return Plan(True)

    def with_limits(self, _limits):
        return self


class Future:
    """Compilation of a plan; done when the test says so."""

    ready = False

    def done(self):
        return self.ready

    def result(self):
        return Plan(True)


class Aside:
    def __init__(self):
        self.futures = []

    def submit(self, _work):
        self.futures = [Future()]
        return self.futures[0]


def _forgets():
    return True  # a named function, because copies are pickled


class Rig:
    """Supervisor and abstract rig. `moved` names what has begun to move in the last step."""

    def __init__(self, *, autostart=False, fits=True):
        self.arm, self.motion, self.faults, self.journal = Arm(), Motion(), FaultMonitor(), Journal()
        self.aside, self.diagnostics = Aside(), ArmDiagnostics()
        self.present = frozenset()
        self.pads_open = True
        self.t = 0.0
        self.granted, self.refused, self.changes, self.by_itself, self.broken = [], [], [], [], []
        self.rules = Rules(State.IDLE)
        self.supervisor = Supervisor(
            self.arm, self.motion, Exploring(), self.faults, self.journal, self.aside, Plan(fits), None,
            autostart=autostart, system=SYSTEM,
            forget_object=_forgets,
        )  # fmt: skip

    @property
    def state(self):
        return self.supervisor.state

    def copies(self):
        """A function that returns a copy of the present state on each call; three times as fast as `copy.deepcopy`."""
        constants = (SYSTEM, self.arm.actual, self.arm.host.pose, self.diagnostics)
        shared = {id(each): each for each in (*TABLE.values(), *REQUESTS.values(), *State, *ArmState, *constants)}
        kept = io.BytesIO()
        pickler = pickle.Pickler(kept, pickle.HIGHEST_PROTOCOL)
        pickler.persistent_id = lambda each: id(each) if id(each) in shared else None
        pickler.dump(self)

        def copy():
            kept.seek(0)
            unpickler = pickle.Unpickler(kept)
            unpickler.persistent_load = shared.__getitem__
            return unpickler.load()

        return copy

    def tick(self, command=None, dt=TICK_S):
        """One tick of the core: obey, decide, and what the arm sends next."""
        self.t += dt
        self.journal.t = self.t
        supervisor = self.supervisor
        if command is not None:
            supervisor.handle(REQUESTS[command], self.t)
        present = set(self.present)
        present.update(self.diagnostics.conditions(self.arm, self.t, self.state in (State.TRACKING, State.HOLD), False))
        self.faults.update(present, self.t, armed=supervisor.armed)
        if "following-error" in present or self.motion.left:
            self.motion.retreat()
        host = self.arm.host
        supervisor.update(self.t, up=self.arm.is_open and self.pads_open and host.there)
        if host.tracking:
            self.motion.follow()
        self.changes = [entry.text.partition(":")[0] for entry in self.journal.entries if entry.kind == "state"]
        obeyed = [entry for entry in self.journal.entries if entry.kind == "command" and entry.text == "done"]
        self.by_itself = [entry.name for entry in obeyed if entry.who == "autostart"]
        self.journal._entries.clear()
        self.granted = [reply.request.name for reply in supervisor.replies if reply.error is None]
        self.refused = [reply.request.name for reply in supervisor.replies if reply.error is not None]
        supervisor.replies = []
        granted = [*self.granted, *self.by_itself]
        self.broken = self.rules.tick(granted, [tuple(map(State, each.split(" -> "))) for each in self.changes])
        graver = {fault.severity for severity in Severity for fault in self.faults.standing(severity)}
        self.broken += self.rules.look(self.state, graver, running=self.motion.running)

    def key(self):
        """Everything that the next steps depend on."""
        s, host, motion = self.supervisor, self.arm.host, self.motion
        return (
            s.state, s._arming is not None, s._resetting is not None, s._closing, tuple(s._autostart),
            s._job is not None and (s._job.request.name, s._job.future.ready), s.plan is not None and s.plan.fits,
            host.state, host.tracking, host.pending, host.there, self.arm.linked_since_open, self.arm.is_open,
            self.pads_open, self.present, frozenset(self.faults._latched), self.faults.active,
            motion.commanded is None, motion.moving, motion.held, motion.jogging, motion.may_retreat, motion.left,
            bool(s._autostart) and math.isinf(s._t_up), self.rules.armed, self.rules.started,
        )  # fmt: skip


def next_events(rig, commands=tuple(COMMANDS)):
    """All possible next events by name; each advances a copy by one tick."""
    host = rig.arm.host
    for name in commands:
        yield name, lambda r, name=name: r.tick(name)
    yield "tick", lambda r: r.tick()
    yield "long", lambda r: r.tick(dt=LONG_S)
    for code in FAULTS:
        yield f"{code} on or off", lambda r, code=code: _toggle(r, code)
    if not rig.arm.is_open:
        yield "port opened", _open
    else:
        yield "port lost", _lose
        if not host.there:
            yield "link", _link
        else:
            yield "silence", _silence
            for state in (ArmState.READY, ArmState.FAULT, ArmState.ESTOP):
                if host.state is not state:
                    yield f"controller {state.name}", lambda r, state=state: _turn(r, state)
            if host.busy:
                yield "granted", lambda r: _answer(r, True)
                yield "controller refuses", lambda r: _answer(r, False)
    yield "pad port", _pad
    if rig.motion.moving:
        yield "motion ends", _end
    if rig.supervisor._job is not None:
        yield "compiled", _compiled


def _toggle(rig, code):
    rig.present = rig.present ^ {code}
    rig.tick()
    rig.tick(dt=0.05)  # the debouncing time is over


def _open(rig):
    rig.arm.is_open = True
    rig.tick()


def _lose(rig):
    rig.arm.is_open = rig.arm.linked_since_open = False
    rig.arm.host.unlink()
    rig.tick()


def _link(rig):
    rig.arm.host.there, rig.arm.linked_since_open = True, True
    rig.arm.host.state = ArmState.READY
    rig.tick()


def _silence(rig):
    rig.arm.host.unlink()
    rig.tick()


def _turn(rig, state):
    rig.arm.host.turn(state)
    rig.tick()


def _answer(rig, granted):
    rig.arm.host.answer(granted)
    rig.tick()


def _pad(rig):
    rig.pads_open = not rig.pads_open
    rig.tick()


def _end(rig):
    rig.motion.end()
    rig.tick()


def _compiled(rig):
    rig.supervisor._job.future.ready = True
    rig.tick()
