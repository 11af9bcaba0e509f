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
    path, made = directory / f".recorder-{name}.lock", not directory.exists()
    try:
        directory.mkdir(parents=True, exist_ok=True)
        fd = _locked(path)
    except BlockingIOError:
        other = ""
        with contextlib.suppress(OSError):  # which may have ended meanwhile
            other = path.read_text(errors="replace")[:20]
        raise RecorderLockedError(
            f"process {other} already records {publish} into {directory}: end it first, or configure another folder"
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
                directory.rmdir()  # unless something was recorded
        os.close(fd)


def _locked(path: Path) -> int:
    """The descriptor of the locked file; raises BlockingIOError where another process has it, OSError where none can.

    Who ends takes the file away: a lock on one that is gone is none.
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
