"""Common parts of every emulated rig: time in steps, and lines from its devices to the host. Pure."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np

from palmd.aliases import RIG_STATUS, with_former_names
from palmd.quantities import Topic
from palmd.rig.actuators import LineDevice
from palmd.rig.fault_injection import FaultInjector, FaultOrder, PortName
from palmd.rig.line import Wire
from palmd.rig.pads import PadEmulator, Press
from palmd.rig.shapes import Kind
from palmd.rig.tally import Decoder, DeviceTally

STEP_S = 5e-4
ARM: PortName = "arm"
_NO_LINE_BAUD = 10_000_000  # of a device without a serial line, so that transmission takes no time
_FINGER_M = 0.045  # where the injected finger presses

Arm = TypeVar("Arm", bound=LineDevice)


class EmulatedRig(ABC, Generic[Arm]):
    """Pads and an arm, each on a port. Times are seconds of one clock that the caller chooses; they never decrease."""

    step_s = STEP_S
    topics: ClassVar[tuple[Topic, Topic]]
    """Topics of `truth` and `object_truth`."""
    extra_arguments: ClassVar[frozenset[str]] = frozenset()
    """Names of the rig's own constructor arguments, with which it differs from a random body on its own plant."""
    seed: int
    kind: Kind
    objects = 0
    """Number of objects so far, all of this kind."""

    def __init__(self, pads: Mapping[PortName, PadEmulator], arm: Arm, rng: np.random.Generator, t: float) -> None:
        """All devices start at t (s)."""
        self.fault_injector = FaultInjector()
        self._pads, self._arm, self._rng = pads, arm, rng
        self._t_start, self._steps = t, 0
        self.bauds: dict[PortName, int | None] = {name: pad.baud for name, pad in pads.items()} | {ARM: arm.baud}
        self.ports = tuple(self.bauds)
        self._out = {port: Wire(baud or _NO_LINE_BAUD) for port, baud in self.bauds.items()}
        self._tallies = {port: DeviceTally() for port in self.ports}

    @property
    def t(self) -> float:
        """The rig's present time (s)."""
        return self._t_start + self._steps * self.step_s

    def advance(self, t: float) -> dict[PortName, bytes]:
        """Advance to t (s) and return the bytes that have left each port on the way."""
        for _ in range(int((t - self.t) / self.step_s + 1e-6)):
            self._step()
        return {port: wire.take(t, self.fault_injector.strength("burst", port)) for port, wire in self._out.items()}

    def receive(self, port: PortName, data: bytes, late_s: float = 0.0) -> None:
        """Take what the host wrote to a port just now, or up to late_s (s) later."""
        corrupted = self.fault_injector.corrupt(port, data, self._rng)
        if port == ARM:
            self._arm.receive(data, corrupted, self.t, late_s)
        else:
            self._pads[port].receive(corrupted, self.t)

    def opened(self, port: PortName) -> None:
        """The host has opened a port. A pad that starts with a handshake then behaves as after the host's breaks.

        A pseudo-terminal cannot carry a break, so the identity is sent as long after the opening as it would be after
        the break, once for each break.
        """
        if port in self._pads:
            for identity, after_s in self._pads[port].greeting():
                self._tallies[port].take(identity, identity, messages=0)
                self._out[port].send(identity, self.t + after_s)

    def make_decoder(self, port: PortName) -> Decoder:
        """A new decoder of the bytes that leave a port."""
        return self._arm.make_decoder() if port == ARM else self._pads[port].make_decoder()

    def unplugged(self, port: PortName) -> bool:
        """Whether fault injection has unplugged the port."""
        return self.fault_injector.strength("unplug", port) > 0.0

    def status(self) -> dict[str, Any]:
        """Counters and state for end-to-end checks."""
        fields = {
            "t_s": self.t - self._t_start,
            "clock_s": self.t,
            "seed": self.seed,
            "kind": self.kind,
            "arm_state": str(self._arm.state),
            "object": self.objects,
            **self._counts(),
            "injected_faults": self.fault_injector.names(),
            **{f"{name}_packets": pad.packets for name, pad in self._pads.items()},
            **{f"{port}_{what}": n for port, tally in self._tallies.items() for what, n in tally.as_dict().items()},
            **{f"{port}_bytes_waiting": wire.waiting for port, wire in self._out.items()},
            **self._arm.status(),
        }
        return with_former_names(RIG_STATUS, fields)

    def truth(self) -> dict[str, Any]:
        """The true state at `t`."""
        return {}

    def object_truth(self) -> dict[str, Any]:
        """The body itself."""
        return {}

    def new_object(self) -> None:
        """Exchange the body, if there is one."""
        return

    @abstractmethod
    def _step(self) -> None:
        """Advance everything by one step."""

    @abstractmethod
    def _inject_fault(self, order: FaultOrder, begins: bool) -> None:
        """Begin or end a fault that acts on the rig's devices or body rather than on its lines."""

    @abstractmethod
    def _object_presses(self, pad: PortName) -> list[Press]:
        """Presses of the rig's own object on a pad."""

    def _counts(self) -> dict[str, Any]:
        """Additional entries of the status."""
        return {}

    def _reporting_delay(self, pad: PortName) -> float:  # noqa: ARG002
        """Delay (s) of a pad's report after the measurement, beyond the nominal one."""
        return 0.0

    def _inject_due_faults(self, t: float) -> None:
        for order, begins in self.fault_injector.update(t):
            self._inject_fault(order, begins)

    def _transmit_due(self, t: float) -> None:
        """Transmit everything that is due."""
        for transmission in self._arm.step(t):
            self._transmit(ARM, transmission.data, transmission.t, transmission.messages)
        for name, pad in self._pads.items():
            if t >= pad.due:
                self._transmit(name, pad.report(t, self._presses(name)), t + self._reporting_delay(name))

    def _presses(self, pad: PortName) -> list[Press]:
        finger = self.fault_injector.strength("touch", pad)
        presses = self._object_presses(pad) + ([Press(_FINGER_M, finger)] if finger > 0.0 else [])
        gain = self.fault_injector.strength("saturate", pad)
        return [replace(each, force=gain * each.force) for each in presses] if gain > 0.0 else presses

    def _transmit(self, port: PortName, data: bytes, t: float, messages: int = 1) -> None:
        """Transmit what was measured at t (s); the first byte, which announces the rest, arrives at that time."""
        if data:
            wire = self._out[port]
            delay = self.fault_injector.strength("late", port) - wire.byte_s
            corrupted = self.fault_injector.corrupt(port, data, self._rng)
            self._tallies[port].take(data, corrupted, messages)
            wire.send(corrupted, t + delay)
