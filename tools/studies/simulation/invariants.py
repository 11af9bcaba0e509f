"""Invariants that must hold at every tick, checked from outside: by messages on all lines, and by the truth."""

from __future__ import annotations

import hashlib
import math
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import msgpack

from palmd.config.two_palms import Config
from palmd.daemon.commands import CommandError, Request, parse
from palmd.daemon.core import Core
from palmd.daemon.lifecycle import COMMANDED, State
from palmd.devices.actuator import ArmState, Pose
from palmd.devices.armlink import LineReader, LinkError, SetPoint, parse_command
from palmd.devices.port import DevicePort
from palmd.events import PalmMotion
from palmd.faults import TABLE, Severity
from palmd.quantities import LOOP
from palmd.rig.adept_arm import AdeptArm
from palmd.topics import TOPICS
from tools.published import validate
from tools.studies.simulation.causes import CAUSES, FOR_GOOD, LINGERS_S, Cause

STANDS_RAD_S = math.radians(1.0)
STOP_S = 0.5
"""Time of a stop (s), even if its line is lost: the controller's watchdog (160 ms), braking, and the servos' lag."""
HOLD_S = 0.5
"""Time until the motion along its path has stopped, and the arm with it (s)."""
ANSWER_S = 8.0
"""Time within which a command is answered (s): the slowest helper takes half of it."""
STILL_M = 1e-4
"""Set-points of standing palms may differ by so much (m): rounding on the line, and the tool's rotation."""
AFTER_HOLD_S = 1.0
"""So long (s) after the controller did not follow, set-points may return to the pose of the halt."""
VALIDATED_EVERY, COUNTS_EVERY, MEMORY_EVERY = 16, 10, 500
"""Periods of checks: in messages of each topic that comes every tick, and in ticks."""
BULK_MOST = 20_000

WRONG_SDS = 10.0
WRONG_TICKS = 5
"""Consecutive ticks: the next readings show that a body has just hit or slipped."""
WRONG_LEAST = {"r1": 1e-4, "r2": 1e-4, "omega0": 0.5}
"""Tolerance of a comparison one tick apart: how far the palms may move a body meanwhile."""
_COMPARED = {"r1": "r1_m", "r2": "r2_m", "omega0": "omega0_rad_s"}

_MOVE_AN_ARM = ("manual@arm", "block@arm", "jump@arm")
"""Somebody takes the arm or releases it; it moves to the pose that its encoders report."""

_TOPIC = {topic.name: topic for topic in TOPICS}


@dataclass(slots=True)
class _Asked:
    """A message without an answer yet: when it was received (s), and its command, empty if there is none.

    `t_turn`: when it was executed (s), infinite before; `might_move`: a command to move the palms had come by then.
    """

    t: float
    name: str
    t_turn: float = math.inf
    might_move: bool = False

    @property
    def had_its_turn(self) -> bool:
        return math.isfinite(self.t_turn)


@dataclass(frozen=True, slots=True)
class Breach:
    """A broken invariant at `t` (s): its `name`, and the observation."""

    t: float
    name: str
    what: str

    def __str__(self) -> str:
        return f"at {self.t:.4f} s: {self.name}: {self.what}"


