"""The host's side of a bus of servos: what to ask them when, and what their answers mean.

A pure state machine. The caller gives it the bytes read and their time, and asks it what to write at the times `due()`
names:

    greeting (ping until all answer) -> setting up (registers compared, set, read back) -> standing (read 20 times a s)
    standing -> arming (goal := present, torque and watchdog on) -> following (goals and readings every cycle)
    arming -> letting go (what could not be armed has its torque turned off again) -> standing
    following -> stopping (the goals come to rest, and are held) -> standing

Goals go out by Sync Write, which is never answered: whether a servo took its goal is seen in the goal that it reports a
cycle later, and so are a tripped watchdog, a restart and a torque that is off. Whatever takes several questions is a
script of `servoscripts`. Nothing that comes down the line raises.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Generator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from enum import Enum, auto

from palmd.config.arms import ServoConfig
from palmd.devices.actuator import ArmReport, ArmState, JointPose, ArmPose, Outgoing
from palmd.devices.arrival import byte_time
from palmd.devices.framing import FrameCounters
from palmd.devices.servoaxis import Axis
from palmd.devices.servobus import Packet, Registers, ServoMake
from palmd.devices.servoscripts import (
    ANSWER_S,
    WATCHDOG_S,
    Answers,
    Ask,
    ServoRefusedError,
    SetUpError,
    hold,
    let_go,
    prepare,
    restart,
    set_up,
    stand_down,
)

FREEZE_S = 0.080
"""Without a reading for so long the motion should stand still."""

LOST_S = 0.250
"""Without a reading for so long the bus is lost."""

GREET_S = 0.250
STANDING_S = 0.050
PERIODS_S = (0.010, 0.020, 0.040)
MOST_SHARE = 0.5
"""Of a period that the bus may be busy."""

PROFILE_PERIODS = 1.2
"""A servo takes so many periods to go to a goal, evenly: more than one, so that it never stops to wait for the next."""

STOP_RAD_S2 = math.radians(900.0)
WAIT_PERIODS = 1.5  # for an answer, before the next question; longer where an adapter holds answers back
WAIT_SHARE = 1.25  # of the slowest of the last answers
LATENCIES_KEPT = 64
SLOW_ADAPTER_S = 0.008
"""Slower answers come from an adapter that holds them back: FTDI's latency timer is 16 ms until somebody sets it."""

LOOK_EVERY = 10  # cycles, after which the torque and the hardware errors are read too
MISSES_MOST = 3  # cycles in a row in which a goal may not have been taken: each may have been spoilt on the line

_KEPT = ("refused", "restarted", "watchdog", "set-up")  # that no reading shows to be over


Script = Generator[Ask, Answers, None]


class Phase(Enum):
    """What the host is doing."""

    GREETING = auto()
    SETTING_UP = auto()
    STANDING = auto()
    ARMING = auto()
    LETTING_GO = auto()
    FOLLOWING = auto()
    STOPPING = auto()
    RESETTING = auto()


