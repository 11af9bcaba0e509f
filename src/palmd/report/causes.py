"""Root cause of a hold or stop, with its evidence, from a run's timeline and the ticks around it. Pure.

A fault is a symptom; the cause is what produced it: a pad that is silent may send nothing, send data of another format,
or have been starved because palmd itself got no processor time.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import fmean
from typing import Any

from palmd.devices.pad import SILENT_INTERVALS, pad_counter_names
from palmd.faults import TABLE
from palmd.messages import Fields, LogEntry
from palmd.quantities import SystemTopics
from palmd.record import DAEMON_RESTARTED, DAEMON_SILENT, PARENT_GONE, REQUESTED
from palmd.report.timeline import Closeup, StateChange, Timeline

STALL_S = 0.1
"""Interval between ticks from which on pads seem silent and the controller (48 ms) runs out of set-points."""

RIG_STALL_S = 0.04
"""Stall of an emulated rig from which on it seems silent or its controller runs out of set-points."""

PAUSE_S = 0.04
"""Interval between ticks from which on the controller holds briefly."""

STALL_BEFORE_S, STALL_READING_S = 0.1, 0.03
BEFORE_FAULT_S, AFTER_FAULT_S = 0.6, 0.05
"""A log entry is evidence for a fault if it lies within this time before and after it."""
SUCCESSOR_S = 15.0  # after the end of a recording the next one may hold the reason

ARM_QUIET_S = 0.1  # without an answer: six cycles of the arm
LINE_BYTES = 30  # length of an answer of the arm, including its line end
FOREIGN_LINE_RATIO = 3.0  # in data of other devices line ends are rarer by this factor
_LINE = ("arm_port_bytes_read", "arm_lines", "arm_crc_errors", "arm_unframed")
_BUS = ("arm_bytes", "arm_packets", "arm_crc_errors", "arm_discarded")
DAMAGED_SHARE, FOREIGN_SHARE = 0.05, 0.5  # fraction of a bus's bytes outside packets that shows damage, foreign data
DISCARDED_BYTES = 24  # per second; fewer are normal losses
FOREIGN_DATA_S = 0.2  # of bytes without a packet: another device sends
COMMANDED = "_cmd_"
TOGETHER_S = 0.15  # longest time between the ends of contact on both pads if the object was lifted off
CONTROLLER_WATCHDOG_MS, SETPOINT_MS = 160, 16
BREAK, NO_SETPOINTS = "-0504", "-0600"  # errors of the controller

_ARM_STATES: dict[str, tuple[str, str]] = {
    "arm-estop": ("estop", "the arm's emergency stop was pressed"),
    "arm-power-off": ("power-off", "arm power went off"),
    "arm-manual": ("manual", "the arm's controller was switched to manual mode"),
    "arm-uncalibrated": ("uncalibrated", "the arm's controller lost its calibration"),
    "arm-left-tracking": ("left", "the arm's controller left tracking without a command"),
}
_STARVED = ("arm-link-lost", "arm-left-tracking", "arm-servo-watchdog")  # without set-points or answers
_ENDINGS = {
    DAEMON_SILENT: "its recorder finished it because no more messages came from the daemon",
    DAEMON_RESTARTED: "its recorder finished it because another daemon had started",
    PARENT_GONE: "its recorder finished it because the daemon, which had started the recorder, was gone",
}
_DIRECT: dict[str, tuple[str, str]] = {
    "tick-error": ("failed", "palmd itself failed: an unexpected error in its control loop"),
    "estimate-not-finite": ("not-finite", "palmd's observer published an estimate as valid that was not finite"),
    "limits-violated": ("limits", "the palms were outside their limits, or the motion would have left them"),
    "following-error": ("not-followed", "the arm did not follow its set-points: it was blocked, or its encoder fails"),
    "pose-implausible": ("implausible", "the arm reported an impossible pose"),
    "pose-contradicts-rig": ("contradicts", "the arm's pose contradicts the configured rig"),
    "force-limit": ("pressed", "the force on a pad exceeded its limit, or the range of the pad"),
    "force-excess": ("pressed", "the force on a pad exceeded 1.5 times its limit"),
    "loop-overruns": ("overruns", "palmd's control loop repeatedly missed its deadline"),
}


@dataclass(frozen=True, slots=True)
class Clue:
    """One piece of evidence for a cause, and the topic of the recording that holds it."""

    where: str
    what: str


@dataclass(frozen=True, slots=True)
class StopCause:
    """A root cause: its kind, the device (`end`: `pad1`, `arm`, or empty), one sentence, and the evidence."""

    kind: str
    end: str
    sentence: str
    evidence: tuple[Clue, ...] = ()

    @property
    def name(self) -> str:
        """Device and kind in one word."""
        return f"{self.end}-{self.kind}" if self.end else self.kind


@dataclass(frozen=True, slots=True)
class RunCase:
    """Input of the analysis: the run's timeline, the ticks around the fault, the configuration, the system's topics."""

    timeline: Timeline
    closeup: Closeup
    config: Any
    topics: SystemTopics

    @property
    def commanded(self) -> tuple[str, ...]:
        """The motion fields with commanded values."""
        return tuple(each.name for each in self.topics.motion.quantities if COMMANDED in each.name)

    @property
    def pad_count(self) -> int:
        """Number of pads."""
        return sum(each.name.startswith("touch") for each in self.topics.contact.quantities)

    def joint_text(self, motion: Fields) -> str:
        """The positions of joints or axes as text."""
        names = (each.replace(COMMANDED, "_") for each in self.commanded)
        return ", ".join(
            f"{name.removesuffix('_rad')} {math.degrees(motion[name]):.1f}°"
            if name.endswith("_rad") else f"{name.removesuffix('_m')} {motion[name] * 1e3:.1f} mm"
            for name in names
        )  # fmt: skip

    def rel(self, t: float) -> str:
        """A time as text, relative to the beginning of the run."""
        return f"{t - self.timeline.begin:.2f} s"

    def logged(self, kind: str, name: str, t: float) -> LogEntry | None:
        """The latest log entry of this kind and name around `t` that reports a beginning; None if there is none."""
        near = (each for each in reversed(self.timeline.log) if t - BEFORE_FAULT_S < each.t_s <= t + AFTER_FAULT_S)
        begun = (each for each in near if (each.kind, each.name) == (kind, name) and math.isnan(each.lasted_s))
        return next(begun, None)


# ---------------------------------------------------------------------------------------------------- of a fault


def of_fault(case: RunCase, codes: Sequence[str], t: float) -> StopCause:
    """The cause of the faults that came up at `t` and acted: the first rule that explains them, with its evidence."""
    stall = _stall(case, t, STALL_S)
    if stall is not None and all(_by_stall(case, code, stall, t) for code in codes):
        return stall.cause
    rig_stall = _rig_stall(case, t)
    if rig_stall is not None and all(code.endswith("-silent") or code in ("arm-fault", *_STARVED) for code in codes):
        return rig_stall
    rules: tuple[tuple[str, Callable[[RunCase, str, float], StopCause]], ...] = (
        ("|".join(_DIRECT), _direct_cause),
        (".*-port", _port),
        ("arm-(estop|power-off|manual|uncalibrated)", _arm_state),
        ("arm-servo-.*", _servo),
        ("arm-fault", _controller),
        ("arm-link-lost", _link),
        (".*-lifted", _lifted),
        (".*-silent", _silent),
        ("arm-left-tracking", _arm_state),
    )
    for pattern, cause_of in rules:
        for code in codes:
            if re.fullmatch(pattern, code):
                return cause_of(case, code, t)
    code = codes[0]
    return StopCause("fault", "", TABLE[code].text if code in TABLE else code, _logged_evidence(case, code, t))


def _logged_evidence(case: RunCase, code: str, t: float) -> tuple[Clue, ...]:
    """The daemon's own evidence for a fault, from its log."""
    entry = case.logged("fault", code, t)
    return () if entry is None else (Clue("palm/log", f"{code}: {entry.text}"),)


