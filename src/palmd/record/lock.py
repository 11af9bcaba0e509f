"""Lock that allows one recorder per daemon and folder; a second one would record the same run twice."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
from collections.abc import Iterator
from pathlib import Path


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
