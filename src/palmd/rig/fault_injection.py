"""What can go wrong on the emulated rig, by name: a table, and the switchboard that says what is on. Pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palmd.system.mechanism import ENDS, PALMS

PortName = str
"""`arm`, or `pad` and the number of its palm."""
PORTS: tuple[PortName, ...] = ENDS
PADS, ARM = PORTS[:-1], PORTS[-1:]


@dataclass(frozen=True, slots=True)
class InjectableFault:
    """One kind of mischief: what it does, which ports it can be done to, and how strongly by default.

    `strength` is a probability per byte, a time or a force, as the description says; `ports` is empty for
    what happens to the object.
    """

    name: str
    description: str
    ports: tuple[PortName, ...] = ()
    strength: float = 1.0


INJECTABLE_FAULTS: dict[str, InjectableFault] = {
    trick.name: trick
    for trick in (
        InjectableFault("drop", "each byte is lost with this probability", PORTS, 0.05),
        InjectableFault("garble", "each byte is flipped, doubled or made up with this probability", PORTS, 0.05),
        InjectableFault("mute", "the device neither speaks nor hears", PORTS),
        InjectableFault("unplug", "the port disappears; it comes back under another number", PORTS),
        InjectableFault("late", "everything the device says comes this many seconds later", PORTS, 0.05),
        InjectableFault("burst", "a USB adapter delivers only once in this many seconds", PORTS, 0.016),
        InjectableFault("misbaud", "the device runs at another speed than configured", PORTS),
        InjectableFault("touch", "a finger presses on the pad as well, with this many newtons", PADS, 0.5),
        InjectableFault("break", "a break on the line: a moving arm takes it for the loss of its link", ARM),
        InjectableFault("estop", "the emergency stop is pressed; off releases it and makes the arm ready", ARM),
        InjectableFault("power_off", "arm power goes; off restores it", ARM),
        InjectableFault("manual", "the operator takes the arm and jogs it a little; off gives it back", ARM),
        InjectableFault("block", "something holds the arm where it is, its controller does not notice", ARM),
        InjectableFault("freeze", "the arm goes on moving and reports the same pose all the time", ARM),
        InjectableFault(
            "jump", "the arm reports an x that is greater by so many metres, from one report to the next", ARM, 0.02
        ),
        InjectableFault("saturate", "the pad tells so many times the pressure, until its scale ends", PADS, 8.0),
        InjectableFault("lift", "the object is lifted off by hand; off puts it back in another pose"),
        InjectableFault("swap", "the object is exchanged for another one, at once"),
    )
}

SERVO_FAULTS: dict[str, InjectableFault] = {
    trick.name: trick
    for trick in (
        InjectableFault("overload", f"palm {PALMS[0]}'s servo is overloaded and lets go", ARM),
        InjectableFault("overheat", f"palm {PALMS[0]}'s servo gets too hot and lets go", ARM),
        InjectableFault("undervoltage", f"palm {PALMS[0]}'s servo says that its supply is out of range", ARM),
        InjectableFault("brownout", f"palm {PALMS[0]}'s servo starts anew and has lost its settings", ARM),
    )
}
"""Of a rig that servos turn; on another they do nothing."""

INPUT_FAULTS: dict[str, InjectableFault] = {
    "overflow": InjectableFault("overflow", "the kernel drops what an input device said, and says so", PADS)
}
"""Of a rig whose pads are input devices; to others they do nothing."""

ALL_FAULTS = INJECTABLE_FAULTS | SERVO_FAULTS | INPUT_FAULTS


class InjectionError(ValueError):
    """A mischief nobody knows, or for a port it cannot be done to."""


@dataclass(frozen=True, slots=True)
class FaultOrder:
    """A wish for mischief: on `port` (None where it has none), this strong, from t_on to t_off (s)."""

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
    """The orders for a trick from t + after_s on, for for_s seconds (None: until switched off).

    Without a port it is done to every port it can be done to. Raises InjectionError for what cannot be.
    """
    trick = ALL_FAULTS.get(name)
    if trick is None:
        raise InjectionError(f"no mischief {name!r}; there are {', '.join(ALL_FAULTS)}")
    if port is not None and port not in trick.ports:
        raise InjectionError(f"{name} is for {' or '.join(trick.ports) or 'no port in particular'}, not {port!r}")
    force = trick.strength if strength is None else strength
    if not force >= 0.0 or not after_s >= 0.0 or (for_s is not None and not for_s > 0.0):
        raise InjectionError(f"{name}: strength and times must be positive numbers")
    ports: list[PortName | None] = [p for p in trick.ports if port in (None, p)] or [None]
    t_on = t + after_s
    t_off = float("inf") if for_s is None else t_on + for_s
    return [FaultOrder(name, p, force, t_on, t_off) for p in ports]


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


class Switchboard:
    """Which mischief is on. Times are told to it; it never looks at a clock."""

    def __init__(self) -> None:
        self._waiting: list[FaultOrder] = []
        self._active: dict[tuple[str, PortName | None], FaultOrder] = {}

    def add(self, orders: list[FaultOrder]) -> None:
        """Takes orders for later or for now."""
        self._waiting += orders

    def cancel(self, name: str, port: str | None) -> None:
        """Forgets what is still to come of a trick, and ends what is on at the next `update`."""
        if name not in ALL_FAULTS:
            raise InjectionError(f"no mischief {name!r}; there are {', '.join(ALL_FAULTS)}")
        self._waiting = [o for o in self._waiting if o.name != name or port not in (None, o.port)]
        for key, active in self._active.items():
            if active.name == name and port in (None, active.port):
                self._active[key] = FaultOrder(name, active.port, active.strength, active.t_on, 0.0)

    def update(self, t: float) -> list[tuple[FaultOrder, bool]]:
        """What has just begun (True) or ended (False) by t (s)."""
        if not self._waiting and not self._active:
            return []
        changes = [(o, False) for o in self._active.values() if t >= o.t_off]
        for ended, _ in changes:
            del self._active[ended.name, ended.port]
        for begun in [o for o in self._waiting if t >= o.t_on]:
            self._waiting.remove(begun)
            self._active[begun.name, begun.port] = begun
            changes.append((begun, True))
        return changes

    def strength(self, name: str, port: PortName | None) -> float:
        """How strongly the trick is on for the port; 0 if it is off."""
        if not self._active:
            return 0.0
        found = self._active.get((name, port))
        return found.strength if found else 0.0

    def names(self) -> list[str]:
        """What is on, as `name` or `name@port`."""
        return [o.name if o.port is None else f"{o.name}@{o.port}" for o in self._active.values()]

    def spoil(self, port: PortName, data: bytes, rng: np.random.Generator) -> bytes:
        """The bytes as the tricks of the line leave them."""
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
            out += _garbled(byte, rng) if rng.random() < garble else bytes((byte,))
        return bytes(out)


def _garbled(byte: int, rng: np.random.Generator) -> bytes:
    """One byte flipped in one bit, doubled, or followed by one that was never sent."""
    match int(rng.integers(3)):
        case 0:
            return bytes((byte ^ 1 << int(rng.integers(8)),))
        case 1:
            return bytes((byte, byte))
        case _:
            return bytes((byte, int(rng.integers(256))))