def _finding(case: RunCase, code: str, t: float) -> str:
    """The daemon's own finding about a fault, from its log, as a code; empty in old runs."""
    entry = case.logged("fault", code, t)
    return "" if entry is None else entry.code


def _state_clue(case: RunCase, code: str, t: float) -> Clue:
    return Clue("palm/state", f"{code} from {case.rel(t)} on")


@dataclass(frozen=True, slots=True)
class _Stall:
    begin: float
    end: float
    cause: StopCause


def _by_stall(case: RunCase, code: str, stall: _Stall, t: float) -> bool:
    """Whether a stall of the loop explains a fault that did not exist before the stall."""
    if code.endswith("-silent"):
        before = [true for fed, true in case.closeup.readings.get(int(code[3]), []) if fed <= t]
        return bool(before) and before[-1] > stall.begin - STALL_READING_S
    if code == "arm-fault":
        return _finding(case, code, t) in ("", NO_SETPOINTS)
    return code in ("loop-overruns", *_STARVED)


def _stall(case: RunCase, t: float, least_s: float) -> _Stall | None:
    """A stall of palmd's own loop just before `t`: a long interval between consecutive ticks."""
    ticks = case.closeup.motion
    numbered = zip(pairwise(ticks), pairwise(case.closeup.numbers), strict=True)
    for ((t0, _), (t1, _)), (number0, number1) in numbered:
        if t1 - t0 >= least_s and t - STALL_BEFORE_S < t1 <= t + 0.02 and number1 == number0 + 1:
            text = (
                f"ticks {number0} and {number1} are {(t1 - t0) * 1e3:.0f} ms apart, at {case.rel(t0)} and "
                f"{case.rel(t1)}; the period is {1e3 / case.config.loop.rate_hz:.0f} ms"
            )
            sentence = (
                f"palmd itself stalled for {(t1 - t0) * 1e3:.0f} ms: it got no processor time, so it sent no "
                "set-points and read no data"
            )
            evidence = (Clue(case.topics.motion.name, text), *_logged_evidence(case, "loop-overrun", t1))
            return _Stall(t0, t1, StopCause("stalled", "", sentence, evidence))
    return None


