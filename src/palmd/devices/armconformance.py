"""What any program at the far end of the arm link must do, as a table of numbered checks. Pure: no port, no clock.

A check is a script: it says what to write and how long to listen, is handed what was heard, and ends with what
it has seen, or raises `DeviationError`. Whoever has the port plays the scripts (`palmd doctor --arm-conformance`);
the same scripts examine the emulated controller, and the V+ program's text, in virtual time.

A controller that keeps the contract moves less than `REACH_M` about where it stands. One that does not may
move by what a check asks it to refuse: at most one cycle of its greatest speed, for each such set-point is
followed by one that calls it back.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from palmd.devices.actuator import ArmState, Pose
from palmd.devices.armconformance_talk import (
    ANSWER_S,
    DeviationError,
    NotExaminedError,
    Script,
    Talk,
    acknowledged,
    only,
    refused,
    reply_in,
    shown,
)
from palmd.devices.armlink import (
    HOST_NEWLINE,
    MAX_LINE_BYTES,
    SEQUENCE_MODULUS,
    Ack,
    Hello,
    HelloReply,
    Line,
    Query,
    Refusal,
    Reset,
    SetPoint,
    Start,
    Stop,
    encode_command,
    frame,
)

REACH_M = 2e-3
"""How far from where it stood a controller that keeps the contract may be moved."""

HOST_SLACK_S = 0.012
"""By how much a busy host may date things wrongly."""

LATE_S = 0.004
"""A host later than this may itself have spoilt the check, which is then made again."""

HOLD_S, GIVE_UP_S = 0.048, 0.160
RESUME_M, RESUME_RAD = 5e-3, math.radians(3.0)
LINK_LOST, OUTSIDE, STEP_TOO_LARGE, WRONG_STATE = -600, -610, -611, -620

_STILL_M = 0.3e-3  # encoders and a servo at rest
_SWING_M = 1e-3
_BEYOND = 1.1  # how far over a bound a refused target lies
_SETTLE_S = 1.0
_TRIES = 6  # of two set-points in one cycle
_SHOWN_SENT = 8
_ATTEMPTS = 3  # at a check that a late host has spoilt


Outcome = Literal["passed", "failed", "not run"]


@dataclass(frozen=True, slots=True)
class CheckResult:
    """One check's outcome: the last lines sent, what was expected and seen; `expected` is empty unless it failed."""

    number: int
    clause: str
    outcome: Outcome
    sent: str
    expected: str
    seen: str


def _require(true: bool, expected: str, seen: str) -> None:
    if not true:
        raise DeviationError(expected, seen)


def _away(pose: Pose, other: Pose) -> float:
    return math.hypot(pose.x_m - other.x_m, pose.y_m - other.y_m)


def _moved(pose: Pose, x_m: float = 0.0, y_m: float = 0.0, t_rad: float = 0.0) -> Pose:
    return Pose(pose.x_m + x_m, pose.y_m + y_m, math.remainder(pose.t_rad + t_rad, math.tau))


def _inward(talk: Talk, distance_m: float) -> Pose:
    """A pose so far from rest, inside the workspace; NotExaminedError where there is no room."""
    limits, rest = talk.limits, talk.rest
    for x_m, y_m in ((distance_m, 0.0), (-distance_m, 0.0), (0.0, distance_m), (0.0, -distance_m)):
        pose = _moved(rest, x_m, y_m)
        if limits.x_min_m <= pose.x_m <= limits.x_max_m and limits.y_min_m <= pose.y_m <= limits.y_max_m:
            return pose
    raise NotExaminedError(f"the workspace has no room of {distance_m * 1e3:.0f} mm about the arm")


def _outside(talk: Talk) -> Pose:
    """The nearest pose beyond the workspace, by a millimetre."""
    limits, rest = talk.limits, talk.rest
    steps = (
        (limits.x_max_m - rest.x_m + 1e-3, 0.0),
        (limits.x_min_m - rest.x_m - 1e-3, 0.0),
        (0.0, limits.y_max_m - rest.y_m + 1e-3),
        (0.0, limits.y_min_m - rest.y_m - 1e-3),
    )
    return _moved(rest, *min(steps, key=lambda step: abs(step[0]) + abs(step[1])))


