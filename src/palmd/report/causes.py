"""What made it hold or stop, from a run's course and the ticks around: a cause with its evidence. Pure.

A fault says what was noticed; the cause is what lies behind it: a pad that is silent may be mute, speak another
language, or have been kept waiting by palmd itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import fmean
from typing import Any, Literal

from palmd.devices.pad import SILENT_INTERVALS, pad_counted
from palmd.faults import TABLE
from palmd.messages import Fields, LogEntry
from palmd.quantities import SystemTopics
from palmd.record import DAEMON_RESTARTED, DAEMON_SILENT, PARENT_GONE, REQUESTED
from palmd.report.course import Closeup, Course, StateChange

CauseKind = Literal[
    "port", "mute", "foreign", "damaged", "lifted", "stalled", "watchdog", "break", "estop", "power-off", "manual",
    "uncalibrated", "controller", "servo", "left", "late", "failed", "not-finite", "limits", "overruns", "command",
    "ended", "rig-gone", "rig-stalled", "fault", "before", "died", "cut", "goes-on", "over", "idle", "nothing",
    "damaged-file", "recorder-ended",
    "not-followed", "implausible", "contradicts", "pressed",
]  # fmt: skip

STALL_S = 0.1
"""Ticks that are so far apart make pads look silent, and the controller (48 ms) go without set-points."""

RIG_STALL_S = 0.04
"""And so long without a word of an emulated rig make it look silent, or its controller go without set-points."""

PAUSE_S = 0.04
"""And ticks so far apart make the controller hold for a moment."""

STALLED_BEFORE_S, STALL_READING_S = 0.1, 0.03
NEAR_S, SOON_S = 0.6, 0.05
BREAK_S = 15.0  # after its end, within which the next recording tells what was wrong
"""A cause is looked for so long before its effect."""

ARM_QUIET_S = 0.1  # without an answer: six of its cycles
LINE_BYTES = 30  # of an answer of the arm, its line end included
ALIEN_LINES = 3.0  # of what is none of ours, a line end is so much rarer
_LINE = ("arm_port_bytes_read", "arm_lines", "arm_crc_errors", "arm_unframed")
_BUS = ("arm_bytes", "arm_packets", "arm_crc_errors", "arm_discarded")
DAMAGED_SHARE, FOREIGN_SHARE = 0.05, 0.5  # of a bus's bytes that are in no packet
SPOKE_BYTES, SPOKE_LINE_BYTES = 8, 31  # fewer may be the rest of a packet, or of a line
DISCARDED_BYTES = 24  # of a second, in which a few may be lost at any time
BABBLE_S = 0.2  # of bytes without a packet: somebody else speaks
COMMANDED = "_cmd_"
TOGETHER_S = 0.15  # both pads left within so long: the object was lifted
CONTROLLER_WATCHDOG_MS, SETPOINT_MS = 160, 16

_STATES: dict[str, tuple[CauseKind, str]] = {
    "arm-estop": ("estop", "the arm's emergency stop was pressed"),
    "arm-power-off": ("power-off", "arm power went off"),
    "arm-manual": ("manual", "somebody took the arm: its controller went to manual mode"),
    "arm-uncalibrated": ("uncalibrated", "the arm's controller lost its calibration"),
    "arm-left-tracking": ("left", "the arm's controller stopped following by itself"),
}
_ENDINGS = {
    DAEMON_SILENT: "it was finished by its recorder, which heard nothing more of the daemon",
    DAEMON_RESTARTED: "it was finished by its recorder when it heard that another daemon had begun",
    PARENT_GONE: "it was finished by its recorder, which the daemon had started, when the daemon was gone",
}
_OWN: dict[str, tuple[CauseKind, str]] = {
    "tick-error": ("failed", "palmd itself failed: an unexpected error in its control loop"),
    "estimate-not-finite": ("not-finite", "palmd's observer called an estimate valid that was not finite"),
    "limits-violated": ("limits", "the palms were outside their limits, or the motion wanted to leave them"),
    "following-error": ("not-followed", "the arm did not follow its set-points: it was blocked, or its encoder fails"),
    "pose-implausible": ("implausible", "the arm reported a pose that cannot be"),
    "pose-contradicts-rig": ("contradicts", "the arm's pose cannot be one of the rig as configured"),
    "force-limit": ("pressed", "something pressed on a pad harder than it may, or than the pad can tell"),
    "force-excess": ("pressed", "something pressed on a pad with more than 1.5 times what it may"),
    "loop-overruns": ("overruns", "palmd's control loop kept missing its deadline"),
}


@dataclass(frozen=True, slots=True)
class Clue:
    """One thing that speaks for a cause, and the topic of the recording that it stands in."""

    where: str
    what: str


@dataclass(frozen=True, slots=True)
class StopCause:
    """What lies behind: its kind, whose it is (`pad1`, `arm`, or empty), one sentence, and what speaks for it."""

    kind: CauseKind
    end: str
    sentence: str
    evidence: tuple[Clue, ...] = ()

    @property
    def name(self) -> str:
        """CauseKind and whose, in one word."""
        return f"{self.end}-{self.kind}" if self.end else self.kind


@dataclass(frozen=True, slots=True)
class RunCase:
    """All there is to judge by: the run's course, the ticks around, the configuration, its system's topics."""

    course: Course
    closeup: Closeup
    config: Any
    topics: SystemTopics

    @property
    def commanded(self) -> tuple[str, ...]:
        """The fields of the motion that tell what is commanded."""
        return tuple(each.name for each in self.topics.motion.quantities if COMMANDED in each.name)

    @property
    def pads(self) -> int:
        """How many there are."""
        return sum(each.name.startswith("touch") for each in self.topics.contact.quantities)

    def places(self, motion: Fields) -> str:
        """Where the joints or axes stand, as people are told it."""
        names = (each.replace(COMMANDED, "_") for each in self.commanded)
        return ", ".join(
            f"{name.removesuffix('_rad')} {math.degrees(motion[name]):.1f}°"
            if name.endswith("_rad") else f"{name.removesuffix('_m')} {motion[name] * 1e3:.1f} mm"
            for name in names
        )  # fmt: skip

    def rel(self, t: float) -> str:
        """A time as people are told it."""
        return f"{t - self.course.begin:.2f} s"

    def logged(self, kind: str, name: str, t: float) -> LogEntry | None:
        """The log's entry of that kind and name nearest before `t`, as it came; None where there is none."""
        each = (entry for entry in reversed(self.course.log) if entry.kind == kind and entry.name == name)
        return next(
            (entry for entry in each if math.isnan(entry.lasted_s) and t - NEAR_S < entry.t_s <= t + SOON_S), None
        )


