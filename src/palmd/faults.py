"""The table of faults, and the monitor that determines which of them are active.

A fault is raised by its condition, which is judged elsewhere; the table holds only its name, severity, how long the
condition must hold, whether the fault persists when the condition has ended, and what the operator should do. The
documentation's table is generated from `FAULTS`.
"""

from __future__ import annotations

from collections.abc import Callable, Set
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Literal

from palmd.system.mechanism import PALMS
from palmd.system.naming import PAD_NUMBERS


class Severity(StrEnum):
    """Effect of a fault: report it; continue with reduced function; hold the motion; stop the arm."""

    NOTE = "note"
    DEGRADE = "degrade"
    HOLD = "hold"
    STOP = "stop"


Latch = Literal["no", "armed", "always"]
"""Whether a fault persists after its cause has ended: never, if the arm was commanded when it occurred, always."""

Clearer = Literal["itself", "reset", "operator"]
"""What clears a fault: the end of its cause, the `reset` command, or a person at the machine."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One row of the table; `debounce_s` is how long the condition must hold without interruption."""

    code: str
    severity: Severity
    text: str
    hint: str
    debounce_s: float = 0.0
    latch: Latch = "no"
    clears: Clearer = "itself"


def _note(code: str, text: str, hint: str, debounce_s: float = 0.0) -> Fault:
    return Fault(code, Severity.NOTE, text, hint, debounce_s)


def _degrade(code: str, text: str, hint: str, debounce_s: float = 0.0) -> Fault:
    return Fault(code, Severity.DEGRADE, text, hint, debounce_s)


def _hold(code: str, text: str, hint: str, debounce_s: float = 0.0) -> Fault:
    return Fault(code, Severity.HOLD, text, hint, debounce_s)


def _stop(
    code: str, text: str, hint: str, debounce_s: float = 0.0, latch: Latch = "armed", clears: Clearer = "reset"
) -> Fault:
    return Fault(code, Severity.STOP, text, hint, debounce_s, latch, clears)


def _pad(number: int) -> tuple[Fault, ...]:
    pad = f"pad{number}"
    return (
        _hold(
            f"{pad}-port",
            f"the serial port of pad {number} is not open",
            f"check the plug and pads.palm{number}.port in the configuration; opening is retried automatically, "
            "then start resumes",
        ),
        _hold(
            f"{pad}-silent",
            f"pad {number} fell silent while the palms moved",
            "check that the object still lies on the palm and the pad's cable is plugged in, then start resumes; "
            "stop, arm and start to move without it",
        ),
        _hold(
            f"{pad}-lifted",
            f"the object left pad {number} while the palms moved",
            "put the object back, then start resumes; stop, arm and start to move without it",
            debounce_s=0.03,
        ),
        _note(
            f"{pad}-untouched",
            f"nothing touches pad {number}",
            "put the object on the palms; if it lies there, check the pad's cable, power and baud",
            debounce_s=1.0,
        ),
        _degrade(
            f"{pad}-garbled",
            f"more than a fifth of pad {number}'s data are not packets",
            "check its baud against the configuration, then cable and shield",
        ),
        _degrade(
            f"{pad}-out-of-range",
            f"more than a fifth of pad {number}'s readings lie beyond its ends",
            "check axis, sign, zero_mm and counts_per_mm in the configuration, and that the pads are not swapped",
        ),
        _degrade(
            f"{pad}-batched",
            f"pad {number}'s packets arrive several at a time",
            "set its USB adapter's latency timer to 1 ms (palmd's udev rule does this)",
        ),
        _degrade(
            f"{pad}-handshake",
            f"pad {number} did not identify itself at start-up",
            "check the pad's power, cable and baud, or configure handshake: none",
        ),
        _degrade(
            f"{pad}-foreign-clock",
            f"pad {number}'s events are not stamped by this machine's monotonic clock",
            "read the device itself and not a copy of its events; until then arrival times are used",
        ),
    )