def _ms(seconds: float) -> str:
    return f"{max(seconds, 0.0) * 1e3:.0f} ms"


# -- standing still --------------------------------------------------------------------------------------------


def _greets(talk: Talk) -> Script[str]:
    heard = yield from talk.send(Hello(), listen_s=0.25)
    talk.count_from(0)
    reply = only(heard.lines, "H1 with seven numbers")
    if not isinstance(reply, HelloReply):
        raise DeviationError("H1 with seven numbers", shown(heard.lines))
    talk.hello = reply
    return f"{heard.lines[0].body}, {_ms(heard.lines[0].t_first - talk.arrived(heard, 5))} after the question"


def _reports(talk: Talk) -> Script[str]:
    ss = talk.next_ss()
    heard = yield from talk.send(Query(ss))
    ack = acknowledged(heard.lines, ss)
    limits = talk.limits
    within = limits.x_min_m <= ack.pose.x_m <= limits.x_max_m and limits.y_min_m <= ack.pose.y_m <= limits.y_max_m
    _require(within, "a place inside the workspace", heard.lines[0].body)
    talk.home = ack.pose
    if ack.state is not ArmState.READY:
        raise NotExaminedError(f"the controller is in state {ack.state} ({ack.state.name}); bring it to READY first")
    late = heard.lines[0].t_first - talk.arrived(heard, 7)
    _require(late <= limits.cycle_s + HOST_SLACK_S, f"an answer within {_ms(limits.cycle_s)}", _ms(late))
    return f"{heard.lines[0].body} after {_ms(late)}"


def _ends_lines(talk: Talk) -> Script[str]:
    for _ in range(3):
        yield from talk.report()
    _require(talk.crlf == talk.line_feeds, "CR LF after every line", f"{talk.line_feeds - talk.crlf} bare LF")
    return f"{talk.crlf} lines, all with CR LF"


def _drops_bad_checksums(talk: Talk) -> Script[str]:
    for body in ("Q40", "P41", "G42"):
        good = frame(body, HOST_NEWLINE)
        heard = yield from talk.raw(good[:-3] + b"%02X\n" % (int(good[-3:-1], 16) ^ 0x5A))
        _require(not heard.lines, "nothing", shown(heard.lines))
    yield from talk.report()
    return "three bad lines went unanswered, the good one after them did not"


def _resynchronises(talk: Talk) -> Script[str]:
    noise = {
        "noise": b"\x00\xff*Q\x1b,,;\n",
        "half a line": b"Q4\n",
        "a line too long": b"S" * (2 * MAX_LINE_BYTES) + b"\n",
    }
    for name, data in noise.items():
        ss = talk.next_ss()
        heard = yield from talk.raw(data + encode_command(Query(ss)), ANSWER_S + len(data) * 0.3e-3)
        try:
            acknowledged(heard.lines, ss)
        except DeviationError as deviation:
            raise DeviationError(f"{deviation.expected} after {name} and LF", deviation.seen) from None
    return f"answered after {', '.join(noise)}"


def _repeats(talk: Talk) -> Script[str]:
    ss = talk.next_ss()
    first = yield from talk.send(Query(ss))
    acknowledged(first.lines, ss)
    second = yield from talk.send(Query(ss))
    acknowledged(second.lines, ss)
    same = first.lines[0].body == second.lines[0].body
    _require(same, first.lines[0].body, second.lines[0].body)
    return f"{first.lines[0].body}, twice"


def _numbers(talk: Talk) -> Script[str]:
    talk.count_from(SEQUENCE_MODULUS - 4)
    for _ in range(8):
        yield from talk.report()
    return "FC to 03, each answered under its own number"


def _refuses_setpoints_at_rest(talk: Talk) -> Script[str]:
    ss = talk.next_ss()
    heard = yield from talk.send(SetPoint(ss, talk.rest))
    refused(heard.lines, ss, WRONG_STATE)
    return shown(heard.lines)


