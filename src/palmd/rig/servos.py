"""An emulated bus of servos of any make: shafts, gear backlash, and the palms that they turn. Pure.

A kind `K` is implemented in `palmd/rig/servokinds/K.py`, which defines `EMULATOR`.
"""

from __future__ import annotations

import importlib
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

import numpy as np

from palmd.config.arms import ArmConfig, ServoConfig, ServosConfig
from palmd.config.two_palms import Config
from palmd.devices.actuator import ArmState
from palmd.devices.servobus import COUNTS_PER_TURN, Packet, PacketReader, Register
from palmd.events import Joints, PalmMotion
from palmd.rig.actuators import Transmission
from palmd.rig.arm import Servo
from palmd.rig.fault_injection import FaultOrder
from palmd.rig.line import Wire
from palmd.rig.plant import Hinge, PlantContact
from palmd.system.mechanism import directions, joints_between

FLICKER_COUNTS = 0.5  # standard deviation of the encoder's noise
SHAFT_LAG_S = 0.020
REBOOT_S = 0.4
BACKLASH_S = 0.010  # in which a palm moves from one end of the backlash to the other
PALM_KG, PALM_CENTRE_M = 0.040, 0.045
JOINT_FRICTION_N_M = 2e-3  # moment up to which joint friction holds the palm
TORQUE_LAG_S = 0.030  # time constant with which a moment is transmitted through the gears
GRAVITY = 9.81
RADIANS_PER_COUNT = math.tau / COUNTS_PER_TURN
_LEVER_M = 0.12  # lever with which the strength (m) of a `jump` is converted to an angle


class Backlash:
    """A palm's position in its gears' backlash: it settles, critically damped, at the end to which it is pushed."""

    def __init__(self, width: float, side: int, t: float) -> None:
        """`width` from end to end (rad); at rest at one end (`side` 1 or −1) at t (s)."""
        self._half, self._side, self._t = 0.5 * width, side, t
        self._k = 4.0 / BACKLASH_S
        self._a = self._b = 0.0

    def push(self, side: int, t: float) -> None:
        """Push towards one end (1 or −1) from t (s) on."""
        if side == self._side:
            return
        offset, rate, _ = self.at(t)
        self._t, self._side = t, side
        self._a = offset - side * self._half
        self._b = rate + self._k * self._a

    def at(self, t: float) -> tuple[float, float, float]:
        """Offset, rate and acceleration (rad, s) at t (s)."""
        tau = t - self._t
        decay = math.exp(-self._k * tau)
        swing, b = (self._a + self._b * tau) * decay, self._b * decay
        k = self._k
        return self._side * self._half + swing, b - k * swing, k * (k * swing - 2.0 * b)


class CommonRegisters(NamedTuple):
    """Registers that every make has; a hardware error in both `error` and `shutdown` switches the torque off."""

    id: Register
    baud: Register
    torque: Register
    error: Register
    shutdown: Register


