"""Host state machine of a servo bus: what to send when, and how to interpret the answers.

It does no I/O. The caller passes the bytes read and their time, and asks what to write at the times that `due()`
returns:

    greeting (ping until all answer) -> setting up (compare, write and verify registers) -> idle (read 20 times a s)
    idle -> arming (goal := present, torque and watchdog on) -> following (goals and readings every cycle)
    arming -> disarming (after a failure, the torque that was turned on is turned off again) -> idle
    following -> stopping (the goals decelerate to rest and are held) -> idle

Goals are sent by Sync Write, which is never answered: whether a servo accepted its goal is checked by the goal that it
reports a cycle later; likewise a tripped watchdog, a restart and a torque that is off. Sequences of several requests
are scripts in `servoscripts`. No received bytes raise an exception.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from enum import Enum, auto

from palmd.config.arms import ServosConfig
from palmd.devices.actuator import (
    FREEZE_S,
    LOST_S,
    Actuator,
    ArmPose,
    ArmReport,
    ArmState,
    JointPose,
    Outgoing,
    Reach,
)
from palmd.devices.arrival import byte_time
from palmd.devices.framing import FrameCounters
from palmd.devices.servobus import Axis, Packet, Registers, ServoMake
from palmd.devices.servoscripts import (
    ANSWER_S,
    WATCHDOG_S,
    Answers,
    ServoRefusedError,
    ServoRequest,
    SetUpError,
    hold,
    prepare,
    restart,
    set_up,
    stop_watchdogs,
    torque_off,
)

GREET_S = 0.250
IDLE_PERIOD_S = 0.050
PERIODS_S = (0.010, 0.020, 0.040)
MAX_BUS_SHARE = 0.5
"""Largest share of a period in which the bus may be busy."""

PROFILE_PERIODS = 1.2
"""Duration of a servo's move to a goal, in periods: more than one, so that it does not stop before the next goal."""

STOP_RAD_S2 = math.radians(900.0)
WAIT_PERIODS = 1.5  # for an answer, before the next request; longer if an adapter delays answers
WAIT_SHARE = 1.25  # times the latency of the slowest recent answer
LATENCIES_KEPT = 64
SLOW_ADAPTER_S = 0.008
"""Latency (s) above which an adapter delays the answers: FTDI's latency timer is 16 ms by default."""

STATUS_EVERY = 10  # cycles between readings of torque and hardware errors
MAX_MISSES = 3  # consecutive cycles without an accepted goal until a fault; each packet may have been damaged

FAULT_CODES = frozenset(
    {"voltage", "hot", "encoder", "shock", "overload", "watchdog", "refused", "restarted", "set-up"}
)
_LATCHED = ("refused", "restarted", "watchdog", "set-up")  # faults that readings cannot clear


Script = Generator[ServoRequest, Answers, None]


class Phase(Enum):
    """State of the host."""

    GREETING = auto()
    SETTING_UP = auto()
    IDLE = auto()
    ARMING = auto()
    DISARMING = auto()
    FOLLOWING = auto()
    STOPPING = auto()
    RESETTING = auto()


@dataclass(slots=True)
class ServoCounters:
    """Counters of the bus since the start.

    `readings` counts cycles in which all servos answered, `missed` cycles in which one did not; `refused_goals` goals
    that a servo did not report back, `registers_set` settings that had to be written, `bad_targets` targets beyond
    a servo's range, `unmatched` answers without a pending request, `losses` silences of 250 ms.
    """

    bus: FrameCounters = field(default_factory=FrameCounters)
    goals: int = 0
    readings: int = 0
    missed: int = 0
    skipped_periods: int = 0
    refused_goals: int = 0
    registers_set: int = 0
    bad_targets: int = 0
    unmatched: int = 0
    retries: int = 0
    losses: int = 0
    answer_latency_max_ms: float = 0.0

    def as_dict(self) -> dict[str, float]:
        """Return all counters by name, those of the bus included."""
        counts = asdict(self)
        return {**counts.pop("bus"), **counts}


