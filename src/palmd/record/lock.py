"""One recorder for each daemon and folder: a second one would record the same run twice."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
from collections.abc import Iterator
from pathlib import Path


class RecorderLockedError(Exception):
    """Another recorder has the lock; says which process."""


@contextlib.contextmanager
def only_recorder(directory: Path, publish: str) -> Iterator[None]:
    """While entered, this process is the only one to record what is published at `publish` into `directory`.

    Raises RecorderLockedError. The lock ends with the process, however it ends; where none can be had, as on a file
    system without locks, there is none.
    """
    name = hashlib.sha256(publish.encode()).hexdigest()[:12]
    try:
        directory.mkdir(parents=True, exist_ok=True)
        fd = os.open(directory / f".recorder-{name}.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o640)
    except OSError:
        yield
        return
    try:
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            other = os.read(fd, 20).decode(errors="replace")
            raise RecorderLockedError(
                f"process {other} already records {publish} into {directory}: end it first, or configure another folder"
            ) from None
        except OSError:
            yield
            return
        os.ftruncate(fd, 0)
        os.write(fd, str(os.getpid()).encode())
        yield
    finally:
        os.close(fd)
