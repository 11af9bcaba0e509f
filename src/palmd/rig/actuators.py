"""Interfaces between the emulated rig and the actuator that turns its palms (an arm that holds palm 2, or servos)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

from palmd.devices.actuator import ArmState
from palmd.events import Joints, PalmMotion
from palmd.rig.fault_injection import FaultOrder
from palmd.rig.plant import Hinge, PlantContact
from palmd.rig.tally import Decoder


class Transmission(NamedTuple):
    """Bytes that a device sends from `t` (s) on; they hold `messages` messages of its protocol."""

    data: bytes
    t: float
    messages: int = 1


class LineDevice(Protocol):
    """A device at the far end of the actuator's line. Times are seconds of the rig's clock."""

    baud: int

    @property
    def state(self) -> ArmState:
        """The state that a host would read."""

    def receive(self, sent: bytes, corrupted: bytes, t: float, late_s: float = 0.0) -> None:
        """Receive what the host wrote at t (s), or up to late_s (s) later.

        `sent` is what the host wrote, `corrupted` what arrives after fault injection.
        """

    def step(self, t: float) -> Sequence[Transmission]:
        """Advance to t (s) and return what the device transmits."""

    def status(self) -> dict[str, Any]:
        """Counters for end-to-end checks."""

    def make_decoder(self) -> Decoder:
        """A new decoder of the bytes that the device transmits."""


class EmulatedActuator(LineDevice, Protocol):
    """An actuator and the palms that it turns."""

    hinge: Hinge
    jams: int

    def palms_at(self, t: float) -> PalmMotion:
        """The palms' angles and rates as the actuator positions them; t (s) must not precede the last step."""

    def apply_contacts(self, palms: PalmMotion, contacts: Callable[[], Sequence[PlantContact]], t: float) -> None:
        """Apply the loads on the palms at t (s), if the actuator yields to them; `contacts` computes them on demand."""

    def inject_fault(self, order: FaultOrder, begins: bool, palms: Joints) -> None:
        """Begin or end a fault that acts on the actuator itself; `palms` are the present joint angles (rad)."""

    def move_by_hand(self, palms: Joints) -> None:
        """Set the palms to where a hand holds them (rad); raises ValueError if the actuator cannot be moved by hand."""
