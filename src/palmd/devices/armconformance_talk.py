"""The words of the arm link's conformance scripts: what they ask for, what they are told, and what they share."""

from __future__ import annotations

import math
from collections.abc import Generator, Sequence
from dataclasses import dataclass
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
"""How long to listen for an answer, and for anything that should not come after it."""

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class TalkRequest:
    """What a script asks for: write `data` at `t_send` (s, monotonic; past: at once), then listen.

    Listening ends `listen_s` after the writing, or as soon as `enough` lines have come (0: never).
    """

    data: bytes
    t_send: float
    listen_s: float
    enough: int = 0


@dataclass(frozen=True, slots=True)
class TalkAnswer:
    """What came of it: whole lines, and all the bytes; written at `t_sent`, over at `t` (s, monotonic)."""

    lines: list[Line]
    raw: bytes
    t_sent: float
    t: float


Script = Generator[TalkRequest, TalkAnswer, _T]


class DeviationError(Exception):
    """The controller did something else than the contract says."""

    def __init__(self, expected: str, seen: str) -> None:
        super().__init__(f"expected {expected}, saw {seen}")
        self.expected = expected
        self.seen = seen


class NotExaminedError(Exception):
    """A check cannot be made here; the text says why."""


class Talk:
    """What the scripts share: numbers, what the controller said of itself, and the phase of its cycle."""

    def __init__(self, baud: int) -> None:
        """`baud` in bit/s. Raises ValueError if it is not positive."""
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

    # what a script needs to know

    @property
    def limits(self) -> HelloReply:
        """What the controller allows; raises NotExaminedError before it has said so."""
        if self.hello is None:
            raise NotExaminedError("the controller has not told its limits")
        return self.hello

    @property
    def rest(self) -> Pose:
        """Where the arm stood at first; raises NotExaminedError before that is known."""
        if self.home is None:
            raise NotExaminedError("the controller has not told where the arm stands")
        return self.home

    def next_ss(self) -> int:
        """The next sequence number."""
        ss, self._ss = self._ss, (self._ss + 1) % SEQUENCE_MODULUS
        return ss

    def count_from(self, ss: int) -> None:
        """Number on from `ss`."""
        self._ss = ss

    # parts of scripts

    def raw(
        self, data: bytes, listen_s: float = ANSWER_S, t_send: float = -math.inf, enough: int = 0
    ) -> Script[TalkAnswer]:
        """Write these bytes, whatever they are."""
        self.sent += [data.decode("ascii", errors="replace").strip()[:40]] if data else []
        heard = yield TalkRequest(data, t_send, listen_s, enough)
        self.late_s = max(self.late_s, heard.t_sent - max(t_send, self.t), heard.t - heard.t_sent - listen_s)
        self.t = heard.t
        self.line_feeds += heard.raw.count(b"\n")
        self.crlf += heard.raw.count(b"\r\n")
        return heard

    def send(self, *commands: Command, listen_s: float = ANSWER_S, enough: int = 0) -> Script[TalkAnswer]:
        """Write these commands in one go."""
        return (yield from self.raw(b"".join(map(encode_command, commands)), listen_s, enough=enough))

    def report(self, t_send: float = -math.inf) -> Script[Ack]:
        """Ask for state and place, at `t_send` (s) or at once. Raises DeviationError without a proper answer."""
        ss = self.next_ss()
        heard = yield from self.raw(encode_command(Query(ss)), t_send=t_send, enough=1)
        return acknowledged(heard.lines, ss)

    def begin(self) -> Script[Ack]:
        """Start tracking, stand still, and learn the phase of the controller's cycle."""
        ss = self.next_ss()
        heard = yield from self.send(Start(ss), enough=1)
        acknowledged(heard.lines, ss, ArmState.TRACKING)
        ss = self.next_ss()
        heard = yield from self.send(SetPoint(ss, self.rest), enough=1)
        ack = acknowledged(heard.lines, ss, ArmState.TRACKING)
        self._timer = SetPointTimer(self._baud, self.limits.cycle_s, heard.lines[0].t_first)
        return ack

    def point(self, pose: Pose, ss: int | None = None, listen_s: float | None = None) -> Script[TalkAnswer]:
        """Send a set-point in the middle of the next cycle; listen until the next but one is due, or as told."""
        timer = self.timer
        timer.skip(self.t)
        t_send = timer.t_next
        timer.sent()
        command = SetPoint(self.next_ss() if ss is None else ss, pose)
        listen = timer.t_next - t_send if listen_s is None else listen_s
        heard = yield from self.raw(encode_command(command), listen, t_send)
        return heard

    @property
    def timer(self) -> SetPointTimer:
        """The set-point timer, once tracking has begun."""
        assert self._timer is not None, "begin() comes first"
        return self._timer

    def arrived(self, heard: TalkAnswer, size: int) -> float:
        """When the last of `size` bytes had reached the controller (s)."""
        return heard.t_sent + size * self.byte_s


def acknowledged(lines: Sequence[Line], ss: int, *states: ArmState) -> Ack:
    """The one answer to command `ss`, with one of these states if any are given. Raises DeviationError."""
    wanted = f"A{ss:02X} with state {' or '.join(states)}" if states else f"A{ss:02X}"
    reply = only(lines, wanted)
    if not isinstance(reply, Ack) or reply.ss != ss or (states and reply.state not in states):
        raise DeviationError(wanted, shown(lines))
    return reply


def refused(lines: Sequence[Line], ss: int, code: int) -> None:
    """Raises DeviationError unless these lines are one refusal of `ss` with this code."""
    wanted = f"E{ss:02X}{code:+05d}"
    reply = only(lines, wanted)
    if reply != Refusal(ss, code):
        raise DeviationError(wanted, shown(lines))


def only(lines: Sequence[Line], wanted: str) -> Reply:
    """The reply in the only line there is. Raises DeviationError."""
    if len(lines) != 1:
        raise DeviationError(wanted, shown(lines))
    return reply_in(lines[0], wanted)


def reply_in(line: Line, wanted: str) -> Reply:
    """What a line says. Raises DeviationError if it is no reply."""
    try:
        return parse_reply(line.body)
    except LinkError:
        raise DeviationError(wanted, f"{line.body!r}, which is no reply") from None


def shown(lines: Sequence[Line]) -> str:
    """Lines in words."""
    return ", ".join(line.body for line in lines) or "nothing"
