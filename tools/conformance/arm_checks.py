"""Conformance checks of controllers at the other end of the arm link. Pure: no port, no clock.

A check is a script: a generator that yields what to write and how long to listen, receives the answers, and returns
what it observed or raises `DeviationError`. `python -m tools.conformance arm PORT` runs the scripts on a real port;
tests run them against the emulated controller and the V+ program's text, in virtual time.

A controller that fulfils the contract moves less than `MAX_EXCURSION_M` from its position. One that does not may
execute a set-point that it should refuse: it moves by at most one cycle at its maximum speed, since each such set-point
is followed by one back to the start.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Literal

from palmd.devices.actuator import ArmState, Pose
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
from tools.conformance.arm_talk import (
    ANSWER_S,
    DeviationError,
    NotExaminedError,
    Script,
    Talk,
    as_text,
    expect_ack,
    expect_refusal,
    only_reply,
    parse_line,
)

MAX_EXCURSION_M = 2e-3
"""Largest motion (m) of a controller that fulfils the contract."""

HOST_TOLERANCE_S = 0.012
"""Tolerance (s) for timestamps of a busy host."""

LATE_S = 0.004
"""Lateness of the host (s) above which a failed check is repeated, since the host may have caused the failure."""

HOLD_S, WATCHDOG_S = 0.048, 0.160
RESUME_M, RESUME_RAD = 5e-3, math.radians(3.0)
LINK_LOST, OUTSIDE, STEP_TOO_LARGE, WRONG_STATE = -600, -610, -611, -620

_STILL_M = 0.3e-3  # encoders and a servo at rest
_SWING_M = 1e-3
_BEYOND = 1.1  # ratio of a target that must be refused to the limit
_SETTLE_S = 1.0
_TRIES = 6  # attempts to send two set-points in one cycle
_SHOWN_SENT = 8
_ATTEMPTS = 3  # at a check that fails while the host is late


Outcome = Literal["passed", "failed", "not run"]


@dataclass(frozen=True, slots=True)
class CheckResult:
    """Outcome of one check: last lines sent, what was expected and observed; `expected` is empty unless it failed."""

    number: int
    clause: str
    outcome: Outcome
    sent: str
    expected: str
    seen: str


def _require(condition: bool, expected: str, seen: str) -> None:
    if not condition:
        raise DeviationError(expected, seen)


def _distance(pose: Pose, other: Pose) -> float:
    return math.hypot(pose.x_m - other.x_m, pose.y_m - other.y_m)


def _moved(pose: Pose, x_m: float = 0.0, y_m: float = 0.0, t_rad: float = 0.0) -> Pose:
    return Pose(pose.x_m + x_m, pose.y_m + y_m, math.remainder(pose.t_rad + t_rad, math.tau))


def _is_within(limits: HelloReply, pose: Pose) -> bool:
    return limits.x_min_m <= pose.x_m <= limits.x_max_m and limits.y_min_m <= pose.y_m <= limits.y_max_m


def _pose_inside(talk: Talk, distance_m: float) -> Pose:
    """Return a pose at this distance from rest, inside the workspace; NotExaminedError if there is no room."""
    limits, rest = talk.limits, talk.rest
    for x_m, y_m in ((distance_m, 0.0), (-distance_m, 0.0), (0.0, distance_m), (0.0, -distance_m)):
        pose = _moved(rest, x_m, y_m)
        if _is_within(limits, pose):
            return pose
    raise NotExaminedError(f"the workspace has no room of {distance_m * 1e3:.0f} mm around the arm's pose")


def _pose_outside(talk: Talk) -> Pose:
    """Return the nearest pose that is 1 mm outside the workspace."""
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


# -- without tracking --------------------------------------------------------------------------------------------


def _answers_hello(talk: Talk) -> Script[str]:
    heard = yield from talk.send(Hello(), listen_s=0.25)
    talk.count_from(0)
    reply = only_reply(heard.lines, "H1 with seven numbers")
    if not isinstance(reply, HelloReply):
        raise DeviationError("H1 with seven numbers", as_text(heard.lines))
    talk.hello = reply
    return f"{heard.lines[0].body}, {_ms(heard.lines[0].t_first - talk.arrived(heard, 5))} after the request"


def _answers_query(talk: Talk) -> Script[str]:
    heard, ack = yield from talk.ask(Query)
    _require(_is_within(talk.limits, ack.pose), "a pose inside the workspace", heard.lines[0].body)
    talk.home = ack.pose
    if ack.state is not ArmState.READY:
        raise NotExaminedError(f"the controller is in state {ack.state} ({ack.state.name}); bring it to READY first")
    late = heard.lines[0].t_first - talk.arrived(heard, 7)
    cycle = talk.limits.cycle_s
    _require(late <= cycle + HOST_TOLERANCE_S, f"an answer within {_ms(cycle)}", _ms(late))
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
        _require(not heard.lines, "nothing", as_text(heard.lines))
    yield from talk.report()
    return "three bad lines were not answered, the good one after them was"


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
            expect_ack(heard.lines, ss)
        except DeviationError as deviation:
            raise DeviationError(f"{deviation.expected} after {name} and LF", deviation.seen) from None
    return f"answered after {', '.join(noise)}"


def _repeats_answer(talk: Talk) -> Script[str]:
    first, ack = yield from talk.ask(Query)
    second = yield from talk.send(Query(ack.ss))
    expect_ack(second.lines, ack.ss)
    same = first.lines[0].body == second.lines[0].body
    _require(same, first.lines[0].body, second.lines[0].body)
    return f"{first.lines[0].body}, twice"


def _wraps_numbers(talk: Talk) -> Script[str]:
    talk.count_from(SEQUENCE_MODULUS - 4)
    for _ in range(8):
        yield from talk.report()
    return "FC to 03, each answered under its own number"


def _refuses_setpoints_at_rest(talk: Talk) -> Script[str]:
    return as_text((yield from talk.refused(partial(SetPoint, pose=talk.rest), WRONG_STATE)))


def _acknowledges_no_change(talk: Talk) -> Script[str]:
    stop, _ = yield from talk.ask(Stop, ArmState.READY)
    reset, _ = yield from talk.ask(Reset, ArmState.READY)
    return as_text([*stop.lines, *reset.lines])


# -- tracking, without motion ----------------------------------------------------------------------------------


def _starts(talk: Talk) -> Script[str]:
    heard, ack = yield from talk.ask(Start, ArmState.TRACKING, listen_s=0.03)
    again = yield from talk.send(Start(ack.ss), listen_s=0.03)
    expect_ack(again.lines, ack.ss, ArmState.TRACKING)
    refused = yield from talk.refused(Start, WRONG_STATE, listen_s=0.03)
    return as_text([*heard.lines, *again.lines, *refused])


def _stops(talk: Talk) -> Script[str]:
    yield from talk.begin()
    heard, _ = yield from talk.ask(Stop, ArmState.DECELERATING)
    t_start = talk.t
    while (ack := (yield from talk.report())).state is not ArmState.READY:
        _require(ack.state is ArmState.DECELERATING, "D, then R", str(ack.state))
        _require(talk.t - t_start < _SETTLE_S, f"R within {_ms(_SETTLE_S)}", "D")
    return f"{as_text(heard.lines)}, then R"


def _faults_without_first_setpoint(talk: Talk) -> Script[str]:
    heard, _ = yield from talk.ask(Start, ArmState.TRACKING, listen_s=0.1)
    t_start = talk.arrived(heard, 7)
    ack = yield from talk.report()
    _require(
        ack.state is ArmState.TRACKING, f"T {_ms(talk.t - t_start)} after G: no hold before the first S", ack.state
    )
    return (yield from _await_fault(talk, t_start, ack.ss))


def _latches_fault(talk: Talk) -> Script[str]:
    yield from talk.send(Start(talk.next_ss()), listen_s=0.35)
    start = yield from talk.refused(Start, WRONG_STATE)
    setpoint = yield from talk.refused(partial(SetPoint, pose=talk.rest), WRONG_STATE)
    ack = yield from talk.report()
    _require(ack.state is ArmState.FAULT, "F until R comes", ack.state)
    heard, _ = yield from talk.ask(Reset, ArmState.READY)
    return as_text([*start, *setpoint, *heard.lines])


def _answers_each_setpoint(talk: Talk) -> Script[str]:
    yield from talk.begin()
    answers = yield from _stream(talk, [talk.rest] * 20)
    late = [line.t_first - t_arrived for line, t_arrived in answers]
    cycle = talk.limits.cycle_s
    _require(max(late) <= cycle + HOST_TOLERANCE_S, f"A within a cycle of {_ms(cycle)}", _ms(max(late)))
    spacing = (answers[-1][0].t_first - answers[0][0].t_first) / (len(answers) - 1)
    _require(abs(spacing - cycle) < 0.03 * cycle, f"one A each {_ms(cycle)}", f"one each {spacing * 1e3:.2f} ms")
    return f"{len(answers)} answers, {spacing * 1e3:.2f} ms apart, the latest after {_ms(max(late))}"


def _uses_latest_setpoint(talk: Talk) -> Script[str]:
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
        seen = as_text(heard.lines)
        if len(heard.lines) == 1:
            expect_ack(heard.lines, second, ArmState.TRACKING)
            return f"of two in a cycle, {seen}"
    raise DeviationError("A for the second of two set-points in one cycle, nothing for the first", seen)


def _repeats_setpoint_answer(talk: Talk) -> Script[str]:
    yield from talk.begin()
    ss = talk.next_ss()
    first = yield from talk.point(talk.rest, ss, 0.035)
    expect_ack(first.lines, ss, ArmState.TRACKING)
    again: list[Line] = []
    for _ in range(4):
        heard = yield from talk.point(_moved(talk.rest, _SWING_M), ss)
        again += heard.lines
    different = [line for line in again if line.body != first.lines[0].body]
    _require(bool(again) and not different, f"{first.lines[0].body} again and again", as_text(different or again))
    heard = yield from talk.raw(b"", 0.02)
    ack = yield from talk.report()
    _require(ack.state is ArmState.HOLD, "H: repeats do not feed the watchdog", str(ack.state))
    still = _distance(ack.pose, talk.rest) < _STILL_M
    _require(still, "no motion", f"{_distance(ack.pose, talk.rest) * 1e3:.2f} mm")
    return f"{len(again)} repeats of {first.lines[0].body}, then H"


def _holds(talk: Talk) -> Script[str]:
    yield from talk.begin()
    ss = talk.next_ss()
    heard = yield from talk.point(talk.rest, ss, 0.03)
    expect_ack(heard.lines, ss, ArmState.TRACKING)
    t_taken = heard.lines[0].t_first
    tracked, held = t_taken, math.inf
    while held == math.inf and talk.t - t_taken < WATCHDOG_S - 0.03:
        heard, ack = yield from talk.ask(Query, ArmState.TRACKING, ArmState.HOLD, listen_s=0.03, enough=1)
        t_state = heard.lines[0].t_first
        tracked, held = (t_state, held) if ack.state is ArmState.TRACKING else (tracked, t_state)
    span = f"T at {_ms(tracked - t_taken)}, H at {_ms(held - t_taken)}" if held < math.inf else "no H"
    cycle = talk.limits.cycle_s
    in_time = held - t_taken >= HOLD_S - HOST_TOLERANCE_S and tracked - t_taken <= HOLD_S + cycle + HOST_TOLERANCE_S
    _require(in_time and held < math.inf, f"H {_ms(HOLD_S)} after the last set-point", span)
    return f"{span} after the last set-point"


def _resumes(talk: Talk) -> Script[str]:
    yield from talk.begin()
    yield from talk.raw(b"", HOLD_S + 0.03)
    far = _pose_inside(talk, RESUME_M * _BEYOND)
    refused = yield from talk.refused(partial(SetPoint, pose=far), STEP_TOO_LARGE, listen_s=0.03)
    near = _pose_inside(talk, 0.5 * _SWING_M)
    resumed, _ = yield from talk.ask(partial(SetPoint, pose=near), ArmState.TRACKING, listen_s=0.03)
    return as_text([*refused, *resumed.lines])


def _first_setpoint_is_near(talk: Talk) -> Script[str]:
    far = {"too far": _pose_inside(talk, RESUME_M * _BEYOND), "turned": _moved(talk.rest, t_rad=RESUME_RAD * _BEYOND)}
    seen = []
    for pose in far.values():
        yield from _bring_to_ready(talk)
        yield from talk.ask(Start, ArmState.TRACKING, listen_s=0.03)
        seen += yield from talk.refused(partial(SetPoint, pose=pose), STEP_TOO_LARGE, listen_s=0.04)
    return f"{' and '.join(far)}: {as_text(seen)}"


def _refuses_outside(talk: Talk) -> Script[str]:
    return (yield from _refuses_setpoint(talk, _pose_outside(talk), OUTSIDE))


def _refuses_steps(talk: Talk) -> Script[str]:
    leap = 3.0 * talk.limits.v_max_m_s * talk.limits.cycle_s
    return (yield from _refuses_setpoint(talk, _pose_inside(talk, leap * _BEYOND), STEP_TOO_LARGE))


def _refuses_setpoint(talk: Talk, pose: Pose, code: int) -> Script[str]:
    """Send one set-point that must be refused, and one back to rest in any case."""
    yield from talk.begin()
    ss = talk.next_ss()
    heard = yield from talk.point(pose, ss)
    after = yield from talk.point(talk.rest, listen_s=0.04)
    answers = [line for line in (*heard.lines, *after.lines) if line.body[1:3] == f"{ss:02X}"]
    expect_refusal(answers, ss, code)
    ack = yield from talk.report()
    _require(ack.state in (ArmState.TRACKING, ArmState.HOLD), "T or H: tracking continues", str(ack.state))
    return as_text(answers)


def _refused_do_not_feed_watchdog(talk: Talk) -> Script[str]:
    yield from talk.begin()
    far = _pose_outside(talk)
    for _ in range(5):
        yield from talk.point(far)
    yield from talk.raw(b"", 0.02)
    ack = yield from talk.report()
    _require(ack.state is ArmState.HOLD, "H: refused set-points do not feed the watchdog", str(ack.state))
    return "H despite five refused set-points"


def _faults_after_silence(talk: Talk) -> Script[str]:
    yield from talk.begin()
    ss = talk.next_ss()
    heard = yield from talk.point(talk.rest, ss, 0.035)
    expect_ack(heard.lines, ss, ArmState.TRACKING)
    return (yield from _await_fault(talk, heard.lines[0].t_first, ss))


def _await_fault(talk: Talk, t_alive: float, last_ss: int) -> Script[str]:
    """Wait for the fault after a silence since `t_alive` (s): reported once, in time, and latched."""
    heard = yield from talk.raw(b"", t_alive + WATCHDOG_S + 0.45 - talk.t)
    expected = f"E{last_ss:02X}{LINK_LOST:+05d}, once"
    if len(heard.lines) != 1 or parse_line(heard.lines[0], expected) != Refusal(last_ss, LINK_LOST):
        raise DeviationError(expected, as_text(heard.lines))
    after = heard.lines[0].t_first - t_alive
    latest = WATCHDOG_S + 3.0 * talk.limits.cycle_s + HOST_TOLERANCE_S
    in_time = WATCHDOG_S - HOST_TOLERANCE_S <= after <= latest
    _require(in_time, f"the fault between {_ms(WATCHDOG_S)} and {_ms(latest)} after the last set-point", _ms(after))
    ack = yield from talk.report()
    _require(ack.state is ArmState.FAULT, "F", str(ack.state))
    return f"{as_text(heard.lines)} after {_ms(after)}, once"


# -- with motion ----------------------------------------------------------------------------------------------------


def _follows(talk: Talk) -> Script[str]:
    yield from talk.begin()
    far = _pose_inside(talk, _SWING_M)
    dx, dy = far.x_m - talk.rest.x_m, far.y_m - talk.rest.y_m
    poses = [
        _moved(talk.rest, dx * part, dy * part) for part in (math.sin(math.pi * k / 40.0) ** 2 for k in range(1, 41))
    ]
    answers = yield from _stream(talk, [*poses, *[talk.rest] * 8])
    reached = [_distance(_pose(line), talk.rest) for line, _ in answers]
    _require(max(reached) > 0.8 * _SWING_M, f"{_SWING_M * 1e3:g} mm of motion", f"{max(reached) * 1e3:.2f} mm")
    _require(max(reached) < MAX_EXCURSION_M, f"less than {MAX_EXCURSION_M * 1e3:g} mm", f"{max(reached) * 1e3:.2f} mm")
    _require(reached[-1] < _STILL_M, "back at the start", f"{reached[-1] * 1e3:.2f} mm from there")
    peak = max(range(len(reached)), key=reached.__getitem__)
    lag_s = (peak - 19) * talk.limits.cycle_s
    return f"{max(reached) * 1e3:.2f} mm and back, the actual pose lags the answered set-point by {_ms(lag_s)}"


def _clamps(talk: Talk) -> Script[str]:
    limits = talk.limits
    quantum = limits.a_max_m_s2 * limits.cycle_s**2
    if quantum > 0.75 * MAX_EXCURSION_M:
        raise NotExaminedError(
            f"one cycle at its maximum acceleration is {quantum * 1e3:.1f} mm;"
            f" set the controller's limit to {0.75 * MAX_EXCURSION_M / limits.cycle_s**2:.1f} m/s² or less"
        )
    far = _pose_inside(talk, 1.5 * limits.v_max_m_s * limits.cycle_s)
    yield from talk.begin()
    answers = yield from _stream(talk, [talk.rest, far, *[talk.rest] * 10])
    reach = max(_distance(_pose(line), talk.rest) for line, _ in answers)
    _require(reach < 1.3 * quantum + _STILL_M, f"at most {quantum * 1e3:.2f} mm in a cycle", f"{reach * 1e3:.2f} mm")
    return f"a step of {_distance(far, talk.rest) * 1e3:.1f} mm moved it by {reach * 1e3:.2f} mm"


def _ends_at_rest(talk: Talk) -> Script[str]:
    yield from _bring_to_ready(talk)
    reports = []
    for _ in range(4):
        reports.append((yield from talk.report()))
        yield from talk.raw(b"", 0.05)
    spread = max(_distance(ack.pose, reports[0].pose) for ack in reports)
    away = _distance(reports[-1].pose, talk.rest)
    _require(reports[-1].state is ArmState.READY, "R", str(reports[-1].state))
    _require(spread < _STILL_M, "an arm at rest", f"one that moves by {spread * 1e3:.2f} mm")
    _require(away < MAX_EXCURSION_M, f"within {MAX_EXCURSION_M * 1e3:g} mm of the start", f"{away * 1e3:.2f} mm away")
    return f"{reports[-1].state}, {away * 1e3:.2f} mm from the start"


def _pose(line: Line) -> Pose:
    reply = parse_line(line, "A")
    assert isinstance(reply, Ack), "_stream raises for other replies"
    return reply.pose


def _stream(talk: Talk, poses: Sequence[Pose]) -> Script[list[tuple[Line, float]]]:
    """Send one set-point a cycle; return each one's answer and the set-point's arrival time (s).

    A late host may make the controller miss a set-point or receive two in a cycle: an eighth may lack an answer.
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
        reply = parse_line(line, "A for each set-point")
        if not isinstance(reply, Ack) or reply.ss not in sent or reply.state is not ArmState.TRACKING:
            raise DeviationError("A with state T for each set-point", line.body)
        answers.append((line, sent.pop(reply.ss)))
    if len(sent) > len(poses) // 8:
        raise DeviationError(f"{len(poses)} answers", f"{len(answers)}")
    return answers