def _rig_stall(case: RunCase, t: float) -> StopCause | None:
    """A stall of an emulated rig just before `t`, which the rig itself publishes."""
    near = [(end, lasted) for end, lasted in case.closeup.rig_stalls if end - lasted < t < end + BEFORE_FAULT_S]
    if not near:
        return None
    end, lasted = max(near, key=lambda each: each[1])
    if lasted < RIG_STALL_S:
        return None
    sentence = (
        f"the emulated rig itself stalled for {lasted * 1e3:.0f} ms: it got no processor time, so no data came from "
        "pads and arm; this cannot happen with a real rig"
    )
    text = f"it continued at {case.rel(end)} after {lasted * 1e3:.0f} ms, by its own clock"
    return StopCause("rig-stalled", "", sentence, (Clue("rig/stall", text),))


def _direct_cause(case: RunCase, code: str, t: float) -> StopCause:
    kind, sentence = _DIRECT[code]
    evidence = [*_logged_evidence(case, code, t)]
    motion = case.closeup.last_motion(t)
    if code == "limits-violated" and motion:
        evidence.append(Clue(case.topics.motion.name, f"the palms were at {case.joint_text(motion)}"))
    return StopCause(kind, "", sentence, tuple(evidence or [_state_clue(case, code, t)]))


def _port(case: RunCase, code: str, t: float) -> StopCause:
    end = code.removesuffix("-port")
    counter = f"{end}_port_losses"
    evidence = [*_logged_evidence(case, code, t)]
    evidence += [
        Clue("palm/loop", f"{counter} grew {when}") for (losses,), when in _counted(case, [counter], t) if losses
    ]
    device = (case.config.arm if end == "arm" else getattr(case.config.pads, f"palm{end[-1]}")).port
    name = "the arm" if end == "arm" else f"pad {end[-1]}"
    sentence = f"the serial port of {name} was lost: {device} could no longer be read"
    return StopCause("port", end, sentence, (*evidence, _state_clue(case, code, t)))


def _arm_state(case: RunCase, code: str, t: float) -> StopCause:
    kind, sentence = _ARM_STATES[code]
    return StopCause(kind, "arm", sentence, (*_state_letter_change(case, t), *_logged_evidence(case, code, t)))