FAULTS: tuple[Fault, ...] = (
    _stop(
        "tick-error",
        "an unexpected error in the control loop; the log has its traceback",
        "read the log; reset, and restart palmd if it occurs again",
        latch="always",
    ),
    _stop(
        "estimate-not-finite",
        "the observer declared an estimate valid that is not finite",
        "take the object off and put it back; reset; keep the recording, this is a defect",
        latch="always",
    ),
    _stop(
        "limits-violated",
        "the palms are outside their limits, or the motion would leave them",
        "find what moved the arm; move it back inside with the pendant, then reset",
        debounce_s=0.03,
    ),
    _stop(
        "following-error",
        "the arm does not follow its set-points",
        "find what blocks the arm, and check its encoders; then reset, arm and start: the motion "
        "begins where the arm is",
        latch="always",
    ),
    _stop(
        "pose-implausible",
        "the arm reports an impossible pose",
        "compare the pose with where the arm is; check its encoders, its calibration and its cable, then reset",
        latch="always",
    ),
    _stop(
        "pose-contradicts-rig",
        "the pose that the arm reports is impossible for the configured rig",
        "run palmd doctor, then palmd calibrate arm: check rig.base_mm, the palms' lengths, arm.base_x_mm, base_y_mm "
        "and base_yaw_deg",
        debounce_s=0.05,
    ),
    _stop(
        "loop-overruns",
        "the control loop keeps missing its deadline",
        "reduce the load of this machine or give palmd real-time priority, then reset",
    ),
    _stop(
        "arm-estop",
        "the arm's emergency stop is pressed",
        "when it is safe, release it at the arm and bring the controller back to READY, then reset",
        latch="always",
        clears="operator",
    ),
    _stop(
        "arm-fault",
        "the arm's controller has latched a fault",
        "look up the controller's code in status; remove the cause, then reset",
    ),
    _stop("arm-power-off", "arm power is off", "enable power at the controller", clears="operator"),
    _stop("arm-manual", "the controller is in manual mode", "switch the controller to automatic", clears="operator"),
    _stop("arm-uncalibrated", "the arm is not calibrated", "calibrate the arm at the controller", clears="operator"),
    _stop(
        "arm-port",
        "the arm's serial port is not open",
        "check the plug and arm.port in the configuration; opening is retried automatically",
    ),
    _stop(
        "arm-link-lost",
        "the arm's controller has not answered for 250 ms, or has restarted",
        "check cable, controller and its palmd program; reset when it answers again",
    ),
    _stop(
        "arm-left-tracking",
        "the controller stopped following without a command",
        "find what stopped the arm at the controller, then reset",
    ),
    _note(
        "arm-mute",
        "the arm's controller does not answer hello",
        "start the palmd program on the controller; check cable and arm.baud",
        debounce_s=1.0,
    ),
    _degrade(
        "arm-late",
        "the arm has not answered for 80 ms; the motion pauses until it does",
        "if it occurs often: check the cable, and the load of this machine and of the controller",
    ),
    _degrade(
        "arm-held",
        "the controller got no set-point in time and stopped; the motion catches up slowly",
        "if it occurs often: reduce the load of this machine or give palmd real-time priority",
    ),
    _degrade(
        "arm-garbled",
        "more than a twentieth of the lines from the arm are damaged",
        "check arm.baud against the controller, then cable and shield",
    ),
    _stop(
        "arm-servo-set-up",
        "a servo cannot be used as configured; status says which and why",
        "do what status says, then reset; palmd doctor checks every setting",
    ),
    _stop(
        "arm-servo-overload",
        "a servo was overloaded and has switched off its torque",
        "find what blocks or loads its palm, then reset restarts the servo",
    ),
    _stop(
        "arm-servo-hot",
        "a servo is too hot and has switched off its torque",
        "let it cool down, lighten the palms, then reset",
    ),
    _stop(
        "arm-servo-voltage",
        "a servo's supply is out of range",
        "check the power supply, its plug and the length of its cable, then reset",
    ),
    _stop("arm-servo-encoder", "a servo's encoder fails", "reset; replace the servo if it occurs again"),
    _stop("arm-servo-shock", "a servo's circuit reports an electrical shock", "check supply and ground, then reset"),
    _stop(
        "arm-servo-watchdog",
        "a servo received no instruction for 100 ms and stopped",
        "reduce the load of this machine, set the adapter's latency timer to 1 ms, then reset",
    ),
    _stop(
        "arm-servo-refused",
        "a servo does not accept the goals it is sent",
        "check that no other program writes to the servos, then reset; palmd doctor compares their limits",
    ),
    _stop(
        "arm-servo-restarted",
        "a servo has switched off its torque, or has restarted and lost its settings",
        "check its supply and cable, hold the palms, then reset",
    ),
    *(fault for number in PAD_NUMBERS for fault in _pad(number)),
    _hold(
        "force-limit",
        "a pad's force exceeds limits.force_n or the pad's range",
        "find what lies on the pads or presses on them; stop, raise a pivoting gripper with the pendant or remove the "
        "object; then arm and start",
    ),
    _stop(
        "force-excess",
        "a pad's force exceeds 1.5 times limits.force_n",
        "remove the object or free the gripper, find what pressed; then reset",
        latch="always",
    ),
    _note(
        "plan-refused",
        "the plan cannot be run; the answer to start or plan says why",
        "correct the plan, then load it with the plan command",
    ),
    _note(
        "operator-lost",
        "the client in control fell silent while the palms moved; the motion was held",
        "check the rig, then start resumes; a page or palmd ctl --keep must stay open while its motion runs",
    ),
    _degrade(
        "smoother-silent",
        "the smoother beside the loop does not run",
        "it is restarted automatically and needs some seconds of readings; if often, reduce the machine's load",
    ),
    _note(
        "explorer-silent",
        "no decision where the exploration goes next arrives; the palms wait",
        "it continues when the explorer answers again; reduce the load of this machine, and read the log",
    ),
    _degrade(
        "pads-swapped",
        "the pressures shift the wrong way between the pads as the palms turn: the pads are swapped",
        f"exchange {' and '.join(f'pads.palm{palm}.port' for palm in PALMS)} in the configuration, or the plugs; "
        "until then no estimate is valid",
    ),
    _degrade(
        "pads-mirrored",
        "the contacts move the wrong way along the palms as these open: the sign of a pad is wrong",
        "invert the sign of the named pads in the configuration; until then no estimate is valid",
    ),
    _degrade(
        "estimate-lost",
        "the rig moves and its pads touch the object, but there is no valid estimate",
        "move for some seconds with large angles; else check the rig's lengths and the pads' calibration",
        debounce_s=10.0,
    ),
    _degrade(
        "estimate-inconsistent",
        "the readings deviate from the model by more, or by less, than their noise explains",
        "check zero_mm, counts_per_mm, the rig's lengths and its lag; is the object rigid, the hinge tight?",
        debounce_s=2.0,
    ),
    _note(
        "rig-contradicted",
        "the readings contradict the configured rig; estimates follow the readings",
        "palm/rig, the page and palmd top show which constants are wrong and what to do",
    ),
    _degrade(
        "samples-too-late",
        "samples arrive too late for the observer",
        "check the latency timers of the USB adapters and the load of this machine",
    ),
    _note(
        "loop-overrun",
        "the control loop missed a deadline within the last second",
        "if it occurs often: reduce the load of this machine or give palmd real-time priority",
    ),
    _note(
        "recorder-failed",
        "the run is not being recorded: the recorder cannot write",
        "status says why: free disk space, or let palmd write to record.directory; writing is retried automatically",
    ),
    _note(
        "recorder-silent",
        "the recorder has not reported for 3 s",
        "restart it with palmd record; what it has written is safe, palmd runs recover packs it",
    ),
    _note(
        "vm-backend",
        "the models run on CasADi's virtual machine, several times slower than compiled",
        "install a C compiler (Debian: apt install gcc libc6-dev) and restart palmd",
    ),
    _note(
        "no-realtime",
        "palmd runs without real-time priority or locked memory; the log says what is missing",
        "run it as the systemd service, or give this user the rights: the log and palmd doctor show the command",
    ),
)
"""Every fault; several active faults are reported in this order."""

