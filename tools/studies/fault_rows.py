"""The fault campaign's table: what is done to rig and processes, and the expected reaction. Pure.

The expected severities are defined here independently of `palmd.faults`: a fault with another severity, or another
resulting state, is a deviation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from palmd.rig.fault_injection import PADS, PortName
from tools.studies.study_processes import InjectedFault

Process = Literal["daemon", "smoother", "recorder", "page"]
State = Literal["tracking", "ready", "hold", "fault"]

HOST_ALIVE_S = 0.060
HOST_DEAD_S = 0.200
"""Goals for the time from the cause to standstill of the arm, with the daemon alive and without it (s)."""

STOPPED_S = 0.5
"""The same if detection takes several reports or readings (s)."""


@dataclass(frozen=True, slots=True)
class Pause:
    """A process is stopped for so many seconds (SIGSTOP, SIGCONT)."""

    process: Process
    seconds: float


@dataclass(frozen=True, slots=True)
class Kill:
    """A process is killed (SIGKILL)."""

    process: Process


@dataclass(frozen=True, slots=True)
class FullDisk:
    """The recorder cannot write: its limit of file size (RLIMIT_FSIZE) is set to the present size of its file."""


@dataclass(frozen=True, slots=True)
class TakenAddress:
    """Another daemon is started on the addresses of this one."""


@dataclass(frozen=True, slots=True)
class WallClockStep:
    """The daemon's wall clock in Python is set by so many seconds; the machine's clock cannot be set here."""

    seconds: float


Act = InjectedFault | Pause | Kill | FullDisk | TakenAddress | WallClockStep


@dataclass(frozen=True, slots=True)
class FaultRow:
    """One cause and its expected effect: `faults` with these severities, and no others that stop motion except `may`.

    `why`: names of the causes that `palmd why` may answer from the recording alone. `goal_s`: goal for the time from
    the cause to standstill if the state is not tracking; infinite if an operator moves the arm.
    """

    name: str
    cause: str
    act: Act
    state: State
    why: tuple[str, ...]
    faults: tuple[tuple[str, str], ...] = ()
    may: tuple[str, ...] = ()
    goal_s: float = HOST_ALIVE_S

    @property
    def codes(self) -> frozenset[str]:
        """Codes of the expected faults."""
        return frozenset(code for code, _ in self.faults)


# fmt: off
def pad_rows(pad: PortName, damaged: tuple[str, float]) -> tuple[FaultRow, ...]:
    """Rows for a pad on a serial line; `damaged`: share of damaged bytes that it just tolerates, in words and number.
    """
    silent, garbled, port = f"{pad}-silent", f"{pad}-garbled", f"{pad}-port"
    late = (silent, f"{pad}-lifted")
    return (
        FaultRow(f"{pad}-dead", "its port disappears", InjectedFault("unplug", pad), "hold", (port,),
                 ((port, "hold"),)),
        FaultRow(f"{pad}-garbled", f"{damaged[0]} of its bytes are damaged", InjectedFault("garble", pad, damaged[1]),
                 "tracking", ("nothing", f"{pad}-damaged"), ((garbled, "degrade"),), late),
        FaultRow(f"{pad}-late", "its data arrive 200 ms late", InjectedFault("late", pad, 0.2), "hold",
                 (f"{pad}-mute",), ((silent, "hold"),)),
        FaultRow(f"{pad}-mute", "it falls silent", InjectedFault("mute", pad), "hold", (f"{pad}-mute",),
                 ((silent, "hold"),)),
        FaultRow(f"{pad}-replaced", "its port comes back under another number",
                 InjectedFault("unplug", pad, for_s=0.5), "hold", (port,), ((port, "hold"),),
                 (silent,)),  # from the opening to the first packet
        FaultRow(f"{pad}-foreign", "another device speaks at its port", InjectedFault("misbaud", pad), "hold",
                 (f"{pad}-foreign",), ((silent, "hold"), (garbled, "degrade"))),
    )


ARM_LOST = ("arm-link-lost", "stop")


def arm_port_rows(
    port: str, mute: str, foreign: tuple[str, str], own: tuple[str, ...], goal_s: float = HOST_ALIVE_S
) -> tuple[FaultRow, FaultRow, FaultRow, FaultRow]:
    """Rows for the arm's line: dead, mute, replaced, foreign.

    port, mute: what disappears and what falls silent, in words. foreign: the other device in words, and the answer of
    `palmd why`. own: faults that the arm may report once it is connected again.
    """
    gone, lost = ("arm-port",), ("arm-link-lost", *own)
    stop = (("arm-port", "stop"),)
    back = InjectedFault("unplug", "arm", for_s=0.5)
    late = (("arm-late", "degrade"), ARM_LOST)
    return (
        FaultRow("arm-dead", f"{port} disappears", InjectedFault("unplug", "arm"), "fault", gone, stop, lost, goal_s),
        FaultRow("arm-mute", mute, InjectedFault("mute", "arm"), "fault", ("arm-mute",), late, own, goal_s),
        FaultRow("arm-replaced", f"{port} comes back under another number", back, "fault", gone, stop, lost, goal_s),
        FaultRow("arm-foreign", foreign[0], InjectedFault("misbaud", "arm"), "fault", (foreign[1],), (ARM_LOST,), own,
                 goal_s),
    )


_ARM_DEAD, _ARM_MUTE, _ARM_REPLACED, _ARM_FOREIGN = arm_port_rows(
    "its port", "it falls silent", ("another device speaks at its port", "arm-foreign"), ("arm-fault",)
)

ROWS: tuple[FaultRow, ...] = (
    *(row for pad in PADS for row in pad_rows(pad, ("a fifth", 0.2))),
    FaultRow("object-lifted", "the object is lifted off", InjectedFault("lift"), "hold", ("lifted",),
             (("pad1-lifted", "hold"), ("pad2-lifted", "hold"))),
    FaultRow("arm-blocked", "something holds the arm for 2 s", InjectedFault("block", "arm", for_s=2.0), "fault",
             ("not-followed",), (("following-error", "stop"),), goal_s=STOPPED_S),
    FaultRow("arm-frozen", "the arm reports the same pose all the time", InjectedFault("freeze", "arm", for_s=2.0),
             "fault", ("not-followed",), (("following-error", "stop"),), goal_s=STOPPED_S),
    FaultRow("arm-jump", "the pose that the arm reports jumps by 20 mm", InjectedFault("jump", "arm", 0.02, for_s=1.0),
             "fault", ("implausible",), (("pose-implausible", "stop"),), goal_s=STOPPED_S),
    FaultRow("arm-impossible", "the arm reports a pose that no palm angles belong to",
             InjectedFault("jump", "arm", 0.5, for_s=1.0), "fault", ("implausible",), (("pose-implausible", "stop"),),
             goal_s=STOPPED_S),
    *(
        FaultRow(f"{pad}-saturated", "its pressure is eight times what it was",
                 InjectedFault("saturate", pad, for_s=3.0), "hold", ("pressed",), (("force-limit", "hold"),),
                 ("force-excess", "pads-swapped", "estimate-lost"), goal_s=STOPPED_S)
        for pad in PADS
    ),
    _ARM_DEAD,
    FaultRow("arm-garbled", "a fifth of its line's bytes are damaged", InjectedFault("garble", "arm", 0.2), "fault",
             ("arm-damaged",), (ARM_LOST,), ("arm-fault", "arm-left-tracking")),
    FaultRow("arm-late", "its data arrive 120 ms late", InjectedFault("late", "arm", 0.12), "tracking", ("arm-late",),
             (("arm-late", "degrade"),)),
    _ARM_MUTE, _ARM_REPLACED, _ARM_FOREIGN,
    FaultRow("controller-break", "a break on the arm's line", InjectedFault("break", "arm"), "fault", ("arm-break",),
             (("arm-fault", "stop"),), ("arm-left-tracking",)),
    FaultRow("controller-estop", "the e-stop is pressed", InjectedFault("estop", "arm"), "fault", ("arm-estop",),
             (("arm-estop", "stop"),)),
    FaultRow("controller-power-off", "arm power goes", InjectedFault("power_off", "arm"), "fault", ("arm-power-off",),
             (("arm-power-off", "stop"),)),
    FaultRow("controller-manual", "the operator takes the arm and jogs it", InjectedFault("manual", "arm"), "fault",
             ("arm-manual",), (("arm-manual", "stop"),), goal_s=math.inf),
    FaultRow("controller-watchdog", "200 ms without a set-point", InjectedFault("mute", "arm", for_s=0.2), "fault",
             ("arm-watchdog", "arm-mute"), (("arm-fault", "stop"),), ("arm-left-tracking", "arm-link-lost"),
             HOST_DEAD_S),
    FaultRow("daemon-paused-50", "the daemon is stopped for 50 ms", Pause("daemon", 0.05), "tracking", ("stalled",),
             (("loop-overrun", "note"),)),
    FaultRow("daemon-paused-300", "the daemon is stopped for 300 ms", Pause("daemon", 0.3), "fault", ("stalled",),
             (("arm-fault", "stop"), ("loop-overrun", "note")),
             ("arm-left-tracking", "arm-link-lost", "pad1-silent", "pad2-silent"), HOST_DEAD_S),
    FaultRow("daemon-killed", "the daemon is killed, and another one started", Kill("daemon"), "ready", ("died",),
             (("arm-fault", "stop"),), goal_s=HOST_DEAD_S),
    FaultRow("disk-full", "the recorder cannot write", FullDisk(), "tracking", ("cut",),
             (("recorder-failed", "note"),)),
    FaultRow("recorder-killed", "the recorder is killed", Kill("recorder"), "tracking", ("cut",),
             (("recorder-silent", "note"),)),
    FaultRow("recorder-stuck", "the recorder is stopped for 5 s", Pause("recorder", 5.0), "tracking", ("nothing",),
             (("recorder-silent", "note"),)),
    FaultRow("smoother-stopped", "the smoother is stopped for 4 s", Pause("smoother", 4.0), "tracking", ("nothing",),
             (("smoother-silent", "degrade"),)),
    FaultRow("page-killed", "the live page is killed", Kill("page"), "tracking", ("nothing",)),
    FaultRow("page-stuck", "the live page is stopped for 3 s", Pause("page", 3.0), "tracking", ("nothing",)),
    FaultRow("address-taken", "a second daemon wants the same addresses", TakenAddress(), "tracking", ("nothing",)),
    FaultRow("clock-step", "the wall clock is set back by an hour", WallClockStep(-3600.0), "tracking", ("nothing",)),
)
NAMES = tuple(row.name for row in ROWS)

# ---- rigs of servos, strips and input devices

SERVOS_DEAD_S = 0.150
"""Goal for the time from the host's death to standstill (s), by the servos' own watchdogs."""

_OWN = ("arm-fault", "arm-servo-watchdog", "arm-servo-restarted", "arm-servo-refused")
"""Faults that a servo may report once it is connected again."""


def _servo(name: str, cause: str, injected: str, code: str) -> FaultRow:
    return FaultRow(name, cause, InjectedFault(injected, "arm"), "fault", ("arm-servo",), ((code, "stop"),),
                    ("arm-fault",))


_SERVOS_DEAD, _SERVOS_MUTE, _SERVOS_REPLACED, _SERVOS_FOREIGN = arm_port_rows(
    "the adapter's port",
    "both servos fall silent and receive nothing",
    ("the bus runs at another speed", "arm-mute"),  # the servos receive no valid instruction
    _OWN,
    SERVOS_DEAD_S,
)

SERVO_ROWS: tuple[FaultRow, ...] = (
    _SERVOS_DEAD, _SERVOS_MUTE, _SERVOS_FOREIGN, _SERVOS_REPLACED,
    _servo("servo-overload", "palm 1's servo is overloaded", "overload", "arm-servo-overload"),
    _servo("servo-hot", "palm 1's servo gets too hot", "overheat", "arm-servo-hot"),
    _servo("servo-voltage", "palm 1's servo reports a supply out of range", "undervoltage", "arm-servo-voltage"),
    FaultRow("servo-brownout", "palm 1's servo restarts, which takes 0.4 s", InjectedFault("brownout", "arm"),
             "fault", ("arm-mute",), (ARM_LOST,), _OWN),
    FaultRow("supply-cut", "the supply's switch is opened", InjectedFault("estop", "arm"), "fault", ("arm-mute",),
             (ARM_LOST,), _OWN),
    FaultRow("servo-watchdog", "200 ms without an instruction", InjectedFault("mute", "arm", for_s=0.2), "fault",
             ("arm-servo-watchdog", "arm-mute"), (("arm-servo-watchdog", "stop"),), ("arm-fault", "arm-link-lost"),
             SERVOS_DEAD_S),
    FaultRow("daemon-paused-300", "the daemon is stopped for 300 ms", Pause("daemon", 0.3), "fault", ("stalled",),
             (ARM_LOST, ("loop-overrun", "note")), (*_OWN, "pad1-silent", "pad2-silent"), SERVOS_DEAD_S),
    FaultRow("daemon-killed", "the daemon is killed, and another one started", Kill("daemon"), "ready", ("died",),
             goal_s=SERVOS_DEAD_S),
)

STRIP_ROWS: tuple[FaultRow, ...] = tuple(row for pad in PADS for row in pad_rows(pad, ("a twentieth", 0.05)))


def _input(pad: PortName) -> tuple[FaultRow, ...]:
    port = f"{pad}-port"
    return (
        FaultRow(f"{pad}-dead", "it is unplugged", InjectedFault("unplug", pad), "hold", (port,), ((port, "hold"),)),
        FaultRow(f"{pad}-replaced", "it comes back under another number",
                 InjectedFault("unplug", pad, for_s=0.5), "hold", (port,), ((port, "hold"),), (f"{pad}-silent",)),
        FaultRow(f"{pad}-overflow", "the kernel drops its data", InjectedFault("overflow", pad), "tracking",
                 ("nothing",)),
        FaultRow(f"{pad}-mute", "it falls silent while the palms turn", InjectedFault("mute", pad), "hold",
                 (f"{pad}-mute",), ((f"{pad}-silent", "hold"),)),
    )


INPUT_ROWS: tuple[FaultRow, ...] = tuple(row for pad in PADS for row in _input(pad))