def _state_letter_change(case: RunCase, t: float) -> tuple[Clue, ...]:
    """The last change of the controller's state letter up to `t`."""
    letters = [(when, fields["arm_state"]) for when, fields in case.closeup.motion if when <= t + 0.02]
    for (_, before), (when, now) in reversed([*pairwise(letters)]):
        if before != now:
            text = f"the controller's state letter changed from {before or 'unknown'} to {now or 'unknown'}"
            return (Clue(case.topics.motion.name, f"{text} at {case.rel(when)}"),)
    return ()


def _controller(case: RunCase, code: str, t: float) -> StopCause:
    """Cause of a fault latched by the controller: from its error code, or from how long the line was dead before."""
    error = _finding(case, code, t)
    evidence = (*_state_letter_change(case, t), *_logged_evidence(case, code, t))
    if error == BREAK:
        sentence = "there was a break on the arm's line: its controller latched error -504"
        return StopCause("break", "arm", sentence, evidence)
    line = _link(case, code, t)
    if line.kind in ("damaged", "foreign"):
        return line
    silent_ms = _oldest_ms(case, "arm_age_ms", t)
    if silent_ms >= ARM_QUIET_S * 1e3 or error == NO_SETPOINTS:
        quiet = Clue(case.topics.contact.name, f"the arm's last answer was up to {silent_ms:.0f} ms old before that")
        sentence = (
            f"the arm's controller received no set-point for {CONTROLLER_WATCHDOG_MS} ms, stopped and latched error "
            f"-600: the line was dead, while palmd sent a set-point every {SETPOINT_MS} ms"
        )
        return StopCause("watchdog", "arm", sentence, (quiet, *evidence))
    how = "of its own" if case.logged("fault", code, t) else "while the line was alive: a break, or an internal fault"
    return StopCause("controller", "arm", f"the arm's controller latched a fault {how}", evidence)


def _servo(case: RunCase, code: str, t: float) -> StopCause:
    """Cause of a servo fault: reported by the servo itself, or a watchdog that expired without set-points."""
    logged = _logged_evidence(case, code, t)
    if code != "arm-servo-watchdog":
        sentence = f"{TABLE[code].text}, as reported by the servo itself"
        return StopCause("servo", "arm", sentence, logged or (_state_clue(case, code, t),))
    line = _bus(case, code, t)
    if line.kind != "late":
        return line
    sentence = f"{TABLE[code].text}, while palmd sent one every cycle: the adapter or the line delayed them"
    return StopCause("watchdog", "arm", sentence, line.evidence)


def _link(case: RunCase, code: str, t: float) -> StopCause:
    """Cause of missing answers of the arm: no data, or unreadable data."""
    return (_bus if case.config.arm.kind == "dynamixel" else _line)(case, code, t)


def _bus(case: RunCase, code: str, t: float) -> StopCause:
    """As `_link` for a bus of servos, whose packets begin with a header."""
    evidence = [_arm_age(case, t, "servos' last answer", "bus")]
    total = outside = checksum_errors = 0.0
    for (read, packets, wrong, discarded), between in _counted(case, _BUS, t - 0.25, t, t + 1.0):
        counts = f"received {read:.0f} bytes, {packets:.0f} complete packets, {wrong:.0f} with a wrong checksum"
        evidence.append(Clue("palm/loop", f"{counts}, {discarded:.0f} bytes outside packets {between}"))
        total, outside, checksum_errors = total + read, outside + discarded, checksum_errors + wrong
    if not total:
        kind, sentence = "mute", "the servos sent no more data"
    elif outside > FOREIGN_SHARE * total and not checksum_errors:
        kind = "foreign"
        sentence = "the data on the servos' line were not answers: another device, or another baud rate"
    elif outside > DAMAGED_SHARE * total:
        kind, sentence = "damaged", "much of the data from the servos was damaged"
    elif code == "arm-link-lost":
        kind, sentence = "mute", "some servos no longer answered"
    else:
        kind, sentence = "late", "the servos answered late"
    return StopCause(kind, "arm", sentence, (*evidence, *_logged_evidence(case, code, t)))


