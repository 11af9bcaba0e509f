"""Building blocks of the arm link's conformance scripts: requests, answers, shared state and assertions."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

from palmd.devices.actuator import ArmState, Pose
from palmd.devices.armlink import (
    SEQUENCE_MODULUS,
    Ack,
    Command,
    HelloReply,
    Line,
    LinkError,
    Query,
    Refusal,
    Reply,
    SetPoint,
    Start,
    encode_command,
    parse_reply,
)
from palmd.devices.arrival import byte_time
from palmd.devices.phaselock import SetPointTimer

ANSWER_S = 0.060
"""How long (s) to listen for an answer, and for lines that must not follow it."""

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class TalkRequest:
    """Request of a script: write `data` at `t_send` (s, monotonic; past: at once), then listen.

    Listening ends `listen_s` after the write, or as soon as `enough` lines have arrived (0: never).
    """

    data: bytes
    t_send: float
    listen_s: float
    enough: int = 0


@dataclass(frozen=True, slots=True)
class TalkAnswer:
    """Answer to it: valid lines and all bytes; written at `t_sent`, ended at `t` (s, monotonic)."""

    lines: list[Line]
    raw: bytes
    t_sent: float
    t: float


Script = Generator[TalkRequest, TalkAnswer, _T]


class DeviationError(Exception):
    """The controller deviated from the contract."""

    def __init__(self, expected: str, seen: str) -> None:
        super().__init__(f"expected {expected}, observed {seen}")
        self.expected = expected
        self.seen = seen


class NotExaminedError(Exception):
    """A check cannot be run; the text has the reason."""


class Talk:
    """State shared by the scripts: sequence number, the controller's limits and pose, and the phase of its cycle."""

    def __init__(self, baud: int) -> None:
        """Raises ValueError if `baud` (bit/s) is not positive."""
        self.byte_s = byte_time(baud)
        self._baud = baud
        self._ss = 0
        self._timer: SetPointTimer | None = None
        self.hello: HelloReply | None = None
        self.home: Pose | None = None
        self.t = -math.inf
        self.sent: list[str] = []
        self.late_s = 0.0
        self.line_feeds = 0
        self.crlf = 0

    # state

    @property
    def limits(self) -> HelloReply:
        """The controller's limits; raises NotExaminedError while they are unknown."""
        if self.hello is None:
            raise NotExaminedError("the controller has not reported its limits")
        return self.hello

    @property
    def rest(self) -> Pose:
        """The arm's first pose; raises NotExaminedError while it is unknown."""
        if self.home is None:
            raise NotExaminedError("the controller has not reported the arm's pose")
        return self.home

    def next_ss(self) -> int:
        """Return the next sequence number."""
        ss, self._ss = self._ss, (self._ss + 1) % SEQUENCE_MODULUS
        return ss

    def count_from(self, ss: int) -> None:
        """Set the next sequence number."""
        self._ss = ss

    # parts of scripts

    def raw(
        self, data: bytes, listen_s: float = ANSWER_S, t_send: float = -math.inf, enough: int = 0
    ) -> Script[TalkAnswer]:
        """Write bytes, valid or not."""
        self.sent += [data.decode("ascii", errors="replace").strip()[:40]] if data else []
        reply = yield TalkRequest(data, t_send, listen_s, enough)
        self.late_s = max(self.late_s, reply.t_sent - max(t_send, self.t), reply.t - reply.t_sent - listen_s)
        self.t = reply.t
        self.line_feeds += reply.raw.count(b"\n")
        self.crlf += reply.raw.count(b"\r\n")
        return reply

    def send(self, command: Command, listen_s: float = ANSWER_S, enough: int = 0) -> Script[TalkAnswer]:
        """Write a command."""
        return (yield from self.raw(encode_command(command), listen_s, enough=enough))

    def ask(
        self, command: Callable[[int], Command], *states: ArmState, listen_s: float = ANSWER_S, enough: int = 0
    ) -> Script[tuple[TalkAnswer, Ack]]:
        """Send a command under the next number. Raises DeviationError unless the only answer is an A in `states`."""
        ss = self.next_ss()
        reply = yield from self.send(command(ss), listen_s, enough)
        return reply, expect_ack(reply.lines, ss, *states)

    def refused(self, command: Callable[[int], Command], code: int, listen_s: float = ANSWER_S) -> Script[list[Line]]:
        """Send a command under the next number. Raises DeviationError unless it is refused with `code`, once."""
        ss = self.next_ss()
        reply = yield from self.send(command(ss), listen_s)
        expect_refusal(reply.lines, ss, code)
        return reply.lines

    def report(self, t_send: float = -math.inf) -> Script[Ack]:
        """Query state and pose, at `t_send` (s) or at once. Raises DeviationError without a valid answer."""
        ss = self.next_ss()
        reply = yield from self.raw(encode_command(Query(ss)), t_send=t_send, enough=1)
        return expect_ack(reply.lines, ss)

    def begin(self) -> Script[None]:
        """Start tracking at rest, and determine the phase of the controller's cycle."""
        yield from self.ask(Start, ArmState.TRACKING, enough=1)
        reply, _ = yield from self.ask(partial(SetPoint, pose=self.rest), ArmState.TRACKING, enough=1)
        self._timer = SetPointTimer(self._baud, self.limits.cycle_s, reply.lines[0].t_first)

    def point(self, pose: Pose, ss: int | None = None, listen_s: float | None = None) -> Script[TalkAnswer]:
        """Send a set-point in the middle of the next cycle; listen for `listen_s` or until the next is due."""
        timer = self.timer
        timer.skip(self.t)
        t_send = timer.t_next
        timer.sent()
        command = SetPoint(self.next_ss() if ss is None else ss, pose)
        listen = timer.t_next - t_send if listen_s is None else listen_s
        return (yield from self.raw(encode_command(command), listen, t_send))

    @property
    def timer(self) -> SetPointTimer:
        """The set-point timer, available after `begin`."""
        assert self._timer is not None, "begin() comes first"
        return self._timer

    def arrived(self, reply: TalkAnswer, size: int) -> float:
        """Return when the last of `size` bytes had reached the controller (s)."""
        return reply.t_sent + size * self.byte_s


