"""Fault injection on the emulated rig: the table of injectable faults, and what is active. Pure."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from palmd.system.mechanism import ENDS, PALMS

PortName = str
"""`arm`, or `pad` and the number of its palm."""
PORTS: tuple[PortName, ...] = ENDS
PADS, ARM = PORTS[:-1], PORTS[-1:]


@dataclass(frozen=True, slots=True)
class InjectableFault:
    """One injectable fault: what it does, to which ports it applies, and its default strength.

    `strength` is a probability per byte, a time or a force, as the description states; `ports` is empty for what
    happens to the object.
    """

    name: str
    description: str
    ports: tuple[PortName, ...] = ()
    strength: float = 1.0


INJECTABLE_FAULTS: dict[str, InjectableFault] = {
    fault.name: fault
    for fault in (
        InjectableFault("drop", "each byte is lost with this probability", PORTS, 0.05),
        InjectableFault("garble", "each byte is flipped, doubled or invented with this probability", PORTS, 0.05),
        InjectableFault("mute", "the device neither sends nor receives", PORTS),
        InjectableFault("unplug", "the port disappears; it returns under another number", PORTS),
        InjectableFault("late", "everything the device sends arrives this many seconds later", PORTS, 0.05),
        InjectableFault("burst", "a USB adapter delivers only once in this many seconds", PORTS, 0.016),
        InjectableFault("misbaud", "the device runs at another speed than configured", PORTS),
        InjectableFault("touch", "a finger also presses on the pad, with this many newtons", PADS, 0.5),
        InjectableFault("break", "a break on the line: a moving arm treats it as loss of its link", ARM),
        InjectableFault("estop", "the emergency stop is pressed; off releases it and makes the arm ready", ARM),
        InjectableFault("power_off", "arm power is lost; off restores it", ARM),
        InjectableFault("manual", "the operator takes over the arm and jogs it a little; off gives it back", ARM),
        InjectableFault("block", "something blocks the arm and its controller does not notice", ARM),
        InjectableFault("freeze", "the arm keeps moving but always reports the same pose", ARM),
        InjectableFault(
            "jump", "the reported x is too large by this many metres, from one report to the next", ARM, 0.02
        ),
        InjectableFault("saturate", "the pad reports this many times the pressure, up to full scale", PADS, 8.0),
        InjectableFault("lift", "the object is lifted off by hand; off puts it back in another pose"),
        InjectableFault("swap", "the object is exchanged for another one immediately"),
    )
}

SERVO_FAULTS: dict[str, InjectableFault] = {
    fault.name: fault
    for fault in (
        InjectableFault("overload", f"palm {PALMS[0]}'s servo is overloaded and switches its torque off", ARM),
        InjectableFault("overheat", f"palm {PALMS[0]}'s servo gets too hot and switches its torque off", ARM),
        InjectableFault("undervoltage", f"palm {PALMS[0]}'s servo reports a supply out of range", ARM),
        InjectableFault("brownout", f"palm {PALMS[0]}'s servo restarts and has lost its settings", ARM),
    )
}
"""Faults of servos; without effect on a rig with another actuator."""

INPUT_FAULTS: dict[str, InjectableFault] = {
    "overflow": InjectableFault("overflow", "the kernel drops an input device's events, and reports it", PADS)
}
"""Faults of pads that are input devices; without effect on others."""

ALL_FAULTS = INJECTABLE_FAULTS | SERVO_FAULTS | INPUT_FAULTS


class InjectionError(ValueError):
    """An unknown fault, a port to which the fault does not apply, or an invalid strength or time."""


@dataclass(frozen=True, slots=True)
class FaultOrder:
    """A requested fault: on `port` (None if it applies to none), with this strength, from t_on to t_off (s)."""

    name: str
    port: PortName | None
    strength: float
    t_on: float
    t_off: float


def order(
    name: str,
    t: float,
    port: str | None = None,
    strength: float | None = None,
    after_s: float = 0.0,
    for_s: float | None = None,
) -> list[FaultOrder]:
    """The orders for a fault from t + after_s on, for for_s seconds (None: until it is switched off).

    Without a port it applies to every port that the fault has. Raises InjectionError.
    """
    fault = ALL_FAULTS.get(name)
    if fault is None:
        raise InjectionError(f"unknown fault {name!r}; known: {', '.join(ALL_FAULTS)}")
    if port is not None and port not in fault.ports:
        raise InjectionError(f"{name} applies to {' or '.join(fault.ports) or 'no port'}, not to {port!r}")
    value = fault.strength if strength is None else strength
    if not value >= 0.0 or not after_s >= 0.0 or (for_s is not None and not for_s > 0.0):
        raise InjectionError(f"{name}: strength and after must not be negative, and for must be positive")
    ports: list[PortName | None] = [p for p in fault.ports if port in (None, p)] or [None]
    t_on = t + after_s
    t_off = float("inf") if for_s is None else t_on + for_s
    return [FaultOrder(name, p, value, t_on, t_off) for p in ports]


def parse(text: str, t: float) -> list[FaultOrder]:
    """Orders from `NAME[@PORT][,strength=X][,after=S][,for=S]`; raises InjectionError."""
    head, *settings = text.split(",")
    name, _, port = head.partition("@")
    numbers: dict[str, float] = {}
    for setting in settings:
        key, _, value = setting.partition("=")
        try:
            numbers[{"strength": "strength", "after": "after_s", "for": "for_s"}[key]] = float(value)
        except (KeyError, ValueError):
            raise InjectionError(f"{text}: expected NAME[@PORT][,strength=X][,after=S][,for=S]") from None
    return order(name, t, port or None, numbers.get("strength"), numbers.get("after_s", 0.0), numbers.get("for_s"))


class FaultInjector:
    """Keeps track of pending and active faults. The caller passes the times; it never reads a clock."""

    def __init__(self) -> None:
        self._waiting: list[FaultOrder] = []
        self._active: dict[tuple[str, PortName | None], FaultOrder] = {}

    def add(self, orders: list[FaultOrder]) -> None:
        """Add orders."""
        self._waiting += orders

    def cancel(self, name: str, port: str | None) -> None:
        """Drop the pending orders of a fault, and end its active ones at the next `update`."""
        if name not in ALL_FAULTS:
            raise InjectionError(f"unknown fault {name!r}; known: {', '.join(ALL_FAULTS)}")
        self._waiting = [o for o in self._waiting if o.name != name or port not in (None, o.port)]
        for key, active in self._active.items():
            if active.name == name and port in (None, active.port):
                self._active[key] = replace(active, t_off=0.0)

    def update(self, t: float) -> list[tuple[FaultOrder, bool]]:
        """The orders that have begun (True) or ended (False) by t (s) since the last call."""
        if not self._waiting and not self._active:
            return []
        changes = [(o, False) for o in self._active.values() if t >= o.t_off]
        for ended, _ in changes:
            del self._active[ended.name, ended.port]
        for started in [o for o in self._waiting if t >= o.t_on]:
            self._waiting.remove(started)
            self._active[started.name, started.port] = started
            changes.append((started, True))
        return changes

    def strength(self, name: str, port: PortName | None) -> float:
        """Strength of a fault that is active on the port; 0 if it is not."""
        if not self._active:
            return 0.0
        found = self._active.get((name, port))
        return found.strength if found else 0.0

    def names(self) -> list[str]:
        """Active faults, as `name` or `name@port`."""
        return [o.name if o.port is None else f"{o.name}@{o.port}" for o in self._active.values()]

    def corrupt(self, port: PortName, data: bytes, rng: np.random.Generator) -> bytes:
        """The bytes after the faults of the line have been applied."""
        if not self._active or not data:
            return data
        if ("mute", port) in self._active:
            return b""
        if ("misbaud", port) in self._active:
            return bytes(rng.integers(0, 256, len(data), dtype=np.uint8))
        drop, garble = self.strength("drop", port), self.strength("garble", port)
        if drop == 0.0 and garble == 0.0:
            return data
        out = bytearray()
        for byte in data:
            if rng.random() < drop:
                continue
            out += _garble(byte, rng) if rng.random() < garble else bytes((byte,))
        return bytes(out)


def _garble(byte: int, rng: np.random.Generator) -> bytes:
    """One byte with one bit flipped, doubled, or followed by a random byte."""
    match int(rng.integers(3)):
        case 0:
            return bytes((byte ^ 1 << int(rng.integers(8)),))
        case 1:
            return bytes((byte, byte))
        case _:
            return bytes((byte, int(rng.integers(256))))