# ---------------------------------------------------------------------------------------------------- of a fault


def of_fault(case: RunCase, codes: Sequence[str], t: float) -> StopCause:
    """What lies behind the faults that came up at `t` and act; the first that explains them, with its evidence."""
    stall = _stall(case, t, STALL_S)
    if stall is not None and all(_by_stall(case, code, stall, t) for code in codes):
        return stall.cause
    rig = _rig_stall(case, t)
    if rig is not None and all(_by_rig_stall(code) for code in codes):
        return rig
    order: tuple[tuple[Callable[[str], bool], Callable[[RunCase, str, float], StopCause]], ...] = (
        (lambda code: code in _OWN, _own),
        (lambda code: code.endswith("-port"), _port),
        (lambda code: code in _STATES and code != "arm-left-tracking", _arm_state),
        (lambda code: code.startswith("arm-servo-"), _servo),
        (lambda code: code == "arm-fault", _controller),
        (lambda code: code == "arm-link-lost", _link),
        (lambda code: code.endswith("-lifted"), _lifted),
        (lambda code: code.endswith("-silent"), _silent),
        (lambda code: code in _STATES, _arm_state),
    )
    for fits, told in order:
        for code in codes:
            if fits(code):
                return told(case, code, t)
    code = codes[0]
    return StopCause("fault", "", TABLE[code].text if code in TABLE else code, _said(case, code, t))


def _said(case: RunCase, code: str, t: float) -> tuple[Clue, ...]:
    """What the daemon itself gave as its evidence."""
    entry = case.logged("fault", code, t)
    return () if entry is None else (Clue("palm/log", f"{code}: {entry.text}"),)


@dataclass(frozen=True, slots=True)
class _Stall:
    begin: float
    end: float
    cause: StopCause


