"""The host's side of the arm link: what to send when, and what the answers mean.

A pure state machine. The caller gives it the bytes read and their time, and asks it what to write at the
times `due()` names:

    hello (H, until H1 comes) -> asking (Q every 100 ms) -> tracking (S every cycle) -> asking ...
                                        every silence of 250 ms leads back to hello

It never starts the arm by itself: G, P and R go out on request only, and are repeated, unchanged, until they
are answered. Nothing that comes down the line raises. All of it is safe inside the 100 Hz loop.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, replace

from palmd.devices.actuator import FOLLOWING, ArmReport, ArmState, Pose, Sent
from palmd.devices.armlink import (
    SEQUENCE_MODULUS,
    SETPOINT_BYTES,
    Ack,
    Command,
    Hello,
    HelloReply,
    LineCounters,
    LineReader,
    LinkError,
    Query,
    Refusal,
    Reset,
    SetPoint,
    Start,
    Stop,
    command_body,
    encode_command,
    error_text,
    parse_reply,
)
from palmd.devices.arrival import byte_time
from palmd.devices.phaselock import SetPointTimer

FREEZE_S = 0.080
"""Without an answer for so long the motion should stand still."""

FAULT_S = 0.250
"""Without an answer for so long the link is lost."""

HELLO_RETRY_S = 0.250
HELLO_ANSWER_S = 1.0
"""An `H1` later than this after the last `H` was not asked for: the controller has restarted."""

QUERY_S = 0.100
REQUEST_RETRY_S = 0.064
"""Four cycles: later than any answer should be, and soon enough for a second try of G within the controller's
160 ms watchdog."""

NEAR_M = 0.005
NEAR_RAD = math.radians(3.0)
"""How near to the arm's actual pose the first set-point after a hold must be."""

PASSING_CODES = (-522, -524, -610, -611)
"""Refusals of one line or one set-point. After any other code the controller may have left tracking."""

WRONG_STATE = -620

Request = type[Start] | type[Stop] | type[Reset]
_VERB: dict[Request, str] = {Start: "start", Stop: "stop", Reset: "reset"}


@dataclass(slots=True)
class HostCounters:
    """What has passed on the arm link since the start.

    `malformed` counts intact lines that are no reply, `unmatched` answers that nothing waits for (late ones
    and repeats), `rebased` set-points sent at the actual pose because the target was too far for a resume,
    `bad_targets` targets that cannot be sent, `losses` silences of 250 ms, `restarts` the controller's.
    """

    line: LineCounters = field(default_factory=LineCounters)
    malformed: int = 0
    acks: int = 0
    unmatched: int = 0
    refusals: int = 0
    setpoints: int = 0
    skipped_periods: int = 0
    rebased: int = 0
    bad_targets: int = 0
    retries: int = 0
    restarts: int = 0
    losses: int = 0
    ack_latency_max_ms: float = 0.0

    def as_dict(self) -> dict[str, float]:
        """Return every count by name, those of the line included."""
        counts = asdict(self)
        return {**counts.pop("line"), **counts}


@dataclass(slots=True)
class _Pending:
    """A request that is to be sent until it is answered; `command` is None before the first time."""

    kind: Request
    command: Start | Stop | Reset | None = None
    t_sent: float = -math.inf

    def waits_for(self, ss: int) -> bool:
        return self.command is not None and self.command.ss == ss


