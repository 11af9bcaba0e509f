"""The emulated controller: the V+ program at the far end of the arm link, as a pure state machine.

Every 16 ms it consumes the latest set-point, checks it, and moves the commanded path there over the next cycle; all
other commands are answered immediately. It does not rely on the host: steps, speed, acceleration and workspace are
clamped or refused, silence leads to a hold and then to a fault, and a state that an operator must clear persists.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

from palmd.devices.actuator import ArmState, Pose
from palmd.devices.armlink import (
    Ack,
    Command,
    Hello,
    HelloReply,
    LineReader,
    LinkError,
    Query,
    Refusal,
    Reply,
    Reset,
    SetPoint,
    Start,
    Stop,
    encode_reply,
    parse_command,
)
from palmd.rig.arm import wrap_angle

CYCLE_S = 0.016
HOLD_AFTER_S = 0.048
GIVE_UP_AFTER_S = 0.160
RESUME_WITHIN_M = 5e-3
RESUME_WITHIN_RAD = math.radians(3.0)
_EMERGENCY_BRAKING = 4.0  # deceleration of an emergency stop over the planned one
_JOG_M_S, _NEAR_M = 0.02, 1e-9
_TIME_TOLERANCE_S = 1e-9  # time-outs are multiples of the cycle

LINK_LOST, OUTSIDE, STEP_TOO_LARGE, WRONG_STATE = -600, -610, -611, -620
EMERGENCY_STOP, POWER_IS_OFF, MANUAL_MODE, BREAK_RECEIVED = -621, -622, -623, -504

_FOLLOWING_STATES = (ArmState.TRACKING, ArmState.HOLD)
_REFUSAL_CODES = {
    ArmState.ESTOP: EMERGENCY_STOP,
    ArmState.POWER_OFF: POWER_IS_OFF,
    ArmState.MANUAL: MANUAL_MODE,
}


@dataclass(frozen=True, slots=True)
class ArmLimits:
    """Workspace box (m, arm coordinates), maximum speed (m/s) and acceleration (m/s²)."""

    x_min: float
    x_max: float
    y_min: float
    y_max: float
    v_max: float
    a_max: float

    def hello(self) -> HelloReply:
        """The answer to `H`."""
        return HelloReply(CYCLE_S, self.x_min, self.x_max, self.y_min, self.y_max, self.v_max, self.a_max)

    def contain(self, pose: Pose) -> bool:
        """Whether the position is inside the workspace."""
        return self.x_min <= pose.x_m <= self.x_max and self.y_min <= pose.y_m <= self.y_max


@dataclass(slots=True)
class ControllerCounters:
    """Counters of received commands and their outcomes, for end-to-end checks."""

    commands: int = 0
    unparsable: int = 0
    starts: int = 0
    resets: int = 0
    setpoints: int = 0
    accepted: int = 0
    superseded: int = 0
    duplicates: int = 0
    clamped: int = 0
    braked: int = 0  # cycles in which the acceleration limit applied
    refused: Counter[int] = field(default_factory=Counter)

    def as_dict(self) -> dict[str, int]:
        """Flat dictionary; refusals as `refused_<code>`."""
        refused = {f"refused_{-code}": count for code, count in sorted(self.refused.items())}
        plain = ("commands", "unparsable", "starts", "resets", "setpoints", "accepted", "superseded", "duplicates")
        return {name: getattr(self, name) for name in (*plain, "clamped", "braked")} | refused


class Controller:
    """See the module. `feed` takes the line's bytes, `cycle` runs every 16 ms; both return the bytes to send."""

    def __init__(self, limits: ArmLimits, start: Pose, baud: int, on_setpoint: Callable[[Pose, float], None]) -> None:
        """At rest at `start` and ready; `on_setpoint` is called with each received set-point and its time (s)."""
        self.limits = limits
        self.state = ArmState.READY
        self.counters = ControllerCounters()
        self.reader = LineReader(baud)
        self.path = start  # commanded path at the end of this cycle
        self._on_setpoint = on_setpoint
        self._step = (0.0, 0.0)  # the commanded path's last step, m per cycle
        self._target = start
        self._pending: SetPoint | None = None
        self._t_alive = 0.0  # last G or valid S, for the longer time-out
        self._t_setpoint: float | None = None  # last valid S since G, for the shorter time-out
        self._stop_code: int | None = None  # error code with which a deceleration ends in FAULT
        self._last_ss = 0
        self._last_key: tuple[str, int] | None = None
        self._last_reply = b""
        self._unsolicited = b""

    # -- the line -----------------------------------------------------------------------------------------

    def feed(self, data: bytes, t: float, actual: Pose) -> bytes:
        """Take bytes that arrived by t (s) with the arm at `actual`; returns the answers, whole lines."""
        out = b""
        for line in self.reader.feed(data, t):
            try:
                command = parse_command(line.body)
            except LinkError:
                self.counters.unparsable += 1
                continue
            self.counters.commands += 1
            self.counters.starts += isinstance(command, Start)
            self.counters.resets += isinstance(command, Reset)
            out += self._execute(command, t, actual)
        return out

    def _execute(self, command: Command, t: float, actual: Pose) -> bytes:
        if isinstance(command, Hello):
            self._last_key, self._last_ss = None, 0
            return encode_reply(self.limits.hello())
        key = (type(command).__name__, command.ss)
        if key == self._last_key:
            self.counters.duplicates += 1
            return self._last_reply
        self._last_ss = command.ss
        if isinstance(command, SetPoint):
            self.counters.setpoints += 1
            self._on_setpoint(command.pose, t)
            if self.state in _FOLLOWING_STATES:
                self.counters.superseded += self._pending is not None
                self._pending = command
                return b""
            return self._reply(key, self._refusal(command.ss, WRONG_STATE))
        return self._reply(key, self._execute_plain(command, t, actual))

    def _execute_plain(self, command: Start | Query | Stop | Reset, t: float, actual: Pose) -> Reply:
        """Execute a command other than H and S and return the answer."""
        state = self.state
        match command:
            case Start() if state is ArmState.READY:
                self._start_tracking(t, actual)
            case Stop() if state in _FOLLOWING_STATES:
                self._decelerate(None)
            case Reset() if state is ArmState.FAULT:
                self.state = ArmState.READY
            case Query():
                pass
            case Stop() | Reset() if state is ArmState.READY:
                pass
            case Stop() if state is ArmState.DECELERATING:
                pass
            case _:
                return self._refusal(command.ss, _REFUSAL_CODES.get(state, WRONG_STATE))
        return Ack(command.ss, self.state, actual)

    def _reply(self, key: tuple[str, int], reply: Reply) -> bytes:
        self._last_key, self._last_reply = key, encode_reply(reply)
        return self._last_reply

    def _refusal(self, ss: int, code: int) -> Refusal:
        self.counters.refused[code] += 1
        return Refusal(ss, code)

    # -- the cycle ----------------------------------------------------------------------------------------

    def cycle(self, t: float, actual: Pose) -> bytes:
        """One 16 ms cycle beginning at t (s) with the arm at `actual`; returns the answers."""
        out = b""
        if self._pending is not None:
            setpoint, self._pending = self._pending, None
            if self.state in _FOLLOWING_STATES:
                reply = self._consume(setpoint, t, actual)
                out += self._reply(("SetPoint", setpoint.ss), reply)
        self._check_timeouts(t)
        self._move()
        if self.state is ArmState.DECELERATING and self._step == (0.0, 0.0):
            self._finish_deceleration()
        out, self._unsolicited = out + self._unsolicited, b""
        return out

    def _consume(self, setpoint: SetPoint, t: float, actual: Pose) -> Reply:
        pose = setpoint.pose
        if not self.limits.contain(pose):
            return self._refusal(setpoint.ss, OUTSIDE)
        is_resuming = self.state is ArmState.HOLD or self._t_setpoint is None
        path = self.path  # the arm's own position; reported poses may include a slide's travel
        is_far = _distance(pose, path) > RESUME_WITHIN_M or abs(wrap_angle(pose.t_rad - path.t_rad)) > RESUME_WITHIN_RAD
        step, max_step = _distance(pose, path), self.limits.v_max * CYCLE_S
        if (is_resuming and is_far) or step > 3.0 * max_step:
            return self._refusal(setpoint.ss, STEP_TOO_LARGE)
        self.counters.accepted += 1
        self.counters.clamped += step > max_step
        self._target = pose
        self._t_alive = self._t_setpoint = t
        self.state = ArmState.TRACKING
        return Ack(setpoint.ss, self.state, actual)

    def _check_timeouts(self, t: float) -> None:
        if self.state not in _FOLLOWING_STATES:
            return
        if t - self._t_alive >= GIVE_UP_AFTER_S - _TIME_TOLERANCE_S:
            self._decelerate(LINK_LOST)
        elif self._t_setpoint is not None and t - self._t_setpoint >= HOLD_AFTER_S - _TIME_TOLERANCE_S:
            self.state = ArmState.HOLD

    def _move(self) -> None:
        """Move the path by one cycle: towards the target if there is one, else towards a stop."""
        path, limits = self.path, self.limits
        wanted = (0.0, 0.0)
        if self.state is ArmState.TRACKING:
            wanted = _step_towards(path, self._target, limits.v_max * CYCLE_S)
        elif self.state is ArmState.MANUAL:
            wanted = _step_towards(path, self._target, _JOG_M_S * CYCLE_S)
        braking_factor = _EMERGENCY_BRAKING if self.state is ArmState.ESTOP else 1.0
        change = (wanted[0] - self._step[0], wanted[1] - self._step[1])
        size, max_change = math.hypot(*change), braking_factor * limits.a_max * CYCLE_S**2
        if size > max_change:
            self.counters.braked += self.state is ArmState.TRACKING
            change = (change[0] * max_change / size, change[1] * max_change / size)
            self._step = (self._step[0] + change[0], self._step[1] + change[1])
        else:
            self._step = wanted
        angle = path.t_rad
        if self.state is ArmState.TRACKING:
            angle = self._target.t_rad
        elif self.state is ArmState.MANUAL:  # the tool turns with the palm that it holds
            remaining = math.hypot(self._target.x_m - path.x_m, self._target.y_m - path.y_m)
            fraction = min(math.hypot(*self._step) / max(remaining, _NEAR_M), 1.0)
            angle = wrap_angle(angle + fraction * wrap_angle(self._target.t_rad - angle))
        self.path = Pose(path.x_m + self._step[0], path.y_m + self._step[1], angle)

    def _start_tracking(self, t: float, actual: Pose) -> None:
        self.state = ArmState.TRACKING
        self._target = self.path = actual
        self._t_alive, self._t_setpoint, self._pending = t, None, None

    def _decelerate(self, code: int | None) -> None:
        self.state = ArmState.DECELERATING
        self._stop_code, self._pending = code, None

    def _finish_deceleration(self) -> None:
        code, self._stop_code = self._stop_code, None
        self.state = ArmState.READY if code is None else ArmState.FAULT
        if code is not None:
            self._unsolicited += encode_reply(Refusal(self._last_ss, code))

    # -- the operator, and line errors --------------------------------------------------------------------

    def press_emergency_stop(self) -> None:
        """Latch the emergency stop: brakes hard and reports it once."""
        if self.state is not ArmState.ESTOP:
            self.state, self._pending = ArmState.ESTOP, None
            self._unsolicited += encode_reply(Refusal(self._last_ss, EMERGENCY_STOP))

    def switch_power_off(self) -> None:
        """Switch arm power off; the brakes close."""
        self.state, self._pending = ArmState.POWER_OFF, None

    def switch_to_manual(self, jog_to: Pose) -> None:
        """Enter manual mode; the operator jogs the arm slowly to `jog_to`."""
        self.state, self._pending, self._target = ArmState.MANUAL, None, jog_to

    def move_by_hand(self, pose: Pose) -> None:
        """Set the path to where a hand holds the arm in manual mode."""
        self.state = ArmState.MANUAL
        self.path = self._target = pose

    def make_ready(self) -> None:
        """Clear everything as the operator does: plungers released, power on, automatic mode."""
        self.state, self._pending, self._stop_code = ArmState.READY, None, None

    def line_fault(self, code: int) -> None:
        """A break, framing or overrun error on the line: a moving arm treats it as loss of the link."""
        if self.state in _FOLLOWING_STATES:
            self._decelerate(code)


def _distance(a: Pose, b: Pose) -> float:
    return math.hypot(a.x_m - b.x_m, a.y_m - b.y_m)


def _step_towards(start: Pose, target: Pose, max_length: float) -> tuple[float, float]:
    """The step from start to target, limited to `max_length` (m)."""
    dx, dy = target.x_m - start.x_m, target.y_m - start.y_m
    size = math.hypot(dx, dy)
    return (dx, dy) if size <= max_length else (dx * max_length / size, dy * max_length / size)
