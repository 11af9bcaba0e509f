"""What the emulated world asks of whatever turns its palms: an arm that holds palm 2's end, or servos. Pure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

from palmd.devices.actuator import ArmState
from palmd.events import Joints, PalmMotion
from palmd.rig.fault_injection import FaultOrder
from palmd.rig.plant import Hinge, PlantContact
from palmd.rig.tally import Decoder


class Utterance(NamedTuple):
    """Bytes that the device says, from `t` (s) on; so many messages of its protocol."""

    data: bytes
    t: float
    messages: int = 1


class LineDevice(Protocol):
    """The far side of the actuator's line. Times are seconds of the rig's clock."""

    baud: int

    @property
    def state(self) -> ArmState:
        """As a host would be told."""

    def receive(self, heard: bytes, spoilt: bytes, t: float, late_s: float = 0.0) -> None:
        """The host has written `heard` at t (s) or up to late_s (s) later, of which `spoilt` is left on the line."""

    def step(self, t: float) -> Sequence[Utterance]:
        """Lives on to t (s) and says what there is to say."""

    def status(self) -> dict[str, Any]:
        """Counts for end-to-end checks."""

    def listener(self) -> Decoder:
        """A new decoder of what it says."""


class EmulatedActuator(LineDevice, Protocol):
    """An actuator, and the palms that it turns."""

    hinge: Hinge
    jams: int

    def palms_at(self, t: float) -> PalmMotion:
        """Where the palms are and how they move, as the actuator has them; t (s) no earlier than the last step."""

    def feel(self, palms: PalmMotion, contacts: Callable[[], Sequence[PlantContact]], t: float) -> None:
        """What presses on the palms at t (s), for one that can tell: `contacts` finds it out."""

    def play(self, order: FaultOrder, begins: bool, palms: Joints) -> None:
        """Mischief that is an act rather than a state of the line; `palms` are where they stand (rad)."""

    def hold_by_hand(self, palms: Joints) -> None:
        """A hand turns the palms, which the actuator allows; ValueError where it does not."""
