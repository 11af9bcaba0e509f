"""Whether every byte, packet, line and set-point is accounted for at both ends of each line. Pure.

The rig's `status` and the daemon's `palm/loop`, both from when the lines were at rest. What a closing or opening port
had under way is lost, as on a real line; no more than `UNDER_WAY_S` of the line's speed for each of them may be.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from palmd.devices.armlink import SETPOINT_BYTES
from palmd.devices.arrival import byte_time
from palmd.devices.versapad import PACKET_BYTES
from tools.studies.soak import SoakFinding, at_most, between, told

UNDER_WAY_S = 0.05
GAPS_PART, GAPS_ANYWAY = 1e-3, 5  # packets in which the kernel paused for longer than the decoder waits
HELLO_BYTES = 64  # what a daemon without an answer says between the two looks

Counts = Mapping[str, Any]


def pad(name: str, rig: Counts, daemon: Counts, baud: int) -> list[SoakFinding]:
    """One pad's line, from its packets to the daemon's."""
    line = _Line(name, rig, daemon, baud)
    packets, whole = line.got("packets"), line.sent("packets")
    fell = line.fell
    lost_at_shut_port = math.ceil(rig[f"{name}_bytes_lost"] / PACKET_BYTES) + line.interruptions
    intact = rig[f"{name}_messages"] - rig[f"{name}_altered"] - rig[f"{name}_withheld"] - lost_at_shut_port
    in_pieces = math.ceil(fell / PACKET_BYTES) + line.interruptions if line.reopened else 0
    gaps, gaps_there = line.got("gaps"), line.sent("gaps")
    return [
        *line.bytes(),
        between(
            "counters",
            f"{name} bytes of no packet",
            line.got("bytes") - PACKET_BYTES * packets - line.got("bytes_discarded"),
            0,
            PACKET_BYTES - 1,
            why="bytes that are neither in a packet, nor discarded, nor in hand",
        ),
        between(
            "counters", f"{name} whole packets sent and not decoded", whole - packets, -gaps_there, in_pieces + gaps
        ),
        at_most("counters", f"{name} packets cut by a gap", gaps, max(GAPS_ANYWAY, GAPS_PART * packets)),
        told("counters", f"{name} packets decoded", packets),
        told("counters", f"{name} packets altered by mischief", rig[f"{name}_altered"]),
        told("counters", f"{name} packets withheld by mischief", rig[f"{name}_withheld"]),
        at_most(
            "counters",
            f"{name} intact packets lost",
            max(0, intact - in_pieces - gaps - packets),
            0,
            why="fewer packets were decoded than left the pad untouched and found the port open",
        ),
        *line.causes(("bad_header", "bad_data", "truncated"), line.allowance, (PACKET_BYTES - 1) * (gaps + gaps_there)),
    ]


def arm(rig: Counts, daemon: Counts, baud: int) -> list[SoakFinding]:
    """The arm's line: the controller's answers one way, set-points the other way."""
    line = _Line("arm", rig, daemon, baud)
    in_pieces = line.interruptions * 4 if line.reopened else 0
    sent, heard = daemon["arm_setpoints"], rig["host_setpoints"]
    got = rig["setpoints"] + rig["duplicates"]
    dropped = math.ceil(daemon["arm_port_bytes_dropped"] / SETPOINT_BYTES)
    at_port = math.ceil(line.allowance / SETPOINT_BYTES) if line.reopened else 0
    return [
        *line.bytes(),
        between("counters", "arm whole lines sent and not read", line.sent("lines") - line.got("lines"), 0, in_pieces),
        told("counters", "arm lines read", line.got("lines")),
        *line.causes(("crc_errors", "unframed", "overlong"), 2 * line.interruptions),
        between(
            "counters",
            "arm bytes written and not heard",
            daemon["arm_port_bytes_written"] - rig["arm_bytes_heard"],
            -HELLO_BYTES,
            HELLO_BYTES + (line.allowance if line.reopened else 0),
        ),
        between("counters", "set-points sent and not heard", sent - heard, 0, dropped + at_port),
        told("counters", "set-points sent", sent),
        between(
            "counters",
            "set-points heard and not received",
            heard - got,
            0,
            2 * rig["host_setpoints_touched"],
            why="mischief touched fewer of them; a lost end of a line takes the next one with it",
        ),
        between("counters", "set-points outside the limits", rig["setpoints_outside_limits"], 0, 0),
    ]


class _Line:
    """What both ends say of one line in the daemon's direction."""

    def __init__(self, name: str, rig: Counts, daemon: Counts, baud: int) -> None:
        self._name, self._rig, self._daemon = name, rig, daemon
        opens, losses = daemon[f"{name}_port_opens"], daemon[f"{name}_port_losses"]
        self.interruptions = opens + losses
        self.reopened = losses > 0
        self.allowance = math.ceil(self.interruptions * UNDER_WAY_S / byte_time(baud))
        self.fell = rig[f"{name}_bytes_sent"] - daemon[f"{name}_port_bytes_read"]

    def sent(self, what: str) -> int:
        return int(self._rig[f"{self._name}_sent_{what}"])

    def got(self, what: str) -> int:
        return int(self._daemon[f"{self._name}_{what}"])

    def bytes(self) -> list[SoakFinding]:
        name, rig = self._name, self._rig
        passed = rig[f"{name}_bytes_sent"] + rig[f"{name}_bytes_lost"] + rig[f"{name}_bytes_waiting"]
        return [
            told("counters", f"{name} interruptions", self.interruptions),
            between("counters", f"{name} bytes astray in the rig", rig[f"{name}_bytes_on_line"] - passed, 0, 0),
            between("counters", f"{name} bytes sent and not read", self.fell, 0, self.allowance),
            between(
                "counters",
                f"{name} bytes read and not decoded",
                self._daemon[f"{name}_port_bytes_read"] - self.got("bytes"),
                0,
                0,
            ),
        ]

    def causes(self, names: tuple[str, ...], if_reopened: int, always: int = 0) -> list[SoakFinding]:
        """What was discarded, by cause, beside what a listener at the rig's end discards of the same bytes."""
        slack = always + (if_reopened if self.reopened else 0)
        return [
            between(
                "counters",
                f"{self._name} {name} beyond the rig's",
                self.got(name) - self.sent(name),
                -slack,
                slack,
                why="the daemon discards other bytes than a listener at the rig's end",
            )
            for name in names
        ]
