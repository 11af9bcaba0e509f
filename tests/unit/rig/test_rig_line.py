"""The emulated lines: pacing, and pseudo-terminals or sockets with a plug, with or without a host."""

import os
import select
import termios
import time
import tty

import numpy as np
import pytest

from palmd.devices.port import Port, PortWaiter
from palmd.rig.line import LineWaiter, PtyLine, SocketLine, Wire


def test_the_line_paces_bytes_and_keeps_their_order():
    wire = Wire(9600)
    byte = 10 / 9600
    wire.send(b"abc", 1.0)
    wire.send(b"de", 1.001)
    assert wire.take(1.0 + 0.9 * byte) == b""
    assert wire.take(1.0 + 1.01 * byte) == b"a"
    assert wire.take(1.0 + 4.01 * byte) == b"bcd"
    assert wire.take(2.0) == b"e"
    wire.send(b"f", 3.0)
    assert wire.take(3.0 + 0.99 * byte) == b""
    assert wire.take(3.0 + 1.01 * byte) == b"f"


@pytest.fixture
def line(tmp_path):
    port = PtyLine(tmp_path / "pad1", 9600, np.random.default_rng(0))
    port.plug()
    yield port
    port.unplug()


def open_host(line, speed=termios.B9600):
    fd = os.open(line.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    tty.setraw(fd)
    attributes = termios.tcgetattr(fd)
    attributes[4] = attributes[5] = speed
    termios.tcsetattr(fd, termios.TCSANOW, attributes)
    return fd


def look(line):
    poll = select.poll()
    poll.register(line.fileno)
    return line.read(dict(poll.poll(0)).get(line.fileno, 0))


def test_bytes_are_passed_both_ways(line):
    host = open_host(line)
    look(line)
    line.write(bytes(range(256)))
    assert os.read(host, 1000) == bytes(range(256))
    os.write(host, b"\x00\x11\x13\n\r")
    assert look(line) == (b"\x00\x11\x13\n\r", False)
    assert (line.bytes_sent, line.bytes_lost, line.bytes_heard) == (256, 0, 5)
    os.close(host)


def test_without_a_host_bytes_are_lost(line):
    assert look(line) == (b"", False)
    line.write(b"lost")
    host = open_host(line)
    look(line)
    line.write(b"heard")
    assert os.read(host, 100) == b"heard"
    os.close(host)
    look(line)
    line.write(b"lost too")
    assert (line.bytes_sent, line.bytes_lost) == (5, 12)


def test_opening_with_a_flush_is_noticed(line):
    host = open_host(line)
    look(line)
    termios.tcflush(host, termios.TCIFLUSH)
    assert look(line) == (b"", True)
    assert look(line) == (b"", False)
    os.close(host)


def test_another_baud_rate_turns_bytes_into_noise(line):
    host = open_host(line, termios.B19200)
    look(line)
    line.write(b"x" * 50)
    assert os.read(host, 100) != b"x" * 50
    os.write(host, b"y" * 50)
    assert look(line)[0] != b"y" * 50
    os.close(host)


def test_unplugging_hangs_up_and_replugging_serves_again(line):
    host = open_host(line)
    line.unplug()
    assert not line.plugged
    assert not line.path.exists()
    with pytest.raises(OSError, match="Input/output error"):
        os.write(host, b"x")
    assert os.read(host, 10) == b""
    line.write(b"into the void")
    line.plug()
    again = open_host(line)
    look(line)
    line.write(b"back")
    assert os.read(again, 10) == b"back"
    os.close(host)
    os.close(again)


def test_waiting_reports_input_once_and_a_missing_host_always(line):
    """If asked about input already reported, the kernel would delay the rig behind other threads."""
    waiter = LineWaiter()
    waiter.watch(line.fileno)
    for _ in range(2):
        assert waiter.ready()[line.fileno] & select.POLLHUP
    for _ in range(2):
        host = open_host(line)
        assert not waiter.ready().get(line.fileno, 0) & select.POLLHUP
        os.write(host, b"move")
        assert heard_by(waiter, line) == b"move"
        assert waiter.ready() == {}
        os.close(host)
        assert waiter.ready()[line.fileno] & select.POLLHUP
    waiter.forget(line.fileno)
    assert waiter.ready() == {}


def heard_by(waiter, line, patience_s=10.0):
    """The line's next input; the kernel delivers it in its own time."""
    t_end = time.monotonic() + patience_s
    while time.monotonic() < t_end:
        heard, _ = line.read(waiter.ready().get(line.fileno, 0))
        if heard:
            return heard
    return b""


@pytest.fixture
def socket_line(tmp_path):
    port = SocketLine(tmp_path / "pad1")
    port.plug()
    yield port
    port.unplug()


@pytest.fixture
def host(socket_line):
    port = Port("pad1", str(socket_line.path), 9600, retry_s=0.0)
    yield port
    port.close()


def test_over_a_socket_bytes_are_passed_both_ways_at_once(socket_line, host):
    assert socket_line.write(b"lost") == b""
    assert host.poll_open(0.0), host.error
    assert look(socket_line) == (b"", True)
    everything = bytes(range(256))
    assert socket_line.write(everything) == everything
    assert PortWaiter([host]).wait(time.monotonic() + 5.0) == [host]
    assert host.read() == everything
    assert host.read() == b""
    host.write(everything)
    assert look(socket_line) == (everything, False)
    assert look(socket_line) == (b"", False)
    assert (socket_line.bytes_sent, socket_line.bytes_lost, socket_line.bytes_heard) == (256, 4, 256)


def test_an_unplugged_socket_hangs_up_and_serves_again(socket_line, host):
    assert host.poll_open(0.0)
    look(socket_line)
    socket_line.unplug()
    assert host.read() == b""
    assert not host.is_open
    assert "was lost" in host.error
    assert not host.poll_open(1.0)
    assert "no such port" in host.error
    socket_line.plug()
    assert host.poll_open(2.0), host.error
    assert look(socket_line) == (b"", True)
    socket_line.write(b"back")
    assert host.read() == b"back"


def test_the_next_host_of_a_socket_waits_until_the_first_has_gone(socket_line, host):
    assert host.poll_open(0.0)
    look(socket_line)
    second = Port("pad1", str(socket_line.path), 9600)
    assert second.poll_open(0.0)
    socket_line.write(b"to the first")
    assert second.read() == b""
    host.close()
    assert look(socket_line) == (b"", False)
    assert look(socket_line) == (b"", True)
    socket_line.write(b"to the second")
    assert second.read() == b"to the second"
    second.close()


def test_waiting_reports_a_sockets_input_until_it_is_read(socket_line, host):
    waiter = LineWaiter()
    waiter.watch(socket_line.fileno, edge_triggered=False)
    assert waiter.ready() == {}
    assert host.poll_open(0.0)
    host.write(b"before it was let in")
    second = Port("pad1", str(socket_line.path), 9600)
    assert second.poll_open(0.0)
    assert socket_line.read(waiter.ready()[socket_line.fileno]) == (b"", True)
    for _ in range(2):
        assert waiter.ready()[socket_line.fileno]
    assert heard_by(waiter, socket_line) == b"before it was let in"
    assert waiter.ready() == {}  # though the second waits
    host.write(b"more")
    host.close()
    assert heard_by(waiter, socket_line) == b"more"
    assert socket_line.read(waiter.ready()[socket_line.fileno]) == (b"", False)
    assert socket_line.read(waiter.ready()[socket_line.fileno]) == (b"", True)
    second.write(b"now")
    assert heard_by(waiter, socket_line) == b"now"
    waiter.forget(socket_line.fileno)
    socket_line.unplug()
    assert socket_line.fileno == -1
    second.close()


def test_a_socket_without_a_server_is_an_error(socket_line, host):
    left_behind = socket_line.path.with_name("left")
    socket_line.path.rename(left_behind)
    socket_line.unplug()
    host.path = str(left_behind)
    assert not host.poll_open(0.0)
    assert "nothing is connected behind" in host.error
