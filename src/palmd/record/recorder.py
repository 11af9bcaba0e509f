"""The recorder process: records the daemon's messages and an emulated rig's truth, and reports to the daemon.

One thread receives messages and writes them to the operating system tick by tick, so the process may be killed at any
time. Another thread syncs the file to disk twenty times a second, or as often as the disk permits, to survive a power
loss.

A lock allows one recorder per daemon and folder; a second one would record the same run twice.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

from palmd.bus.command_client import CommandClient
from palmd.bus.subscriber import Subscriber
from palmd.config.addresses import from_here
from palmd.config.any_config import AnyConfig
from palmd.keys import Credentials
from palmd.record import PARENT_GONE, REQUESTED
from palmd.record.recording import ClosedFile, Recording


class RecorderLockedError(Exception):
    """Another recorder has the lock; the text names its process."""


@contextlib.contextmanager
def only_recorder(directory: Path, publish: str) -> Iterator[None]:
    """Hold the lock for recording from the address `publish` into `directory`.

    Raises RecorderLockedError if another process holds it. The lock is released when the process ends, however it ends.
    On a file system without locks nothing is locked.
    """
    name = hashlib.sha256(publish.encode()).hexdigest()[:12]
    path, made = directory / f".recorder-{name}.lock", not directory.exists()
    try:
        directory.mkdir(parents=True, exist_ok=True)
        fd = _locked(path)
    except BlockingIOError:
        other = ""
        with contextlib.suppress(OSError):  # the other process may have ended meanwhile
            other = path.read_text(errors="replace")[:20]
        raise RecorderLockedError(
            f"process {other} already records {publish} into {directory}: stop it first, or configure another folder"
        ) from None
    except OSError:
        yield
        return
    try:
        os.ftruncate(fd, 0)
        os.write(fd, str(os.getpid()).encode())
        yield
    finally:
        with contextlib.suppress(OSError):
            path.unlink()
            if made:
                directory.rmdir()  # fails if something was recorded
        os.close(fd)


def _locked(path: Path) -> int:
    """Lock the file and return its descriptor; raises BlockingIOError if another process has it, OSError without locks.

    The previous holder removes the file when it ends; a lock on a removed file is void, so try again.
    """
    while True:
        fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o640)
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.samestat(os.fstat(fd), path.stat()):
                return fd
        except FileNotFoundError:
            pass
        except OSError:
            os.close(fd)
            raise
        os.close(fd)


POLL_S = 0.05  # longest wait for messages before the clock is checked
BATCH_MESSAGES = 1000  # most messages received before they are written
SYNC_S = 0.05  # period of syncs to disk
STATUS_PERIOD_S = 1.0  # period of status reports to the daemon
DRAIN_S = 0.15  # wait for the daemon's last messages when stopped


def record(
    config: AnyConfig,
    truth: Sequence[str],
    ready: Callable[[], None],
    stopped: Callable[[], bool],
    ended: Callable[[ClosedFile], None],
    key: Credentials | None = None,
) -> None:
    """Record until `stopped`. `truth`: further addresses to subscribe to; `key`: for a daemon that requires keys.

    `ready` is called when the sockets are open, whether or not a daemon runs; `ended` is called with each closed file.
    Raises CliError for an invalid address.
    """
    recording, parent = Recording(config, ended), os.getppid()
    with contextlib.ExitStack() as stack:
        publish, command = from_here(config.bus.publish), from_here(config.bus.command)
        subscriber = stack.enter_context(Subscriber(publish, topics=("",), key=key, keyless=truth, high_water=0))
        daemon = stack.enter_context(CommandClient(command, key=key, now_or_never=True))
        syncer = stack.enter_context(_Syncer())
        sync_due = status_due = 0.0
        clock = _MonotonicWallClock()
        ready()
        while not stopped():
            if recording.path is None:
                clock.set()
            _drain(subscriber, recording, POLL_S, clock)
            recording.flush(clock())
            error = syncer.failed()
            if isinstance(error, OSError):
                recording.fail(error, clock())
            now = time.monotonic()
            if now >= sync_due and syncer.sync(recording.fd):
                sync_due = now + SYNC_S
            if now >= status_due and _send_status(daemon, recording):
                status_due = now + STATUS_PERIOD_S
        t_end = time.monotonic() + DRAIN_S
        while _drain(subscriber, recording, DRAIN_S, clock) and time.monotonic() < t_end:
            pass
    recording.finish(REQUESTED if os.getppid() == parent else PARENT_GONE)


class _MonotonicWallClock:
    """Unix time (s) that advances with the monotonic clock between calls of `set`, so setting the wall clock cannot
    make times jump within a file."""

    def __init__(self) -> None:
        self.set()

    def set(self) -> None:
        """Align with the wall clock."""
        self._offset = time.time() - time.monotonic()

    def __call__(self) -> float:
        return time.monotonic() + self._offset


def _drain(subscriber: Subscriber, recording: Recording, wait_s: float, clock: Callable[[], float]) -> int:
    """Wait for messages and record all that are there; returns their number."""
    count = 0
    for frames in subscriber.frames(BATCH_MESSAGES, wait_s):
        recording.take(frames, clock())
        count += 1
    return count


def _send_status(client: CommandClient, recording: Recording) -> bool:
    """Send the command `recorder` with the status; False if no daemon takes it. Discards earlier replies."""
    args: dict[str, Any] = {"bytes": recording.size_bytes, "messages": recording.messages, "lost": recording.lost}
    args["process"] = os.getpid()
    if recording.path is not None:
        args["path"] = str(recording.path)
    if recording.problem:
        args["problem"] = recording.problem
    for _ in client.replies():
        pass
    return client.post("recorder", args) is not None


class _Syncer:
    """Syncs a file to disk in its own thread, one sync at a time."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1, "sync")
        self._running: Future[None] | None = None

    def __enter__(self) -> _Syncer:
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown()

    def sync(self, fd: int | None) -> bool:
        """Start a sync of `fd` and return True; False without a file or while a sync is running."""
        if fd is None or self._running is not None:
            return False
        self._running = self._pool.submit(_sync, os.dup(fd))  # the file may be closed meanwhile
        return True

    def failed(self) -> BaseException | None:
        """The error of the sync that has ended since the last call, None without one."""
        if self._running is None or not self._running.done():
            return None
        ended, self._running = self._running, None
        return ended.exception()


def _sync(fd: int) -> None:
    try:
        os.fdatasync(fd)
    finally:
        os.close(fd)