TABLE: dict[str, Fault] = {fault.code: fault for fault in FAULTS}


def _none(code: str) -> str:
    del code
    return ""


class FaultMonitor:
    """Determines the active faults from the conditions that hold. Pure, and safe in the loop.

    `active` holds them in the table's order; it is the same object while nothing changes.
    """

    def __init__(self) -> None:
        self.active: tuple[Fault, ...] = ()
        self._since: dict[str, float] = {}
        self._latched: set[str] = set()
        self._active_codes: set[str] = set()
        self._with_evidence: dict[str, Fault] = {}  # texts extended by the evidence at their occurrence

    def update(
        self,
        present: Set[str],
        t: float,
        *,
        armed: bool,
        certain: Set[str] = frozenset(),
        evidence: Callable[[str], str] = _none,
    ) -> bool:
        """Process the codes whose condition holds at `t` (s); returns whether `active` has changed.

        `evidence(code)` gives the evidence with numbers; it is called once, when the fault comes up. `armed` says
        whether the arm is commanded, on which the latching of some rows depends; codes in `certain` need no debouncing.
        Raises KeyError for a code that is not in the table.
        """
        since = self._since
        for code in [code for code in since if code not in present]:
            del since[code]
        standing = set()
        for code in present:
            row = TABLE[code]
            if t - since.setdefault(code, t) >= row.debounce_s or code in certain:
                standing.add(code)
                if row.latch == "always" or (armed and row.latch == "armed"):
                    self._latched.add(code)
        for code in standing - self._active_codes:
            details = evidence(code)
            if details:
                self._with_evidence[code] = replace(TABLE[code], text=f"{TABLE[code].text}: {details}")
        return self._show(standing | self._latched)

    def reset(self) -> bool:
        """Clear every latched fault whose condition has ended; returns whether `active` has changed."""
        self._latched.intersection_update(self._since)
        return self._show({code for code in self._active_codes if code in self._since} | self._latched)

    def latched(self, severity: Severity) -> bool:
        """Whether a fault of this severity is latched."""
        return any(TABLE[code].severity is severity for code in self._latched)

    def standing(self, severity: Severity) -> tuple[Fault, ...]:
        """The active faults of one severity."""
        return tuple([fault for fault in self.active if fault.severity is severity]) if self.active else ()

    def _show(self, codes: set[str]) -> bool:
        if codes == self._active_codes:
            return False
        self._active_codes = codes
        for code in [code for code in self._with_evidence if code not in codes]:
            del self._with_evidence[code]
        self.active = tuple(self._with_evidence.get(fault.code, fault) for fault in FAULTS if fault.code in codes)
        return True