def _grants_what_is_so(talk: Talk) -> Script[str]:
    seen = []
    for kind in (Stop, Reset):
        ss = talk.next_ss()
        heard = yield from talk.send(kind(ss))
        acknowledged(heard.lines, ss, ArmState.READY)
        seen += heard.lines
    return shown(seen)


# -- tracking, without motion ----------------------------------------------------------------------------------


def _starts(talk: Talk) -> Script[str]:
    ss = talk.next_ss()
    heard = yield from talk.send(Start(ss), listen_s=0.03)
    acknowledged(heard.lines, ss, ArmState.TRACKING)
    again = yield from talk.send(Start(ss), listen_s=0.03)
    acknowledged(again.lines, ss, ArmState.TRACKING)
    ss = talk.next_ss()
    anew = yield from talk.send(Start(ss), listen_s=0.03)
    refused(anew.lines, ss, WRONG_STATE)
    return shown([*heard.lines, *again.lines, *anew.lines])


def _stops(talk: Talk) -> Script[str]:
    yield from talk.begin()
    ss = talk.next_ss()
    heard = yield from talk.send(Stop(ss))
    acknowledged(heard.lines, ss, ArmState.DECELERATING)
    t_begun = talk.t
    while (ack := (yield from talk.report())).state is not ArmState.READY:
        _require(ack.state is ArmState.DECELERATING, "D, then R", str(ack.state))
        _require(talk.t - t_begun < _SETTLE_S, f"R within {_ms(_SETTLE_S)}", "D")
    return f"{shown(heard.lines)}, then R"


def _gives_up_without_setpoint(talk: Talk) -> Script[str]:
    ss = talk.next_ss()
    heard = yield from talk.send(Start(ss), listen_s=0.1)
    acknowledged(heard.lines, ss, ArmState.TRACKING)
    t_begun = talk.arrived(heard, 7)
    ack = yield from talk.report()
    _require(
        ack.state is ArmState.TRACKING, f"T {_ms(talk.t - t_begun)} after G: no hold before the first S", ack.state
    )
    return (yield from _fault(talk, t_begun, ack.ss))


def _latches(talk: Talk) -> Script[str]:
    yield from talk.send(Start(talk.next_ss()), listen_s=0.35)
    seen = []
    for command in (Start(talk.next_ss()), SetPoint(talk.next_ss(), talk.rest)):
        heard = yield from talk.send(command)
        refused(heard.lines, command.ss, WRONG_STATE)
        seen += heard.lines
    ack = yield from talk.report()
    _require(ack.state is ArmState.FAULT, "F until R comes", ack.state)
    ss = talk.next_ss()
    heard = yield from talk.send(Reset(ss))
    acknowledged(heard.lines, ss, ArmState.READY)
    return shown([*seen, *heard.lines])


def _answers_each_setpoint(talk: Talk) -> Script[str]:
    yield from talk.begin()
    answers = yield from _stream(talk, [talk.rest] * 20)
    late = [line.t_first - t_arrived for line, t_arrived in answers]
    cycle = talk.limits.cycle_s
    _require(max(late) <= cycle + HOST_SLACK_S, f"A within a cycle of {_ms(cycle)}", _ms(max(late)))
    spacing = (answers[-1][0].t_first - answers[0][0].t_first) / (len(answers) - 1)
    _require(abs(spacing - cycle) < 0.03 * cycle, f"one A each {_ms(cycle)}", f"one each {spacing * 1e3:.2f} ms")
    return f"{len(answers)} answers, {spacing * 1e3:.2f} ms apart, the latest after {_ms(max(late))}"


def _latest_wins(talk: Talk) -> Script[str]:
    yield from talk.begin()
    seen = "nothing"
    for _ in range(_TRIES):
        yield from talk.point(talk.rest, listen_s=0.045)
        first, second = talk.next_ss(), talk.next_ss()
        timer = talk.timer
        timer.skip(talk.t)
        lines = encode_command(SetPoint(first, talk.rest)) + encode_command(SetPoint(second, talk.rest))
        early = len(lines) / 4 * talk.byte_s  # so that both end in the same cycle
        heard = yield from talk.raw(lines, 0.045, timer.t_next - early)
        seen = shown(heard.lines)
        if len(heard.lines) == 1:
            acknowledged(heard.lines, second, ArmState.TRACKING)
            return f"of two in a cycle, {seen}"
    raise DeviationError("A for the second of two set-points in one cycle, nothing for the first", seen)


