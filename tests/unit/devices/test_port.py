"""Serial ports on pseudo-terminals: opening, loss and return; waiting; the touchpad's start-up."""

from __future__ import annotations

import errno
import fcntl
import os
import struct
import termios
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import serial

from palmd.devices.handshake import ANSWER_S, BREAK_S, Handshake
from palmd.devices.port import Port, PortWaiter, explain


class FarEnd:
    """The other side of a port: a pseudo-terminal's master, whose slave is linked at `path`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.master = -1
        self.plug()

    def plug(self) -> None:
        self.master, slave = os.openpty()
        os.set_blocking(self.master, False)
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(slave))
        os.close(slave)

    def unplug(self) -> None:
        if self.master >= 0:
            os.close(self.master)
            self.path.unlink(missing_ok=True)
            self.master = -1


@pytest.fixture
def far(tmp_path: Path) -> Iterator[FarEnd]:
    end = FarEnd(tmp_path / "pad1")
    yield end
    end.unplug()


@pytest.fixture
def port(far: FarEnd) -> Iterator[Port]:
    near = Port("pad1", str(far.path), 9600)
    assert near.poll_open(0.0), near.error
    yield near
    near.close()


def read_within(port: Port, size: int, seconds: float = 2.0) -> bytes:
    """Reads until `size` bytes have come, as the loop does: wait, drain, wait."""
    waiter, data, t_end = PortWaiter([port]), b"", time.monotonic() + seconds
    while len(data) < size and time.monotonic() < t_end:
        data += b"".join(ready.read() for ready in waiter.wait(t_end))
    return data


# Reading and writing


def test_bytes_pass_both_ways_unchanged(far: FarEnd, port: Port) -> None:
    everything = bytes(range(256))
    os.write(far.master, everything)
    assert read_within(port, 256) == everything
    port.write(everything)
    assert os.read(far.master, 1000) == everything
    assert port.counters.as_dict() == {
        "bytes_read": 256,
        "bytes_written": 256,
        "bytes_dropped": 0,
        "opens": 1,
        "losses": 0,
        "breaks": 0,
        "framing_errors": 0,
        "parity_errors": 0,
        "overruns": 0,
    }


def test_the_kernels_line_error_counts_add_up_over_openings(port: Port, monkeypatch: pytest.MonkeyPatch) -> None:
    kernels = [7, 5, 3, 2, 1]  # framing errors, overruns, parity errors, breaks, overruns of the terminal
    real = fcntl.ioctl

    def ioctl(fd: int, request: int, *rest: Any) -> Any:
        if request != 0x545D:  # TIOCGICOUNT
            return real(fd, request, *rest)
        struct.pack_into("11i", rest[0], 0, *range(100, 106), *kernels)
        return 0

    def counted() -> list[int]:
        port.update_counters()
        counters = port.counters
        return [counters.breaks, counters.framing_errors, counters.parity_errors, counters.overruns]

    assert counted() == [0, 0, 0, 0]  # a pseudo-terminal has none
    monkeypatch.setattr("palmd.devices.port.fcntl.ioctl", ioctl)
    port.close()
    assert port.poll_open(1.0)
    assert counted() == [0, 0, 0, 0]  # not counted before the opening
    kernels[:] = [17, 6, 6, 4, 4]
    assert counted() == counted() == [2, 10, 3, 4]
    port.close()
    assert counted() == [2, 10, 3, 4]
    kernels[:] = [0, 0, 0, 0, 0]  # another adapter is plugged in
    assert port.poll_open(2.0)
    kernels[:] = [1, 0, 0, 0, 0]
    assert counted() == [2, 11, 3, 4]


def test_the_baud_rate_is_set_on_the_line(far: FarEnd, port: Port) -> None:
    assert termios.tcgetattr(far.master)[4] == termios.B9600


def test_a_full_buffer_drops_whole_writes_and_never_blocks(far: FarEnd, port: Port) -> None:
    line = b"S" * 99 + b"\n"
    for _ in range(2000):
        port.write(line)
    assert port.is_open
    assert port.counters.bytes_dropped > 0
    received = b""
    while True:
        port.write(b"")  # the rest of a partly sent line is sent as soon as there is room
        try:
            received += os.read(far.master, 65536)
        except BlockingIOError:
            break
    assert len(received) == port.counters.bytes_written
    assert received == line * (len(received) // 100)
    assert len(received) + port.counters.bytes_dropped == 200_000


def test_a_flood_is_read_in_portions(far: FarEnd, port: Port) -> None:
    written = 0
    while True:
        try:
            written += os.write(far.master, b"x" * 1024)
        except BlockingIOError:
            break
    assert len(read_within(port, written)) == written


# Loss and return


@pytest.mark.parametrize("discovery", ["read", "write"])
def test_an_unplugged_port_is_closed_at_once_and_reports_it(far: FarEnd, port: Port, discovery: str) -> None:
    far.unplug()
    port.read() if discovery == "read" else port.write(b"Q00*00\n")
    assert not port.is_open
    assert "was lost" in port.error
    assert port.counters.losses == 1
    assert port.read() == b""
    port.write(b"more")
    assert port.counters.losses == 1


def test_a_hang_up_wakes_the_waiter_once(far: FarEnd, port: Port) -> None:
    waiter = PortWaiter([port])
    far.unplug()
    assert waiter.wait(time.monotonic() + 2.0) == [port]
    port.read()
    t_start = time.monotonic()
    assert waiter.wait(t_start + 0.02) == []
    assert time.monotonic() - t_start >= 0.0199


def test_a_replugged_port_returns_at_the_same_path(far: FarEnd, port: Port) -> None:
    port.write(b"half a l")
    far.unplug()
    port.read()
    assert not port.poll_open(1.0)
    assert "no such port" in port.error
    far.plug()
    assert not port.poll_open(1.4), "retried too soon"
    assert port.poll_open(1.5)
    assert port.error is None
    os.write(far.master, b"back")
    assert read_within(port, 4) == b"back"
    port.write(b"again")
    assert os.read(far.master, 100) == b"again"
    assert (port.counters.opens, port.counters.losses) == (2, 1)


def test_the_rest_of_a_cut_line_is_discarded_with_the_port(far: FarEnd, port: Port) -> None:
    for _ in range(300):
        port.write(b"x" * 999)
    far.unplug()
    port.write(b"y")
    far.plug()
    assert port.poll_open(1.0)
    port.write(b"fresh")
    assert os.read(far.master, 100) == b"fresh"


def test_fileno_of_a_closed_port_is_an_error(port: Port) -> None:
    port.close()
    with pytest.raises(ValueError, match="pad1: port is not open"):
        port.fileno()
    assert port.error is not None
    port.set_break(True)


# Ports that cannot be opened


def test_a_missing_port_is_reported(tmp_path: Path) -> None:
    port = Port("arm", str(tmp_path / "nowhere"), 38400)
    assert not port.poll_open(0.0)
    assert port.error == f"arm: no such port {tmp_path}/nowhere: check the plug and the configured name"


def test_a_port_held_by_another_process_is_reported(far: FarEnd, port: Port) -> None:
    rival = Port("rival", str(far.path), 9600)
    assert not rival.poll_open(0.0)
    assert "is held by another process" in rival.error
    port.close()
    assert rival.poll_open(1.0), rival.error
    rival.close()


def test_a_port_locked_by_another_program_is_reported(far: FarEnd) -> None:
    with far.path.open("r+b", buffering=0) as stranger:
        fcntl.flock(stranger, fcntl.LOCK_EX)
        port = Port("pad1", str(far.path), 9600)
        assert not port.poll_open(0.0)
        assert "is held by another process" in port.error


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_a_file_that_is_no_serial_port_is_reported(tmp_path: Path, kind: str) -> None:
    path = tmp_path / kind
    path.touch() if kind == "file" else path.mkdir()
    port = Port("pad1", str(path), 9600)
    assert not port.poll_open(0.0)
    assert "cannot be used as a serial port" in port.error


def test_missing_permission_names_the_group() -> None:
    text = explain("/dev/ttyUSB0", serial.SerialException(errno.EACCES, "denied"))
    assert "dialout" in text
    assert "/dev/ttyUSB0" in text


def test_termios_errors_are_caught(far: FarEnd, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise termios.error(errno.EIO, "Input/output error")

    monkeypatch.setattr(termios, "tcflush", refuse)
    port = Port("pad1", str(far.path), 9600)
    assert not port.poll_open(0.0)
    assert port.error is not None
    monkeypatch.undo()
    assert port.poll_open(1.0)
    port.close()


# Waiting


def test_wait_returns_only_the_readable_port(tmp_path: Path) -> None:
    ends = [FarEnd(tmp_path / name) for name in ("a", "b")]
    ports = [Port(end.path.name, str(end.path), 9600) for end in ends]
    assert all(port.poll_open(0.0) for port in ports)
    os.write(ends[1].master, b"!")
    assert PortWaiter(ports).wait(time.monotonic() + 2.0) == [ports[1]]
    for port, end in zip(ports, ends, strict=True):
        port.close()
        end.unplug()


def test_bytes_that_came_while_nobody_waited_are_not_lost(far: FarEnd, port: Port) -> None:
    waiter = PortWaiter([port])
    assert waiter.wait(0.0) == []
    for data in (b"one", b"two"):
        os.write(far.master, data)
        assert waiter.wait(time.monotonic() + 2.0) == [port]
        assert port.read() == data
        assert waiter.wait(0.0) == []


def test_bytes_after_a_ports_loss_and_return_wake_the_same_waiter(far: FarEnd, port: Port) -> None:
    waiter = PortWaiter([port])
    for t in (1.0, 2.0):
        far.unplug()
        assert waiter.wait(time.monotonic() + 2.0) == [port]
        port.read()
        far.plug()
        assert port.poll_open(t)
        assert waiter.wait(0.0) == []
        os.write(far.master, b"back")
        assert waiter.wait(time.monotonic() + 2.0) == [port]
        assert port.read() == b"back"


def test_wait_sleeps_for_exactly_the_remaining_time(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[float] = []
    monkeypatch.setattr("select.select", lambda r, w, x, timeout: asked.append(timeout) or (r, w, x))
    waiter = PortWaiter([], clock=lambda: 5.0)
    waiter.wait(5.0004)
    waiter.wait(4.0)
    assert asked == [pytest.approx(0.0004), 0.0]


# The touchpad's start-up


def test_without_a_handshake_the_start_up_is_complete_at_once() -> None:
    assert Handshake("none", 0.0).done


def test_the_identity_is_found_among_packets_after_a_break() -> None:
    shake = Handshake("break", 10.0)
    assert shake.step(10.0, b"")
    assert shake.step(10.0 + BREAK_S - 0.01, b"VPold1\r")
    assert not shake.step(10.0 + BREAK_S, b"\x00\xc4\x00VP1")
    assert not shake.done
    shake.step(10.5, b"234\r\xc4")
    assert shake.done
    assert shake.identity == b"VP1234\r"
    assert shake.error is None


def test_two_breaks_need_the_same_answer_twice() -> None:
    shake = Handshake("break_twice", 0.0)
    assert shake.step(0.5, b"VP12345\r"), "the second break follows the first answer"
    assert not shake.step(0.5 + BREAK_S, b"")
    shake.step(1.0, b"VP12345\r")
    assert shake.done
    assert shake.identity == b"VP12345\r"


def test_different_answers_are_an_error() -> None:
    shake = Handshake("break_twice", 0.0)
    shake.step(0.5, b"VP12345\r")
    shake.step(1.0, b"VP54321\r")
    assert shake.done
    assert shake.identity is None
    assert "two different identities" in shake.error


def test_a_mute_pad_times_out() -> None:
    shake = Handshake("break", 0.0)
    for n in range(1000):
        shake.step(n * 0.001, b"\xc4\x00\x00\x00\x00\x10")
    assert not shake.done
    assert not shake.step(BREAK_S + ANSWER_S, b"")
    assert shake.done
    assert "no identity" in shake.error
    assert shake.step(9.0, b"VP1234\r") is False
