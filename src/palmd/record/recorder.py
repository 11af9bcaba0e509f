"""The recorder's process: listens to the daemon and to the emulated rig's truth, and tells the daemon how it fares.

One thread receives and hands over to the operating system, tick by tick, so that the process may be killed at any time;
another one brings that to the disk twenty times a second, or as often as the disk lets it, so that the power may go.
"""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

from palmd.bus.command_client import CommandClient
from palmd.bus.subscriber import Subscriber
from palmd.config.addresses import from_here
from palmd.config.any_config import AnyConfig
from palmd.keys import Credentials
from palmd.record import ASKED, STARTER_GONE
from palmd.record.recording import Ended, Recording

LOOK_S = 0.05  # between looks at the clock when nothing comes
BATCH = 1000  # messages that are taken before they are handed over
SYNC_S = 0.05  # and between times that this is brought to the disk
TELL_S = 1.0
LAST_WORDS_S = 0.15  # that a daemon's last messages may take


def record(
    config: AnyConfig,
    truth: Sequence[str],
    ready: Callable[[], None],
    stopped: Callable[[], bool],
    ended: Callable[[Ended], None],
    key: Credentials | None = None,
) -> None:
    """Record until `stopped`; `truth` holds addresses beside the daemon's, `key` is for a daemon that has keys.

    `ready` is called when it listens, whoever is there; `ended` is told of each closed file. Raises CliError for what
    is no address.
    """
    recording, starter = Recording(config, ended), os.getppid()
    with contextlib.ExitStack() as stack:
        publish, command = from_here(config.bus.publish), from_here(config.bus.command)
        subscriber = stack.enter_context(Subscriber(publish, topics=("",), key=key, keyless=truth, high_water=0))
        daemon = stack.enter_context(CommandClient(command, key=key, now_or_never=True))
        syncer = stack.enter_context(_Syncer())
        sync_due = tell_due = 0.0
        clock = _SteadyClock()
        ready()
        while not stopped():
            if recording.path is None:
                clock.set()
            _drain(subscriber, recording, LOOK_S, clock)
            recording.flush(clock())
            error = syncer.failed()
            if error is not None:
                recording.fail(error, clock())
            now = time.monotonic()
            if now >= sync_due and syncer.sync(recording.fd):
                sync_due = now + SYNC_S
            if now >= tell_due and _told(daemon, recording):
                tell_due = now + TELL_S
        t_end = time.monotonic() + LAST_WORDS_S
        while _drain(subscriber, recording, LAST_WORDS_S, clock) and time.monotonic() < t_end:
            pass
    recording.finish(ASKED if os.getppid() == starter else STARTER_GONE)


class _SteadyClock:
    """Unix time (s) that no setting of the wall clock moves within a file: a file has no message of another year."""

    def __init__(self) -> None:
        self.set()

    def set(self) -> None:
        """By the wall clock, as it is now."""
        self._ahead = time.time() - time.monotonic()

    def __call__(self) -> float:
        return time.monotonic() + self._ahead


def _drain(subscriber: Subscriber, recording: Recording, wait_s: float, clock: Callable[[], float]) -> int:
    """Wait for something to come, then take what there is; how much that was."""
    count = 0
    for frames in subscriber.frames(BATCH, wait_s):
        recording.take(frames, clock())
        count += 1
    return count


def _told(client: CommandClient, recording: Recording) -> bool:
    """Whether the daemon, if there is one, took the command `recorder`; earlier answers are of no interest."""
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

    def sync(self, fd: int | None) -> bool:
        """Begin, unless there is nothing to bring or it is still being brought; whether it has begun."""
        if fd is None or self._fd is not None:
            return False
        self._fd = os.dup(fd)  # the file may be closed meanwhile
        self._wanted.release()
        return True

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