def _bring_to_ready(talk: Talk) -> Script[None]:
    """Bring the controller back to READY from any state. Raises DeviationError if that fails."""
    t_start = talk.t
    state: ArmState | str = "nothing"
    while talk.t - t_start < 2.0 * _SETTLE_S:
        heard = yield from talk.send(Query(talk.next_ss()))
        replies = [parse_line(line, "A") for line in heard.lines]
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
    """One clause of the contract: number, text, script, and whether the script makes the arm track."""

    number: int
    clause: str
    script: Callable[[Talk], Script[str]] = field(repr=False)
    tracks: bool = True


_STANDING: tuple[tuple[str, Callable[[Talk], Script[str]]], ...] = (
    ("H is answered by H1 with the cycle and six limits", _answers_hello),
    ("Q is answered within a cycle by A: state and actual pose", _answers_query),
    ("the controller ends its lines with CR LF", _ends_lines),
    ("a line with a bad checksum is discarded without an answer", _drops_bad_checksums),
    ("LF always resynchronises", _resynchronises),
    ("a command repeated with its number repeats its answer", _repeats_answer),
    ("sequence numbers are modulo 256; each answer has its command's number", _wraps_numbers),
    ("S outside T and H is refused: -620", _refuses_setpoints_at_rest),
    ("P and R in R are acknowledged", _acknowledges_no_change),
)
_TRACKING: tuple[tuple[str, Callable[[Talk], Script[str]]], ...] = (
    ("G in R is answered with T; repeated, the same; a new G in T: -620", _starts),
    ("P is answered with D at once, then the state is R", _stops),
    ("G without S: no hold, a fault after 160 ms, reported once: -600", _faults_without_first_setpoint),
    ("F is latched: G and S are refused, R clears it", _latches_fault),
    ("each S is answered in the cycle that uses it", _answers_each_setpoint),
    ("of two S in a cycle the later one is used, the earlier gets no answer", _uses_latest_setpoint),
    ("a repeated S repeats its answer, causes no motion and does not feed the watchdog", _repeats_setpoint_answer),
    ("no S for 48 ms: H", _holds),
    ("H resumes with an S within 5 mm, and refuses others: -611", _resumes),
    ("no S for 160 ms: a fault, reported once: -600", _faults_after_silence),
    ("set-points are followed, and A reports the actual pose", _follows),
    ("the first S after G must be within 5 mm and 3 degrees: -611", _first_setpoint_is_near),
    ("a target outside the workspace is refused: -610", _refuses_outside),
    ("a refused S does not feed the watchdog", _refused_do_not_feed_watchdog),
    ("a step over three times vmax × cycle is refused: -611", _refuses_steps),
    ("a step over vmax × cycle is clamped, and so is acceleration", _clamps),
    ("at the end the arm is at rest where it started, in state R", _ends_at_rest),
)