@dataclass(slots=True)
class ServoCounters:
    """What has passed on the bus since the start.

    `readings` are cycles in which all servos answered, `missed` those in which one did not; `refused_goals` goals that
    a servo did not report back, `registers_set` settings that were not as they should be, `bad_targets` targets beyond
    a servo's range, `unmatched` answers that nothing waits for, `losses` silences of 250 ms.
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
        """Return every count by name, those of the bus included."""
        counts = asdict(self)
        return {**counts.pop("bus"), **counts}


@dataclass(slots=True)
class _Cycle:
    """What a Sync Read has asked for, and what has come of it."""

    t_sent: float
    t_heard: float
    """When its last byte reached the servos, which is when they look: answers may be held back, questions are not."""
    address: int
    size: int
    goals: Sequence[Mapping[int, int]]
    """Those sent last when it was asked: which of them a servo has is seen in its answer."""
    found: dict[int, Packet] = field(default_factory=dict)


class ServoHost:
    """Speaks to the servos of one bus, palm 1's first; see the module's text.

    `state` is the last reported one, None while unknown. `refusal` says why the last request came to nothing, else
    None.
    """

    def __init__(self, baud: int, servos: Sequence[ServoConfig], make: ServoMake) -> None:
        """`baud` in bit/s; all servos are of one make."""
        self._make = make
        self.axes = tuple(Axis.from_config(number, servo, make) for number, servo in enumerate(servos, 1))
        self._ids = tuple(axis.id for axis in self.axes)
        self.period_s = cycle_period(baud, len(self.axes), make)
        self.profile_ms = round(PROFILE_PERIODS * self.period_s * 1e3)
        self._byte_s = byte_time(baud)
        self._reader = make.reader(baud)
        self.counters = ServoCounters(bus=self._reader.counters)
        self.state: ArmState | None = None
        self.refusal: str | None = None
        self.trouble: dict[str, str] = {}
        """What is wrong, by the code of the fault table without the arm's name."""
        self.looks: dict[int, Registers] = {}
        """The last long reading of each servo."""
        self._phase = Phase.GREETING
        self._pose: JointPose | None = None
        self._t_pose = -math.inf
        self._script: Script | None = None
        self._ask: Ask | None = None
        self._answers: dict[int, Packet] = {}
        self._t_asked = self._t_sent = self._t_answer = -math.inf
        self._latencies_s: deque[float] = deque(maxlen=LATENCIES_KEPT)
        self._turned_on: tuple[Axis, ...] = ()  # by an `arm` that is under way, or came to nothing
        self._tries = 0
        self._t_slot = -math.inf
        self._cycle: _Cycle | None = None
        self._cycles = 0
        self._goals: tuple[float, ...] = ()  # directions (rad) that were sent last
        self._rates: tuple[float, ...] = ()  # rad/s
        self._sent_counts: list[dict[int, int]] = []  # of the last cycles, the latest last
        self._path: dict[int, float] = {}  # counts where each servo's even way to its goals has got to
        self._missed_goals: dict[int, int] = {}
        self._t_now = self._t_stood = -math.inf
        self._reset_untold = False  # a reset has been done, but no reading has come since

    # What the caller may ask

    @property
    def pose(self) -> JointPose | None:
        """The last one reported, None while unknown."""
        return self._pose

    def linked(self, t: float) -> bool:
        """Whether all servos have been set up and have answered within the last 250 ms at `t` (s)."""
        return self.state is not None and t - max(self._t_pose, self._t_answer) <= LOST_S

    def lost(self, t: float) -> bool:
        """Whether not."""
        return not self.linked(t)

    def frozen(self, t: float) -> bool:
        """Whether, while following, no reading has come for 80 ms at `t` (s): motion should halt."""
        return self.tracking and self.age(t) > FREEZE_S

    def age(self, t: float) -> float:
        """How old (s) the last reading of all is at `t` (s); infinite before the first."""
        return t - self._t_pose

    @property
    def tracking(self) -> bool:
        """Whether goals are being sent."""
        return self._phase is Phase.FOLLOWING

    @property
    def busy(self) -> bool:
        """Whether a request is still under way."""
        busy = (Phase.ARMING, Phase.LETTING_GO, Phase.RESETTING, Phase.STOPPING)
        return self._phase in busy or self._reset_untold

    @property
    def error(self) -> str:
        """What is wrong, in words; empty when nothing is."""
        return "; ".join(self.trouble.values())

    # What the caller may want

    def request_tracking(self) -> None:
        """Ask for tracking: goals follow by themselves, the first at the actual pose."""
        if self._phase is not Phase.STANDING:
            self.refusal = None if self.tracking else "start refused: the servos are not ready"
        elif self.trouble:
            self.refusal = f"start refused: {self.error}"
        else:
            self.refusal = None
            self._begin(Phase.ARMING, self._arming())

    def request_stop(self) -> None:
        """Ask for a planned stop: the goals come to rest, and the servos hold them."""
        if self._phase is Phase.FOLLOWING:
            self._phase = Phase.STOPPING
            self.state = ArmState.DECELERATING
        elif self._phase is Phase.ARMING:
            self._let_go()

    def request_reset(self) -> None:
        """Ask for what is latched to be cleared: servos with a hardware error start anew, watchdogs are cleared."""
        if self._phase is Phase.STANDING:
            self.refusal = None
            self._reset_untold = True
            self._begin(Phase.RESETTING, self._resetting())
        else:
            self.refusal = "reset refused: the servos are not standing"

    def disconnected(self) -> None:
        """The port is gone: begin with greeting when bytes flow again."""
        self._reader.reset()
        self._unlink("the port was lost")

    # In

    def feed(self, data: bytes, t_recv: float) -> list[ArmReport]:
        """Take the bytes read at `t_recv` (s, monotonic) and return the reports they complete."""
        return self._take(self._reader.feed(data, t_recv), t_recv)

    def _take(self, packets: list[Packet], t_recv: float) -> list[ArmReport]:
        reports: list[ArmReport] = []
        for packet in packets:
            if not packet.is_status:
                continue  # an adapter that echoes what the host says
            if self._ask is not None and self._tries and self._ask.fits(packet):
                self._answers[packet.servo] = packet
                if len(self._answers) == len(self._ask.servos):
                    self._answered(self._ask, t_recv)
            elif (report := self._read(packet, t_recv)) is not None:
                reports.append(report)
        return reports

    def _read(self, packet: Packet, t_recv: float) -> ArmReport | None:
        """One servo's answer to the Sync Read under way; a report when it was the last."""
        cycle = self._cycle
        if cycle is None or packet.servo not in self._ids or len(packet.parameters) != cycle.size:
            self.counters.unmatched += 1
            return None
        cycle.found[packet.servo] = packet
        if len(cycle.found) < len(self.axes):
            return None
        self._cycle = None
        self._reset_untold = False
        self._latencies_s.append(t_recv - cycle.t_sent)
        self.counters.readings += 1
        t_sample = cycle.t_heard
        latency_ms = (packet.t_first - cycle.t_sent) * 1e3
        self.counters.answer_latency_max_ms = max(self.counters.answer_latency_max_ms, latency_ms)
        registers = {servo: Registers(cycle.address, each.parameters) for servo, each in cycle.found.items()}
        if cycle.address == self._make.look[0]:
            self.looks = registers
        self._judge(registers, {servo: each.error for servo, each in cycle.found.items()}, cycle.goals)
        self._pose, self._t_pose = self._posed(registers), t_sample
        return ArmReport(t_sample, self._reported_state(), self._pose)

    def _posed(self, registers: Mapping[int, Registers]) -> JointPose:
        directions = [axis.direction(registers[axis.id][self._make.position]) for axis in self.axes]
        return JointPose(tuple(here - before for here, before in zip(directions, [0.0, *directions], strict=False)))

    def _reported_state(self) -> ArmState:
        if self.trouble:
            state = ArmState.FAULT
        elif self._phase is Phase.FOLLOWING:
            state = ArmState.TRACKING
        elif self._phase is Phase.STOPPING:
            state = ArmState.DECELERATING
        else:
            state = ArmState.READY
        self.state = state
        return state

    def _judge(
        self, registers: Mapping[int, Registers], errors: Mapping[int, int], goals: Sequence[Mapping[int, int]]
    ) -> None:
        """Find what is wrong with servos that follow, and what hardware errors there are."""
        make = self._make
        found: dict[str, str] = {}
        for axis in self.axes:
            at = registers[axis.id]
            if make.hardware_error in at:
                for bit, (code, words) in make.troubles.items():
                    if at[make.hardware_error] & bit:
                        found[code] = f"servo {axis.number}: {words}"
            elif errors[axis.id] & make.alert and not self.trouble:
                found["alert"] = f"servo {axis.number} raises a hardware alert"
            if make.watchdog is not None and make.watchdog in at and at[make.watchdog] < 0:
                found["watchdog"] = f"servo {axis.number} had no instruction for {WATCHDOG_S * 1e3:.0f} ms and stopped"
            if self._phase in (Phase.FOLLOWING, Phase.STOPPING) and not found:
                found |= self._strayed(axis, at, goals)
        if found:
            self._fall(found)
        elif make.hardware_error in next(iter(registers.values())):
            self.trouble = {code: text for code, text in self.trouble.items() if code in _KEPT}

    def _strayed(self, axis: Axis, at: Registers, goals: Sequence[Mapping[int, int]]) -> dict[str, str]:
        """What a servo that ought to follow does instead."""
        make = self._make
        if make.torque in at and not at[make.torque]:
            return {"restarted": f"servo {axis.number} has let go: its torque is off"}
        if any(register in at and at[register] != value for register, value in make.profile(self.profile_ms)):
            return {"restarted": f"servo {axis.number} has lost its settings: it has started anew"}
        if any(at[make.goal] == sent[axis.id] for sent in goals):
            self._missed_goals[axis.id] = 0
            return {}
        self.counters.refused_goals += 1
        misses = self._missed_goals[axis.id] = self._missed_goals.get(axis.id, 0) + 1
        if misses < MISSES_MOST:
            return {}
        sent = goals[-1][axis.id]
        return {"refused": f"servo {axis.number} does not take its goals: it has {at[make.goal]}, {sent} was sent"}

    def _fall(self, found: dict[str, str]) -> None:
        """Something is wrong: no more goals."""
        if "alert" in self.trouble:
            self.trouble.pop("alert")
        self.trouble = self.trouble | found
        if self._phase in (Phase.FOLLOWING, Phase.STOPPING):
            self._stand()

    # Out

    def due(self) -> float:
        """When (s) `poll` next has something to do; always after the time of the last `poll`."""
        if self._ask is not None:
            if self._tries:
                return self._t_asked + ANSWER_S
            return -math.inf if self._cycle is None else self._cycle.t_sent + ANSWER_S
        return self._t_slot

    def poll(self, t: float, target: ArmPose | None) -> Outgoing:
        """What to write at `t` (s, monotonic), `target` being where the palms should be, if tracking."""
        self._t_now = t
        silent_s = t - max(self._t_pose, self._t_stood)
        if self.state is not None and self._script is None and silent_s > LOST_S:
            self.counters.losses += 1
            self._unlink("the servos do not answer")
        if t < self.due():
            return Outgoing(b"")
        if self._ask is not None:
            return Outgoing(self._put(t))
        if self._phase is Phase.GREETING:
            self._t_slot = t + GREET_S
            self._begin(Phase.SETTING_UP, self._setting_up())
            return Outgoing(self._put(t))
        return self._next_cycle(t, target)

    def _next_cycle(self, t: float, target: ArmPose | None) -> Outgoing:
        moving = self._phase in (Phase.FOLLOWING, Phase.STOPPING)
        period = self.period_s if moving else STANDING_S
        missed = max(0, math.floor((t - self._t_slot) / period)) if math.isfinite(self._t_slot) else 0
        self.counters.skipped_periods += missed if moving else 0
        self._t_slot = self._t_slot + (missed + 1) * period if math.isfinite(self._t_slot) else t + period
        out, setpoint = b"", None
        if self._phase is Phase.FOLLOWING:
            out, setpoint = self._follow(target)
        elif self._phase is Phase.STOPPING:
            out = self._slow_down()
        if self._cycle is not None and t - self._cycle.t_sent < self._patience_s(period):
            return Outgoing(out, setpoint)  # a late answer must not be taken for that to a later question
        self._give_up_cycle()
        self._cycles += 1
        look = not moving or self._cycles % LOOK_EVERY == 0
        address, size = self._make.look if look else self._make.cycle
        out += self._make.sync_read(address, size, self._ids)
        self._cycle = _Cycle(t, t + len(out) * self._byte_s, address, size, tuple(self._sent_counts))
        return Outgoing(out, setpoint)

    def _patience_s(self, period: float) -> float:
        """How long an answer may take before the next question: as long as the adapter holds answers back."""
        held_s = min(WAIT_SHARE * max(self._latencies_s, default=0.0), ANSWER_S)
        return max(WAIT_PERIODS * period, held_s)

    def _give_up_cycle(self) -> None:
        if self._cycle is not None:
            self.counters.missed += 1
            self._cycle = None
        for _ in self._reader.flush():
            self.counters.unmatched += 1

    def _follow(self, target: ArmPose | None) -> tuple[bytes, ArmPose | None]:
        goals, setpoint = self._goals, None
        if isinstance(target, JointPose) and all(map(math.isfinite, target.joints_rad)):
            goals, setpoint = tuple(_summed(target.joints_rad)), target
        return self._send_goals(goals), setpoint

    def _slow_down(self) -> bytes:
        """The next goals on the way to rest."""
        slower = tuple(math.copysign(max(abs(w) - STOP_RAD_S2 * self.period_s, 0.0), w) for w in self._rates)
        goals = tuple(goal + w * self.period_s for goal, w in zip(self._goals, slower, strict=True))
        out = self._send_goals(goals)
        self._rates = slower
        if not any(slower):
            self._begin(Phase.STOPPING, self._standing_down())
        return out

    def _send_goals(self, goals: tuple[float, ...]) -> bytes:
        self._rates = tuple((new - old) / self.period_s for new, old in zip(goals, self._goals, strict=True))
        self._goals = goals
        counts, ways = {}, {}
        for axis, goal in zip(self.axes, goals, strict=True):
            wanted = axis.counts(goal)
            counts[axis.id] = min(max(wanted, axis.low), axis.high)
            self.counters.bad_targets += counts[axis.id] != wanted
            ways[axis.id] = counts[axis.id] - self._path[axis.id]
            self._path[axis.id] += ways[axis.id] / PROFILE_PERIODS
        self._sent_counts = [*self._sent_counts[-3:], counts]
        self.counters.goals += 1
        return self._make.goals(counts, ways, self.profile_ms)

    # Questions

    def _begin(self, phase: Phase, script: Script) -> None:
        self._phase, self._script = phase, script
        self._resume(None)

    def _resume(self, answers: Answers | None) -> None:
        assert self._script is not None
        try:
            self._ask = next(self._script) if answers is None else self._script.send(answers)
            self._tries = 0
        except StopIteration:
            self._ask = self._script = None
        except ServoRefusedError as failure:
            if self._phase is Phase.LETTING_GO:  # once more when it is set up again
                self._unlink(str(failure))
            else:
                self.refusal = f"start refused: {failure}" if self._phase is Phase.ARMING else str(failure)
                self._let_go()
        except SetUpError as failure:
            self._ask = self._script = None
            self.trouble = {"set-up": str(failure)}
            self.refusal = str(failure)
            self._stand()

    def _put(self, t: float) -> bytes:
        """Ask, again if need be; after as many tries as there are, give up."""
        ask = self._ask
        assert ask is not None
        self._cycle = None
        self._reader.flush()
        if self._tries >= ask.tries:
            silent = [axis.number for axis in self.axes if axis.id in ask.servos and axis.id not in self._answers]
            self._unlink(f"servo {', '.join(map(str, silent))} does not answer")
            self._t_slot = t + GREET_S
            off = {axis.id: 0 for axis in self._turned_on}
            return self._make.sync_write(self._make.torque, off) if off else b""
        self.counters.retries += self._tries > 0
        self._tries += 1
        self._t_asked = self._t_sent = t
        self._answers = {}
        return ask.packet

    def _answered(self, ask: Ask, t_recv: float) -> None:
        self._t_asked, self._t_answer = -math.inf, t_recv
        self._latencies_s.append(t_recv - self._t_sent)
        answers, self._answers = [self._answers[servo] for servo in ask.servos], {}
        self._resume(answers)

    # Scripts

    def _setting_up(self) -> Script:
        self.counters.registers_set += yield from set_up(self.axes, [axis.id for axis in self._turned_on])
        self._turned_on = ()
        self.trouble = {}
        self._stand()

    def _arming(self) -> Script:
        found = yield from prepare(self.axes, self.profile_ms)
        self._turned_on = tuple(axis for axis in self.axes if not found[axis.id][self._make.torque])
        goals, awake = yield from hold(self.axes, found)
        self._goals = tuple(axis.direction(goals[axis.id]) for axis in self.axes)
        self._rates = (0.0,) * len(self._goals)
        self._sent_counts, self._missed_goals, self._turned_on = [goals], {}, ()
        self._path = {servo: float(goal) for servo, goal in goals.items()}
        self._pose, self._t_pose = self._posed(awake), self._t_answer
        self._phase, self.state = Phase.FOLLOWING, ArmState.TRACKING
        self._t_slot = self._t_now

    def _let_go(self) -> None:
        """What an `arm` has turned on goes off again; what held before it goes on holding."""
        self._begin(Phase.LETTING_GO, self._letting_go())

    def _letting_go(self) -> Script:
        yield from let_go(self._turned_on)
        self._turned_on = ()
        self._stand()

    def _standing_down(self) -> Script:
        yield from stand_down(self.axes)
        self._stand()

    def _resetting(self) -> Script:
        error = self._make.hardware_error
        yield from restart([axis for axis in self.axes if axis.id in self.looks and self.looks[axis.id][error]])
        yield from self._setting_up()

    def _stand(self) -> None:
        """No goals from now on; the servos are read at leisure."""
        self._phase = Phase.STANDING
        self._script = self._ask = None
        self._t_slot = self._t_stood = self._t_now
        if self.state is not None:
            self.state = ArmState.FAULT if self.trouble else ArmState.READY

    def _hint(self) -> str:
        slowest_s = max(self._latencies_s, default=0.0)
        return f"; {adapter_hint(slowest_s)}" if slowest_s > SLOW_ADAPTER_S else ""

    def _unlink(self, reason: str) -> None:
        if self.busy:
            self.refusal = f"it came to nothing: {reason}{self._hint()}"
        self._script = self._ask = self._cycle = None
        self._phase = Phase.GREETING
        self._reset_untold = False
        self._t_slot = -math.inf
        self.state = self._pose = None
        self.trouble = {}


def adapter_hint(latency_s: float) -> str:
    """What to do about answers that take so long (s)."""
    return (
        f"answers take {latency_s * 1e3:.0f} ms: set the adapter's latency timer to 1 ms"
        " (sudo palmd install; or setserial PORT low_latency)"
    )


def cycle_period(baud: int, servos: int, make: ServoMake) -> float:
    """The shortest period (s) in which a cycle leaves half of the bus free."""
    goals = len(make.goals(dict.fromkeys(range(servos), 0), dict.fromkeys(range(servos), 0.0), 1))
    asked = len(make.sync_read(*make.cycle, range(servos)))
    told = servos * len(make.status(0, 0, bytes(make.cycle[1])))
    busy = (goals + asked + told) * byte_time(baud)
    return next((period for period in PERIODS_S if busy <= MOST_SHARE * period), PERIODS_S[-1])


def _summed(joints: Sequence[float]) -> list[float]:
    """Of joint angles the palms' directions."""
    total, out = 0.0, []
    for joint in joints:
        total += joint
        out.append(total)
    return out
