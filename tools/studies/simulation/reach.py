"""Who brings a fault about in one state of the lifecycle after the other, until every command has found it. Pure.

What is drawn at random seldom has a rare fault in a rare state just when a command comes. Here somebody looks at the
daemon after every period, and does what leads there: commands as a client gives them, mischief, a stall. Many pairs
last for a single tick, in which the state changes while a fault still stands; commands that are sent before the next
find it. Four have their turn in a tick, so that those which come behind a `stop` find what stood before it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Iterator
from dataclasses import dataclass

import msgpack

from palmd.daemon.command_queue import PER_TICK
from palmd.daemon.commands import COMMANDS
from palmd.daemon.core import Core
from palmd.daemon.lifecycle import COMMANDED, State
from palmd.devices.versapad import COUNT_MAX, COUNT_MIN, encode_packet
from palmd.events import PalmMotion
from palmd.faults import FAULTS, TABLE, Severity
from palmd.rig.fault_injection import PADS, PortName
from palmd.system.mechanism import directions
from tools.studies.simulation.causes import FOR_GOOD
from tools.studies.simulation.happenings import (
    EXPLORE_TEXT,
    LONGEST_S,
    PLAN_TEXTS,
    Broken,
    Bytes,
    Happening,
    Restart,
    Scenario,
    Slow,
    Stall,
    Told,
    Trick,
)
from tools.studies.simulation.reached import Triple, behind_a_stop, unreachable

SOUGHT: dict[str, tuple[State, ...]] = {
    code: states
    for code in ("", *(fault.code for fault in FAULTS))
    if (states := tuple(state for state in State if unreachable(state, TABLE.get(code)) is None))
}
"""By fault, empty for none: the states in which it is sought; a number seeks the one as far along, round and round."""

GIVEN_UP_S = 100.0
"""After so long in search of one state, without every command having found it."""

STEP_S = 0.15
"""From one deed that leads to a state to the next."""

CALM_S = 4.0
"""After that: little more than a cause may linger, for there are many such runs."""

LIVELY, EXPLORES = 1, 3
_NEEDS_OBSERVER = ("explorer-silent",)
_PLAN_FROM_HOME = (
    "name: from home\nsegments:\n- move: {phi1_deg: 75}\n  duration_s: 0.8\n"
    "- move: {phi1_deg: 50, phi2_deg: 112}\n  duration_s: 1.5\n- hold_s: 60\n"
)
"""Suits palms near home, and not those that it has led away from there."""
_AWAY_RAD = math.radians(105.0)
"""What palm 2's angle is by then."""

_CHANGING = {
    State.READY: ("arm",),
    State.TRACKING: ("hold", "stop"),
    State.HOLD: ("start", "stop"),
    State.FAULT: ("reset",),
}
_PLANS = {"plan-refused": PLAN_TEXTS[3], "explorer-silent": EXPLORE_TEXT}
"""What is told to be loaded where any other plan would not do: with one that explores nobody is asked any more."""
_RECORDED: dict[str, object] = {"bytes": 1.0, "messages": 1.0, "lost": 0.0}
_FULL = {"problem": "no space left"}


@dataclass(frozen=True, slots=True)
class _View:
    """What is looked at: the daemon, the palms as they are, and which commands are still to find what is sought."""

    core: Core
    palms: PalmMotion
    missing: tuple[str, ...]
    t: float

    @property
    def state(self) -> State:
        return self.core.state

    def stands(self, code: str) -> bool:
        """Whether the fault does, or for an empty code none."""
        return any(fault.code == code for fault in self.core.faults.active) if code else not self.core.faults.active

    @property
    def moving(self) -> bool:
        """Whether a plan is under way in the state tracking."""
        return self.state is State.TRACKING and self.core.setpoints.moving