CHECKS: tuple[Check, ...] = tuple(
    Check(number, clause, script, number > len(_STANDING))
    for number, (clause, script) in enumerate((*_STANDING, *_TRACKING), 1)
)
"""In the order of execution: checks without motion first, checks with excessive set-points last."""

REPORT = CHECKS[1]
"""All other checks require that this one passes with state READY."""


def examine(check: Check, talk: Talk) -> Script[CheckResult]:
    """Run one check and leave the controller READY; if that fails, the check fails.

    A check that fails while the host is late is repeated; the result notes if the host was late every time.
    """
    for _ in range(_ATTEMPTS):
        talk.late_s = 0.0
        result = yield from _run_once(check, talk)
        if result.outcome != "failed" or talk.late_s <= LATE_S:
            return result
    return replace(
        result, seen=f"{result.seen}; but this machine was {_ms(talk.late_s)} late, make it idle and try again"
    )


def _run_once(check: Check, talk: Talk) -> Script[CheckResult]:
    talk.sent.clear()
    outcome: Outcome = "passed"
    expected = ""
    try:
        if check.tracks:
            yield from _bring_to_ready(talk)
        seen = yield from check.script(talk)
    except DeviationError as deviation:
        outcome, expected, seen = "failed", deviation.expected, deviation.seen
    except NotExaminedError as reason:
        outcome, seen = "not run", str(reason)
    sent = " ".join(talk.sent[-_SHOWN_SENT:])
    if check.tracks:
        try:
            yield from _bring_to_ready(talk)
        except DeviationError as deviation:
            if outcome != "failed":
                outcome, expected, seen = "failed", deviation.expected, deviation.seen
    return CheckResult(check.number, check.clause, outcome, sent, expected, seen)