def _line(case: RunCase, code: str, t: float) -> StopCause:
    """As `_link` for a controller's serial line."""
    evidence = [_arm_age(case, t, "arm's last answer", "link")]
    excess = ends = 0.0
    for (read, whole, wrong, unframed), between in _counted(case, _LINE, t - 0.25, t, t + 1.0):
        counts = f"received {read:.0f} bytes, {whole:.0f} complete lines, {wrong:.0f} with a wrong checksum"
        evidence.append(Clue("palm/loop", f"{counts}, {unframed:.0f} without any {between}"))
        ends += wrong + unframed
        excess = max(excess, read - LINE_BYTES * whole)
    if _finding(case, code, t) != "unreadable" and excess <= LINE_BYTES and ends <= 1.0:
        kind, sentence = "mute", "the arm's controller sent no more data"
    elif ends > 1.0 and excess < FOREIGN_LINE_RATIO * LINE_BYTES * ends:  # line ends at the expected rate
        kind, sentence = "damaged", "the data from the arm's controller were damaged: hardly any line was complete"
    else:
        kind = "foreign"
        sentence = "the data on the arm's line were not answers: another device, or another baud rate"
    return StopCause(kind, "arm", sentence, (*evidence, *_logged_evidence(case, code, t)))


def _arm_age(case: RunCase, t: float, what: str, lost: str) -> Clue:
    age_ms = _oldest_ms(case, "arm_age_ms", t)
    text = f"the {what} was {age_ms:.0f} ms old; after 250 ms the {lost} counts as lost"
    return Clue(case.topics.contact.name, text)


def _counted(case: RunCase, names: Sequence[str], *times: float) -> Iterator[tuple[tuple[float, ...], str]]:
    """Growth of counters of `palm/loop` in each second around one of the times, and that second as text."""
    seconds = {growth[0]: growth for t in times if (growth := case.timeline.counter_growth(t, *names))}
    for begin, end, grown in seconds.values():
        yield tuple(grown[name] for name in names), f"between {case.rel(begin)} and {case.rel(end)}"


def _lifted(case: RunCase, code: str, t: float) -> StopCause:
    end = code.removesuffix("-lifted")
    number = int(end[-1])
    lifts = {
        pad: [true for _, true in ends if abs(true - t) < BEFORE_FAULT_S] for pad, ends in case.closeup.lifts.items()
    }
    here = min(lifts.get(number, [t]), key=lambda when: abs(when - t))
    others = [pad for pad, times in lifts.items() if pad != number and any(abs(w - here) < TOGETHER_S for w in times)]
    evidence = [
        Clue(case.topics.events.name, f"pad {pad} reported the end of contact at {case.rel(when)}")
        for pad, times in sorted(lifts.items()) for when in times[-1:]
    ]  # fmt: skip
    logged = [each for pad in sorted({number, *others}) for each in _logged_evidence(case, f"pad{pad}-lifted", t)]
    if others:
        which = "both pads" if case.pad_count == 2 else f"{1 + len(others)} of {case.pad_count} pads"
        return StopCause("lifted", "", f"the object left {which} at once: it was lifted off", (*evidence, *logged))
    sentence = f"the object left pad {number}, as reported by the in-use bit in the pad's first byte"
    return StopCause("lifted", end, sentence, (*evidence, *logged))


def _silent(case: RunCase, code: str, t: float) -> StopCause:
    """Cause of a silent pad: no data, or no valid packets."""
    end = code.removesuffix("-silent")
    evidence = [*_ages(case, int(end[-1]), t)]
    logged, finding = _logged_evidence(case, code, t), _finding(case, code, t)
    kind = getattr(case.config.pads, f"palm{end[-1]}").kind
    names = tuple(f"{end}_{name}" for name in pad_counter_names(kind) or ())
    lost = 0.0
    if finding == "foreign":  # the daemon has checked byte by byte
        sentence = f"the data on pad {end[-1]}'s line were not packets: another device, or another baud rate"
        return StopCause("foreign", end, sentence, (*evidence, *logged))
    for (read, packets, discarded), between in _counted(case, names, t, t + 1.0) if names else ():
        counts = f"received {read:.0f} bytes, {packets:.0f} packets, {discarded:.0f} bytes outside packets {between}"
        evidence.append(Clue("palm/loop", counts))
        lost = max(lost, discarded)
    if finding == "mute" or (not finding and lost < DISCARDED_BYTES):
        return StopCause("mute", end, f"pad {end[-1]} sent no more data", (*evidence, *logged))
    if case.timeline.fault_duration(code, t) >= FOREIGN_DATA_S:
        sentence = f"the data on pad {end[-1]}'s line were not packets: another device, or another baud rate"
        return StopCause("foreign", end, sentence, (*evidence, *logged))
    sentence = f"the data from pad {end[-1]} were damaged, so that five consecutive packets were missing"
    return StopCause("damaged", end, sentence, (*evidence, *logged))