def _by_stall(case: RunCase, code: str, stall: _Stall, t: float) -> bool:
    """Whether a loop that stood still explains a fault: what it says was not so before."""
    if code.endswith("-silent"):
        before = [true for fed, true in case.closeup.readings.get(int(code[3]), []) if fed <= t]
        return bool(before) and before[-1] > stall.begin - STALL_READING_S
    if code == "arm-fault":
        entry = case.logged("fault", code, t)
        return entry is None or "-0600" in entry.text or "error" not in entry.text
    return code in ("arm-link-lost", "arm-left-tracking", "arm-servo-watchdog", "loop-overruns")


def _stall(case: RunCase, t: float, least_s: float) -> _Stall | None:
    """Whether palmd's own loop stood still just before `t`: a long step between ticks none of which is missing."""
    ticks = case.closeup.motion
    numbered = zip(pairwise(ticks), pairwise(case.closeup.numbers), strict=True)
    for ((t0, _), (t1, _)), (number0, number1) in numbered:
        if t1 - t0 >= least_s and t - STALLED_BEFORE_S < t1 <= t + 0.02 and number1 == number0 + 1:
            said = (
                f"ticks {number0} and {number1} are {(t1 - t0) * 1e3:.0f} ms apart, at {case.rel(t0)} and "
                f"{case.rel(t1)}; the period is {1e3 / case.config.loop.rate_hz:.0f} ms"
            )
            sentence = (
                f"palmd itself stood still for {(t1 - t0) * 1e3:.0f} ms: it got no processor, so no set-point went "
                "out and nothing was read"
            )
            evidence = (Clue(case.topics.motion.name, said), *_said(case, "loop-overrun", t1))
            return _Stall(t0, t1, StopCause("stalled", "", sentence, evidence))
    return None


def _rig_stall(case: RunCase, t: float) -> StopCause | None:
    """Whether an emulated rig stood still just before `t`, as it says itself."""
    near = [(end, lasted) for end, lasted in case.closeup.rig_stalls if end - lasted < t < end + NEAR_S]
    if not near:
        return None
    end, lasted = max(near, key=lambda each: each[1])
    if lasted < RIG_STALL_S:
        return None
    sentence = (
        f"the emulated rig itself stood still for {lasted * 1e3:.0f} ms: it got no processor, so nothing came from "
        "pads and arm, which a real rig would not do"
    )
    said = f"it went on at {case.rel(end)} after {lasted * 1e3:.0f} ms, by its own clock"
    return StopCause("rig-stalled", "", sentence, (Clue("rig/stall", said),))


def _by_rig_stall(code: str) -> bool:
    """Whether an emulated rig that stood still explains a fault."""
    return code.endswith("-silent") or code in ("arm-fault", "arm-link-lost", "arm-left-tracking", "arm-servo-watchdog")


def _own(case: RunCase, code: str, t: float) -> StopCause:
    kind, sentence = _OWN[code]
    evidence = [*_said(case, code, t)]
    motion = case.closeup.last_motion(t)
    if code == "limits-violated" and motion:
        evidence.append(Clue(case.topics.motion.name, f"the palms stood at {case.places(motion)}"))
    return StopCause(kind, "", sentence, tuple(evidence or [Clue("palm/state", f"{code} stood from {case.rel(t)}")]))


def _port(case: RunCase, code: str, t: float) -> StopCause:
    end = code.removesuffix("-port")
    evidence = [*_said(case, code, t)]
    gained = case.course.gained(t, f"{end}_port_losses")
    if gained is not None and gained[2][f"{end}_port_losses"]:
        evidence.append(Clue("palm/loop", f"{end}_port_losses grew {_between(case, gained)}"))
    device = (case.config.arm if end == "arm" else getattr(case.config.pads, f"palm{end[-1]}")).port
    sentence = f"the serial port of {_named(end)} was gone: {device} could not be read any more"
    return StopCause("port", end, sentence, (*evidence, Clue("palm/state", f"{code} from {case.rel(t)} on")))


def _arm_state(case: RunCase, code: str, t: float) -> StopCause:
    kind, sentence = _STATES[code]
    return StopCause(kind, "arm", sentence, (*_letter(case, t), *_said(case, code, t)))