class InvariantWatch:
    """See the module. The first breach is kept; `sometimes` counts what occurred."""

    def __init__(self, config: Config, causes: Sequence[Cause], arm: AdeptArm, *, autostart: bool) -> None:
        """`causes`: all that will occur; `autostart`: the daemon arms by itself."""
        self.breach: Breach | None = None
        self.sometimes: Counter[str] = Counter()
        self.digest = hashlib.blake2b(digest_size=16)
        self._causes, self._arm, self._autostart = list(causes), arm, autostart
        self._autostarts = autostart
        self._rate_most = math.radians(config.limits.rate_deg_s) * 1.01
        self._ticks = 0
        self._wrong: Counter[str] = Counter()
        self._t_left = -math.inf
        self._reader = LineReader(arm.baud)
        self.t_trouble = max([0.0, *(each.t_off for each in causes if math.isfinite(each.t_off))])
        self._begin(0.0)

    def _begin(self, t: float) -> None:
        self._autostart = self._autostarts
        self._asked_to_arm = self._autostart
        self._may_move = False
        self._t_still = t  # since when the palms must stop
        self._t_stopped = self._t_granted = -math.inf
        self._last: Pose | None = None
        self._open: dict[tuple[int, str], list[_Asked]] = defaultdict(list)
        self._state, self._faults = State.IDLE, frozenset[str]()
        self._t_not_following = -math.inf
        self._t_begun = t

    def restarted(self, t: float) -> None:
        """Another daemon starts at `t` (s), without any command."""
        self.sometimes["restarted"] += 1
        self._begin(t)

    def happened(self, name: str, t_on: float, t_off: float) -> None:
        """A cause acted from t_on to t_off (s), which may differ from the schedule."""
        self._causes.append(Cause(name, t_on, t_off))
        if math.isfinite(t_off):
            self.t_trouble = max(self.t_trouble, t_off)

    def left(self, t: float) -> None:
        """The body is off the palms at `t` (s) for any reason."""
        self._t_left = t

    def fail(self, t: float, name: str, what: str) -> None:
        """An invariant is broken at `t` (s)."""
        self._break(t, name, what)

    def _break(self, t: float, name: str, what: str) -> None:
        if self.breach is None:
            self.breach = Breach(t, name, what)

    # ---- commands ----------------------------------------------------------------------------------------

    def received(self, client: int, payload: bytes, t: float) -> None:
        """The daemon has received a message from a client."""
        self.digest.update(payload)
        try:
            request = parse(payload)
        except CommandError as error:
            self.sometimes["malformed command"] += 1
            self._open[client, repr(error.id)].append(_Asked(t, ""))
            return
        self._open[client, repr(request.id)].append(_Asked(t, request.name))

    def handled(self, request: Request, t: float) -> None:
        """A command is executed at `t` (s)."""
        client = int(request.route[0]) if request.route else -1
        for asked in self._open.get((client, repr(request.id)), ()):
            if asked.name == request.name and not asked.had_its_turn:
                asked.t_turn, asked.might_move = t, self._may_move
                break
        match request.name:
            case "arm":
                self._asked_to_arm = True
            case "start" | "jog":
                self._may_move, self._t_still = True, math.inf
            case "hold":
                self._must_stand(t)
            case "stop":
                self._must_stand(t)
                self._asked_to_arm = self._autostart = False
                self._t_stopped = t

    def answered(self, client: int, payload: bytes, t: float) -> None:
        """A client has been answered."""
        self.digest.update(payload)
        reply = msgpack.unpackb(payload)
        waiting = self._open.get((client, repr(reply["id"])))
        if not waiting:
            self._break(t, "one answer to one command", f"client {client} was answered {reply} without a request")
            return
        asked = waiting.pop(0)
        name = asked.name
        if reply["ok"]:
            self.sometimes[f"{name} granted"] += 1
            if name in ("start", "jog"):
                self._t_granted = t
        elif name:
            self.sometimes[f"{name} refused" if asked.had_its_turn else "refused in a crowd"] += 1
            if not asked.had_its_turn:
                return
            if name in ("start", "jog") and not asked.might_move and asked.t_turn > self._t_granted:
                self._may_move = self._under_way("start", "jog")
                self._t_still = min(self._t_still, t)
            if name == "arm" and not self._under_way("arm"):
                self._asked_to_arm = self._autostart or (self._asked_to_arm and self._state in COMMANDED)

    def _under_way(self, *names: str) -> bool:
        """Whether one of these commands has been executed without an answer yet."""
        return any(each.had_its_turn and each.name in names for some in self._open.values() for each in some)

    def _must_stand(self, t: float) -> None:
        if self._may_move or math.isinf(self._t_still):
            self._t_still = t
        self._may_move = False

    # ---- the lines ---------------------------------------------------------------------------------------

    def wrote(self, core: Core, data: bytes, t: float) -> None:
        """The daemon has written to the arm."""
        self.digest.update(data)
        for line in self._reader.feed(data, t):
            try:
                command = parse_command(line.body)
            except LinkError as error:
                self._break(t, "no line malformed", f"{line.body!r}: {error}")
                continue
            if isinstance(command, SetPoint):
                self._check_set_point(core, command.pose, t)

    def _check_set_point(self, core: Core, pose: Pose, t: float) -> None:
        if core.setpoints.retreating:  # to an arm that does not follow, before it is stopped
            self._last = pose
            return
        if not self._asked_to_arm:
            self._break(t, "no set-point unless armed", f"{pose} in state {core.state}, stopped at {self._t_stopped}")
        stops = [fault.code for fault in core.faults.standing(Severity.STOP)]
        if stops:
            self._break(t, "no set-point while a stop fault stands", f"{pose} with {stops}")
        last, self._last = self._last, pose
        if last is None or self._may_move or t < max(self._t_still + HOLD_S, self._t_not_following + AFTER_HOLD_S):
            return
        apart = math.dist((last.x_m, last.y_m), (pose.x_m, pose.y_m))
        if apart > STILL_M:
            self._break(t, "no motion unless commanded", f"a set-point {apart * 1e3:.3f} mm from the one before")

    def published(self, frames: Sequence[bytes], t: float) -> None:
        """The daemon has published."""
        topic = _TOPIC[frames[0].decode()]
        if topic is LOOP:
            return  # depends on this process's own memory
        self.digest.update(frames[1])
        self.sometimes["published"] += 1
        if topic.rate_hz >= 50 and self.sometimes["published"] % VALIDATED_EVERY:
            return
        wrong = validate(topic, msgpack.unpackb(frames[1]))
        if wrong:
            self._break(t, "no message malformed", "; ".join(wrong))

    # ---- every tick --------------------------------------------------------------------------------------

    def tick(
        self, core: Core, ports: Mapping[str, DevicePort], in_hand: Callable[[str], int], palms: PalmMotion, t: float
    ) -> None:
        """A period is over at `t` (s); `in_hand` bytes of a port are not decoded yet."""
        self._ticks += 1
        self._look_at_set_points(t)
        self._look_at_state(core, t)
        self._look_at_palms(palms, t)
        if self._ticks % MEMORY_EVERY == 0:
            self._look_at_memory(core, t)
        if self._ticks % COUNTS_EVERY == 0:
            self._look_at_counts(core, ports, in_hand, t)
            self._look_at_answers(t)

    def _look_at_set_points(self, t: float) -> None:
        judge = self._arm.setpoint_checker
        if judge.outside_limits:
            self._break(t, "set-points inside the limits", f"{judge.outside_limits} outside")
        if judge.largest_rate_rad_s > self._rate_most:
            self._break(t, "set-points within the rate", f"{math.degrees(judge.largest_rate_rad_s):.1f}°/s")

    def _look_at_state(self, core: Core, t: float) -> None:
        state, codes = core.state, frozenset(fault.code for fault in core.faults.active)
        if state is not self._state:
            self.sometimes[f"{self._state} -> {state}"] += 1
            if state in (State.HOLD, State.FAULT, State.READY, State.IDLE):
                self._must_stand(t)
            if (self._state in COMMANDED and state not in COMMANDED) or state is State.FAULT:
                self._autostart = False
            if state is State.TRACKING and self._autostart:
                self._may_move, self._t_still = True, math.inf
            if state is State.FAULT:
                self._asked_to_arm = self._under_way("arm")
        if state in COMMANDED and core.faults.standing(Severity.STOP):
            self._break(t, "a stop fault ends tracking", f"{state} with {sorted(codes)}")
        if state is State.TRACKING and core.faults.standing(Severity.HOLD):
            self._break(t, "a hold fault holds", f"tracking with {sorted(codes)}")
        for code in sorted(codes - self._faults):
            self.sometimes[code] += 1
            if not self._has_cause(code, t):
                self._break(t, "every fault has a cause", f"{code} came up without an active cause")
        self._state, self._faults = state, codes
        if core.arm.host.state is not ArmState.TRACKING or self._arm.state is not ArmState.TRACKING:
            self._t_not_following = t

    def _has_cause(self, code: str, t: float) -> bool:
        """Whether a cause acted, or had ended shortly before, when the condition that the fault reports at `t` (s)
        began.
        """
        t_began = t - TABLE[code].debounce_s
        if t - self._t_begun < LINGERS_S and code in _AT_BEGINNING:
            return True
        names = CAUSES.get(code, frozenset())
        if "left" in names and t_began <= self._t_left + LINGERS_S:
            return True
        return any(
            cause.name in names and cause.t_on <= t and t_began <= cause.t_off + LINGERS_S for cause in self._causes
        )

    def faults_over(self, core: Core, t: float, lies_on_palms: bool) -> None:
        """All causes have been over for a while: no fault is active except those that last until a client's request.

        Untouched pads are no fault where the palms cannot hold an object.
        """
        left = {fault.code for fault in core.faults.active} - FOR_GOOD
        if not lies_on_palms:
            left = {code for code in left if "left" not in CAUSES[code]}
        if left:
            self._break(t, "a fault ends with its cause", f"{sorted(left)} in state {core.state}")

    def _look_at_palms(self, palms: PalmMotion, t: float) -> None:
        if any(each.name in _MOVE_AN_ARM and each.t_on <= t <= each.t_off + STOP_S for each in self._causes):
            self._t_still = max(self._t_still, t)
        turning = max(map(abs, palms.rates))
        if turning > STANDS_RAD_S and not self._may_move:
            since = max(self._t_still, self._t_not_following if self._state in COMMANDED else -math.inf)
            if t > since + max(STOP_S, HOLD_S) + (AFTER_HOLD_S if self._state in COMMANDED else 0.0):
                self._break(
                    t, "a stop comes to a standstill", f"{math.degrees(turning):.1f}°/s, {t - self._t_still:.2f} s on"
                )

    def _look_at_counts(
        self, core: Core, ports: Mapping[str, DevicePort], in_hand: Callable[[str], int], t: float
    ) -> None:
        for end, pad in core.pads.items():
            counts: Mapping[str, int] = pad.counts()
            discarded = counts["bad_header"] + counts["bad_data"] + counts["truncated"]
            left = counts["bytes"] - 6 * counts["packets"] - discarded
            if not 0 <= left < 6:
                self._break(t, "the counters balance", f"{end}: {left} bytes are neither packet nor discarded")
            if counts["bytes"] + in_hand(end) != ports[end].counters.bytes_read:
                self._break(t, "the counters balance", f"{end}: {counts['bytes']} bytes of those read were decoded")
        arm: Mapping[str, Any] = core.arm.host.counts()
        if arm["bytes"] + in_hand("arm") != ports["arm"].counters.bytes_read:
            self._break(t, "the counters balance", f"arm: {arm['bytes']:g} bytes of those read were decoded")

    def _look_at_memory(self, core: Core, t: float) -> None:
        kept = bulk(core)
        self.sometimes["most kept"] = max(self.sometimes["most kept"], kept)
        if kept > BULK_MOST:
            self._break(t, "memory is bounded", f"{kept} things are kept")

    def compare(self, core: Core, truth: Mapping[str, Any], t: float) -> None:
        """Compares the values of a valid estimate with the truth at `t` (s)."""
        estimate = core.estimate
        if not estimate.valid or any(
            each.t_on <= t <= each.t_off + LINGERS_S for each in self._causes if each.name != "request"
        ):
            return
        self.sometimes["estimate compared"] += 1
        for name, quantity in _COMPARED.items():
            error, sd = abs(getattr(estimate, name) - truth[quantity]), estimate.sd[name]
            wrong = error > WRONG_SDS * sd + WRONG_LEAST[name]
            self._wrong[name] = self._wrong[name] + 1 if wrong else 0
            if self._wrong[name] >= WRONG_TICKS:
                self._break(t, "no valid estimate is wrong", f"{name} is off by {error:.3g}, its sd is {sd:.3g}")

    def _look_at_answers(self, t: float) -> None:
        for (client, id), waiting in self._open.items():
            if waiting and t - waiting[0].t > ANSWER_S:
                self._break(t, "every command is answered", f"{waiting[0].name} {id} of client {client} is not")


_AT_BEGINNING = frozenset(
    {"arm-mute", "pad1-untouched", "pad2-untouched", "pad1-port", "pad2-port", "arm-port", "arm-fault"}
    | {"arm-estop", "arm-power-off", "arm-manual", "arm-link-lost"}
)
"""The state that a daemon may find at its start, before any command."""


def bulk(thing: object) -> int:
    """Number of entries in all containers that the daemon's own objects hold, one level deep."""
    total, found, seen = 0, [thing], set[int]()
    while found:
        each = found.pop()
        if id(each) in seen:
            continue
        seen.add(id(each))
        if isinstance(each, dict):
            total += len(each)
            found += each.values()
        elif isinstance(each, list | tuple | set | frozenset | deque):
            total += len(each)
            found += each
        elif isinstance(each, Core) or type(each).__module__.startswith(_OWN):
            found.append(getattr(each, "__dict__", None))
    return total


_OWN = ("palmd.daemon", "palmd.devices", "palmd.faults", "palmd.motion")
