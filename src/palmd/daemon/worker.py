"""Work in a process of its own beside the loop: they meet on ZeroMQ, and the loop never waits.

What the process cannot take at once is refused; a process that has died is started again.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import logging
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import zmq

from palmd.console.folders import for_sockets
from palmd.daemon.realtime import freeze_collector

log = logging.getLogger(__name__)

RESTART_S = 10.0  # from one start of the process to the next at least
CLOSE_S = 1.0


class WorkerProcess:
    """The loop's end; `send` and `received` are safe inside the loop, starting the process again takes it 1 ms."""

    def __init__(self, name: str, module: str, *arguments: str, high_water: int) -> None:
        """Start a process that calls `serve` of `module` with an address for `meet` and the arguments.

        `name` is for people, `high_water` the most messages on their way. Raises OSError when it cannot be started.
        """
        self._name = name
        self._folder = for_sockets("palmd-", name)
        address = f"ipc://{Path(self._folder.name) / name}"
        self._command = [
            sys.executable,
            "-m",
            "palmd.daemon.worker_main",
            module,
            str(os.getpid()),
            address,
            *arguments,
        ]
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.DEALER)
        self._socket.set(zmq.SNDHWM, high_water)
        self._socket.set(zmq.LINGER, 0)
        self._socket.bind(address)
        self.starts = 0
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
            self._revive()
            return False
        return True

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
        self._socket.close()
        self._context.term()
        self._folder.cleanup()

    def _start(self) -> None:
        self._t_started = time.monotonic()
        self.starts += 1
        self._process = subprocess.Popen(self._command, stdin=subprocess.DEVNULL)

    def _revive(self) -> None:
        if self._process.poll() is not None and time.monotonic() - self._t_started > RESTART_S:
            log.warning("the %s ended with status %s: started again", self._name, self._process.returncode)
            self._start()


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