def _letter(case: RunCase, t: float) -> tuple[Clue, ...]:
    """When the controller's state letter changed last, up to `t`."""
    letters = [(when, fields["arm_state"]) for when, fields in case.closeup.motion if when <= t + 0.02]
    for (_, before), (when, now) in reversed([*pairwise(letters)]):
        if before != now:
            said = f"the controller's state letter went from {before or 'unknown'} to {now or 'unknown'}"
            return (Clue(case.topics.motion.name, f"{said} at {case.rel(when)}"),)
    return ()


def _controller(case: RunCase, code: str, t: float) -> StopCause:
    """The controller has latched a fault: by its own code, or by how long the line was dead before."""
    entry = case.logged("fault", code, t)
    said = "" if entry is None else entry.text
    evidence = (*_letter(case, t), *_said(case, code, t))
    if "-0504" in said:
        return StopCause(
            "break", "arm", "there was a break on the arm's line: its controller latched error -504", evidence
        )
    line = _link(case, code, t)
    if line.kind in ("damaged", "foreign"):
        return line
    silent_ms = _oldest(case, "arm_age_ms", t)
    if silent_ms >= ARM_QUIET_S * 1e3 or "-0600" in said:
        quiet = Clue(case.topics.contact.name, f"the arm's last answer was up to {silent_ms:.0f} ms old before that")
        sentence = (
            f"the arm's controller had no set-point for {CONTROLLER_WATCHDOG_MS} ms, stopped and latched error -600: "
            f"the line was dead, while palmd sent one every {SETPOINT_MS} ms"
        )
        return StopCause("watchdog", "arm", sentence, (quiet, *evidence))
    if said:
        return StopCause("controller", "arm", "the arm's controller latched a fault of its own", evidence)
    return StopCause(
        "controller",
        "arm",
        "the arm's controller latched a fault while the line was alive: a break, or its own",
        evidence,
    )


def _servo(case: RunCase, code: str, t: float) -> StopCause:
    """A servo says itself what is wrong with it, or has heard nothing for so long that it stopped."""
    said = _said(case, code, t)
    if code != "arm-servo-watchdog":
        sentence = f"{TABLE[code].text}: the servo says so itself"
        return StopCause("servo", "arm", sentence, said or (Clue("palm/state", f"{code} from {case.rel(t)} on"),))
    line = _bus(case, code, t)
    if line.kind != "late":
        return line
    sentence = f"{TABLE[code].text}, while palmd sent it one every cycle: the adapter or the line held them back"
    return StopCause("watchdog", "arm", sentence, line.evidence)


def _link(case: RunCase, code: str, t: float) -> StopCause:
    """The arm does not answer: nothing comes, or nothing that can be read."""
    return (_bus if case.config.arm.kind == "dynamixel" else _line)(case, code, t)


def _bus(case: RunCase, code: str, t: float) -> StopCause:
    """The same of a bus of servos, whose packets begin with a mark: what comes is theirs, or has none."""
    age_ms = _oldest(case, "arm_age_ms", t)
    evidence = [
        Clue(
            case.topics.contact.name,
            f"the servos had answered last {age_ms:.0f} ms before; after 250 ms the bus counts as lost",
        )
    ]
    came = spoilt = marked = 0.0
    for gained in {g[0]: g for at in (t - 0.25, t, t + 1.0) if (g := case.course.gained(at, *_BUS))}.values():
        read, packets, wrong, discarded = (gained[2][name] for name in _BUS)
        told = f"{read:.0f} bytes came, {packets:.0f} whole packets, {wrong:.0f} of a wrong checksum"
        evidence.append(Clue("palm/loop", f"{told}, {discarded:.0f} bytes in none {_between(case, gained)}"))
        came, spoilt, marked = came + read, spoilt + discarded, marked + wrong
    proof = (*evidence, *_said(case, code, t))
    if not came:
        return StopCause("mute", "arm", "nothing came from the servos any more", proof)
    if spoilt > FOREIGN_SHARE * came and not marked:
        sentence = "what came from the servos' line was no answer: another device, or another baud rate"
        return StopCause("foreign", "arm", sentence, proof)
    if spoilt > DAMAGED_SHARE * came:
        return StopCause("damaged", "arm", "much of what came from the servos was damaged", proof)
    if code == "arm-link-lost":
        return StopCause("mute", "arm", "not all servos answered any more", proof)
    return StopCause("late", "arm", "the servos answered late", proof)


