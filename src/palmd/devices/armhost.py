"""Host state machine of the arm link: what to send when, and how to interpret the answers.

It does no I/O. The caller passes the bytes read and their time, and asks what to write at the times that `due()`
returns:

    hello (H, until H1 arrives) -> polling (Q every 100 ms) -> tracking (S every cycle) -> polling ...
                                        every silence of 250 ms leads back to hello

It never starts the arm on its own: G, P and R are sent on request only, and are repeated unchanged until they
are answered. No received bytes raise an exception. Safe inside the 100 Hz loop.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, replace

from palmd.config.arms import AdeptConfig
from palmd.devices.actuator import (
    FOLLOWING,
    FREEZE_S,
    LOST_S,
    Actuator,
    ArmPose,
    ArmReport,
    ArmState,
    Outgoing,
    Pose,
    Reach,
)
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

HELLO_RETRY_S = 0.250
HELLO_ANSWER_S = 1.0
"""An `H1` that arrives later than this (s) after the last `H` was not requested: the controller has restarted."""

QUERY_S = 0.100
REQUEST_RETRY_S = 0.064
"""Four cycles: longer than any answer takes, and short enough for a second attempt of G within the controller's
160 ms watchdog."""

RESUME_M = 0.005
RESUME_RAD = math.radians(3.0)
"""Largest distance (m, rad) of the first set-point after a hold from the arm's actual pose."""

HARMLESS_CODES = (-522, -524, -610, -611)
"""Codes that refuse one line or one set-point only. After any other code the controller may have left tracking."""

WRONG_STATE = -620
MIN_LINE_BYTES = 31  # fewer may be the rest of a line

Request = type[Start] | type[Stop] | type[Reset]
_VERB: dict[Request, str] = {Start: "start", Stop: "stop", Reset: "reset"}


