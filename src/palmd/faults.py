"""What may go wrong: one table of faults, and the monitor that says which of them stand.

A fault is raised by its condition, which somebody else watches; here are only its name, how grave it is, how
long the condition must hold, whether it stays when the condition has gone, and what the operator should do.
The documentation's table is generated from `FAULTS`.
"""

from __future__ import annotations

from collections.abc import Callable, Set
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Literal

from palmd.system.mechanism import PALMS
from palmd.system.naming import PAD_NUMBERS


class Severity(StrEnum):
    """What a fault does, from mild to grave: say so; work on with less; hold the motion; stop the arm."""

    NOTE = "note"
    DEGRADE = "degrade"
    HOLD = "hold"
    STOP = "stop"


Latch = Literal["no", "armed", "always"]
"""Whether a fault stays after its cause has gone: never, if the arm was commanded when it came, always."""

Clearer = Literal["itself", "reset", "operator"]
"""Who may clear a fault: the end of its cause, the `reset` command, or a person at the machine."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One row of the table; `debounce_s` is how long the condition must have held without a break."""

    code: str
    severity: Severity
    text: str
    hint: str
    debounce_s: float = 0.0
    latch: Latch = "no"
    clears: Clearer = "itself"


def _pad(number: int) -> tuple[Fault, ...]:
    pad = f"pad{number}"
    return (
        Fault(
            f"{pad}-port",
            Severity.HOLD,
            f"the serial port of pad {number} is not open",
            f"check the plug and pads.palm{number}.port in the configuration; it is tried again by itself, "
            "then start goes on",
        ),
        Fault(
            f"{pad}-silent",
            Severity.HOLD,
            f"pad {number} fell silent while the palms moved",
            "see whether the object still lies on the palm and the pad's cable is in, then start goes on; "
            "stop, arm and start to move without it",
        ),
        Fault(
            f"{pad}-lifted",
            Severity.HOLD,
            f"the object left pad {number} while the palms moved",
            "put the object back, then start goes on; stop, arm and start to move without it",
            debounce_s=0.03,
        ),
        Fault(
            f"{pad}-untouched",
            Severity.NOTE,
            f"nothing touches pad {number}",
            "put the object on the palms; if it lies there, check the pad's cable, power and baud",
            debounce_s=1.0,
        ),
        Fault(
            f"{pad}-garbled",
            Severity.DEGRADE,
            f"more than a fifth of what pad {number} says is no packet",
            "check its baud against the configuration, then cable and shield",
        ),
        Fault(
            f"{pad}-out-of-range",
            Severity.DEGRADE,
            f"more than a fifth of pad {number}'s readings lie beyond its ends",
            "check axis, sign, zero_mm and counts_per_mm in the configuration, and that the pads are not swapped",
        ),
        Fault(
            f"{pad}-batched",
            Severity.DEGRADE,
            f"pad {number}'s packets arrive several at a time",
            "set its USB adapter's latency timer to 1 ms (the udev rule palmd ships does)",
        ),
        Fault(
            f"{pad}-handshake",
            Severity.DEGRADE,
            f"pad {number} did not answer its start-up with an identity",
            "check the pad's power, cable and baud, or configure handshake: none",
        ),
        Fault(
            f"{pad}-foreign-clock",
            Severity.DEGRADE,
            f"pad {number}'s events are not stamped by this machine's monotonic clock",
            "read the device itself and not a copy of its events; their times are taken from when they arrive",
        ),
    )


def _servo(what: str, text: str, hint: str) -> Fault:
    return Fault(f"arm-servo-{what}", Severity.STOP, text, hint, latch="armed", clears="reset")