def _line(case: RunCase, code: str, t: float) -> StopCause:
    """The same of a controller's line."""
    age_ms = _oldest(case, "arm_age_ms", t)
    evidence = [
        Clue(
            case.topics.contact.name,
            f"the arm's last answer was {age_ms:.0f} ms old; after 250 ms the link counts as lost",
        )
    ]
    windows = {gained[0]: gained for at in (t - 0.25, t, t + 1.0) if (gained := case.course.gained(at, *_LINE))}
    excess = ends = 0.0
    for gained in windows.values():
        read, whole, wrong, alien = (gained[2][name] for name in _LINE)
        told = (
            f"{read:.0f} bytes came, {whole:.0f} whole lines, {wrong:.0f} of a wrong checksum, {alien:.0f} without any"
        )
        evidence.append(Clue("palm/loop", f"{told} {_between(case, gained)}"))
        ends += wrong + alien
        excess = max(excess, read - LINE_BYTES * whole)
    said = _said(case, code, t)
    if _bytes_since(said) < SPOKE_LINE_BYTES and excess <= LINE_BYTES and ends <= 1.0:
        return StopCause("mute", "arm", "nothing came from the arm's controller any more", (*evidence, *said))
    if ends > 1.0 and excess < ALIEN_LINES * LINE_BYTES * ends:  # lines end where they should
        sentence = "what came from the arm's controller was damaged: its lines came, and hardly one of them whole"
        return StopCause("damaged", "arm", sentence, (*evidence, *said))
    sentence = "what came from the arm's line was no answer: another device, or another baud rate"
    return StopCause("foreign", "arm", sentence, (*evidence, *said))


def _lifted(case: RunCase, code: str, t: float) -> StopCause:
    end = code.removesuffix("-lifted")
    number = int(end[-1])
    lifts = {pad: [true for _, true in told if abs(true - t) < NEAR_S] for pad, told in case.closeup.lifts.items()}
    here = min(lifts.get(number, [t]), key=lambda when: abs(when - t))
    others = [pad for pad, times in lifts.items() if pad != number and any(abs(w - here) < TOGETHER_S for w in times)]
    evidence = [
        Clue(case.topics.events.name, f"pad {pad} told the end of its contact at {case.rel(when)}")
        for pad, times in sorted(lifts.items()) for when in times[-1:]
    ]  # fmt: skip
    said = [each for pad in sorted({number, *others}) for each in _said(case, f"pad{pad}-lifted", t)]
    if others:
        which = "both pads" if case.pads == 2 else f"{1 + len(others)} of {case.pads} pads"
        return StopCause("lifted", "", f"the object left {which} at once: it was lifted off", (*evidence, *said))
    sentence = f"the object left pad {number}: the pad said so itself, by the bit for in use of its first byte"
    return StopCause("lifted", end, sentence, (*evidence, *said))


def _silent(case: RunCase, code: str, t: float) -> StopCause:
    """A pad says nothing, or nothing that is a packet."""
    end = code.removesuffix("-silent")
    evidence = [*_ages(case, int(end[-1]), t)]
    said = _said(case, code, t)
    kind = getattr(case.config.pads, f"palm{end[-1]}").kind
    names = tuple(f"{end}_{name}" for name in pad_counted(kind) or ())
    lost = 0.0
    if any("not even a damaged one's" in each.what for each in said):  # the daemon has judged byte by byte
        sentence = f"what came from pad {end[-1]}'s line was no packet: another device, or another baud rate"
        return StopCause("foreign", end, sentence, (*evidence, *said))
    for at in (t, t + 1.0) if names else ():
        gained = case.course.gained(at, *names)
        if gained is None:
            continue
        came, packets, discarded = (gained[2][name] for name in names)
        told = f"{came:.0f} bytes came, {packets:.0f} packets, {discarded:.0f} bytes in none {_between(case, gained)}"
        evidence.append(Clue("palm/loop", told))
        lost = max(lost, discarded)
    if _bytes_since(said) < SPOKE_BYTES if said else lost < DISCARDED_BYTES:
        return StopCause("mute", end, f"nothing came from pad {end[-1]} any more", (*evidence, *said))
    if case.course.stood(code, t) >= BABBLE_S:
        sentence = f"what came from pad {end[-1]}'s line was no packet: another device, or another baud rate"
        return StopCause("foreign", end, sentence, (*evidence, *said))
    sentence = f"so much of what pad {end[-1]} said was damaged that five packets in a row were missing"
    return StopCause("damaged", end, sentence, (*evidence, *said))


