"""Codec of the arm link between this host and the V+ program on the arm's controller, both directions.

A line is `BODY*CC`; CC is the CRC-8 of BODY as two upper-case hexadecimal digits. The host ends lines with LF,
the controller with CR LF; a reader accepts both. Numbers on the wire are integers in micrometres and
thousandths of a degree; here all values are SI. All functions are pure and safe inside the 100 Hz loop.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from palmd.devices.actuator import ArmState, Pose
from palmd.devices.arrival import FirstByteClock
from palmd.devices.framing import crc_table
from palmd.devices.health import Counters

HOST_NEWLINE = b"\n"
CONTROLLER_NEWLINE = b"\r\n"
MAX_LINE_BYTES = 160
"""Longer lines are discarded; the longest valid one, `H1` with seven numbers, has about half of that."""

SETPOINT_BYTES = 28
"""Size of a set-point on the wire, `*CC` and LF included."""

SEQUENCE_MODULUS = 256
COORDINATE_MAX_UM = 999_999
HALF_TURN_MDEG = 180_000


class LinkError(ValueError):
    """A line or a value that the link's grammar does not allow."""


ERROR_TEXT: dict[int, str] = {
    -504: "break received on the line: check the cable, then reset",
    -522: "parity or framing error at the controller: check that both sides use the same baud rate",
    -524: "receive overrun at the controller: its program does not keep up with the line",
    -600: "the controller lost the link and stopped the arm: check the cable and the host's load, then reset",
    -610: "target outside the arm's workspace: check the plan and the arm's base in the configuration",
    -611: "set-point step too large: start again from the arm's actual position",
    -620: "the controller is in the wrong state for this: it must be READY to start",
    -621: "emergency stop: release it at the arm and bring the controller back to READY",
    -1006: "the arm does not follow its path: free what blocks it, check its encoders, then reset",
    -622: "arm power is off: enable power at the controller",
    -623: "the controller is in manual mode: switch it to automatic",
}
"""Meaning of each of the controller's error codes, and what to do."""


def error_text(code: int) -> str:
    """Return one line of text for error `code`, known or unknown."""
    return f"{code:+05d} {ERROR_TEXT.get(code, 'unknown error: look it up in the V+ reference')}"


@dataclass(frozen=True, slots=True)
class Hello:
    """Requests the controller's limits and restarts the sequence numbers."""


@dataclass(frozen=True, slots=True)
class Start:
    """Requests tracking."""

    ss: int


@dataclass(frozen=True, slots=True)
class SetPoint:
    """An absolute target for the next cycle; of several, the latest is used."""

    ss: int
    pose: Pose


@dataclass(frozen=True, slots=True)
class Query:
    """Requests state and pose."""

    ss: int


@dataclass(frozen=True, slots=True)
class Stop:
    """Requests a planned stop."""

    ss: int


@dataclass(frozen=True, slots=True)
class Reset:
    """Requests that a latched fault be cleared."""

    ss: int


Command = Hello | Start | SetPoint | Query | Stop | Reset
_PLAIN: dict[str, type[Start] | type[Query] | type[Stop] | type[Reset]] = {
    "G": Start,
    "Q": Query,
    "P": Stop,
    "R": Reset,
}
_LETTER = {kind: letter for letter, kind in _PLAIN.items()}


@dataclass(frozen=True, slots=True)
class HelloReply:
    """The controller's cycle time and the limits that it enforces."""

    cycle_s: float
    x_min_m: float
    x_max_m: float
    y_min_m: float
    y_max_m: float
    v_max_m_s: float
    a_max_m_s2: float


@dataclass(frozen=True, slots=True)
class Ack:
    """Answer to command `ss`: the controller's state and the arm's actual pose."""

    ss: int
    state: ArmState
    pose: Pose


@dataclass(frozen=True, slots=True)
class Refusal:
    """Refuses command `ss`; sent once with the last `ss` when a fault latches."""

    ss: int
    code: int


Reply = HelloReply | Ack | Refusal


_CRC8 = crc_table(0x07, 8)


def crc8(data: bytes) -> int:
    """Return the CRC-8 of `data`: polynomial 0x07, initial value 0, not reflected."""
    crc = 0
    for byte in data:
        crc = _CRC8[crc ^ byte]
    return crc