class Director:
    """See the module. `over` once every command has found the fault in every state, and the fault has gone."""

    def __init__(self, number: int) -> None:
        self.over = False
        self._code = _sought(number)
        self._states = list(SOUGHT[self._code])
        self._port: PortName
        self._port, _, of = self._code.partition("-")
        self._of = of if self._port in PADS else self._code
        self._ids = iter(range(1 << 30))
        self._t_begun = self._t_way = self._t_cause = self._t_always = 0.0

    @property
    def _state(self) -> State:
        return self._states[0]

    def look(self, core: Core, palms: PalmMotion, seen: Container[Triple], t: float) -> list[Happening]:
        """What is done at `t` (s), when this has been seen."""
        while self._states:
            missing = tuple(name for name in COMMANDS if (str(self._state), self._code or "none", name) not in seen)
            if missing and t <= self._t_begun + GIVEN_UP_S:
                return list(self._deeds(_View(core, palms, missing, t)))
            self._states.pop(0)
            self._t_begun = self._t_cause = t
        view = _View(core, palms, (), t)
        self.over = not self._code or self._code in FOR_GOOD or not view.stands(self._code)
        self.over |= t > self._t_begun + GIVEN_UP_S
        return [] if self.over or t < self._t_way else list(self._way(view, State.TRACKING, moving=True))

    def _deeds(self, view: _View) -> Iterator[Happening]:
        here = view.stands(self._code)
        if here and view.state is self._state:
            yield from self._tell(view, *self._batch(view, PER_TICK))
        elif here and view.state in COMMANDED and behind_a_stop(self._state, TABLE.get(self._code)):
            yield from self._tell(view, "stop", *self._batch(view, PER_TICK - 1))
        else:
            yield from self._lead(view, here)

    def _batch(self, view: _View, most: int) -> list[str]:
        """Commands that have not found it yet, what changes the state last."""
        changing = _CHANGING.get(view.state, ())
        later = ("reset", "recorder", "plan", *changing)
        batch = [name for name in view.missing if name not in later] + [name for name in later if name in view.missing]
        return batch[: next((k + 1 for k, name in enumerate(batch) if name in changing), most)][:most]

    # ---- what leads there --------------------------------------------------------------------------------

    def _lead(self, view: _View, here: bool) -> Iterator[Happening]:
        of, t, behind = self._of, view.t, behind_a_stop(self._state, TABLE.get(self._code))
        if of == "untouched" and t >= self._t_always:
            self._t_always = t + LONGEST_S - STEP_S
            yield Trick(t, "lift", None, 1.0, LONGEST_S)
        if here or not (of in (*_CAUSES_IN_MOTION, "plan-refused") or behind):
            if view.state is not self._state:
                if t >= self._t_way or here:
                    yield from self._way(view, self._state, moving=False)
            elif t >= self._t_cause and of in _CAUSES:
                yield from self._cause(view, _CAUSES[of])
        elif of == "plan-refused":
            yield from self._led_away(view)
        elif view.moving and t >= self._t_cause:
            yield from self._cause(view, (_CAUSES | _CAUSES_IN_MOTION)[of])
        elif t >= self._t_way:
            yield from self._way(view, State.TRACKING, moving=True)

    def _cause(self, view: _View, cause: _Cause) -> Iterator[Happening]:
        lasts_s, happenings = cause(self, view)
        self._t_cause = view.t + lasts_s
        yield from happenings

    def _way(self, view: _View, state: State, *, moving: bool) -> Iterator[Happening]:
        """The next step from where the daemon is to a state, and there to palms that move."""
        self._t_way = view.t + STEP_S
        core, t = view.core, view.t
        match view.state, state:
            case State.READY, State.IDLE if not self._code:
                yield from self.no_hello(view, 0.7)[1]
            case ((State.READY | State.TRACKING | State.HOLD), State.IDLE):
                self._t_way = t + 0.5
                both = self._of == "samples-too-late"  # it takes one pad to know that the other is late
                other = "arm" if both else next(pad for pad in PADS if pad != self._port)
                yield Trick(t, "unplug", other, 1.0, 1.5)
                if view.state in COMMANDED:
                    yield from self._tell(view, "stop")
            case ((State.READY | State.TRACKING | State.HOLD), State.FAULT):
                yield Broken(t, "raises", 0.03)
            case ((State.TRACKING | State.HOLD), State.READY):
                yield from self._tell(view, "stop")
            case State.FAULT, (State.IDLE | State.READY | State.TRACKING | State.HOLD):
                yield from self._tell(view, "reset")
            case State.READY, (State.TRACKING | State.HOLD):
                yield from self._tell(view, "reset" if core.faults.standing(Severity.STOP) else "arm")
            case State.TRACKING, State.HOLD:
                yield from self._tell(view, "hold")
            case State.HOLD, State.TRACKING if self._code == "plan-refused" and view.stands(self._code):
                yield from self._tell(view, "stop")  # for a start would be refused
            case State.HOLD, State.TRACKING if not core.faults.standing(Severity.HOLD):
                yield from self._tell(view, "start")
            case State.TRACKING, State.TRACKING if moving and not view.moving:
                yield from self._tell(view, "start")

    def _led_away(self, view: _View) -> Iterator[Happening]:
        """A plan that suited the pose in which it was loaded is begun anew where it has led the palms."""
        if view.t < self._t_way:
            return
        setpoints, plan = view.core.setpoints, view.core.supervisor.plan
        away = view.palms.angles[1] > _AWAY_RAD
        ours = plan is not None and plan.name == "from home"
        if not ours and view.state in COMMANDED and setpoints.running:
            self._t_way = view.t + STEP_S
            yield from self._tell(view, "stop")
        elif not ours and view.state is State.READY:
            self._t_way = view.t + STEP_S
            yield self._message(view.t, "plan", {"path": "sent.yaml", "text": _PLAN_FROM_HOME})
        elif ours and away and view.state in COMMANDED and setpoints.running:
            self._t_way = view.t + 0.5
            yield from self._tell(view, "stop")
        else:
            yield from self._way(view, State.TRACKING, moving=not (ours and setpoints.running))

    # ---- words -------------------------------------------------------------------------------------------

    def _tell(self, view: _View, *names: str) -> Iterator[Told]:
        for name in names:
            args: dict[str, dict[str, object]] = {
                "plan": {"path": "sent.yaml", "text": _PLANS.get(self._code, PLAN_TEXTS[0])},
                "jog": {"phi1_deg": 0.1},
                "note": {"text": "here"},
                "alive": {"take": True},
                "recorder": _RECORDED | (_FULL if self._code == "recorder-failed" else {}),
            }
            yield self._message(view.t, name, args.get(name, {}))

    def _message(self, t: float, name: str, args: dict[str, object]) -> Told:
        message = {"id": next(self._ids), "cmd": name, "args": args, "from": "director"}
        return Told(t, 0, msgpack.packb(message))

    # ---- causes: for how long (s) none is needed again, and what happens ------------------------------------

    def trick(self, view: _View, name: str, for_s: float, strength: float = 1.0) -> tuple[float, list[Happening]]:
        """A mischief at the fault's own port."""
        port = None if name == "lift" else self._port
        return for_s + 0.5, [Trick(view.t, name, port, strength, for_s)]

    def stray(self, view: _View, data: bytes) -> tuple[float, list[Happening]]:
        """Bytes that nobody has sent, in every period."""
        return 0.0, [Bytes(view.t, self._port, "stray", data)]

    def stalls(self, view: _View, number: int) -> tuple[float, list[Happening]]:
        """The daemon gets no processor, so many times."""
        return 0.03, [Stall(view.t, "observe", 0.012)] if number > 1 else [Stall(view.t, "observe", 0.03)]

    def gone_over(self, view: _View) -> tuple[float, list[Happening]]:
        """The controller has latched a fault: a break while it follows; to be found by another daemon, if unarmed."""
        if self._state is State.FAULT:
            return self.trick(view, "break", 0.1)
        return 2.0, [Restart(view.t, True, 0.4)]

    def no_hello(self, view: _View, for_s: float) -> tuple[float, list[Happening]]:
        """The arm's port comes back, and nobody answers there; the fault comes up after a second."""
        t = view.t
        return for_s + 0.5, [Trick(t, "unplug", "arm", 1.0, 0.1), Trick(t, "mute", "arm", 1.0, for_s)]

    def recorder(self, view: _View) -> tuple[float, list[Happening]]:
        """A recorder says that all is well, or not, and no more."""
        return 4.0, list(self._tell(view, "recorder"))

    def broken(self, view: _View, how: str, for_s: float) -> tuple[float, list[Happening]]:
        """The observer does not do its work."""
        assert how in ("raises", "nan", "blind", "misses")
        return for_s + 0.2, [Broken(view.t, how, for_s)]  # type: ignore[arg-type]

    def pressed(self, view: _View) -> tuple[float, list[Happening]]:
        """A finger on the pad that statics has weigh less."""
        first, second = directions(view.palms.angles)
        less = PADS[0] if math.sin(second) < math.sin(first) else PADS[1]
        return 0.05, [Trick(view.t, "touch", less, 1.2, 0.05)]

    def slow(self, view: _View) -> tuple[float, list[Happening]]:
        """Whoever decides takes its time."""
        return 5.0, [Slow(view.t, "explorer", 6.0, 4.0)]

    def left_behind(self, view: _View) -> tuple[float, list[Happening]]:
        """What led to fault is reset while another stop fault stands, which does not latch there and goes by itself."""
        if self._state is not State.FAULT:
            return 0.0, []
        if view.stands("arm-port"):
            return 1.0, list(self._tell(view, "reset"))
        return 0.1, [Trick(view.t, "unplug", "arm", 1.0, 0.4)]

    def silent_smoother(self, view: _View) -> tuple[float, list[Happening]]:
        """The smoother's process gives no sign of life."""
        return 1.0, [Slow(view.t, "smoother", 15.0, 0.8)]

    def lost_operator(self, view: _View) -> tuple[float, list[Happening]]:
        """The client that has control declares a lease, and nothing comes from it any more."""
        message = {"id": next(self._ids), "cmd": "alive", "args": {"take": True}, "client": "lost", "lease_s": 0.05}
        return 0.3, [Told(view.t, 1, msgpack.packb(message))]

    def held_up(self, view: _View) -> tuple[float, list[Happening]]:
        """An adapter keeps back so much that most of it is too old."""
        return 3.0, [Trick(view.t, "burst", PADS[0], 0.4, 2.5)]