def _ages(case: RunCase, pad: int, t: float) -> tuple[Clue, ...]:
    """How old the pad's last reading was at `t`, and how old it might be."""
    before = [true for fed, true in case.closeup.readings.get(pad, []) if fed <= t]
    if len(before) < SILENT_INTERVALS:
        return ()
    mean_ms = fmean(b - a for a, b in pairwise(before[-20:])) * 1e3
    told = (
        f"pad {pad}'s last reading was at {case.rel(before[-1])}, {(t - before[-1]) * 1e3:.0f} ms before; "
        f"they had come every {mean_ms:.0f} ms, and the limit is {SILENT_INTERVALS} intervals"
    )
    return (Clue(case.topics.events.name, told),)


def _oldest(case: RunCase, name: str, t: float) -> float:
    ages = [float(fields[name]) for when, fields in case.closeup.contact if t - NEAR_S < when <= t + 0.02]
    return max((age for age in ages if math.isfinite(age)), default=math.nan)


def _bytes_since(said: Sequence[Clue]) -> int:
    """How many bytes, and no whole line, the daemon says have come since the last good packet or answer."""
    for each in said:
        if "whole lines" in each.what and "with 0 whole lines" not in each.what:
            return 0
        words = each.what.split(" bytes have come since")[0].split()
        if " bytes have come since" in each.what and words[-1].isdigit():
            return int(words[-1])
    return 0


def _between(case: RunCase, gained: tuple[float, float, object]) -> str:
    return f"between {case.rel(gained[0])} and {case.rel(gained[1])}"


def _named(end: str) -> str:
    return "the arm" if end == "arm" else f"pad {end[-1]}"


# ------------------------------------------------------------------------------------------------ without a fault


def of_no_fault(case: RunCase, before: StateChange, now: StateChange) -> StopCause:
    """What changed the state at `now` though no fault acts: a command, the end of palmd, the rig that went."""
    entry = case.logged("state", now.state, now.t)
    evidence = () if entry is None else (Clue("palm/log", entry.text),)
    stopping = case.logged("palmd", "stopping", now.t)
    if stopping is not None:
        return StopCause("ended", "", "palmd was told to end, and stopped the arm", (Clue("palm/log", stopping.text),))
    if entry is not None and entry.who:
        return StopCause("command", "", f"{entry.text.split(': ')[-1]}: somebody wanted it so", evidence)
    if now.state == "idle":
        return StopCause("rig-gone", "", "a port or the arm's link was gone while the arm was not commanded", evidence)
    command = {"hold": "hold", "ready": "stop"}.get(now.state, "command")
    sentence = f"no fault acted: somebody gave the command {command}" + (", or palmd was ended" * (command == "stop"))
    said = f"{before.state} -> {now.state} at {case.rel(now.t)}, and no fault that holds or stops"
    return StopCause("command", "", sentence, (*evidence, Clue("palm/state", said)))


def of_damage(said: str, begin: str, end: str) -> StopCause:
    """What happened lies in a part of the file that cannot be read, between these times."""
    sentence = f"what happened between {begin} and {end} cannot be told: the file is damaged there"
    return StopCause("damaged-file", "", sentence, (Clue("the file", said),))