def frame(body: str, newline: bytes) -> bytes:
    """Return the line that carries `body` (ASCII)."""
    raw = body.encode("ascii")
    return b"%b*%02X%b" % (raw, crc8(raw), newline)


@dataclass(frozen=True, slots=True)
class Line:
    """Body of one valid line, and arrival time (s, monotonic) of its first byte."""

    body: str
    t_first: float


@dataclass(slots=True)
class LineCounters(Counters):
    """Counters of a line-oriented port: bytes, valid lines, and discarded lines by cause.

    `crc_errors`, `unframed` (no `*CC`, or bytes that are not printable ASCII) and `overlong` count lines;
    `bytes_discarded` counts their bytes.
    """

    bytes: int = 0
    lines: int = 0
    crc_errors: int = 0
    unframed: int = 0
    overlong: int = 0
    bytes_discarded: int = 0


class LineReader:
    """Splits a byte stream into lines and checks them; LF always resynchronises, and the buffer is bounded."""

    def __init__(self, baud: int) -> None:
        """Raises ValueError if `baud` (bit/s, used for timestamps) is not positive."""
        self.counters = LineCounters()
        self._clock = FirstByteClock(baud)
        self._partial = bytearray()
        self._skipping = False

    @property
    def pending(self) -> int:
        """Number of buffered bytes of an incomplete line."""
        return len(self._partial)

    def feed(self, data: bytes, t_recv: float) -> list[Line]:
        """Process the bytes read at `t_recv` (s, monotonic) and return the valid lines that they complete."""
        lines: list[Line] = []
        self.counters.bytes += len(data)
        if self._partial and data:
            self._clock.more(t_recv, len(self._partial) + len(data) - 1)
        position = 0
        while position < len(data):
            newline = data.find(b"\n", position)
            end = len(data) if newline < 0 else newline + 1
            if not self._partial:
                self._clock.begin(t_recv, len(data) - 1 - position)
            self._take(data[position:end])
            if newline >= 0:
                self._finish(lines)
            position = end
        return lines

    def reset(self) -> None:
        """Discard the incomplete line after an interruption of the port."""
        self.counters.bytes_discarded += len(self._partial)
        self._partial.clear()
        self._skipping = False

    def _take(self, piece: bytes) -> None:
        if not self._skipping and len(self._partial) + len(piece) > MAX_LINE_BYTES:
            self.counters.overlong += 1
            self.counters.bytes_discarded += len(self._partial)
            self._partial.clear()
            self._skipping = True
        if self._skipping:
            self.counters.bytes_discarded += len(piece)
        else:
            self._partial += piece

    def _finish(self, lines: list[Line]) -> None:
        if self._skipping:
            self._skipping = False
            return
        raw = bytes(self._partial)
        self._partial.clear()
        body = self._check(raw[:-1].removesuffix(b"\r"))
        if body is None:
            self.counters.bytes_discarded += len(raw)
        else:
            self.counters.lines += 1
            lines.append(Line(body, self._clock.end()))

    def _check(self, raw: bytes) -> str | None:
        match = _FRAMED.fullmatch(raw)
        if match is None:
            self.counters.unframed += 1
            return None
        if crc8(match[1]) != int(match[2], 16):
            self.counters.crc_errors += 1
            return None
        return match[1].decode("ascii")


_FRAMED = re.compile(rb"([ -~]+)\*([0-9A-F]{2})")


_POSE = r"([+-][0-9]{6})([+-][0-9]{6})([+-][0-9]{6})"
_SS = r"([0-9A-Fa-f]{2})"
_PLAIN_BODY = re.compile(rf"([{''.join(_PLAIN)}]){_SS}")
_SETPOINT_BODY = re.compile(rf"S{_SS}{_POSE}")
_ACK_BODY = re.compile(rf"A{_SS}([{''.join(ArmState)}]){_POSE}")
_REFUSAL_BODY = re.compile(rf"E{_SS}([+-][0-9]{{4}})")
_HELLO_BODY = re.compile("H1" + r",([+-]?[0-9]+)" * 7)


def command_body(command: Command) -> str:
    """Return the body of a host's line. Raises LinkError if a number does not fit its field."""
    match command:
        case Hello():
            return "H"
        case SetPoint(ss, pose):
            return f"S{_sequence(ss)}{_pose(pose)}"
        case _:
            return f"{_LETTER[type(command)]}{_sequence(command.ss)}"


