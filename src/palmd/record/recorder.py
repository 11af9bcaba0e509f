"""The recorder's process: listens to the daemon and to the emulated rig's truth, and tells the daemon how it fares.

One thread receives and hands over to the operating system, tick by tick, so that the process may be killed at any time;
another one brings that to the disk each second, however long it takes.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import msgpack
import zmq

from palmd.config import Config, from_here
from palmd.keys import Credentials
from palmd.record.recording import Ended, Recording

LOOK_S = 0.05  # between looks at the clock when nothing comes
BATCH = 1000  # messages that are taken before they are handed over
SYNC_S = TELL_S = 1.0
LAST_WORDS_S = 0.15  # that a daemon's last messages may take
RECONNECT_MS = 20


def record(
    config: Config,
    truth: Sequence[str],
    ready: Callable[[], None],
    stopped: Callable[[], bool],
    ended: Callable[[Ended], None],
    key: Credentials | None = None,
) -> None:
    """Record until `stopped`; `truth` holds addresses beside the daemon's, `key` is for a daemon that has keys.

    `ready` is called when it listens, whoever is there; `ended` is told of each closed file. Raises zmq.ZMQError for
    what is no address.
    """
    recording = Recording(config, ended)
    with contextlib.ExitStack() as stack:
        context = zmq.Context()
        stack.callback(context.destroy, linger=0)
        socket = _subscriber(context, from_here(config.bus.publish), truth, key)
        daemon = _Teller(context, from_here(config.bus.command), key)
        syncer = stack.enter_context(_Syncer())
        due = 0.0
        ready()
        while not stopped():
            _drain(socket, recording, LOOK_S)
            recording.flush(time.time())
            error = syncer.failed()
            if error is not None:
                recording.fail(error, time.time())
            if time.monotonic() >= due:
                syncer.sync(recording.fd)
                if daemon.tell(recording):
                    due = time.monotonic() + TELL_S
        t_end = time.monotonic() + LAST_WORDS_S
        while _drain(socket, recording, LAST_WORDS_S) and time.monotonic() < t_end:
            pass
    recording.finish()


def _drain(socket: zmq.Socket[bytes], recording: Recording, wait_s: float) -> int:
    """Wait for something to come, then take what there is."""
    if not socket.poll(round(wait_s * 1e3)):
        return 0
    for count in range(BATCH):
        try:
            frames = socket.recv_multipart(zmq.NOBLOCK)
        except zmq.Again:
            return count
        recording.take(frames, time.time())
    return BATCH


def _subscriber(
    context: zmq.Context[zmq.Socket[bytes]], publish: str, truth: Sequence[str], key: Credentials | None
) -> zmq.Socket[bytes]:
    """Keeps everything that comes for as long as this process lives."""
    socket = context.socket(zmq.SUB)
    socket.setsockopt(zmq.RCVHWM, 0)
    socket.setsockopt(zmq.RECONNECT_IVL, RECONNECT_MS)
    for address in truth:
        socket.connect(address)  # a rig has no keys, and a key counts for what is connected after it is set
    if key is not None:
        key.encrypt(socket)
    socket.connect(publish)
    socket.subscribe(b"")
    return socket


class _Teller:
    """Tells the daemon, if there is one, and never waits for it."""

    def __init__(self, context: zmq.Context[zmq.Socket[bytes]], address: str, key: Credentials | None) -> None:
        self._socket = context.socket(zmq.DEALER)
        self._socket.setsockopt(zmq.IMMEDIATE, 1)  # what nobody hears now is not worth keeping
        if key is not None:
            key.encrypt(self._socket)
        self._socket.connect(address)
        self._numbers = itertools.count(1)

    def tell(self, recording: Recording) -> bool:
        """One command `recorder`, if somebody takes it; what was answered to earlier ones is of no interest."""
        args: dict[str, Any] = {
            "bytes": recording.size_bytes,
            "messages": recording.messages,
            "lost": recording.lost,
        }
        if recording.path is not None:
            args["path"] = str(recording.path)
        if recording.problem:
            args["problem"] = recording.problem
        with contextlib.suppress(zmq.Again):
            while True:
                self._socket.recv_multipart(zmq.NOBLOCK)
        with contextlib.suppress(zmq.Again):
            request = {"id": next(self._numbers), "cmd": "recorder", "args": args}
            self._socket.send(msgpack.packb(request), zmq.NOBLOCK)
            return True
        return False


class _Syncer:
    """Brings a file to the disk in a thread of its own, one at a time."""

    def __init__(self) -> None:
        self._error: OSError | None = None
        self._wanted = threading.Semaphore(0)
        self._fd: int | None = None
        self._over = False
        self._thread = threading.Thread(target=self._run, name="sync", daemon=True)

    def __enter__(self) -> _Syncer:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over = True
        self._wanted.release()
        self._thread.join()

    def sync(self, fd: int | None) -> None:
        """Begin, unless there is nothing to bring or it is still being brought."""
        if fd is not None and self._fd is None:
            self._fd = os.dup(fd)  # the file may be closed meanwhile
            self._wanted.release()

    def failed(self) -> OSError | None:
        """What has gone wrong since it was asked last."""
        error, self._error = self._error, None
        return error

    def _run(self) -> None:
        while True:
            self._wanted.acquire()
            if self._over and self._fd is None:
                return
            assert self._fd is not None
            try:
                os.fdatasync(self._fd)
            except OSError as error:
                self._error = error
            finally:
                os.close(self._fd)
                self._fd = None