def _ages(case: RunCase, pad: int, t: float) -> tuple[Clue, ...]:
    """Evidence: the age of the pad's last reading at `t`, and the limit."""
    before = [true for fed, true in case.closeup.readings.get(pad, []) if fed <= t]
    if len(before) < SILENT_INTERVALS:
        return ()
    mean_ms = fmean(b - a for a, b in pairwise(before[-20:])) * 1e3
    text = (
        f"pad {pad}'s last reading was at {case.rel(before[-1])}, {(t - before[-1]) * 1e3:.0f} ms before; "
        f"readings had come every {mean_ms:.0f} ms, and the limit is {SILENT_INTERVALS} intervals"
    )
    return (Clue(case.topics.events.name, text),)


def _oldest_ms(case: RunCase, name: str, t: float) -> float:
    ages = [float(fields[name]) for when, fields in case.closeup.contact if t - BEFORE_FAULT_S < when <= t + 0.02]
    return max((age for age in ages if math.isfinite(age)), default=math.nan)


# ------------------------------------------------------------------------------------------------ without a fault


def of_no_fault(case: RunCase, before: StateChange, now: StateChange) -> StopCause:
    """The cause of a change of state to `now` without an acting fault: a command, the end of palmd, or a lost rig."""
    entry = case.logged("state", now.state, now.t)
    evidence = () if entry is None else (Clue("palm/log", entry.text),)
    stopping = case.logged("palmd", "stopping", now.t)
    if stopping is not None:
        return StopCause("ended", "", "palmd was shut down and stopped the arm", (Clue("palm/log", stopping.text),))
    if entry is not None and entry.who:
        return StopCause("command", "", f"{entry.text.split(': ')[-1]}: requested by a client", evidence)
    if now.state == "idle":
        return StopCause("rig-gone", "", "a port or the arm's link was lost while the arm was not commanded", evidence)
    command = {"hold": "hold", "ready": "stop"}.get(now.state, "command")
    sentence = f"no fault acted: a client sent the command {command}" + (
        ", or palmd was shut down" * (command == "stop")
    )
    text = f"{before.state} -> {now.state} at {case.rel(now.t)}, without a fault that holds or stops"
    return StopCause("command", "", sentence, (*evidence, Clue("palm/state", text)))


def of_damage(description: str, begin: str, end: str) -> StopCause:
    """The cause is unknown because the file is damaged between the two times."""
    sentence = f"unknown what happened between {begin} and {end}: the file is damaged there"
    return StopCause("damaged-file", "", sentence, (Clue("the file", description),))


def of_end(case: RunCase, *, being_written: bool = False) -> StopCause:
    """The cause of a recording that ends during motion: the daemon or its recorder ended or crashed."""
    timeline, last = case.timeline, case.timeline.end
    motion: Fields = case.closeup.last_motion(math.inf)
    evidence = [
        Clue(case.topics.motion.name, f"the last message, at {case.rel(last)}, is in the middle of "
                                f"{motion.get('plan') or 'no plan'}, the arm in state {motion.get('arm_state')}")
    ]  # fmt: skip
    if any(entry.name == "stopping" for entry in timeline.log[-3:]):
        return StopCause("ended", "", "palmd was shut down", tuple(evidence))
    if timeline.ending == REQUESTED:
        evidence.append(Clue("the file", "its recorder finished it because it was stopped"))
        return StopCause("recorder-ended", "", "the recorder was stopped; palmd continued", tuple(evidence))
    if timeline.complete:
        evidence.append(Clue("the file", _ENDINGS.get(timeline.ending, _ENDINGS[DAEMON_SILENT])))
        unless = "" if timeline.ending else ", unless only its recorder was stopped"
        sentence = (
            f"the daemon's messages end without a shutdown: it was killed or it crashed{unless}; "
            "without set-points the arm's controller holds after 48 ms and latches error -600 "
            f"after {CONTROLLER_WATCHDOG_MS} ms"
        )
        return StopCause("died", "", sentence, tuple(evidence))
    evidence.append(Clue("the file", "it was not finished"))
    sentence = (
        "the recording breaks off without a hold or stop: its recorder was killed or could not write, or the machine "
        "went down; what palmd did afterwards is not recorded"
    ) + ("; or it is still being written, as it was a moment ago" if being_written else "")
    return StopCause("cut", "", sentence, tuple(evidence))