class ServoShaft(ABC):
    """One servo of any make: its control table, and its shaft.

    Shaft positions are in counts; the configured sign relates them to palm directions.
    """

    registers: ClassVar[CommonRegisters]
    hardware_errors: ClassVar[Mapping[str, int]]
    """Bit of the register `error` by injected fault."""
    refusals = 0
    _table: bytearray

    def __init__(self, config: ServoConfig, direction: float, rng: np.random.Generator, t: float) -> None:
        """At rest with its palm at `direction` (rad) at t (s)."""
        self._config, self._rng = config, rng
        self._shaft = Servo(self._counts(direction), SHAFT_LAG_S)
        self._t_arrival = -math.inf  # when the motion to the goal ends
        self._t_ready = t  # from when on it answers
        self._frozen: float | None = None  # counts that a frozen encoder reports
        self._offset_counts = 0.0  # injected encoder error
        self._load = 0.0  # N m, in the direction of increasing counts

    def get(self, register: Register) -> int:
        """A register's value."""
        return register.decode(self._table[register.address : register.end])

    def _set(self, register: Register, value: int) -> None:
        self._table[register.address : register.end] = register.encode(value)

    @property
    def id(self) -> int:
        """Its number on the bus."""
        return self.get(self.registers.id)

    @property
    def torque(self) -> bool:
        """Whether its torque is enabled."""
        return bool(self.get(self.registers.torque))

    def is_listening(self, baud_code: int, t: float) -> bool:
        """Whether it receives and answers on a bus of this speed."""
        return t >= self._t_ready and self.get(self.registers.baud) == baud_code

    def fail(self, trouble: str, t: float) -> None:
        """Raise the hardware error of the injected fault `trouble`; torque goes off if the shutdown mask says so."""
        error, registers = self.hardware_errors[trouble], self.registers
        self._set(registers.error, self.get(registers.error) | error)
        if self.get(registers.shutdown) & error:
            self._set(registers.torque, 0)
            self._stop(t)

    @property
    @abstractmethod
    def has_failed(self) -> bool:
        """Whether a host would read a fault."""

    @property
    @abstractmethod
    def follows(self) -> bool:
        """Whether it is in a state in which it follows goals."""

    @abstractmethod
    def step(self, t: float) -> None:
        """Advance to t (s)."""

    @abstractmethod
    def restart(self, t: float, silent_s: float = REBOOT_S) -> None:
        """Restart as after a loss of power: RAM is reset, and it does not answer for `silent_s`."""

    def at(self, t: float) -> tuple[float, float, float]:
        """The palm's direction (rad), rate and acceleration at t (s), without backlash."""
        x, v, a = self._shaft.at(t)
        scale = self._config.sign * RADIANS_PER_COUNT
        return math.radians(self._config.centre_deg) + scale * (x - 2048), scale * v, scale * a

    def set_load(self, moment: float) -> None:
        """Set the palm's moment about the hinge (N m, counter-clockwise)."""
        self._load = self._config.sign * moment

    def set_blocked(self, blocked: bool, t: float) -> None:
        """Block the palm from t (s) on, or release it."""
        if blocked:
            self._shaft.block(t)
        else:
            self._shaft.release(t)

    def set_frozen(self, frozen: bool, t: float) -> None:
        """Freeze the encoder at its value at t (s), or unfreeze it."""
        self._frozen = self._shaft.at(t)[0] if frozen else None

    def set_offset(self, error_rad: float) -> None:
        """Set the encoder's injected error (rad)."""
        self._offset_counts = self._config.sign * error_rad / RADIANS_PER_COUNT

    def _encoder_counts(self, t: float) -> tuple[float, float]:
        """Counts and counts/s that the encoder reports at t (s)."""
        x, v, _ = self._shaft.at(t)
        x = (x if self._frozen is None else self._frozen) + self._offset_counts
        return x + float(self._rng.normal(0.0, FLICKER_COUNTS)), v

    def _counts(self, direction: float) -> float:
        return 2048 + self._config.sign * (direction - math.radians(self._config.centre_deg)) / RADIANS_PER_COUNT

    def _stop(self, t: float) -> None:
        self._shaft.follow(t, 0.0)
        self._t_arrival = math.inf


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
        """`servos` are at rest at t (s) without torque; `reader` decodes the host's packets."""
        self.baud = arm.baud
        self.hinge = Hinge("fixed", config.rig.palm_lengths_mm[0] * 1e-3, (0.0, 0.0))
        self.jams = 0
        self._rng = rng
        self._servos = tuple(servos)
        width = math.radians(arm.backlash_deg)
        self._backlashes = (Backlash(width, -1, t), Backlash(width, 1, t))
        self._reader = reader
        self._in = Wire(arm.baud)
        self._moments = [0.0, 0.0]
        self._instructions = self._goals = self._outside = 0
        self._now = self._t_loaded = t

    @abstractmethod
    def _execute(self, packet: Packet, t: float) -> list[Transmission]:
        """Execute an instruction received at t (s); returns the servos' answers."""

    @abstractmethod
    def make_decoder(self) -> PacketReader:
        """A new decoder of the servos' answers."""

    @property
    def state(self) -> ArmState:
        """The state that a host would derive from the registers."""
        if any(servo.has_failed for servo in self._servos):
            return ArmState.FAULT
        return ArmState.TRACKING if all(servo.follows for servo in self._servos) else ArmState.READY

    def palms_at(self, t: float) -> PalmMotion:
        """The palms' motion, backlash included."""
        each = (
            tuple(x + y for x, y in zip(servo.at(t), backlash.at(t), strict=True))
            for servo, backlash in zip(self._servos, self._backlashes, strict=True)
        )
        return PalmMotion(*map(joints_between, zip(*each, strict=True)))

    def receive(self, sent: bytes, corrupted: bytes, t: float, late_s: float = 0.0) -> None:  # noqa: ARG002
        """Receive what the host wrote, as corrupted on the line."""
        self._in.send(corrupted, t)

    def step(self, t: float) -> Sequence[Transmission]:
        """Advance the servos to t (s); they execute what has arrived and answer in turn."""
        self._now = t
        for servo in self._servos:
            servo.step(t)
        transmissions: list[Transmission] = []
        if arrived := self._in.take(t):
            for packet in self._reader.feed(arrived, t):
                if not packet.is_status:
                    self._instructions += 1
                    transmissions += self._execute(packet, t)
        return transmissions

    def apply_contacts(self, palms: PalmMotion, contacts: Callable[[], Sequence[PlantContact]], t: float) -> None:
        """Push each palm to one end of its backlash by its weight and the object's contact force."""
        first, second = palms.angles[0], palms.angles[0] + palms.angles[1]
        weight = PALM_KG * GRAVITY * PALM_CENTRE_M
        signs, fraction = (-1.0, 1.0), (t - self._t_loaded) / TORQUE_LAG_S
        self._t_loaded = t
        for i, (sign, angle, contact) in enumerate(zip(signs, (first, second), contacts(), strict=True)):
            moment = -weight * math.cos(angle)
            if contact.touching:
                moment += sign * contact.s * contact.force
            self._moments[i] += min(fraction, 1.0) * (moment - self._moments[i])
            self._servos[i].set_load(self._moments[i])
            if abs(self._moments[i]) > JOINT_FRICTION_N_M:
                self._backlashes[i].push(1 if self._moments[i] > 0.0 else -1, t)

    def inject_fault(self, order: FaultOrder, begins: bool, palms: Joints) -> None:  # noqa: ARG002
        """Begin or end a fault of the servos; faults of a single servo act on palm 1's."""
        t = self._now
        match order.name, begins:
            case (("estop" | "power_off"), False):
                for servo in self._servos:
                    servo.restart(t)
            case (("estop" | "power_off"), True):
                for servo in self._servos:
                    servo.restart(t, math.inf)
            case (("overload" | "overheat" | "undervoltage"), True):
                self._servos[0].fail(order.name, t)
            case "brownout", True:
                self._servos[0].restart(t)
            case "block", _:
                for servo in self._servos:
                    servo.set_blocked(begins, t)
            case "freeze", _:
                for servo in self._servos:
                    servo.set_frozen(begins, t)
            case "jump", _:
                self._servos[0].set_offset(order.strength / _LEVER_M if begins else 0.0)

    def move_by_hand(self, palms: Joints) -> None:  # noqa: ARG002
        """Not supported: raises ValueError."""
        raise ValueError("--by-hand needs an arm: servos have no linkage to calibrate")

    def status(self) -> dict[str, Any]:
        """Counters of the bus."""
        return {
            "crc_errors": self._reader.counters.crc_errors,
            "instructions": self._instructions,
            "setpoints": self._goals,
            "setpoints_outside_limits": self._outside,
            "refusals": sum(servo.refusals for servo in self._servos),
        }


ServoArmFactory = Callable[..., ServoArm[Any]]
"""Takes the rig's and the arm's configuration, the palms' angles (rad), random numbers and the time (s)."""


def make_servo_arm(config: Config, arm: ArmConfig, home: Joints, rng: np.random.Generator, t: float) -> ServoArm[Any]:
    """The emulated servos of the configured kind, at rest at `home` (rad) at t (s), without torque."""
    emulator: ServoArmFactory = importlib.import_module(f"palmd.rig.servokinds.{arm.kind}").EMULATOR
    return emulator(config, arm, home, rng, t)


def servos_with_directions(arm: ServosConfig, home: Joints) -> list[tuple[ServoConfig, float]]:
    """Each servo's configuration and its palm's direction (rad)."""
    return list(zip(arm.servos, directions(home), strict=True))
