"""What servos of every make have in common on their bus: packets, registers, and what a host must know about a make.

Everything here is pure and safe inside the 100 Hz loop.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from palmd.devices.framing import Frame, FrameScanner

COUNTS_PER_TURN = 4096


class Register(NamedTuple):
    """An entry of a servo's control table: where it begins, how many bytes it has, and how it is signed.

    signed: two's complement. sign_bit: the bit that says that the rest of them is negative, None where there is none.
    Numbers are little-endian.
    """

    address: int
    size: int
    signed: bool = False
    sign_bit: int | None = None

    @property
    def end(self) -> int:
        """The address after it."""
        return self.address + self.size

    def encode(self, value: int) -> bytes:
        """Its bytes. Raises OverflowError for what it cannot hold."""
        if self.sign_bit is None:
            return value.to_bytes(self.size, "little", signed=self.signed)
        if abs(value) >= 1 << self.sign_bit:
            raise OverflowError(f"register {self.address} holds less than {1 << self.sign_bit} in size, not {value}")
        return (abs(value) | (value < 0) << self.sign_bit).to_bytes(self.size, "little")

    def decode(self, raw: bytes | bytearray) -> int:
        """The value of its bytes."""
        if self.sign_bit is None:
            return int.from_bytes(raw, "little", signed=self.signed)
        value = int.from_bytes(raw, "little")
        size = value & ((1 << self.sign_bit) - 1)
        return -size if value >> self.sign_bit & 1 else size


class Registers:
    """A stretch of one servo's table as read: `registers[POSITION]` is a number."""

    def __init__(self, address: int, data: bytes) -> None:
        self._address, self._data = address, data

    def __contains__(self, register: Register) -> bool:
        return self._address <= register.address and register.end <= self._address + len(self._data)

    def __getitem__(self, register: Register) -> int:
        """Raises KeyError for a register that was not read."""
        if register not in self:
            raise KeyError(register)
        start = register.address - self._address
        return register.decode(self._data[start : start + register.size])

    def get(self, register: Register) -> int | None:
        """None for a register that was not read."""
        return self[register] if register in self else None  # noqa: SIM401


@dataclass(frozen=True, slots=True)
class Packet:
    """One packet; `t_first` is when its first byte arrived (s). `parameters` have no error in them.

    is_status: it is a servo's answer; `instruction` means nothing then, where a make does not send one.
    """

    t_first: float
    servo: int
    instruction: int
    error: int
    parameters: bytes
    is_status: bool


class PacketReader:
    """Turns a bus's bytes into packets; garbage is counted and nothing else."""

    def __init__(self, scanner: FrameScanner, packet: Callable[[Frame], Packet]) -> None:
        """`scanner` finds the make's frames, `packet` says what is in one."""
        self._scanner, self._packet = scanner, packet
        self.counters = scanner.counters

    @property
    def pending(self) -> int:
        """How many bytes are in hand."""
        return self._scanner.pending

    def feed(self, data: bytes, t_recv: float) -> list[Packet]:
        """Take the bytes read at `t_recv` (s, monotonic) and return the packets they complete."""
        return list(map(self._packet, self._scanner.feed(data, t_recv)))

    def flush(self) -> list[Packet]:
        """No more comes of the packet in hand: the packets that it hid."""
        return list(map(self._packet, self._scanner.flush()))

    def reset(self) -> None:
        """Discard what is in hand, for the line has been interrupted."""
        self._scanner.reset()


class Unfit(NamedTuple):
    """A model that must not be used: what it is, why not, and what to use instead."""

    what: str
    why: str
    mend: str


Span = tuple[int, int]
"""An address and how many bytes from there on."""

Settings = Sequence[tuple[Register, int]]


class ServoMake(Protocol):
    """One make of servos: its protocol, its registers, and what it needs before its torque goes on.

    look, cycle: what is read at leisure, and in every cycle. all_answered: status return level at which every
    instruction is answered. ping_bytes: parameters of the answer to a ping, which begin with the model where there are
    any. alert: bits of an answer's error that report a hardware error; refusals: those that say that the instruction
    was not carried out. settings_end: registers below keep their values without power. unlock: 0 while they are to.
    watchdog: stops the servo when nobody speaks any more; None where a make has none.
    troubles: by bit of the hardware error register, the code of the fault table without the arm's name, and words.
    """

    name: str
    model: Register
    firmware: Register
    torque: Register
    status_level: Register
    return_delay: Register
    hardware_error: Register
    goal: Register
    position: Register
    voltage: Register
    temperature: Register
    watchdog: Register | None
    unlock: Register | None
    settings_end: int
    table_bytes: int
    look: Span
    cycle: Span
    all_answered: int
    ping_bytes: int
    alert: int
    refusals: int
    supply_v: tuple[float, float]
    troubles: Mapping[int, tuple[str, str]]
    models: Mapping[int, str]
    unfit: Mapping[int, Unfit]

    def reader(self, baud: int) -> PacketReader:
        """Of what the servos say. Raises ValueError for a `baud` that is not positive."""

    def ping(self, servo: int) -> bytes:
        """Asks whether it is there."""

    def read(self, servo: int, address: int, size: int) -> bytes:
        """Asks one servo for `size` bytes of its table."""

    def write(self, servo: int, register: Register, value: int) -> bytes:
        """Sets one register of one servo."""

    def sync_write(self, register: Register, values: Mapping[int, int]) -> bytes:
        """Sets one register of several servos, by id; never answered."""

    def sync_read(self, address: int, size: int, servos: Iterable[int]) -> bytes:
        """Asks several servos for `size` bytes of their tables; they answer in this order."""

    def status(self, servo: int, error: int, parameters: bytes = b"") -> bytes:
        """A servo's answer."""

    def restart(self, servo: int) -> bytes:
        """Clears its hardware errors; answered without parameters."""

    def settings(self, low: int, high: int) -> Settings:
        """What must be so before the torque goes on, in the order in which it can be set, with limits in counts."""

    def profile(self, span_ms: int) -> Settings:
        """What makes it go to a goal evenly within `span_ms`, and must stay so while it follows."""

    def goals(self, counts: Mapping[int, int], ways: Mapping[int, float], span_ms: int) -> bytes:
        """Goals by id, `ways` (counts) from where the path of each is, to be gone evenly within `span_ms`."""