_Cause = Callable[[Director, _View], tuple[float, list[Happening]]]

_FAR = b"".join(encode_packet(counts, counts, 40) for counts in (COUNT_MAX, COUNT_MIN))
_NEAR = encode_packet(0, 0, 40) * 2

_CAUSES: dict[str, _Cause] = {
    "": Director.left_behind,
    "tick-error": lambda by, view: by.broken(view, "raises", 0.03),
    "estimate-not-finite": lambda by, view: by.broken(view, "nan", 0.03),
    "loop-overruns": lambda by, view: by.stalls(view, 10),
    "loop-overrun": lambda by, view: by.stalls(view, 1),
    "arm-estop": lambda by, view: by.trick(view, "estop", 0.5),
    "arm-power-off": lambda by, view: by.trick(view, "power_off", 0.5),
    "arm-manual": lambda by, view: by.trick(view, "manual", 0.5),
    "arm-port": lambda by, view: by.trick(view, "unplug", 0.5),
    "arm-link-lost": lambda by, view: by.trick(view, "mute", 0.6),
    "arm-mute": lambda by, view: by.no_hello(view, 3.5),
    "arm-garbled": lambda by, view: by.stray(view, b"no line\r\n" * 2),
    "port": lambda by, view: by.trick(view, "unplug", 0.5),
    "garbled": lambda by, view: by.stray(view, b"\xff" * 20),
    "out-of-range": lambda by, view: by.stray(view, _FAR),
    "batched": lambda by, view: by.stray(view, _NEAR),
    "recorder-failed": Director.recorder,
    "recorder-silent": Director.recorder,
    "samples-too-late": Director.held_up,
    "smoother-silent": Director.silent_smoother,
}
"""What brings a fault about in the state in which it is sought. The arm's and the pads' by what follows the port."""