def _repeated_setpoints(talk: Talk) -> Script[str]:
    yield from talk.begin()
    ss = talk.next_ss()
    first = yield from talk.point(talk.rest, ss, 0.035)
    acknowledged(first.lines, ss, ArmState.TRACKING)
    again: list[Line] = []
    for _ in range(4):
        heard = yield from talk.point(_moved(talk.rest, _SWING_M), ss)
        again += heard.lines
    different = [line for line in again if line.body != first.lines[0].body]
    _require(bool(again) and not different, f"{first.lines[0].body} again and again", shown(different or again))
    heard = yield from talk.raw(b"", 0.02)
    ack = yield from talk.report()
    _require(ack.state is ArmState.HOLD, "H: repeats do not feed the watchdog", str(ack.state))
    still = _away(ack.pose, talk.rest) < _STILL_M
    _require(still, "no motion", f"{_away(ack.pose, talk.rest) * 1e3:.2f} mm")
    return f"{len(again)} repeats of {first.lines[0].body}, then H"


def _holds(talk: Talk) -> Script[str]:
    yield from talk.begin()
    ss = talk.next_ss()
    heard = yield from talk.point(talk.rest, ss, 0.03)
    acknowledged(heard.lines, ss, ArmState.TRACKING)
    t_taken = heard.lines[0].t_first
    tracked, held = t_taken, math.inf
    while held == math.inf and talk.t - t_taken < GIVE_UP_S - 0.03:
        ss = talk.next_ss()
        heard = yield from talk.send(Query(ss), listen_s=0.03, enough=1)
        ack = acknowledged(heard.lines, ss, ArmState.TRACKING, ArmState.HOLD)
        t_state = heard.lines[0].t_first
        tracked, held = (t_state, held) if ack.state is ArmState.TRACKING else (tracked, t_state)
    span = f"T at {_ms(tracked - t_taken)}, H at {_ms(held - t_taken)}" if held < math.inf else "no H"
    cycle = talk.limits.cycle_s
    in_time = held - t_taken >= HOLD_S - HOST_SLACK_S and tracked - t_taken <= HOLD_S + cycle + HOST_SLACK_S
    _require(in_time and held < math.inf, f"H {_ms(HOLD_S)} after the last set-point", span)
    return f"{span} after the last set-point"


def _resumes(talk: Talk) -> Script[str]:
    yield from talk.begin()
    yield from talk.raw(b"", HOLD_S + 0.03)
    ss = talk.next_ss()
    heard = yield from talk.send(SetPoint(ss, _inward(talk, RESUME_M * _BEYOND)), listen_s=0.03)
    refused(heard.lines, ss, STEP_TOO_LARGE)
    ss = talk.next_ss()
    resumed = yield from talk.send(SetPoint(ss, _inward(talk, 0.5 * _SWING_M)), listen_s=0.03)
    acknowledged(resumed.lines, ss, ArmState.TRACKING)
    return shown([*heard.lines, *resumed.lines])


def _first_setpoint_is_near(talk: Talk) -> Script[str]:
    far = {"too far": _inward(talk, RESUME_M * _BEYOND), "turned": _moved(talk.rest, t_rad=RESUME_RAD * _BEYOND)}
    seen = []
    for pose in far.values():
        yield from _settled(talk)
        ss = talk.next_ss()
        heard = yield from talk.send(Start(ss), listen_s=0.03)
        acknowledged(heard.lines, ss, ArmState.TRACKING)
        ss = talk.next_ss()
        heard = yield from talk.send(SetPoint(ss, pose), listen_s=0.04)
        refused(heard.lines, ss, STEP_TOO_LARGE)
        seen += heard.lines
    return f"{' and '.join(far)}: {shown(seen)}"