class ArmHost:
    """Speaks to one controller; see the module's text.

    `state` and `pose` are the last reported ones, None while unknown; `commanded` is the last set-point sent
    since tracking began. `last_error` is the code of the last error line, until a start or reset succeeds.
    `refusal` says why the last request came to nothing, else None; `unlinked` how the last link ended.
    """

    def __init__(self, baud: int) -> None:
        """`baud` in bit/s dates the bytes. Raises ValueError if it is not positive."""
        self._baud = baud
        self._reader = LineReader(baud)
        self.counters = HostCounters(line=self._reader.counters)
        self.hello: HelloReply | None = None
        self.state: ArmState | None = None
        self.pose: Pose | None = None
        self.commanded: Pose | None = None
        self.last_error: int | None = None
        self.refusal: str | None = None
        self.unlinked = "the controller has not answered yet"
        self._bytes_at_ack = self._lines_at_ack = 0
        self._latency_s = 0.0  # of the last answer
        self._t_ack = -math.inf
        self._t_alive = -math.inf
        self._t_hello = -math.inf
        self._t_query = -math.inf
        self._say_hello = True
        self._ss = 0
        self._waiting: dict[int, tuple[type[Command], float]] = {}
        self._pending: _Pending | None = None
        self._timer: SetPointTimer | None = None
        self._doubt = False

    # What the caller may ask

    def linked(self, t: float) -> bool:
        """Tell whether the controller has said hello and its last report is at most 250 ms old at `t` (s)."""
        return self.state is not None and self.age(t) <= FAULT_S

    def lost(self, t: float) -> bool:
        """Tell whether there is no link at `t` (s): none yet, silent for more than 250 ms, or restarted."""
        return not self.linked(t)

    def frozen(self, t: float) -> bool:
        """Tell whether, while tracking, no answer has come for 80 ms at `t` (s): motion should halt."""
        return self.tracking and self.age(t) > FREEZE_S

    def age(self, t: float) -> float:
        """Return how old (s) the last report is at `t` (s); infinite before the first."""
        return t - self._t_ack

    @property
    def unanswering(self) -> tuple[int, int]:
        """How many bytes, and how many whole lines, have come since the last report."""
        return self.counters.line.bytes - self._bytes_at_ack, self.counters.line.lines - self._lines_at_ack

    @property
    def tracking(self) -> bool:
        """Whether set-points are being sent."""
        return self._timer is not None

    @property
    def busy(self) -> bool:
        """Whether a request still waits for its answer."""
        return self._pending is not None

    # What the caller may want

    def want_tracking(self) -> None:
        """Ask for tracking (G). Set-points follow by themselves, the first at the arm's actual pose."""
        if self.tracking:
            return
        wire_s = SETPOINT_BYTES * byte_time(self._baud)
        if self.hello is not None and wire_s > self.hello.cycle_s:
            self.refusal = (
                f"start refused: a set-point takes {wire_s * 1e3:.1f} ms at {self._baud} baud, longer than "
                f"the controller's cycle of {self.hello.cycle_s * 1e3:.0f} ms; use a faster line"
            )
            return
        self._request(Start)

    def want_stop(self) -> None:
        """Ask for a planned stop (P); no more set-points are sent."""
        self._end_tracking()
        self._request(Stop)

    def request_reset(self) -> None:
        """Ask the controller to clear a latched fault (R)."""
        if self.tracking:
            self.refusal = "reset refused: the arm is tracking"
        else:
            self._request(Reset)

    def disconnected(self) -> None:
        """The port is gone: forget the link, and begin with hello when bytes flow again."""
        self._reader.reset()
        self._unlink("the port was lost")

    # In

    def feed(self, data: bytes, t_recv: float) -> list[ArmReport]:
        """Take the bytes read at `t_recv` (s, monotonic) and return the reports they complete."""
        reports: list[ArmReport] = []
        lines = list(self._reader.feed(data, t_recv))
        for line in lines:
            try:
                reply = parse_reply(line.body)
            except LinkError:
                self.counters.malformed += 1
                continue
            match reply:
                case Ack():
                    if self._acknowledged(reply, line.t_first, alone=len(lines) == 1):
                        fresh = self._latency_s <= REQUEST_RETRY_S
                        reports.append(ArmReport(line.t_first, reply.state, reply.pose, fresh))
                case Refusal():
                    self._refused(reply)
                case HelloReply():
                    self._greeted(reply, line.t_first)
        return self._told_apart(reports)

    def _acknowledged(self, ack: Ack, t_first: float, *, alone: bool) -> bool:
        kind, t_sent = self._waiting.pop(ack.ss, (None, 0.0))
        if kind is None or self.hello is None:
            self.counters.unmatched += 1
            return False
        self._latency_s = t_first - t_sent
        self.counters.acks += 1
        self.counters.ack_latency_max_ms = max(self.counters.ack_latency_max_ms, self._latency_s * 1e3)
        self.state, self.pose = ack.state, ack.pose
        self._t_ack = self._t_alive = t_first
        self._bytes_at_ack, self._lines_at_ack = self.counters.line.bytes, self.counters.line.lines
        if self._timer is not None:
            if kind is SetPoint and alone:
                self._timer.answered(t_first)
            if self._doubt:
                self._t_query = math.inf
        self._doubt = False
        if self._pending is not None and self._pending.waits_for(ack.ss):
            self._granted(self._pending.kind, ack, t_first, self.hello.cycle_s)
        elif ack.state not in FOLLOWING:
            self._end_tracking()
        return True

    def _granted(self, kind: Request, ack: Ack, t_first: float, cycle_s: float) -> None:
        self._pending = None
        self.refusal = None
        self._t_query = t_first + QUERY_S
        if kind is Start and ack.state not in FOLLOWING:
            self.refusal = f"start refused: the controller answered with state {ack.state} ({ack.state.name})"
        elif kind is not Stop:
            self.last_error = None
        if kind is Start and ack.state in FOLLOWING:
            self._timer = SetPointTimer(self._baud, cycle_s, t_first)
            self._t_query = math.inf
            self.commanded = None

    def _told_apart(self, reports: list[ArmReport]) -> list[ArmReport]:
        """Where several came at once: set-points are answered a cycle apart, so something has held them up."""
        if len(reports) < 2 or self._timer is None or any(each.state is not ArmState.TRACKING for each in reports):
            return reports
        last = self._timer.cycle_before(reports[-1].t_sample)
        ago = range(len(reports) - 1, -1, -1)
        return [
            replace(each, t_sample=min(each.t_sample, last - cycles * self._timer.period_s))
            for each, cycles in zip(reports, ago, strict=True)
        ]

    def _refused(self, refusal: Refusal) -> None:
        self._waiting.pop(refusal.ss, None)
        self.counters.refusals += 1
        if not (self._doubt and refusal.code == WRONG_STATE):  # set-points on their way when a fault latched
            self.last_error = refusal.code
        self._doubt = refusal.code not in PASSING_CODES
        self._t_query = -math.inf
        if self._pending is not None and self._pending.waits_for(refusal.ss):
            self.refusal = f"{_VERB[self._pending.kind]} refused: {error_text(refusal.code)}"
            self._pending = None

    def _greeted(self, reply: HelloReply, t_first: float) -> None:
        if t_first - self._t_hello <= HELLO_ANSWER_S:
            self.hello = reply
            self._t_alive = t_first
        elif self.hello is not None:
            self.counters.restarts += 1
            self._unlink("the controller restarted")

    # Out

    def due(self) -> float:
        """Return when (s) `poll` next has something to do; always after the time of the last `poll`."""
        if self.hello is None:
            return -math.inf if self._say_hello else self._t_hello + HELLO_RETRY_S
        t_lost = self._t_alive + FAULT_S
        if self._pending is not None:
            return min(t_lost, self._pending.t_sent + REQUEST_RETRY_S)
        if self._timer is not None and not self._doubt:
            return min(t_lost, self._t_query, self._timer.t_next)
        return min(t_lost, self._t_query)

    def poll(self, t: float, target: Pose | None) -> Sent:
        """Return what to write at `t` (s, monotonic), and the set-point in it; empty if nothing is due.

        `target` is where the arm should be in this cycle, if tracking; None repeats the last set-point.
        """
        if self.hello is not None and t >= self._t_alive + FAULT_S:
            self.counters.losses += 1
            self._unlink("the controller does not answer")
        if t < self.due():
            return Sent(b"")
        if self.hello is None:
            return Sent(self._greet(t))
        if self._pending is not None:
            return Sent(self._ask(self._pending, t))
        out = Sent(b"")
        if self._timer is not None and not self._doubt:
            out = self._set_point(self._timer, t, target)
        if t >= self._t_query:
            out = Sent(out.data + self._send(Query(self._next_ss()), t), out.setpoint)
            self._t_query = math.inf if self.tracking and not self._doubt else t + QUERY_S
        return out

    def _greet(self, t: float) -> bytes:
        self._say_hello = False
        self._t_hello = t
        self._t_query = -math.inf
        self._ss = 0
        self._waiting.clear()
        return encode_command(Hello())

    def _ask(self, pending: _Pending, t: float) -> bytes:
        pending.t_sent = t
        if pending.command is None:
            pending.command = pending.kind(self._next_ss())
            return self._send(pending.command, t)
        self.counters.retries += 1
        return encode_command(pending.command)

    def _set_point(self, timer: SetPointTimer, t: float, target: Pose | None) -> Sent:
        self.counters.skipped_periods += timer.skip(t)
        if t < timer.t_next:
            return Sent(b"")
        timer.sent()
        self.counters.setpoints += 1
        self.commanded = self._goal(target)
        return Sent(self._send(SetPoint(self._next_ss(), self.commanded), t), self.commanded)

    def _goal(self, target: Pose | None) -> Pose:
        assert self.pose is not None, "tracking begins with a report"
        if self.commanded is None:
            return self.pose
        if target is not None and not _fits(target):
            self.counters.bad_targets += 1
            target = None
        goal = target or self.commanded
        if self.state is ArmState.HOLD and not _near(goal, self.pose):
            self.counters.rebased += 1
            return self.pose
        return goal

    def _send(self, command: Start | SetPoint | Query | Stop | Reset, t: float) -> bytes:
        line = encode_command(command)
        self._waiting[command.ss] = (type(command), t)
        return line

    def _next_ss(self) -> int:
        ss = self._ss
        self._ss = (ss + 1) % SEQUENCE_MODULUS
        return ss

    # Changes of mind

    def _request(self, kind: Request) -> None:
        if self.hello is None:
            self.refusal = f"{_VERB[kind]} refused: no link to the arm's controller"
        elif self._pending is not None and self._pending.kind is Stop:
            if kind is not Stop:
                self.refusal = f"{_VERB[kind]} refused: a stop is under way"
        elif self._pending is None or self._pending.kind is not kind:
            self.refusal = None
            self._pending = _Pending(kind)

    def _end_tracking(self) -> None:
        if self._timer is not None:
            self._timer = None
            self._t_query = -math.inf

    def _unlink(self, reason: str) -> None:
        if self._pending is not None:
            self.refusal = f"{_VERB[self._pending.kind]} came to nothing: {reason}"
        self.unlinked = reason
        self._pending = None
        self._timer = None
        self._doubt = False
        self.hello = None
        self.state = None
        self.pose = None
        self.commanded = None
        self._say_hello = True


def _fits(pose: Pose) -> bool:
    """Tell whether the wire can carry `pose`."""
    try:
        command_body(SetPoint(0, pose))
    except LinkError:
        return False
    return True


def _near(pose: Pose, other: Pose) -> bool:
    """Tell whether two poses are near enough for the controller to resume at one from the other."""
    turn = math.remainder(pose.t_rad - other.t_rad, math.tau)
    return math.dist((pose.x_m, pose.y_m), (other.x_m, other.y_m)) <= NEAR_M and abs(turn) <= NEAR_RAD