def of_continuation(case: RunCase, later: str, log: Sequence[LogEntry]) -> StopCause:
    """The cause of a recording that ends during motion and is continued by the recording `later` with the given log."""
    failures = [entry for entry in log if entry.name in ("recorder-failed", "recorder-silent") and not entry.who]
    evidence = tuple(
        Clue("palm/log", f"at {case.rel(entry.t_s)} {entry.line}")
        for entry in failures if -BEFORE_FAULT_S < entry.t_s - case.timeline.end < SUCCESSOR_S
    )  # fmt: skip
    if evidence:
        sentence = f"the recorder could not write any more; palmd continued, and {later} continues this recording"
        return StopCause("cut", "", sentence, evidence)
    return StopCause("goes-on", "", f"no hold or stop: {later} continues this recording, analyse that one")


def _moves(case: RunCase, t: float) -> bool:
    """Whether the commanded position changed within the last quarter of a second."""
    commanded = [
        tuple(fields[name] for name in case.commanded)
        for when, fields in case.closeup.motion if t - 0.25 < when <= t
    ]  # fmt: skip
    return len(set(commanded)) > 1


def of_tracking(case: RunCase, faults: Mapping[str, str], t: float) -> StopCause:
    """What the palms did at `t` in state tracking, with recent `faults`: moved, paused for the arm, or had no plan."""
    active = tuple(
        Clue("palm/state", f"{code} ({severity}) was active; it does not hold") for code, severity in faults.items()
    )
    late = next((code for code in ("arm-late", "arm-held") if code in faults), None)
    stall = _stall(case, t, PAUSE_S) if "loop-overrun" in faults else None
    age_ms = _oldest_ms(case, "arm_age_ms", t)
    if stall is not None and (late is None or age_ms < (stall.end - stall.begin + 0.06) * 1e3):
        return stall.cause
    if late is not None:
        age = Clue(
            case.topics.contact.name, f"the arm's last answer was {age_ms:.0f} ms old; after 80 ms the motion pauses"
        )
        sentence = "the motion paused and resumed automatically: the arm's answers were late"
        return StopCause("late", "arm", sentence, (age, *_logged_evidence(case, late, t)))
    motion = case.closeup.last_motion(t)
    if motion and not _moves(case, t):
        finished = [entry for entry in case.timeline.log if entry.kind == "plan" and entry.t_s <= t]
        started = [entry for entry in case.timeline.log if entry.name == "start" and entry.t_s <= t]
        if finished and (not started or finished[-1].number > started[-1].number):
            when = Clue("palm/log", f"at {case.rel(finished[-1].t_s)}")
            return StopCause("over", "", finished[-1].text, (when, *active))
        if motion["segment"] < 0 or motion["progress"] >= 1.0:
            return StopCause("idle", "", "the palms rest because no plan is running: finished, or not started", active)
    doing = (
        f"palmd was tracking, in segment {motion['segment']} of {motion['plan']}" if motion else "palmd was tracking"
    )
    logged = tuple(each for code in faults for each in _logged_evidence(case, code, t + BEFORE_FAULT_S))
    steps = tuple(
        Clue("timestamps", f"the wall clock was set by {by:+.0f} s at {case.rel(when)}; the loop does not use it")
        for when, by in case.timeline.clock_steps if abs(when - t) < 5.0
    )  # fmt: skip
    return StopCause("nothing", "", f"no hold or stop: {doing}", (*active, *logged, *steps))
