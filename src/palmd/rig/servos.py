"""An emulated bus of servos of any make: shafts, the play of their gears, and the palms that they turn. Pure.

A kind `K` is `palmd/rig/servokinds/K.py`, which says `EMULATOR`.
"""

from __future__ import annotations

import importlib
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, Generic, TypeVar

import numpy as np

from palmd.config.arms import ArmConfig, ServoConfig, ServosConfig
from palmd.config.two_palms import Config
from palmd.devices.actuator import ArmState
from palmd.devices.servobus import COUNTS_PER_TURN, Packet, PacketReader
from palmd.events import Joints, PalmMotion
from palmd.rig.actuators import Utterance
from palmd.rig.arm import Servo
from palmd.rig.fault_injection import FaultOrder
from palmd.rig.line import Wire
from palmd.rig.plant import Hinge, PlantContact
from palmd.system.mechanism import directions, joints_between

FLICKER_COUNTS = 0.5
SHAFT_LAG_S = 0.020
REBOOT_S = 0.4
PLAY_S = 0.010  # in which a palm falls from one end of the play to the other
PALM_KG, PALM_CENTRE_M = 0.040, 0.045
RUB_N_M = 2e-3  # what friction in the joint holds against
GREASE_S = 0.030  # in which a moment makes itself felt through the gears
GRAVITY = 9.81
RADIANS_PER_COUNT = math.tau / COUNTS_PER_TURN
_LEVER_M = 0.12  # at which a jump in metres is one of a palm's far end


class Play:
    """A palm between the two ends of its gears' play: it settles, critically damped, at the end it is pushed to."""

    def __init__(self, width: float, side: int, t: float) -> None:
        """`width` from end to end (rad); at rest at one end at t (s)."""
        self._half, self._side, self._t = 0.5 * width, side, t
        self._k = 4.0 / PLAY_S
        self._a = self._b = 0.0

    def push(self, side: int, t: float) -> None:
        """Towards one end (1 or -1) from t (s) on."""
        if side == self._side:
            return
        offset, rate, _ = self.at(t)
        self._t, self._side = t, side
        self._a = offset - side * self._half
        self._b = rate + self._k * self._a

    def at(self, t: float) -> tuple[float, float, float]:
        """Offset, its rate and acceleration (rad, s) at t (s)."""
        tau = t - self._t
        decay = math.exp(-self._k * tau)
        swing, b = (self._a + self._b * tau) * decay, self._b * decay
        k = self._k
        return self._side * self._half + swing, b - k * swing, k * (k * swing - 2.0 * b)


class ServoShaft(ABC):
    """One servo, of whatever make: its shaft in counts, which grow with the palm's direction as configured."""

    refusals = 0

    def __init__(self, config: ServoConfig, direction: float, rng: np.random.Generator, t: float) -> None:
        """Standing with its palm at `direction` (rad) at t (s)."""
        self._config, self._rng = config, rng
        self._shaft = Servo(self._counts(direction), SHAFT_LAG_S)
        self._t_there = -math.inf  # when the way to the goal ends
        self._t_awake = t
        self._frozen: float | None = None  # counts that the encoder goes on telling
        self._jump = 0.0  # counts that it tells too many
        self._load = 0.0  # N m, in the direction of growing counts

    @property
    @abstractmethod
    def torque(self) -> bool:
        """Whether it holds its goal."""

    @property
    @abstractmethod
    def has_failed(self) -> bool:
        """Whether a host would call it a fault."""

    @property
    @abstractmethod
    def follows(self) -> bool:
        """Whether a host has it follow."""

    @abstractmethod
    def step(self, t: float) -> None:
        """Lives on to t (s)."""

    @abstractmethod
    def hurt(self, trouble: str, t: float) -> None:
        """A hardware error by the name of its mischief."""

    @abstractmethod
    def restart(self, t: float, silent_s: float = REBOOT_S) -> None:
        """As without power for a while: RAM is wiped, and it is silent for so long."""

    def at(self, t: float) -> tuple[float, float, float]:
        """The palm's direction (rad), rate and acceleration, but for the play."""
        x, v, a = self._shaft.at(t)
        scale = self._config.sign * RADIANS_PER_COUNT
        return math.radians(self._config.centre_deg) + scale * (x - 2048), scale * v, scale * a

    def bear(self, moment: float) -> None:
        """The palm's moment (N m) about the hinge, anticlockwise."""
        self._load = self._config.sign * moment

    def block(self, held: bool, t: float) -> None:
        """Something holds the palm from t (s) on, or lets it go."""
        if held:
            self._shaft.block(t)
        else:
            self._shaft.release(t)

    def freeze(self, frozen: bool, t: float) -> None:
        """The encoder goes on telling what it tells at t (s), or the truth again."""
        self._frozen = self._shaft.at(t)[0] if frozen else None

    def jump(self, by_rad: float) -> None:
        """The encoder tells so much more."""
        self._jump = self._config.sign * by_rad / RADIANS_PER_COUNT

    def _told(self, t: float) -> tuple[float, float]:
        """Counts and counts/s at t (s) as the encoder tells them."""
        x, v, _ = self._shaft.at(t)
        x = (x if self._frozen is None else self._frozen) + self._jump
        return x + float(self._rng.normal(0.0, FLICKER_COUNTS)), v

    def _counts(self, direction: float) -> float:
        return 2048 + self._config.sign * (direction - math.radians(self._config.centre_deg)) / RADIANS_PER_COUNT

    def _stop(self, t: float) -> None:
        self._shaft.follow(t, 0.0)
        self._t_there = math.inf