FAULTS: tuple[Fault, ...] = (
    Fault(
        "tick-error",
        Severity.STOP,
        "an unexpected error in the control loop; the log has its traceback",
        "read the log; reset, and restart palmd if it comes again",
        latch="always",
        clears="reset",
    ),
    Fault(
        "estimate-not-finite",
        Severity.STOP,
        "the observer called an estimate valid that is not finite",
        "take the object off and put it back; reset; keep the recording, this is a defect",
        latch="always",
        clears="reset",
    ),
    Fault(
        "limits-violated",
        Severity.STOP,
        "the palms are outside their limits, or the motion wanted to leave them",
        "see what moved the arm; bring it back inside with the pendant, then reset",
        debounce_s=0.03,
        latch="armed",
        clears="reset",
    ),
    Fault(
        "following-error",
        Severity.STOP,
        "the arm does not follow its set-points",
        "see what blocks the arm, and whether its encoders tell the truth; then reset, arm and start: the motion "
        "begins where the arm is",
        latch="always",
        clears="reset",
    ),
    Fault(
        "pose-implausible",
        Severity.STOP,
        "the arm reports a pose that cannot be",
        "compare the pose with where the arm is; check its encoders, its calibration and its cable, then reset",
        latch="always",
        clears="reset",
    ),
    Fault(
        "pose-contradicts-rig",
        Severity.STOP,
        "the pose that the arm reports cannot be one of the rig as configured",
        "run palmd doctor, then palmd calibrate arm: check rig.base_mm, the palms' lengths, arm.base_x_mm, base_y_mm "
        "and base_yaw_deg",
        debounce_s=0.05,
        latch="armed",
        clears="reset",
    ),
    Fault(
        "loop-overruns",
        Severity.STOP,
        "the control loop keeps missing its deadline",
        "take load off this machine or give palmd real-time priority, then reset",
        latch="armed",
        clears="reset",
    ),
    Fault(
        "arm-estop",
        Severity.STOP,
        "the arm's emergency stop is pressed",
        "when it is safe, release it at the arm and bring the controller back to READY, then reset",
        latch="always",
        clears="operator",
    ),
    Fault(
        "arm-fault",
        Severity.STOP,
        "the arm's controller has latched a fault",
        "see the controller's code in status; remove the cause, then reset",
        latch="armed",
        clears="reset",
    ),
    Fault(
        "arm-power-off",
        Severity.STOP,
        "arm power is off",
        "enable power at the controller",
        latch="armed",
        clears="operator",
    ),
    Fault(
        "arm-manual",
        Severity.STOP,
        "the controller is in manual mode",
        "switch the controller to automatic",
        latch="armed",
        clears="operator",
    ),
    Fault(
        "arm-uncalibrated",
        Severity.STOP,
        "the arm is not calibrated",
        "calibrate the arm at the controller",
        latch="armed",
        clears="operator",
    ),
    Fault(
        "arm-port",
        Severity.STOP,
        "the arm's serial port is not open",
        "check the plug and arm.port in the configuration; it is tried again by itself",
        latch="armed",
        clears="reset",
    ),
    Fault(
        "arm-link-lost",
        Severity.STOP,
        "the arm's controller has not answered for 250 ms, or has restarted",
        "check cable, controller and its palmd program; reset when it answers again",
        latch="armed",
        clears="reset",
    ),
    Fault(
        "arm-left-tracking",
        Severity.STOP,
        "the controller stopped following by itself",
        "see who stopped the arm at the controller, then reset",
        latch="armed",
        clears="reset",
    ),
    Fault(
        "arm-mute",
        Severity.NOTE,
        "the arm's controller does not answer hello",
        "start the palmd program on the controller; check cable and arm.baud",
        debounce_s=1.0,
    ),
    Fault(
        "arm-late",
        Severity.DEGRADE,
        "the arm has not answered for 80 ms; the motion pauses until it does",
        "if it comes often: check the cable, and the load of this machine and of the controller",
    ),
    Fault(
        "arm-held",
        Severity.DEGRADE,
        "the controller got no set-point in time and stood still; the motion catches up gently",
        "if it comes often: take load off this machine or give palmd real-time priority",
    ),
    Fault(
        "arm-garbled",
        Severity.DEGRADE,
        "more than a twentieth of the lines from the arm are damaged",
        "check arm.baud against the controller, then cable and shield",
    ),
    _servo(
        "set-up",
        "a servo cannot be used as it is; status says which and why",
        "do what status says, then reset; palmd doctor looks at every setting",
    ),
    _servo(
        "overload",
        "a servo was overloaded and has let go",
        "see what blocks or loads its palm, then reset starts the servo anew",
    ),
    _servo("hot", "a servo is too hot and has let go", "let it cool down, lighten the palms, then reset"),
    _servo(
        "voltage",
        "a servo's supply is out of range",
        "check the power supply, its plug and the length of its cable, then reset",
    ),
    _servo("encoder", "a servo's encoder fails", "reset; exchange the servo if it comes again"),
    _servo("shock", "a servo's circuit has had a shock", "check supply and ground, then reset"),
    _servo(
        "watchdog",
        "a servo had no instruction for 100 ms and stopped by itself",
        "take load off this machine, set the adapter's latency timer to 1 ms, then reset",
    ),
    _servo(
        "refused",
        "a servo does not take the goals it is sent",
        "see that no other program writes to the servos, then reset; palmd doctor compares their limits",
    ),
    _servo(
        "restarted",
        "a servo has let go, or has started anew and lost its settings",
        "check its supply and cable, hold the palms, then reset",
    ),
    *(fault for number in PAD_NUMBERS for fault in _pad(number)),
    Fault(
        "force-limit",
        Severity.HOLD,
        "something presses harder on a pad than limits.force_n, or than the pad can tell",
        "see what lies on the pads or presses on them; stop, raise a pivoting gripper with the pendant or take the "
        "object off; then arm and start",
    ),
    Fault(
        "force-excess",
        Severity.STOP,
        "something presses on a pad with more than 1.5 times limits.force_n",
        "take the object off or free the gripper, see what pressed; then reset",
        latch="always",
        clears="reset",
    ),
    Fault(
        "plan-refused",
        Severity.NOTE,
        "the plan cannot be run; the answer to start or plan says why",
        "mend the plan, then load it with the plan command",
    ),
    Fault(
        "operator-lost",
        Severity.NOTE,
        "the client in control fell silent while the palms moved; the motion was held",
        "look at the rig, then start goes on; a page or palmd ctl --keep must stay open while its motion runs",
    ),
    Fault(
        "smoother-silent",
        Severity.DEGRADE,
        "the smoother beside the loop does not run",
        "it is started again by itself and needs some seconds of readings; if often, take load off the machine",
    ),
    Fault(
        "explorer-silent",
        Severity.NOTE,
        "nobody decides where the exploration goes next; the palms stand and wait",
        "it goes on by itself when the explorer answers again; take load off this machine, and read the log",
    ),
    Fault(
        "pads-swapped",
        Severity.DEGRADE,
        "the pressures move the wrong way between the pads as the palms turn: the pads are swapped",
        f"exchange {' and '.join(f'pads.palm{palm}.port' for palm in PALMS)} in the configuration, or the plugs; "
        "until then no estimate is called valid",
    ),
    Fault(
        "pads-mirrored",
        Severity.DEGRADE,
        "the contacts move the wrong way along the palms as these open: the sign of a pad is wrong",
        "give the pads that are named the other sign in the configuration; until then no estimate is valid",
    ),
    Fault(
        "estimate-lost",
        Severity.DEGRADE,
        "the palms move and both pads feel the object, but there is no valid estimate",
        "give it some seconds of lively motion; else check the rig's lengths and the pads' calibration",
        debounce_s=10.0,
    ),
    Fault(
        "estimate-inconsistent",
        Severity.DEGRADE,
        "the readings miss what the model expects by more, or by less, than their noise explains",
        "check zero_mm, counts_per_mm, the rig's lengths and its lag; is the object rigid, the hinge tight?",
        debounce_s=2.0,
    ),
    Fault(
        "rig-contradicted",
        Severity.NOTE,
        "the readings contradict what the configuration says of the rig; estimates go by the readings",
        "palm/rig, the page and palmd top say what is off and what to do about it",
    ),
    Fault(
        "samples-too-late",
        Severity.DEGRADE,
        "samples arrive too late to be of use to the observer",
        "check the latency timers of the USB adapters and the load of this machine",
    ),
    Fault(
        "loop-overrun",
        Severity.NOTE,
        "the control loop missed a deadline within the last second",
        "if it comes often: take load off this machine or give palmd real-time priority",
    ),
    Fault(
        "recorder-failed",
        Severity.NOTE,
        "the run is not being recorded: the recorder cannot write",
        "status tells why: make room on the disk, or let palmd write to record.directory; it tries again by itself",
    ),
    Fault(
        "recorder-silent",
        Severity.NOTE,
        "the recorder has not been heard for 3 s",
        "start it again with palmd record; what it has written is safe, palmd runs recover packs it",
    ),
    Fault(
        "vm-backend",
        Severity.NOTE,
        "the models run on CasADi's virtual machine, several times slower than compiled",
        "install a C compiler (Debian: apt install gcc libc6-dev) and restart palmd",
    ),
    Fault(
        "no-realtime",
        Severity.NOTE,
        "palmd runs without real-time priority or locked memory; the log says what is missing",
        "run it as the systemd service, or give this user the rights: the log and palmd doctor tell the command",
    ),
)
"""Every fault there is; where several stand they are told in this order."""