def encode_command(command: Command) -> bytes:
    """Return the bytes of a host's line. Raises LinkError if a number does not fit its field."""
    return frame(command_body(command), HOST_NEWLINE)


def parse_command(body: str) -> Command:
    """Parse the body of a host's line. Raises LinkError if it is no command."""
    if body == "H":
        return Hello()
    if match := _SETPOINT_BODY.fullmatch(body):
        return SetPoint(int(match[1], 16), _parse_pose(match[2], match[3], match[4]))
    if match := _PLAIN_BODY.fullmatch(body):
        return _PLAIN[match[1]](int(match[2], 16))
    raise LinkError(f"not a command: {body!r}")


def reply_body(reply: Reply) -> str:
    """Return the body of a controller's line. Raises LinkError if a number does not fit its field."""
    match reply:
        case Ack(ss, state, pose):
            return f"A{_sequence(ss)}{state}{_pose(pose)}"
        case Refusal(ss, code):
            if abs(code) > 9999:
                raise LinkError(f"error code {code} does not fit four digits")
            return f"E{_sequence(ss)}{code:+05d}"
        case HelloReply():
            lengths = (reply.x_min_m, reply.x_max_m, reply.y_min_m, reply.y_max_m)
            limits = (*lengths, reply.v_max_m_s, reply.a_max_m_s2)
            numbers = (_whole(reply.cycle_s, 1e3), *(_whole(value, 1e6) for value in limits))
            return "H1," + ",".join(map(str, numbers))


def encode_reply(reply: Reply) -> bytes:
    """Return the bytes of a controller's line. Raises LinkError if a number does not fit its field."""
    return frame(reply_body(reply), CONTROLLER_NEWLINE)


def parse_reply(body: str) -> Reply:
    """Parse the body of a controller's line. Raises LinkError if it is no reply."""
    if match := _ACK_BODY.fullmatch(body):
        return Ack(int(match[1], 16), ArmState(match[2]), _parse_pose(match[3], match[4], match[5]))
    if match := _REFUSAL_BODY.fullmatch(body):
        return Refusal(int(match[1], 16), int(match[2]))
    if match := _HELLO_BODY.fullmatch(body):
        cycle_ms, *micro = map(int, match.groups())
        x_min, x_max, y_min, y_max, v_max, a_max = micro
        if cycle_ms <= 0 or v_max <= 0 or a_max <= 0 or x_min >= x_max or y_min >= y_max:
            raise LinkError(f"impossible limits: {body!r}")
        return HelloReply(cycle_ms / 1e3, *(value / 1e6 for value in micro))
    raise LinkError(f"not a reply: {body!r}")


def wrap_mdeg(angle_mdeg: int) -> int:
    """Return `angle_mdeg` (1/1000 degree) wrapped to (-180, 180] degrees."""
    return HALF_TURN_MDEG - (HALF_TURN_MDEG - angle_mdeg) % (2 * HALF_TURN_MDEG)


def _sequence(ss: int) -> str:
    if not 0 <= ss < SEQUENCE_MODULUS:
        raise LinkError(f"sequence number {ss} is not 0 to {SEQUENCE_MODULUS - 1}")
    return f"{ss:02X}"


def _whole(value: float, scale: float) -> int:
    scaled = value * scale
    if not math.isfinite(scaled):
        raise LinkError(f"{value} cannot be sent")
    return round(scaled)


def _pose(pose: Pose) -> str:
    x_um, y_um = _whole(pose.x_m, 1e6), _whole(pose.y_m, 1e6)
    if max(abs(x_um), abs(y_um)) > COORDINATE_MAX_UM:
        raise LinkError(f"position {x_um}, {y_um} µm does not fit six digits")
    t_mdeg = wrap_mdeg(_whole(math.degrees(pose.t_rad), 1e3))
    return f"{x_um:+07d}{y_um:+07d}{t_mdeg:+07d}"


def _parse_pose(x_um: str, y_um: str, t_mdeg: str) -> Pose:
    angle = int(t_mdeg)
    if angle != wrap_mdeg(angle):
        raise LinkError(f"tool angle {angle} mdeg is outside (-180, 180] degrees")
    return Pose(int(x_um) / 1e6, int(y_um) / 1e6, math.radians(angle / 1e3))