_CAUSES_IN_MOTION: dict[str, _Cause] = {
    "arm-fault": Director.gone_over,
    "arm-left-tracking": lambda by, view: by.trick(view, "power_off", 0.004),
    "arm-late": lambda by, view: by.trick(view, "mute", 0.14),
    "arm-held": lambda by, view: by.trick(view, "mute", 0.09),
    "silent": lambda by, view: by.trick(view, "mute", 0.5),
    "lifted": lambda by, view: by.trick(view, "lift", 0.5),
    "pads-swapped": Director.pressed,
    "estimate-lost": lambda by, view: by.broken(view, "blind", 12.0),
    "estimate-inconsistent": lambda by, view: by.broken(view, "misses", 7.0),
    "explorer-silent": Director.slow,
    "operator-lost": Director.lost_operator,
}
"""What does so only while the palms move, from where a command or another fault leads to the state."""


def _sought(number: int) -> str:
    return list(SOUGHT)[number % len(SOUGHT)]


def sought(number: int) -> Scenario:
    """The run of a number: its happenings are what the director does, so there are none before it is run."""
    observer = _sought(number) in _NEEDS_OBSERVER
    plan = EXPLORES if observer else LIVELY
    return Scenario(
        number, plan, False, 0.3, (0.004,) * 3, (), (),
        thorough=observer, coarse=True, sought=True, trouble_s=math.inf, calm_s=CALM_S,
    )  # fmt: skip