def _keeps_inside(talk: Talk) -> Script[str]:
    return (yield from _refuses(talk, _outside(talk), OUTSIDE))


def _refuses_leaps(talk: Talk) -> Script[str]:
    leap = 3.0 * talk.limits.v_max_m_s * talk.limits.cycle_s
    return (yield from _refuses(talk, _inward(talk, leap * _BEYOND), STEP_TOO_LARGE))


def _refuses(talk: Talk, pose: Pose, code: int) -> Script[str]:
    """One set-point that must be refused, and one that calls the arm back, whatever it did."""
    yield from talk.begin()
    ss = talk.next_ss()
    heard = yield from talk.point(pose, ss)
    after = yield from talk.point(talk.rest, listen_s=0.04)
    answers = [line for line in (*heard.lines, *after.lines) if line.body[1:3] == f"{ss:02X}"]
    refused(answers, ss, code)
    ack = yield from talk.report()
    _require(ack.state in (ArmState.TRACKING, ArmState.HOLD), "tracking goes on", str(ack.state))
    return shown(answers)


def _refused_do_not_feed(talk: Talk) -> Script[str]:
    yield from talk.begin()
    far = _outside(talk)
    for _ in range(5):
        yield from talk.point(far)
    yield from talk.raw(b"", 0.02)
    ack = yield from talk.report()
    _require(ack.state is ArmState.HOLD, "H: refused set-points do not feed the watchdog", str(ack.state))
    return "H in spite of five refused set-points"


def _gives_up(talk: Talk) -> Script[str]:
    yield from talk.begin()
    ss = talk.next_ss()
    heard = yield from talk.point(talk.rest, ss, 0.035)
    acknowledged(heard.lines, ss, ArmState.TRACKING)
    return (yield from _fault(talk, heard.lines[0].t_first, ss))


def _fault(talk: Talk, t_alive: float, last_ss: int) -> Script[str]:
    """Wait for the fault that follows a silence since `t_alive`: told once, in time, and latched."""
    heard = yield from talk.raw(b"", t_alive + GIVE_UP_S + 0.45 - talk.t)
    wanted = f"E{last_ss:02X}{LINK_LOST:+05d}, once"
    if len(heard.lines) != 1 or reply_in(heard.lines[0], wanted) != Refusal(last_ss, LINK_LOST):
        raise DeviationError(wanted, shown(heard.lines))
    after = heard.lines[0].t_first - t_alive
    latest = GIVE_UP_S + 3.0 * talk.limits.cycle_s + HOST_SLACK_S
    in_time = GIVE_UP_S - HOST_SLACK_S <= after <= latest
    _require(in_time, f"the fault between {_ms(GIVE_UP_S)} and {_ms(latest)} after the last sign", _ms(after))
    ack = yield from talk.report()
    _require(ack.state is ArmState.FAULT, "F", str(ack.state))
    return f"{shown(heard.lines)} after {_ms(after)}, once"


# -- moving ----------------------------------------------------------------------------------------------------


def _follows(talk: Talk) -> Script[str]:
    yield from talk.begin()
    far = _inward(talk, _SWING_M)
    dx, dy = far.x_m - talk.rest.x_m, far.y_m - talk.rest.y_m
    poses = [
        _moved(talk.rest, dx * part, dy * part) for part in (math.sin(math.pi * k / 40.0) ** 2 for k in range(1, 41))
    ]
    answers = yield from _stream(talk, [*poses, *[talk.rest] * 8])
    reached = [_away(_pose(line), talk.rest) for line, _ in answers]
    _require(max(reached) > 0.8 * _SWING_M, f"{_SWING_M * 1e3:g} mm of motion", f"{max(reached) * 1e3:.2f} mm")
    _require(max(reached) < REACH_M, f"less than {REACH_M * 1e3:g} mm", f"{max(reached) * 1e3:.2f} mm")
    _require(reached[-1] < _STILL_M, "back where it began", f"{reached[-1] * 1e3:.2f} mm from there")
    peak = max(range(len(reached)), key=reached.__getitem__)
    lag_s = (peak - 19) * talk.limits.cycle_s
    return f"{max(reached) * 1e3:.2f} mm and back, the actual place {_ms(lag_s)} after the answered set-point"


