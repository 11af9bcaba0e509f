"""Work in a process of its own beside the loop: they meet on ZeroMQ, and the loop never waits.

What the process cannot take at once is refused. It gives a sign of life four times a second, also while it computes;
a process that has died or gives none is ended and started again.
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

RESTART_S = 5.0  # from one start of the process to the next at least
SILENT_S = 1.5
"""Without a sign of life for so long a process counts as stopped; a busy machine gives it its milliseconds sooner."""
SAID_S = 3.0
"""So long after a restart it is still said to have been silent, for those who look once a second."""
CLOSE_S = 1.0


class WorkerProcess:
    """The loop's end; all but `close` is safe inside the loop, starting the process again takes it 1 ms."""

    def __init__(self, name: str, module: str, *arguments: str, high_water: int, copied: bool = False) -> None:
        """Start a process that calls `serve` of `module` with an address for `meet` and the arguments.

        `name` is for people, `high_water` the most messages on their way. `copied`: the first process is a copy of this
        one (fork), so that it need not load its modules; only before this one has other threads. Raises OSError when it
        cannot be started.
        """
        self._name = name
        self._folder = socket_folder("palmd-", name)
        address = f"ipc://{Path(self._folder.name) / name}"
        self._command = [sys.executable, "-m", "palmd.daemon.worker_main", module]
        self._arguments = [address, *arguments]
        self._copied = copied
        self._signs = -1  # the pipe on which signs of life come
        self._t_sign = math.inf  # of the last one; infinite until the first
        self._t_restarted = -math.inf
        self._ended: list[subprocess.Popen[bytes] | _Copy] = []  # still to be waited for
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.DEALER)
        self._socket.set(zmq.SNDHWM, high_water)
        self._socket.set(zmq.LINGER, 0)
        self._socket.bind(address)
        self.starts = 0
        self._process: subprocess.Popen[bytes] | _Copy
        try:
            self._start()
        except OSError:
            self._tidy_up()
            raise

    def send(self, message: bytes) -> bool:
        """Pass a message on; False when the process does not take it: it is starting, or stuck, or gone."""
        try:
            self._socket.send(message, zmq.NOBLOCK)
        except zmq.Again:
            return False
        return True

    def tend(self, t: float) -> None:
        """Look for signs of life at `t` (s, monotonic clock), a few times a second; without any start it again."""
        self._ended = [each for each in self._ended if each.poll() is None]
        with contextlib.suppress(BlockingIOError):
            if os.read(self._signs, 4096):
                self._t_sign = t
        died = self._process.poll() is not None
        if (died or t - self._t_sign > SILENT_S) and t - self._t_started > RESTART_S:
            how = (
                f"ended with status {self._process.returncode}" if died else f"was silent for {t - self._t_sign:.1f} s"
            )
            log.warning("the %s (process %d) %s: started again", self._name, self._process.pid, how)
            self.restart(t)

    def restart(self, t: float) -> None:
        """End the process and start another one, at `t` (s)."""
        self._process.kill()
        self._ended.append(self._process)
        os.close(self._signs)
        self._t_restarted = t
        try:
            self._start()
        except OSError as error:
            log.warning("the %s cannot be started: %s", self._name, error)

    def silent(self, t: float) -> bool:
        """Whether the process gives no sign of life at `t` (s), or did not until shortly before."""
        return t - self._t_sign > SILENT_S or t - self._t_restarted < SAID_S or self._process.returncode is not None

    @property
    def number(self) -> int:
        """Of the process."""
        return self._process.pid

    def received(self) -> Iterator[bytes]:
        """The messages that have come."""
        with contextlib.suppress(zmq.Again):
            while True:
                yield self._socket.recv(zmq.NOBLOCK)

    def close(self) -> None:
        """End the process."""
        self._process.terminate()
        try:
            self._process.wait(CLOSE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._tidy_up()

    def _tidy_up(self) -> None:
        if self._signs >= 0:
            os.close(self._signs)
        self._socket.close()
        self._context.term()
        self._folder.cleanup()

    def _start(self) -> None:
        self._t_started = time.monotonic()
        self._t_sign = math.inf
        self.starts += 1
        self._signs, theirs = os.pipe()
        os.set_blocking(self._signs, False)
        os.set_blocking(theirs, False)
        try:
            self._process = self._copy(theirs) if self._copied else self._fresh(theirs)
        finally:
            self._copied = False
            os.close(theirs)

    def _fresh(self, signs: int) -> subprocess.Popen[bytes]:
        command = [*self._command, str(os.getpid()), str(signs), *self._arguments]
        return subprocess.Popen(command, stdin=subprocess.DEVNULL, pass_fds=(signs,))

    def _copy(self, signs: int) -> _Copy:
        parent, number = os.getpid(), os.fork()
        if number:
            return _Copy(number)
        try:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
            worker_main.main(self._command[-1], parent, signs, self._arguments)
        finally:
            os._exit(1)  # nothing of what the parent has to tidy up is ours


class _Copy:
    """A process made by fork, as far as it is used like one of `subprocess`."""

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
        """The exit status, once there is one; raises subprocess.TimeoutExpired."""
        t_end = time.monotonic() + timeout
        while (status := self.poll()) is None:
            if time.monotonic() > t_end:
                raise subprocess.TimeoutExpired(str(self.pid), timeout)
            time.sleep(0.01)
        return status

    def terminate(self) -> None:
        """Ask it to end."""
        self._send(signal.SIGTERM)

    def kill(self) -> None:
        """Make it end."""
        self._send(signal.SIGKILL)

    def _send(self, number: signal.Signals) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)


@contextlib.contextmanager
def meet(address: str, niceness: int) -> Iterator[zmq.Socket[bytes]]:
    """The process's end: a socket on which messages come and go, and no more of the machine than is left over."""
    os.nice(niceness)
    freeze_collector()
    with zmq.Context() as context, context.socket(zmq.DEALER) as socket:
        socket.set(zmq.LINGER, 0)
        socket.connect(address)
        yield socket


def give_back_memory() -> None:
    """Return to the system what this process needs no longer; once an answer is out, takes milliseconds.

    Else cycles wait for the collector, and with glibc one small block that is still in use above a solver's many freed
    ones keeps them all resident: the process's memory wanders by tens of megabytes, under which no leak would be seen.
    """
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(ctypes.c_size_t(0))