@dataclass(slots=True)
class _Cycle:
    """A pending Sync Read and the answers so far."""

    t_sent: float
    t_received: float
    """When its last byte reached the servos (s), which is when they sample; adapters delay answers, not requests."""
    address: int
    size: int
    goals: Sequence[Mapping[int, int]]
    """Goals of the last cycles at that time; a servo's answer shows which of them it has."""
    found: dict[int, Packet] = field(default_factory=dict)


class ServoHost(Actuator):
    """`Actuator` of the servos of one bus, palm 1's first; see the module's docstring."""

    def __init__(self, config: ServosConfig, make: ServoMake) -> None:
        """All servos are of the same make. Nothing is opened yet."""
        super().__init__(config, "packets")
        self._make, baud = make, config.baud
        self.axes = tuple(Axis.from_config(number, servo, make) for number, servo in enumerate(config.servos, 1))
        self._ids = tuple(axis.id for axis in self.axes)
        self.period_s = cycle_period(baud, len(self.axes), make)
        self.profile_ms = round(PROFILE_PERIODS * self.period_s * 1e3)
        self._byte_s = byte_time(baud)
        self._reader = make.reader(baud)
        self.counters = ServoCounters(bus=self._reader.counters)
        self.pose: JointPose | None = None
        self.faults: dict[str, str] = {}
        """Active faults: text by the code in the fault table, without the arm's name."""
        self.last_status: dict[int, Registers] = {}
        """The last reading of each servo's `status_span`."""
        self._phase = Phase.GREETING
        self._script: Script | None = None
        self._request: ServoRequest | None = None
        self._answers: dict[int, Packet] = {}
        self._t_request = self._t_sent = self._t_answer = -math.inf
        self._latencies_s: deque[float] = deque(maxlen=LATENCIES_KEPT)
        self._turned_on: tuple[Axis, ...] = ()  # by an `arm` that is under way or has failed
        self._tries = 0
        self._t_slot = -math.inf
        self._cycle: _Cycle | None = None
        self._cycles = 0
        self._goals: tuple[float, ...] = ()  # directions (rad) sent last
        self._rates: tuple[float, ...] = ()  # rad/s
        self._sent_counts: list[dict[int, int]] = []  # of the last cycles, newest last
        self._path: dict[int, float] = {}  # interpolated position (counts) of each servo on its way to its goals
        self._missed_goals: dict[int, int] = {}
        self._t_now = self._t_idle = -math.inf
        self._reset_unreported = False  # a reset has been executed, but no reading has arrived since

    # Queries

    def linked(self, t: float) -> bool:
        """Whether all servos are set up and have answered within the last 250 ms at `t` (s)."""
        return self.state is not None and t - max(self._t_report, self._t_answer) <= LOST_S

    @property
    def tracking(self) -> bool:
        """Whether goals are being sent."""
        return self._phase is Phase.FOLLOWING

    @property
    def busy(self) -> bool:
        """Whether a request is still being executed."""
        busy = (Phase.ARMING, Phase.DISARMING, Phase.RESETTING, Phase.STOPPING)
        return self._phase in busy or self._reset_unreported

    @property
    def error(self) -> str:
        """Text of the active faults; empty if there are none."""
        return "; ".join(self.faults.values())

    @property
    def reach(self) -> Reach | None:
        """None: servo limits are angles, and are set from the configuration."""
        return None

    def health(self, refresh: bool) -> Iterator[str]:
        """Yield the servos' fault conditions as well."""
        yield from super().health(refresh)
        yield from (f"servo-{code}" for code in self.faults if code in FAULT_CODES)

    def _garbled(self) -> tuple[int, int]:
        bus, missed = self.counters.bus, self.counters.missed
        return bus.packets + missed, bus.crc_errors + missed

    def evidence(self, condition: str, t: float) -> str:
        """Return the measurements behind a condition at `t` (s)."""
        match condition:
            case "late" | "link-lost":
                limit_s = FREEZE_S if condition == "late" else LOST_S
                return f"the last reading is {self.age(t) * 1e3:.0f} ms old, the limit is {limit_s * 1e3:.0f} ms"
            case "mute":
                return f"{self.counters.bus.bytes} bytes have come since the start"
            case "garbled":
                return self._error_shares.text(condition)
        return self.faults.get(condition.removeprefix("servo-"), "")

    def counts(self) -> dict[str, float]:
        return self.counters.as_dict()

    # Requests

    def request_tracking(self) -> None:
        if self._phase is not Phase.IDLE:
            self.refusal = None if self.tracking else "start refused: the servos are not ready"
        elif self.faults:
            self.refusal = f"start refused: {self.error}"
        else:
            self.refusal = None
            self._begin(Phase.ARMING, self._arming())

    def request_stop(self) -> None:
        """Request a planned stop: the goals decelerate to rest, and the servos hold them."""
        if self._phase is Phase.FOLLOWING:
            self._phase = Phase.STOPPING
            self.state = ArmState.DECELERATING
        elif self._phase is Phase.ARMING:
            self._disarm()

    def request_reset(self) -> None:
        """Request that latched faults be cleared: servos with a hardware error are restarted, watchdogs cleared."""
        if self._phase is Phase.IDLE:
            self.refusal = None
            self._reset_unreported = True
            self._begin(Phase.RESETTING, self._resetting())
        else:
            self.refusal = "reset refused: the servos are not idle"

    def disconnected(self) -> None:
        """Handle the loss of the port; greeting begins when it is open again."""
        self._reader.reset()
        self._unlink("the port was lost")

    # Input

    def feed(self, data: bytes, t_recv: float) -> list[ArmReport]:
        return self._take(self._reader.feed(data, t_recv), t_recv)

    def _take(self, packets: list[Packet], t_recv: float) -> list[ArmReport]:
        reports: list[ArmReport] = []
        for packet in packets:
            if not packet.is_status:
                continue  # echo of the host's packet by the adapter
            if self._request is not None and self._tries and self._request.fits(packet):
                self._answers[packet.servo] = packet
                if len(self._answers) == len(self._request.servos):
                    self._answered(self._request, t_recv)
            elif (report := self._read(packet, t_recv)) is not None:
                reports.append(report)
        return reports

    def _read(self, packet: Packet, t_recv: float) -> ArmReport | None:
        """Process one servo's answer to the pending Sync Read; return the report when it was the last one."""
        cycle = self._cycle
        if cycle is None or packet.servo not in self._ids or len(packet.parameters) != cycle.size:
            self.counters.unmatched += 1
            return None
        cycle.found[packet.servo] = packet
        if len(cycle.found) < len(self.axes):
            return None
        self._cycle = None
        self._reset_unreported = False
        self._latencies_s.append(t_recv - cycle.t_sent)
        self.counters.readings += 1
        t_sample = cycle.t_received
        latency_ms = (packet.t_first - cycle.t_sent) * 1e3
        self.counters.answer_latency_max_ms = max(self.counters.answer_latency_max_ms, latency_ms)
        registers = {servo: Registers(cycle.address, each.parameters) for servo, each in cycle.found.items()}
        if cycle.address == self._make.status_span[0]:
            self.last_status = registers
        self._check_registers(registers, {servo: each.error for servo, each in cycle.found.items()}, cycle.goals)
        self.pose, self._t_report = self._pose_from(registers), t_sample
        return ArmReport(t_sample, self._reported_state(), self.pose)

    def _pose_from(self, registers: Mapping[int, Registers]) -> JointPose:
        directions = [axis.direction(registers[axis.id][self._make.position]) for axis in self.axes]
        return JointPose(tuple(here - before for here, before in zip(directions, [0.0, *directions], strict=False)))

    def _reported_state(self) -> ArmState:
        if self.faults:
            state = ArmState.FAULT
        elif self._phase is Phase.FOLLOWING:
            state = ArmState.TRACKING
        elif self._phase is Phase.STOPPING:
            state = ArmState.DECELERATING
        else:
            state = ArmState.READY
        self.state = state
        return state

    def _check_registers(
        self, registers: Mapping[int, Registers], errors: Mapping[int, int], goals: Sequence[Mapping[int, int]]
    ) -> None:
        """Detect hardware errors, tripped watchdogs, and servos that do not follow."""
        make = self._make
        found: dict[str, str] = {}
        for axis in self.axes:
            at = registers[axis.id]
            if make.hardware_error in at:
                for bit, (code, words) in make.error_bits.items():
                    if at[make.hardware_error] & bit:
                        found[code] = f"servo {axis.number}: {words}"
            elif errors[axis.id] & make.alert and not self.faults:
                found["alert"] = f"servo {axis.number} raises a hardware alert"
            if make.watchdog is not None and make.watchdog in at and at[make.watchdog] < 0:
                found["watchdog"] = f"servo {axis.number} had no instruction for {WATCHDOG_S * 1e3:.0f} ms and stopped"
            if self._phase in (Phase.FOLLOWING, Phase.STOPPING) and not found:
                found |= self._tracking_fault(axis, at, goals)
        if found:
            self._add_faults(found)
        elif make.hardware_error in next(iter(registers.values())):
            self.faults = {code: text for code, text in self.faults.items() if code in _LATCHED}

    def _tracking_fault(self, axis: Axis, at: Registers, goals: Sequence[Mapping[int, int]]) -> dict[str, str]:
        """Return the fault of a servo that does not follow, by its code; empty if it follows."""
        make = self._make
        if make.torque in at and not at[make.torque]:
            return {"restarted": f"servo {axis.number} has turned its torque off"}
        if any(register in at and at[register] != value for register, value in make.profile(self.profile_ms)):
            return {"restarted": f"servo {axis.number} has lost its settings: it has restarted"}
        if any(at[make.goal] == sent[axis.id] for sent in goals):
            self._missed_goals[axis.id] = 0
            return {}
        self.counters.refused_goals += 1
        misses = self._missed_goals[axis.id] = self._missed_goals.get(axis.id, 0) + 1
        if misses < MAX_MISSES:
            return {}
        sent = goals[-1][axis.id]
        return {"refused": f"servo {axis.number} does not accept its goals: it has {at[make.goal]}, {sent} was sent"}

    def _add_faults(self, found: dict[str, str]) -> None:
        """Add faults and stop sending goals."""
        if "alert" in self.faults:
            self.faults.pop("alert")
        self.faults = self.faults | found
        if self._phase in (Phase.FOLLOWING, Phase.STOPPING):
            self._enter_idle()

    # Output

    def due(self) -> float:
        if self._request is not None:
            if self._tries:
                return self._t_request + ANSWER_S
            return -math.inf if self._cycle is None else self._cycle.t_sent + ANSWER_S
        return self._t_slot

    def poll(self, t: float, target: ArmPose | None) -> Outgoing:
        """Return what to write at `t` (s, monotonic); `target` is the set-point while tracking."""
        self._t_now = t
        silent_s = t - max(self._t_report, self._t_idle)
        if self.state is not None and self._script is None and silent_s > LOST_S:
            self.counters.losses += 1
            self._unlink("the servos do not answer")
        if t < self.due():
            return Outgoing(b"")
        if self._request is not None:
            return Outgoing(self._send_request(t))
        if self._phase is Phase.GREETING:
            self._t_slot = t + GREET_S
            self._begin(Phase.SETTING_UP, self._setting_up())
            return Outgoing(self._send_request(t))
        return self._next_cycle(t, target)

    def _next_cycle(self, t: float, target: ArmPose | None) -> Outgoing:
        moving = self._phase in (Phase.FOLLOWING, Phase.STOPPING)
        period = self.period_s if moving else IDLE_PERIOD_S
        missed = max(0, math.floor((t - self._t_slot) / period)) if math.isfinite(self._t_slot) else 0
        self.counters.skipped_periods += missed if moving else 0
        self._t_slot = self._t_slot + (missed + 1) * period if math.isfinite(self._t_slot) else t + period
        out, setpoint = b"", None
        if self._phase is Phase.FOLLOWING:
            out, setpoint = self._follow(target)
        elif self._phase is Phase.STOPPING:
            out = self._slow_down()
        if self._cycle is not None and t - self._cycle.t_sent < self._patience_s(period):
            return Outgoing(out, setpoint)  # a late answer must not be mistaken for one to a later request
        self.counters.missed += self._cycle is not None
        self.counters.unmatched += len(self._reader.flush())
        self._cycles += 1
        reads_status = not moving or self._cycles % STATUS_EVERY == 0
        address, size = self._make.status_span if reads_status else self._make.cycle_span
        out += self._make.sync_read(address, size, self._ids)
        self._cycle = _Cycle(t, t + len(out) * self._byte_s, address, size, tuple(self._sent_counts))
        return Outgoing(out, setpoint)

    def _patience_s(self, period: float) -> float:
        """Return how long (s) to wait for an answer before the next request; adapts to the adapter's delay."""
        held_s = min(WAIT_SHARE * max(self._latencies_s, default=0.0), ANSWER_S)
        return max(WAIT_PERIODS * period, held_s)

    def _follow(self, target: ArmPose | None) -> tuple[bytes, ArmPose | None]:
        goals, setpoint = self._goals, None
        if isinstance(target, JointPose) and all(map(math.isfinite, target.joints_rad)):
            goals, setpoint = tuple(_summed(target.joints_rad)), target
        return self._send_goals(goals), setpoint

    def _slow_down(self) -> bytes:
        """Send the next goals of the deceleration."""
        slower = tuple(math.copysign(max(abs(w) - STOP_RAD_S2 * self.period_s, 0.0), w) for w in self._rates)
        goals = tuple(goal + w * self.period_s for goal, w in zip(self._goals, slower, strict=True))
        out = self._send_goals(goals)
        self._rates = slower
        if not any(slower):
            self._begin(Phase.STOPPING, self._stopping_watchdogs())
        return out

    def _send_goals(self, goals: tuple[float, ...]) -> bytes:
        self._rates = tuple((new - old) / self.period_s for new, old in zip(goals, self._goals, strict=True))
        self._goals = goals
        counts, distances = {}, {}
        for axis, goal in zip(self.axes, goals, strict=True):
            wanted = axis.counts(goal)
            counts[axis.id] = min(max(wanted, axis.low), axis.high)
            self.counters.bad_targets += counts[axis.id] != wanted
            distances[axis.id] = counts[axis.id] - self._path[axis.id]
            self._path[axis.id] += distances[axis.id] / PROFILE_PERIODS
        self._sent_counts = [*self._sent_counts[-3:], counts]
        self.counters.goals += 1
        return self._make.goals(counts, distances, self.profile_ms)

    # Scripts

    def _begin(self, phase: Phase, script: Script) -> None:
        self._phase, self._script = phase, script
        self._resume(None)

    def _resume(self, answers: Answers | None) -> None:
        assert self._script is not None
        try:
            self._request = next(self._script) if answers is None else self._script.send(answers)
            self._tries = 0
        except StopIteration:
            self._request = self._script = None
        except ServoRefusedError as failure:
            if self._phase is Phase.DISARMING:  # repeated when the bus is set up again
                self._unlink(str(failure))
            else:
                self.refusal = f"start refused: {failure}" if self._phase is Phase.ARMING else str(failure)
                self._disarm()
        except SetUpError as failure:
            self._request = self._script = None
            self.faults = {"set-up": str(failure)}
            self.refusal = str(failure)
            self._enter_idle()

    def _send_request(self, t: float) -> bytes:
        """Send the pending request or repeat it; unlink after the last try."""
        request = self._request
        assert request is not None
        self._cycle = None
        self._reader.flush()
        if self._tries >= request.tries:
            silent = [axis.number for axis in self.axes if axis.id in request.servos and axis.id not in self._answers]
            self._unlink(f"servo {', '.join(map(str, silent))} does not answer")
            self._t_slot = t + GREET_S
            torques_off = {axis.id: 0 for axis in self._turned_on}
            return self._make.sync_write(self._make.torque, torques_off) if torques_off else b""
        self.counters.retries += self._tries > 0
        self._tries += 1
        self._t_request = self._t_sent = t
        self._answers = {}
        return request.packet

    def _answered(self, request: ServoRequest, t_recv: float) -> None:
        self._t_request, self._t_answer = -math.inf, t_recv
        self._latencies_s.append(t_recv - self._t_sent)
        answers, self._answers = [self._answers[servo] for servo in request.servos], {}
        self._resume(answers)

    # Steps

    def _setting_up(self) -> Script:
        self.counters.registers_set += yield from set_up(self.axes, [axis.id for axis in self._turned_on])
        self._turned_on = ()
        self.faults = {}
        self._enter_idle()

    def _arming(self) -> Script:
        found = yield from prepare(self.axes, self.profile_ms)
        self._turned_on = tuple(axis for axis in self.axes if not found[axis.id][self._make.torque])
        goals, awake = yield from hold(self.axes, found)
        self._goals = tuple(axis.direction(goals[axis.id]) for axis in self.axes)
        self._rates = (0.0,) * len(self._goals)
        self._sent_counts, self._missed_goals, self._turned_on = [goals], {}, ()
        self._path = {servo: float(goal) for servo, goal in goals.items()}
        self.pose, self._t_report = self._pose_from(awake), self._t_answer
        self._phase, self.state = Phase.FOLLOWING, ArmState.TRACKING
        self._t_slot = self._t_now

    def _disarm(self) -> None:
        """Turn off the torque that an `arm` has turned on; servos that held before keep holding."""
        self._begin(Phase.DISARMING, self._disarming())

    def _disarming(self) -> Script:
        yield from torque_off(self._turned_on)
        self._turned_on = ()
        self._enter_idle()

    def _stopping_watchdogs(self) -> Script:
        yield from stop_watchdogs(self.axes)
        self._enter_idle()

    def _resetting(self) -> Script:
        error = self._make.hardware_error
        yield from restart(
            [axis for axis in self.axes if axis.id in self.last_status and self.last_status[axis.id][error]]
        )
        yield from self._setting_up()

    def _enter_idle(self) -> None:
        """Stop sending goals; the servos are read at the low rate."""
        self._phase = Phase.IDLE
        self._script = self._request = None
        self._t_slot = self._t_idle = self._t_now
        if self.state is not None:
            self.state = ArmState.FAULT if self.faults else ArmState.READY

    def _hint(self) -> str:
        slowest_s = max(self._latencies_s, default=0.0)
        return f"; {adapter_hint(slowest_s)}" if slowest_s > SLOW_ADAPTER_S else ""

    def _unlink(self, reason: str) -> None:
        if self.busy:
            self.refusal = f"the request failed: {reason}{self._hint()}"
        self._script = self._request = self._cycle = None
        self._phase = Phase.GREETING
        self._reset_unreported = False
        self._t_slot = -math.inf
        self.state = self.pose = None
        self.faults = {}


def adapter_hint(latency_s: float) -> str:
    """Return what to do about answers with this latency (s)."""
    return (
        f"answers take {latency_s * 1e3:.0f} ms: set the adapter's latency timer to 1 ms"
        " (sudo palmd install; or setserial PORT low_latency)"
    )


def cycle_period(baud: int, servos: int, make: ServoMake) -> float:
    """Return the shortest period (s) in which a cycle uses at most half of the bus."""
    goals = len(make.goals(dict.fromkeys(range(servos), 0), dict.fromkeys(range(servos), 0.0), 1))
    request_bytes = len(make.sync_read(*make.cycle_span, range(servos)))
    answer_bytes = servos * len(make.status(0, 0, bytes(make.cycle_span[1])))
    busy = (goals + request_bytes + answer_bytes) * byte_time(baud)
    return next((period for period in PERIODS_S if busy <= MAX_BUS_SHARE * period), PERIODS_S[-1])


def _summed(joints: Sequence[float]) -> list[float]:
    """Convert joint angles to the palms' directions (rad)."""
    total, out = 0.0, []
    for joint in joints:
        total += joint
        out.append(total)
    return out