def _clamps(talk: Talk) -> Script[str]:
    limits = talk.limits
    quantum = limits.a_max_m_s2 * limits.cycle_s**2
    if quantum > 0.75 * REACH_M:
        raise NotExaminedError(
            f"one cycle at its greatest acceleration is {quantum * 1e3:.1f} mm;"
            f" set the controller's to {0.75 * REACH_M / limits.cycle_s**2:.1f} m/s² or less to examine this"
        )
    far = _inward(talk, 1.5 * limits.v_max_m_s * limits.cycle_s)
    yield from talk.begin()
    answers = yield from _stream(talk, [talk.rest, far, *[talk.rest] * 10])
    reach = max(_away(_pose(line), talk.rest) for line, _ in answers)
    _require(reach < 1.3 * quantum + _STILL_M, f"at most {quantum * 1e3:.2f} mm in a cycle", f"{reach * 1e3:.2f} mm")
    return f"a step of {_away(far, talk.rest) * 1e3:.1f} mm moved it by {reach * 1e3:.2f} mm"


def _ends_at_rest(talk: Talk) -> Script[str]:
    yield from _settled(talk)
    places = []
    for _ in range(4):
        places.append((yield from talk.report()))
        yield from talk.raw(b"", 0.05)
    spread = max(_away(ack.pose, places[0].pose) for ack in places)
    away = _away(places[-1].pose, talk.rest)
    _require(places[-1].state is ArmState.READY, "R", str(places[-1].state))
    _require(spread < _STILL_M, "an arm at rest", f"one that moves by {spread * 1e3:.2f} mm")
    _require(away < REACH_M, f"within {REACH_M * 1e3:g} mm of where it began", f"{away * 1e3:.2f} mm away")
    return f"{places[-1].state}, {away * 1e3:.2f} mm from where it began"


def _pose(line: Line) -> Pose:
    reply = reply_in(line, "A")
    assert isinstance(reply, Ack), "the stream has sorted out the others"
    return reply.pose


def _stream(talk: Talk, poses: Sequence[Pose]) -> Script[list[tuple[Line, float]]]:
    """Send one set-point a cycle; returns each one's answer, and when the set-point had arrived (s).

    A late host makes the controller miss one, or take two for one: an eighth may lack an answer.
    """
    sent: dict[int, float] = {}
    lines: list[Line] = []
    for pose in poses:
        ss = talk.next_ss()
        heard = yield from talk.point(pose, ss)
        sent[ss] = talk.arrived(heard, len(encode_command(SetPoint(ss, pose))))
        lines += heard.lines
    heard = yield from talk.raw(b"", 0.03)
    answers = []
    for line in [*lines, *heard.lines]:
        reply = reply_in(line, "A for each set-point")
        if not isinstance(reply, Ack) or reply.ss not in sent or reply.state is not ArmState.TRACKING:
            raise DeviationError("A with state T for each set-point", line.body)
        answers.append((line, sent.pop(reply.ss)))
    if len(sent) > len(poses) // 8:
        raise DeviationError(f"{len(poses)} answers", f"{len(answers)}")
    return answers


def _settled(talk: Talk) -> Script[None]:
    """Bring the controller back to READY, whatever it does. Raises DeviationError if it will not."""
    t_begun = talk.t
    state: ArmState | str = "nothing"
    while talk.t - t_begun < 2.0 * _SETTLE_S:
        heard = yield from talk.send(Query(talk.next_ss()))
        replies = [reply_in(line, "A") for line in heard.lines]
        states = [reply.state for reply in replies if isinstance(reply, Ack)]
        state = states[-1] if states else state
        match state:
            case ArmState.READY:
                return
            case ArmState.TRACKING | ArmState.HOLD:
                yield from talk.send(Stop(talk.next_ss()))
            case ArmState.FAULT:
                yield from talk.send(Reset(talk.next_ss()))
    raise DeviationError("READY after P and R", str(state))


