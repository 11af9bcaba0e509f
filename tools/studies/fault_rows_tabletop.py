"""The fault campaign's rows for rigs of servos, strips and input devices; see `fault_rows`. Pure."""

from __future__ import annotations

from palmd.rig.fault_injection import PADS, PortName
from tools.studies.fault_rows import ARM_LOST, FaultRow, Kill, Pause, RowFault, arm_port_rows, pad_rows

SERVOS_DEAD_S = 0.150
"""From the host's death to the palms standing still: the servos' own watchdogs."""

_OWN = ("arm-fault", "arm-servo-watchdog", "arm-servo-restarted", "arm-servo-refused")
"""What a servo may say of itself once it is heard again."""


def _servo(name: str, cause: str, trick: str, code: str) -> FaultRow:
    return FaultRow(name, cause, RowFault(trick, "arm"), "fault", ("arm-servo",), ((code, "stop"),), ("arm-fault",))


_ARM_DEAD, _ARM_MUTE, _ARM_REPLACED, _ARM_FOREIGN = arm_port_rows(
    "the adapter's port",
    "both servos fall silent, and hear nothing",
    ("the bus runs at another speed", "arm-mute"),  # for the servos hear nothing that is an instruction
    _OWN,
    SERVOS_DEAD_S,
)

SERVO_ROWS: tuple[FaultRow, ...] = (
    _ARM_DEAD,
    _ARM_MUTE,
    _ARM_FOREIGN,
    _ARM_REPLACED,
    _servo("servo-overload", "palm 1's servo is overloaded", "overload", "arm-servo-overload"),
    _servo("servo-hot", "palm 1's servo gets too hot", "overheat", "arm-servo-hot"),
    _servo("servo-voltage", "palm 1's servo says that its supply is out of range", "undervoltage", "arm-servo-voltage"),
    FaultRow(
        "servo-brownout",
        "palm 1's servo starts anew, which takes it 0.4 s",
        RowFault("brownout", "arm"),
        "fault",
        ("arm-mute",),
        (ARM_LOST,),
        _OWN,
    ),
    FaultRow(
        "supply-cut",
        "the supply's switch is opened",
        RowFault("estop", "arm"),
        "fault",
        ("arm-mute",),
        (ARM_LOST,),
        _OWN,
    ),
    FaultRow(
        "servo-watchdog",
        "200 ms without an instruction",
        RowFault("mute", "arm", for_s=0.2),
        "fault",
        ("arm-servo-watchdog", "arm-mute"),
        (("arm-servo-watchdog", "stop"),),
        ("arm-fault", "arm-link-lost"),
        SERVOS_DEAD_S,
    ),
    FaultRow(
        "daemon-paused-300",
        "the daemon is stopped for 300 ms",
        Pause("daemon", 0.3),
        "fault",
        ("stalled",),
        (ARM_LOST, ("loop-overrun", "note")),
        (*_OWN, "pad1-silent", "pad2-silent"),
        SERVOS_DEAD_S,
    ),
    FaultRow(
        "daemon-killed",
        "the daemon is killed, and another one started",
        Kill("daemon"),
        "ready",
        ("died",),
        goal_s=SERVOS_DEAD_S,
    ),
)

STRIP_ROWS: tuple[FaultRow, ...] = tuple(row for pad in PADS for row in pad_rows(pad, ("a twentieth", 0.05)))


def _input(pad: PortName) -> tuple[FaultRow, ...]:
    port = f"{pad}-port"
    return (
        FaultRow(f"{pad}-dead", "it is unplugged", RowFault("unplug", pad), "hold", (port,), ((port, "hold"),)),
        FaultRow(
            f"{pad}-replaced",
            "it comes back under another number",
            RowFault("unplug", pad, for_s=0.5),
            "hold",
            (port,),
            ((port, "hold"),),
            (f"{pad}-silent",),
        ),
        FaultRow(
            f"{pad}-overflow", "the kernel drops what it said", RowFault("overflow", pad), "tracking", ("nothing",)
        ),
        FaultRow(
            f"{pad}-mute",
            "it says nothing any more, and the palms turn",
            RowFault("mute", pad),
            "hold",
            (f"{pad}-mute",),
            ((f"{pad}-silent", "hold"),),
        ),
    )


INPUT_ROWS: tuple[FaultRow, ...] = tuple(row for pad in PADS for row in _input(pad))