def expect_ack(lines: Sequence[Line], ss: int, *states: ArmState) -> Ack:
    """Return the only answer to command `ss`, with one of `states` if any are given. Raises DeviationError."""
    expected = f"A{ss:02X} with state {' or '.join(states)}" if states else f"A{ss:02X}"
    reply = only_reply(lines, expected)
    if not isinstance(reply, Ack) or reply.ss != ss or (states and reply.state not in states):
        raise DeviationError(expected, as_text(lines))
    return reply


def expect_refusal(lines: Sequence[Line], ss: int, code: int) -> None:
    """Raise DeviationError unless `lines` is exactly one refusal of `ss` with this code."""
    expected = f"E{ss:02X}{code:+05d}"
    reply = only_reply(lines, expected)
    if reply != Refusal(ss, code):
        raise DeviationError(expected, as_text(lines))


def only_reply(lines: Sequence[Line], expected: str) -> Reply:
    """Return the reply in the only line. Raises DeviationError for none or several."""
    if len(lines) != 1:
        raise DeviationError(expected, as_text(lines))
    return parse_line(lines[0], expected)


def parse_line(line: Line, expected: str) -> Reply:
    """Parse a line. Raises DeviationError if it is no reply."""
    try:
        return parse_reply(line.body)
    except LinkError:
        raise DeviationError(expected, f"{line.body!r}, which is no reply") from None


def as_text(lines: Sequence[Line]) -> str:
    """Lines as text."""
    return ", ".join(line.body for line in lines) or "nothing"