@dataclass(frozen=True, slots=True)
class Check:
    """One clause of the contract: what it says, how it is examined, whether the arm is told to track."""

    number: int
    clause: str
    script: Callable[[Talk], Script[str]] = field(repr=False)
    tracks: bool = True


_STANDING: tuple[tuple[str, Callable[[Talk], Script[str]]], ...] = (
    ("H is answered by H1 with the cycle and six limits", _greets),
    ("Q is answered within a cycle by A: state and actual place", _reports),
    ("the controller ends its lines with CR LF", _ends_lines),
    ("a line with a bad checksum is dropped silently", _drops_bad_checksums),
    ("LF always resynchronises", _resynchronises),
    ("a command repeated with its number repeats its answer", _repeats),
    ("numbers run modulo 256, and each answer bears its command's", _numbers),
    ("S outside T and H is refused: -620", _refuses_setpoints_at_rest),
    ("P and R in R are acknowledged", _grants_what_is_so),
)
_TRACKING: tuple[tuple[str, Callable[[Talk], Script[str]]], ...] = (
    ("G from R answers T; repeated, the same; anew in T: -620", _starts),
    ("P answers D at once, then the state is R", _stops),
    ("G without S: no hold, a fault after 160 ms, told once: -600", _gives_up_without_setpoint),
    ("F is latched: G and S refused, R clears it", _latches),
    ("each S is answered in the cycle that takes it", _answers_each_setpoint),
    ("of two S in a cycle the later wins, the earlier gets no answer", _latest_wins),
    ("a repeated S repeats its answer, moves nothing, feeds no watchdog", _repeated_setpoints),
    ("no S for 48 ms: H", _holds),
    ("H resumes with an S within 5 mm, and refuses others: -611", _resumes),
    ("no S for 160 ms: a fault, told once: -600", _gives_up),
    ("set-points are followed, and A tells the actual place", _follows),
    ("the first S after G must be within 5 mm and 3 degrees: -611", _first_setpoint_is_near),
    ("a target outside the workspace is refused: -610", _keeps_inside),
    ("refused S feed no watchdog", _refused_do_not_feed),
    ("a step over three times vmax × cycle is refused: -611", _refuses_leaps),
    ("a step over vmax × cycle is clamped, and so is acceleration", _clamps),
    ("in the end the arm is at rest where it began, in state R", _ends_at_rest),
)

CHECKS: tuple[Check, ...] = tuple(
    Check(number, clause, script, number > len(_STANDING))
    for number, (clause, script) in enumerate((*_STANDING, *_TRACKING), 1)
)
"""In the order in which they are made: what moves nothing first, what asks for too much last."""

REPORT = CHECKS[1]
"""Without an answer to this one, and state READY in it, no other means anything."""


def examine(check: Check, talk: Talk) -> Script[CheckResult]:
    """Make one check and leave the controller READY; a failure to do so is the check's own.

    What a late host may have spoilt is made again, some times; the result tells if it was late every time.
    """
    for _ in range(_ATTEMPTS):
        talk.late_s = 0.0
        result = yield from _examine(check, talk)
        if result.outcome != "failed" or talk.late_s <= LATE_S:
            return result
    return replace(
        result, seen=f"{result.seen}; but this machine was {_ms(talk.late_s)} late, make it idle and try again"
    )


def _examine(check: Check, talk: Talk) -> Script[CheckResult]:
    talk.sent.clear()
    outcome: Outcome = "passed"
    expected = ""
    try:
        if check.tracks:
            yield from _settled(talk)
        seen = yield from check.script(talk)
    except DeviationError as deviation:
        outcome, expected, seen = "failed", deviation.expected, deviation.seen
    except NotExaminedError as reason:
        outcome, seen = "not run", str(reason)
    sent = " ".join(talk.sent[-_SHOWN_SENT:])
    if check.tracks:
        try:
            yield from _settled(talk)
        except DeviationError as deviation:
            if outcome != "failed":
                outcome, expected, seen = "failed", deviation.expected, deviation.seen
    return CheckResult(check.number, check.clause, outcome, sent, expected, seen)