Shaft = TypeVar("Shaft", bound=ServoShaft)


class ServoArm(ABC, Generic[Shaft]):
    """Both servos on their bus; see `rig.actuators.EmulatedActuator`."""

    def __init__(
        self,
        config: Config,
        arm: ServosConfig,
        servos: Sequence[Shaft],
        reader: PacketReader,
        rng: np.random.Generator,
        t: float,
    ) -> None:
        """`servos` stand still at t (s), without torque; `reader` is of what a host says."""
        self.baud = arm.baud
        self.hinge = Hinge("fixed", config.rig.palm_lengths_mm[0] * 1e-3, (0.0, 0.0))
        self.jams = 0
        self._rng = rng
        self._servos = tuple(servos)
        width = math.radians(arm.backlash_deg)
        self._plays = (Play(width, -1, t), Play(width, 1, t))
        self._reader = reader
        self._in = Wire(arm.baud)
        self._moments = [0.0, 0.0]
        self._instructions = self._goals = self._outside = 0
        self._now = self._t_felt = t

    @abstractmethod
    def _obey(self, packet: Packet, t: float) -> list[Utterance]:
        """What the servos do and say when they have heard a question at t (s)."""

    @abstractmethod
    def listener(self) -> PacketReader:
        """Of their answers."""

    @property
    def state(self) -> ArmState:
        """What a host would make of the registers."""
        if any(servo.has_failed for servo in self._servos):
            return ArmState.FAULT
        return ArmState.TRACKING if all(servo.follows for servo in self._servos) else ArmState.READY

    def palms_at(self, t: float) -> PalmMotion:
        """With the play."""
        each = (
            tuple(x + y for x, y in zip(servo.at(t), play.at(t), strict=True))
            for servo, play in zip(self._servos, self._plays, strict=True)
        )
        return PalmMotion(*map(joints_between, zip(*each, strict=True)))

    def receive(self, heard: bytes, spoilt: bytes, t: float, late_s: float = 0.0) -> None:  # noqa: ARG002
        """What the host has written, as the line leaves it."""
        self._in.send(spoilt, t)

    def step(self, t: float) -> Sequence[Utterance]:
        """Servos hear, move, and answer in turn."""
        self._now = t
        for servo in self._servos:
            servo.step(t)
        said: list[Utterance] = []
        if arrived := self._in.take(t):
            for packet in self._reader.feed(arrived, t):
                if not packet.is_status:
                    self._instructions += 1
                    said += self._obey(packet, t)
        return said

    def feel(self, palms: PalmMotion, contacts: Callable[[], Sequence[PlantContact]], t: float) -> None:
        """Weight and the object push each palm to one end of its play."""
        first, second = palms.angles[0], palms.angles[0] + palms.angles[1]
        weight = PALM_KG * GRAVITY * PALM_CENTRE_M
        signs, share = (-1.0, 1.0), (t - self._t_felt) / GREASE_S
        self._t_felt = t
        for i, (sign, angle, contact) in enumerate(zip(signs, (first, second), contacts(), strict=True)):
            moment = -weight * math.cos(angle)
            if contact.touching:
                moment += sign * contact.s * contact.force
            self._moments[i] += min(share, 1.0) * (moment - self._moments[i])
            self._servos[i].bear(self._moments[i])
            if abs(self._moments[i]) > RUB_N_M:
                self._plays[i].push(1 if self._moments[i] > 0.0 else -1, t)

    def play(self, order: FaultOrder, begins: bool, palms: Joints) -> None:  # noqa: ARG002
        """What is done to the servos: always to palm 1's."""
        t = self._now
        match order.name, begins:
            case (("estop" | "power_off"), False):
                for servo in self._servos:
                    servo.restart(t)
            case (("estop" | "power_off"), True):
                for servo in self._servos:
                    servo.restart(t, math.inf)
            case (("overload" | "overheat" | "undervoltage"), True):
                self._servos[0].hurt(order.name, t)
            case "brownout", True:
                self._servos[0].restart(t)
            case "block", _:
                for servo in self._servos:
                    servo.block(begins, t)
            case "freeze", _:
                for servo in self._servos:
                    servo.freeze(begins, t)
            case "jump", _:
                self._servos[0].jump(order.strength / _LEVER_M if begins else 0.0)

    def hold_by_hand(self, palms: Joints) -> None:  # noqa: ARG002
        """Servos are not swung by hand to be calibrated."""
        raise ValueError("--by-hand is for a rig with an arm: servos need no linkage to be calibrated")

    def status(self) -> dict[str, Any]:
        """Counts of the bus."""
        return {
            "crc_errors": self._reader.counters.crc_errors,
            "instructions": self._instructions,
            "setpoints": self._goals,
            "setpoints_outside_limits": self._outside,
            "refusals": sum(servo.refusals for servo in self._servos),
        }


ServoArmFactory = Callable[..., ServoArm[Any]]
"""Takes the rig's configuration, the arm's, where the palms stand (rad), random numbers and the time (s)."""


def make_servo_arm(config: Config, arm: ArmConfig, home: Joints, rng: np.random.Generator, t: float) -> ServoArm[Any]:
    """The emulated servos of the configured kind, at rest at `home` (rad) at t (s), without torque."""
    emulator: ServoArmFactory = importlib.import_module(f"palmd.rig.servokinds.{arm.kind}").EMULATOR
    return emulator(config, arm, home, rng, t)


def palms_of(arm: ServosConfig, home: Joints) -> list[tuple[ServoConfig, float]]:
    """Each servo's configuration, and where its palm stands (rad)."""
    return list(zip(arm.servos, directions(home), strict=True))