def of_end(case: RunCase, *, being_written: bool = False) -> StopCause:
    """The recording ends while the palms moved: the daemon has died, or its recorder."""
    course, last = case.course, case.course.end
    motion: Fields = case.closeup.last_motion(math.inf)
    evidence = [
        Clue(case.topics.motion.name, f"its last message, at {case.rel(last)}, is in the middle of "
                                f"{motion.get('plan') or 'no plan'}, the arm in state {motion.get('arm_state')}")
    ]  # fmt: skip
    if any(entry.name == "stopping" for entry in course.log[-3:]):
        return StopCause("ended", "", "palmd was told to end", tuple(evidence))
    if course.ending == REQUESTED:
        evidence.append(Clue("the file", "it was finished by its recorder, which was asked to end"))
        return StopCause("recorder-ended", "", "the recorder was told to end; palmd went on", tuple(evidence))
    if course.complete:
        evidence.append(Clue("the file", _ENDINGS.get(course.ending, _ENDINGS[DAEMON_SILENT])))
        unless = "" if course.ending else ", unless its recorder alone was told to end"
        sentence = (
            f"the daemon said nothing more, and no word of ending: it was killed or has crashed{unless}; "
            "without set-points the arm's controller holds after 48 ms and latches error -600 "
            f"after {CONTROLLER_WATCHDOG_MS} ms"
        )
        return StopCause("died", "", sentence, tuple(evidence))
    evidence.append(Clue("the file", "nobody has finished it"))
    sentence = (
        "the recording breaks off, and tells of nothing that held or stopped it: its recorder was killed or could not "
        "write, or the machine went; what palmd did after that is not in it"
    ) + ("; or it is still being written: it was a moment ago" if being_written else "")
    return StopCause("cut", "", sentence, tuple(evidence))


def of_break(case: RunCase, later: str, log: Sequence[LogEntry]) -> StopCause:
    """The recording ends while the palms moved, and another one, whose log is given, goes on from it."""
    missed = [entry for entry in log if entry.name in ("recorder-failed", "recorder-silent") and not entry.who]
    said = tuple(
        Clue("palm/log", f"at {case.rel(entry.t_s)} {entry.line}")
        for entry in missed if -NEAR_S < entry.t_s - case.course.end < BREAK_S
    )  # fmt: skip
    if said:
        sentence = f"the recorder could not go on writing; palmd did, and {later} goes on from here"
        return StopCause("cut", "", sentence, said)
    return StopCause("goes-on", "", f"nothing held or stopped it: {later} goes on from here, ask that one")


def _moves(case: RunCase, t: float) -> bool:
    """Whether the palms were told to be elsewhere within the last quarter of a second."""
    told = [
        tuple(fields[name] for name in case.commanded)
        for when, fields in case.closeup.motion if t - 0.25 < when <= t
    ]  # fmt: skip
    return len(set(told)) > 1


def of_tracking(case: RunCase, faults: Mapping[str, str], t: float) -> StopCause:
    """The state is tracking at `t`, with these faults of late: the palms move, pause for the arm, or have no plan."""
    standing = tuple(
        Clue("palm/state", f"{code} ({severity}) stood; it holds nothing") for code, severity in faults.items()
    )
    late = next((code for code in ("arm-late", "arm-held") if code in faults), None)
    stall = _stall(case, t, PAUSE_S) if "loop-overrun" in faults else None
    age_ms = _oldest(case, "arm_age_ms", t)
    if stall is not None and (late is None or age_ms < (stall.end - stall.begin + 0.06) * 1e3):
        return stall.cause
    if late is not None:
        age = Clue(
            case.topics.contact.name, f"the arm's last answer was {age_ms:.0f} ms old; after 80 ms the motion pauses"
        )
        sentence = "the motion paused, and went on by itself: the arm's answers came late"
        return StopCause("late", "arm", sentence, (age, *_said(case, late, t)))
    motion = case.closeup.last_motion(t)
    if motion and not _moves(case, t):
        over = [entry for entry in case.course.log if entry.kind == "plan" and entry.t_s <= t]
        started = [entry for entry in case.course.log if entry.name == "start" and entry.t_s <= t]
        if over and (not started or over[-1].number > started[-1].number):
            when = Clue("palm/log", f"at {case.rel(over[-1].t_s)}")
            return StopCause("over", "", over[-1].text, (when, *standing))
        if motion["segment"] < 0 or motion["progress"] >= 1.0:
            return StopCause("idle", "", "the palms stand because no plan is being run: over, or not started", standing)
    moves = (
        f"palmd was tracking, in segment {motion['segment']} of {motion['plan']}" if motion else "palmd was tracking"
    )
    logged = tuple(each for code in faults for each in _said(case, code, t + NEAR_S))
    steps = tuple(
        Clue("timestamps", f"the wall clock was set by {by:+.0f} s at {case.rel(when)}; nothing goes by it")
        for when, by in case.course.clock_steps if abs(when - t) < 5.0
    )  # fmt: skip
    return StopCause("nothing", "", f"nothing held or stopped it: {moves}", (*standing, *logged, *steps))
