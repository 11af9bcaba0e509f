"""A process beside the loop, connected by ZeroMQ; the loop never waits for it.

Messages that the process cannot take at once are rejected. It sends a heartbeat four times a second, also while it
computes; a process that has died or sends none is killed and restarted.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import logging
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import zmq

from palmd.console.folders import socket_folder
from palmd.daemon import worker_main
from palmd.daemon.realtime import freeze_collector

log = logging.getLogger(__name__)

RESTART_S = 5.0  # shortest time between two starts of the process
SILENT_S = 1.5
"""Time without a heartbeat after which a process counts as stopped; even a busy machine lets it send one sooner."""
RESTART_REPORTED_S = 3.0
"""Time after a restart during which it is still reported as silent, for clients that poll once a second."""
CLOSE_S = 1.0


class WorkerProcess:
    """The loop's side; all methods but `close` are safe inside the loop, restarting the process takes 1 ms."""

    def __init__(self, name: str, module: str, *arguments: str, high_water: int, forked: bool = False) -> None:
        """Start a process that calls `serve` of `module` with an address for `worker_socket` and the arguments.

        `name` is for messages; `high_water` is the largest number of messages in transit. `forked`: the first process
        is a fork of this one and need not load its modules; possible only before this one has other threads. Raises
        OSError if it cannot be started.
        """
        self._name = name
        self._folder = socket_folder("palmd-", name)
        address = f"ipc://{Path(self._folder.name) / name}"
        self._command = [sys.executable, "-m", "palmd.daemon.worker_main", module]
        self._arguments = [address, *arguments]
        self._forked = forked
        self._heartbeat_fd = -1  # pipe on which heartbeats arrive
        self._t_heartbeat = math.inf  # of the last heartbeat; infinite before the first
        self._t_restarted = -math.inf
        self._ended: list[subprocess.Popen[bytes] | _ForkedProcess] = []  # not reaped yet
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.DEALER)
        self._socket.set(zmq.SNDHWM, high_water)
        self._socket.set(zmq.LINGER, 0)
        self._socket.bind(address)
        self.starts = 0
        self._process: subprocess.Popen[bytes] | _ForkedProcess
        try:
            self._start()
        except OSError:
            self._clean_up()
            raise

    def send(self, message: bytes) -> bool:
        """Send a message; False if the process does not take it: it is starting, stuck or gone."""
        try:
            self._socket.send(message, zmq.NOBLOCK)
        except zmq.Again:
            return False
        return True

    def tend(self, t: float) -> None:
        """Check for heartbeats at `t` (s, monotonic clock), a few times a second; restarts a dead process."""
        self._ended = [each for each in self._ended if each.poll() is None]
        with contextlib.suppress(BlockingIOError):
            if os.read(self._heartbeat_fd, 4096):
                self._t_heartbeat = t
        died = self._process.poll() is not None
        if (died or t - self._t_heartbeat > SILENT_S) and t - self._t_started > RESTART_S:
            reason = (
                f"ended with status {self._process.returncode}"
                if died
                else f"was silent for {t - self._t_heartbeat:.1f} s"
            )
            log.warning("the %s (process %d) %s: restarted", self._name, self._process.pid, reason)
            self.restart(t)

    def restart(self, t: float) -> None:
        """Kill the process and start another one, at `t` (s)."""
        self._process.kill()
        self._ended.append(self._process)
        os.close(self._heartbeat_fd)
        self._t_restarted = t
        try:
            self._start()
        except OSError as error:
            log.warning("the %s cannot be started: %s", self._name, error)

    def silent(self, t: float) -> bool:
        """Whether the process sends no heartbeat at `t` (s), or did not until recently."""
        return (
            t - self._t_heartbeat > SILENT_S
            or t - self._t_restarted < RESTART_REPORTED_S
            or self._process.returncode is not None
        )

    @property
    def number(self) -> int:
        """The process id."""
        return self._process.pid

    def received(self) -> Iterator[bytes]:
        """The messages that have arrived."""
        with contextlib.suppress(zmq.Again):
            while True:
                yield self._socket.recv(zmq.NOBLOCK)

    def close(self) -> None:
        """Stop the process."""
        self._process.terminate()
        try:
            self._process.wait(CLOSE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._clean_up()

    def _clean_up(self) -> None:
        if self._heartbeat_fd >= 0:
            os.close(self._heartbeat_fd)
        self._socket.close()
        self._context.term()
        self._folder.cleanup()

    def _start(self) -> None:
        self._t_started = time.monotonic()
        self._t_heartbeat = math.inf
        self.starts += 1
        self._heartbeat_fd, child_fd = os.pipe()
        os.set_blocking(self._heartbeat_fd, False)
        os.set_blocking(child_fd, False)
        try:
            self._process = self._fork(child_fd) if self._forked else self._spawn(child_fd)
        finally:
            self._forked = False
            os.close(child_fd)

    def _spawn(self, heartbeat_fd: int) -> subprocess.Popen[bytes]:
        command = [*self._command, str(os.getpid()), str(heartbeat_fd), *self._arguments]
        return subprocess.Popen(command, stdin=subprocess.DEVNULL, pass_fds=(heartbeat_fd,))

    def _fork(self, heartbeat_fd: int) -> _ForkedProcess:
        parent, number = os.getpid(), os.fork()
        if number:
            return _ForkedProcess(number)
        try:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
            worker_main.main(self._command[-1], parent, heartbeat_fd, self._arguments)
        finally:
            os._exit(1)  # skip the parent's clean-up handlers


class _ForkedProcess:
    """A process made by fork, with the methods of `subprocess.Popen` that are used here."""

    def __init__(self, number: int) -> None:
        self.pid = number
        self.returncode: int | None = None

    def poll(self) -> int | None:
        """The exit status, None while it runs; negative for a signal."""
        if self.returncode is None:
            number, status = os.waitpid(self.pid, os.WNOHANG)
            if number:
                self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode

    def wait(self, timeout: float = math.inf) -> int:
        """The exit status; raises subprocess.TimeoutExpired."""
        t_end = time.monotonic() + timeout
        while (status := self.poll()) is None:
            if time.monotonic() > t_end:
                raise subprocess.TimeoutExpired(str(self.pid), timeout)
            time.sleep(0.01)
        return status

    def terminate(self) -> None:
        """Send SIGTERM."""
        self._send(signal.SIGTERM)

    def kill(self) -> None:
        """Send SIGKILL."""
        self._send(signal.SIGKILL)

    def _send(self, number: signal.Signals) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)


@contextlib.contextmanager
def worker_socket(address: str, niceness: int) -> Iterator[zmq.Socket[bytes]]:
    """The process's side: a socket for messages to and from the loop; lowers the process's priority."""
    os.nice(niceness)
    freeze_collector()
    with zmq.Context() as context, context.socket(zmq.DEALER) as socket:
        socket.set(zmq.LINGER, 0)
        socket.connect(address)
        yield socket


def release_memory() -> None:
    """Return memory that is no longer needed to the system; takes milliseconds, call after an answer has been sent.

    Otherwise reference cycles wait for the collector, and with glibc one small block in use above a solver's many freed
    ones keeps them all resident: resident memory would vary by tens of megabytes and hide a leak.
    """
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(ctypes.c_size_t(0))