@dataclass(slots=True)
class HostCounters:
    """Counters of the arm link since the start.

    `malformed` counts valid lines that are no reply, `unmatched` answers without a pending command (late ones
    and repeats), `rebased` set-points sent at the actual pose because the target was too far for a resume,
    `bad_targets` targets that cannot be encoded, `losses` silences of 250 ms, `restarts` restarts of the controller.
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
        """Return all counters by name, those of the line included."""
        counts = asdict(self)
        return {**counts.pop("line"), **counts}


@dataclass(slots=True)
class _Pending:
    """A request that is sent until it is answered; `command` is None before it is sent first."""

    kind: Request
    command: Start | Stop | Reset | None = None
    t_sent: float = -math.inf

    def waits_for(self, ss: int) -> bool:
        return self.command is not None and self.command.ss == ss


class ArmHost(Actuator):
    """`Actuator` of one controller; see the module's docstring.

    `commanded` is the last set-point sent since tracking began. `last_error` is the code of the last error line, until
    a start or reset succeeds. `link_loss` is the reason why the link was lost last.
    """

    def __init__(self, config: AdeptConfig) -> None:
        """The baud rate is also used for timestamps."""
        super().__init__(config, "lines")
        self._reader = LineReader(self._baud)
        self.counters = HostCounters(line=self._reader.counters)
        self.hello: HelloReply | None = None
        self.pose: Pose | None = None
        self.commanded: Pose | None = None
        self.last_error: int | None = None
        self.link_loss = "the controller has not answered yet"
        self._bytes_at_ack = self._lines_at_ack = 0
        self._latency_s = 0.0  # of the last answer
        self._t_alive = -math.inf
        self._t_hello = -math.inf
        self._t_query = -math.inf
        self._hello_due = True
        self._ss = 0
        self._waiting: dict[int, tuple[type[Command], float]] = {}
        self._pending: _Pending | None = None
        self._timer: SetPointTimer | None = None
        self._state_uncertain = False

    # Queries

    def linked(self, t: float) -> bool:
        """Whether the controller has answered hello and its last report is at most 250 ms old at `t` (s)."""
        return self.state is not None and self.age(t) <= LOST_S

    @property
    def reach(self) -> Reach | None:
        """The limits in the controller's hello reply."""
        hello = self.hello
        if hello is None:
            return None
        return Reach(hello.x_min_m, hello.x_max_m, hello.y_min_m, hello.y_max_m, hello.v_max_m_s, hello.a_max_m_s2)

    @property
    def error(self) -> str:
        """Code and meaning of the last error line."""
        return "" if self.last_error is None else error_text(self.last_error)

    def _garbled(self) -> tuple[int, int]:
        line = self.counters.line
        errors = line.crc_errors + line.unframed + line.overlong
        return line.lines + errors, errors

    def evidence(self, condition: str, t: float) -> str:
        match condition:
            case "late":
                return self._silence(t, FREEZE_S)
            case "link-lost":
                return f"{self.link_loss}: {self._silence(t, LOST_S)}"
            case "mute":
                return f"{self.counters.line.bytes} bytes have come since the start"
            case "garbled":
                return self._error_shares.text(condition)
        if self.state is None:
            return ""
        return f"its line A reports state {self.state} ({self.state.name})" + (
            f", error {self.error}" * bool(self.error)
        )

    def finding(self, condition: str) -> str:
        """See `Actuator`; empty for a line on which whole lines still come."""
        if condition != "link-lost":
            return "" if self.last_error is None else f"{self.last_error:+05d}"
        line = self.counters.line
        found = "mute" if line.bytes - self._bytes_at_ack < MIN_LINE_BYTES else "unreadable"
        return found if line.lines == self._lines_at_ack else ""

    def _silence(self, t: float, limit_s: float) -> str:
        count = self.counters.line.bytes - self._bytes_at_ack
        lines = self.counters.line.lines - self._lines_at_ack
        came = (
            f"{count} bytes have come since, with {lines} whole lines in them" if count else "not a byte has come since"
        )
        return f"its last answer is {self.age(t) * 1e3:.0f} ms old, the limit is {limit_s * 1e3:.0f} ms; {came}"

    def counts(self) -> dict[str, float]:
        return self.counters.as_dict()

    @property
    def tracking(self) -> bool:
        return self._timer is not None

    @property
    def busy(self) -> bool:
        return self._pending is not None

    # Requests

    def request_tracking(self) -> None:
        """Request tracking (G). Set-points are then sent automatically, the first at the arm's actual pose."""
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

    def request_stop(self) -> None:
        """Request a planned stop (P); no more set-points are sent."""
        self._end_tracking()
        self._request(Stop)

    def request_reset(self) -> None:
        """Request that the controller clear a latched fault (R)."""
        if self.tracking:
            self.refusal = "reset refused: the arm is tracking"
        else:
            self._request(Reset)

    def disconnected(self) -> None:
        """Handle the loss of the port: reset the link; it begins with hello when the port is open again."""
        self._reader.reset()
        self._unlink("the port was lost")

    # Input

    def feed(self, data: bytes, t_recv: float) -> list[ArmReport]:
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
                    if self._ack_received(reply, line.t_first, alone=len(lines) == 1):
                        fresh = self._latency_s <= REQUEST_RETRY_S
                        reports.append(ArmReport(line.t_first, reply.state, reply.pose, fresh))
                case Refusal():
                    self._refusal_received(reply)
                case HelloReply():
                    self._hello_received(reply, line.t_first)
        return self._spread_in_time(reports)

    def _ack_received(self, ack: Ack, t_first: float, *, alone: bool) -> bool:
        kind, t_sent = self._waiting.pop(ack.ss, (None, 0.0))
        if kind is None or self.hello is None:
            self.counters.unmatched += 1
            return False
        self._latency_s = t_first - t_sent
        self.counters.acks += 1
        self.counters.ack_latency_max_ms = max(self.counters.ack_latency_max_ms, self._latency_s * 1e3)
        self.state, self.pose = ack.state, ack.pose
        self._t_report = self._t_alive = t_first
        self._bytes_at_ack, self._lines_at_ack = self.counters.line.bytes, self.counters.line.lines
        if self._timer is not None:
            if kind is SetPoint and alone:
                self._timer.answered(t_first)
            if self._state_uncertain:
                self._t_query = math.inf
        self._state_uncertain = False
        if self._pending is not None and self._pending.waits_for(ack.ss):
            self._request_answered(self._pending.kind, ack, t_first, self.hello.cycle_s)
        elif ack.state not in FOLLOWING:
            self._end_tracking()
        return True

    def _request_answered(self, kind: Request, ack: Ack, t_first: float, cycle_s: float) -> None:
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

    def _spread_in_time(self, reports: list[ArmReport]) -> list[ArmReport]:
        """Back-date reports that arrived together while tracking: set-points are answered one cycle apart."""
        if len(reports) < 2 or self._timer is None or any(each.state is not ArmState.TRACKING for each in reports):
            return reports
        last = self._timer.cycle_before(reports[-1].t_sample)
        ago = range(len(reports) - 1, -1, -1)
        return [
            replace(each, t_sample=min(each.t_sample, last - cycles * self._timer.period_s))
            for each, cycles in zip(reports, ago, strict=True)
        ]

    def _refusal_received(self, refusal: Refusal) -> None:
        self._waiting.pop(refusal.ss, None)
        self.counters.refusals += 1
        if not (
            self._state_uncertain and refusal.code == WRONG_STATE
        ):  # refuses set-points that were in transit when a fault latched
            self.last_error = refusal.code
        self._state_uncertain = refusal.code not in HARMLESS_CODES
        self._t_query = -math.inf
        if self._pending is not None and self._pending.waits_for(refusal.ss):
            self.refusal = f"{_VERB[self._pending.kind]} refused: {error_text(refusal.code)}"
            self._pending = None

    def _hello_received(self, reply: HelloReply, t_first: float) -> None:
        if t_first - self._t_hello <= HELLO_ANSWER_S:
            self.hello = reply
            self._t_alive = t_first
        elif self.hello is not None:
            self.counters.restarts += 1
            self._unlink("the controller restarted")

    # Output

    def due(self) -> float:
        if self.hello is None:
            return -math.inf if self._hello_due else self._t_hello + HELLO_RETRY_S
        t_lost = self._t_alive + LOST_S
        if self._pending is not None:
            return min(t_lost, self._pending.t_sent + REQUEST_RETRY_S)
        if self._timer is not None and not self._state_uncertain:
            return min(t_lost, self._t_query, self._timer.t_next)
        return min(t_lost, self._t_query)

    def poll(self, t: float, target: ArmPose | None) -> Outgoing:
        """See `Actuator`; empty if nothing is due. Targets other than poses of the tool are ignored."""
        if self.hello is not None and t >= self._t_alive + LOST_S:
            self.counters.losses += 1
            self._unlink("the controller does not answer")
        if t < self.due():
            return Outgoing(b"")
        if self.hello is None:
            return Outgoing(self._send_hello(t))
        if self._pending is not None:
            return Outgoing(self._send_request(self._pending, t))
        out = Outgoing(b"")
        if self._timer is not None and not self._state_uncertain:
            out = self._set_point(self._timer, t, target if isinstance(target, Pose) else None)
        if t >= self._t_query:
            out = Outgoing(out.data + self._send(Query(self._next_ss()), t), out.setpoint)
            self._t_query = math.inf if self.tracking and not self._state_uncertain else t + QUERY_S
        return out

    def _send_hello(self, t: float) -> bytes:
        self._hello_due = False
        self._t_hello = t
        self._t_query = -math.inf
        self._ss = 0
        self._waiting.clear()
        return encode_command(Hello())

    def _send_request(self, pending: _Pending, t: float) -> bytes:
        pending.t_sent = t
        if pending.command is None:
            pending.command = pending.kind(self._next_ss())
            return self._send(pending.command, t)
        self.counters.retries += 1
        return encode_command(pending.command)

    def _set_point(self, timer: SetPointTimer, t: float, target: Pose | None) -> Outgoing:
        self.counters.skipped_periods += timer.skip(t)
        if t < timer.t_next:
            return Outgoing(b"")
        timer.sent()
        self.counters.setpoints += 1
        self.commanded = self._next_setpoint(target)
        return Outgoing(self._send(SetPoint(self._next_ss(), self.commanded), t), self.commanded)

    def _next_setpoint(self, target: Pose | None) -> Pose:
        assert self.pose is not None, "tracking begins with a report"
        if self.commanded is None:
            return self.pose
        if target is not None and not _is_encodable(target):
            self.counters.bad_targets += 1
            target = None
        goal = target or self.commanded
        if self.state is ArmState.HOLD and not _is_near(goal, self.pose):
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

    # Transitions

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
            self.refusal = f"{_VERB[self._pending.kind]} failed: {reason}"
        self.link_loss = reason
        self._pending = None
        self._timer = None
        self._state_uncertain = False
        self.hello = None
        self.state = None
        self.pose = None
        self.commanded = None
        self._hello_due = True


def _is_encodable(pose: Pose) -> bool:
    """Whether `pose` can be encoded in a set-point."""
    try:
        command_body(SetPoint(0, pose))
    except LinkError:
        return False
    return True


def _is_near(pose: Pose, other: Pose) -> bool:
    """Whether two poses are close enough for the controller to resume from one at the other."""
    turn = math.remainder(pose.t_rad - other.t_rad, math.tau)
    return math.dist((pose.x_m, pose.y_m), (other.x_m, other.y_m)) <= RESUME_M and abs(turn) <= RESUME_RAD