TABLE: dict[str, Fault] = {fault.code: fault for fault in FAULTS}


def _none(code: str) -> str:
    del code
    return ""


class FaultMonitor:
    """Says which faults stand, given the conditions that hold. Pure, and safe in the loop.

    `active` holds them in the table's order; it is the same object for as long as nothing changes.
    """

    def __init__(self) -> None:
        self.active: tuple[Fault, ...] = ()
        self._since: dict[str, float] = {}
        self._latched: set[str] = set()
        self._shown: set[str] = set()
        self._told: dict[str, Fault] = {}  # with what spoke for them when they came up

    def update(
        self,
        present: Set[str],
        t: float,
        *,
        armed: bool,
        sure: Set[str] = frozenset(),
        evidence: Callable[[str], str] = _none,
    ) -> bool:
        """Take the codes whose condition holds at `t` (s); return whether `active` has changed.

        `evidence` tells what speaks for a code, with numbers; it is asked once, when the fault comes up.
        `armed` says whether the arm is commanded, on which some rows' latching depends; what is `sure` need not hold
        for any time first. Raises KeyError for a code that is not in the table.
        """
        since = self._since
        for code in [code for code in since if code not in present]:
            del since[code]
        standing = set()
        for code in present:
            row = TABLE[code]
            if t - since.setdefault(code, t) >= row.debounce_s or code in sure:
                standing.add(code)
                if row.latch == "always" or (armed and row.latch == "armed"):
                    self._latched.add(code)
        for code in standing - self._shown:
            told = evidence(code)
            if told:
                self._told[code] = replace(TABLE[code], text=f"{TABLE[code].text}: {told}")
        return self._show(standing | self._latched)

    def reset(self) -> bool:
        """Let go of every latched fault whose condition has gone; return whether `active` has changed."""
        self._latched.intersection_update(self._since)
        return self._show({code for code in self._shown if code in self._since} | self._latched)

    def latched(self, severity: Severity) -> bool:
        """Whether a fault of this severity stays until reset."""
        return any(TABLE[code].severity is severity for code in self._latched)

    def standing(self, severity: Severity) -> tuple[Fault, ...]:
        """The active faults of one severity."""
        return tuple([fault for fault in self.active if fault.severity is severity]) if self.active else ()

    def _show(self, shown: set[str]) -> bool:
        if shown == self._shown:
            return False
        self._shown = shown
        for code in [code for code in self._told if code not in shown]:
            del self._told[code]
        self.active = tuple(self._told.get(fault.code, fault) for fault in FAULTS if fault.code in shown)
        return True
