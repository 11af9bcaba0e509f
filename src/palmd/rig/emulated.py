"""What every emulated rig has: time in steps, and lines from its devices to the host, spoilt and counted. Pure."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np

from palmd.quantities import Topic
from palmd.rig.actuators import LineDevice
from palmd.rig.fault_injection import FaultOrder, PortName, Switchboard
from palmd.rig.line import Wire
from palmd.rig.pads import PadEmulator, Press
from palmd.rig.shapes import Kind
from palmd.rig.tally import Decoder, DeviceTally

STEP_S = 5e-4
ARM: PortName = "arm"
_NO_LINE_BAUD = 10_000_000  # of what is no serial line and takes no time
_FINGER_M = 0.045

Arm = TypeVar("Arm", bound=LineDevice)


class EmulatedRig(ABC, Generic[Arm]):
    """Pads and an arm, each on a port. Times are seconds on one clock of the caller's choice, never running back."""

    step_s = STEP_S
    topics: ClassVar[tuple[Topic, Topic]]
    """What `truth` and `object_truth` are published as."""
    gauges: ClassVar[frozenset[str]] = frozenset()
    """By which arguments of its own it is made otherwise than with a random body that its own plant moves."""
    seed: int
    kind: Kind
    objects = 0
    """How many there have been, of which kind."""

    def __init__(self, pads: Mapping[PortName, PadEmulator], arm: Arm, rng: np.random.Generator, t: float) -> None:
        """At t (s)."""
        self.mischief = Switchboard()
        self._pads, self._arm, self._rng = pads, arm, rng
        self._t_start, self._steps = t, 0
        self.bauds: dict[PortName, int | None] = {name: pad.baud for name, pad in pads.items()} | {ARM: arm.baud}
        self.ports = tuple(self.bauds)
        self._out = {port: Wire(baud or _NO_LINE_BAUD) for port, baud in self.bauds.items()}
        self._said = {port: DeviceTally() for port in self.ports}

    @property
    def t(self) -> float:
        """The time the rig stands at (s)."""
        return self._t_start + self._steps * self.step_s

    def advance(self, t: float) -> dict[PortName, bytes]:
        """Lives on to t (s) and returns what has come out of each port on the way."""
        for _ in range(int((t - self.t) / self.step_s + 1e-6)):
            self._step()
        return {port: wire.take(t, self.mischief.strength("burst", port)) for port, wire in self._out.items()}

    def receive(self, port: PortName, data: bytes, late_s: float = 0.0) -> None:
        """Takes what the host has just written to a port, or up to late_s (s) later."""
        spoilt = self.mischief.spoil(port, data, self._rng)
        if port == ARM:
            self._arm.receive(data, spoilt, self.t, late_s)
        else:
            self._pads[port].hear(spoilt, self.t)

    def opened(self, port: PortName) -> None:
        """The host has opened a port. For a pad that starts with a handshake this stands for its breaks.

        A pseudo-terminal cannot carry a break, so the identity is sent as long after the opening as it would
        be after the break, once for each.
        """
        if port in self._pads:
            for identity, after_s in self._pads[port].greeting():
                self._said[port].take(identity, identity, messages=0)
                self._out[port].send(identity, self.t + after_s)

    def listener(self, port: PortName) -> Decoder:
        """A new decoder of what comes out of a port."""
        return self._arm.listener() if port == ARM else self._pads[port].listener()

    def unplugged(self, port: PortName) -> bool:
        """Whether mischief has pulled the plug of the port."""
        return self.mischief.strength("unplug", port) > 0.0

    def status(self) -> dict[str, Any]:
        """Counts for end-to-end checks."""
        return {
            "t_s": self.t - self._t_start,
            "clock_s": self.t,
            "seed": self.seed,
            "kind": self.kind,
            "arm_state": str(self._arm.state),
            "object": self.objects,
            **self._counts(),
            "mischief": self.mischief.names(),
            **{f"{name}_packets": pad.packets for name, pad in self._pads.items()},
            **{f"{port}_{what}": n for port, said in self._said.items() for what, n in said.as_dict().items()},
            **{f"{port}_bytes_waiting": wire.waiting for port, wire in self._out.items()},
            **self._arm.status(),
        }

    def truth(self) -> dict[str, Any]:
        """What is really there at `t`."""
        return {}

    def object_truth(self) -> dict[str, Any]:
        """The body itself."""
        return {}

    def new_object(self) -> None:
        """A hand exchanges the body, where there is one."""
        return

    @abstractmethod
    def _step(self) -> None:
        """So much time of everything."""

    @abstractmethod
    def _play(self, order: FaultOrder, begins: bool) -> None:
        """Mischief that is an act rather than a state of the lines."""

    @abstractmethod
    def _felt(self, pad: PortName) -> list[Press]:
        """What of the rig's presses on a pad."""

    def _counts(self) -> dict[str, Any]:
        """What else the status tells."""
        return {}

    def _late(self, pad: PortName) -> float:  # noqa: ARG002
        """How long after the measurement a pad speaks, beyond what it should (s)."""
        return 0.0

    def _play_all(self, t: float) -> None:
        for order, begins in self.mischief.update(t):
            self._play(order, begins)

    def _speak(self, t: float) -> None:
        """Whoever has something to say says it."""
        for said in self._arm.step(t):
            self._say(ARM, said.data, said.t, said.messages)
        for name, pad in self._pads.items():
            if t >= pad.due:
                self._say(name, pad.report(t, self._presses(name)), t + self._late(name))

    def _presses(self, pad: PortName) -> list[Press]:
        finger = self.mischief.strength("touch", pad)
        presses = self._felt(pad) + ([Press(_FINGER_M, finger)] if finger > 0.0 else [])
        times = self.mischief.strength("saturate", pad)
        return [replace(each, force=times * each.force) for each in presses] if times > 0.0 else presses

    def _say(self, port: PortName, data: bytes, t: float, messages: int = 1) -> None:
        """Sends what was measured at t (s); the first byte, which only says what follows, arrives then."""
        if data:
            wire = self._out[port]
            late = self.mischief.strength("late", port) - wire.byte_s
            spoilt = self.mischief.spoil(port, data, self._rng)
            self._said[port].take(data, spoilt, messages)
            wire.send(spoilt, t + late)
