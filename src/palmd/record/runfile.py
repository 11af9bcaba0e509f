"""The file of a run while it is being recorded, and its packing after the end."""

from __future__ import annotations

import contextlib
import os
import stat
from collections.abc import Callable
from datetime import UTC, datetime
from io import BytesIO
from pathlib import Path

from palmd.record import SUFFIX, RunError
from palmd.record.mcapfile import Preface, RawMessage, RunWriter
from palmd.record.mcapread import Layout, read_layout, read_messages
from palmd.record.metadata import preface_of

NAME = "%Y-%m-%dT%H-%M-%SZ"
_MAX_FILES_PER_SECOND = 100


class _Spool(BytesIO):
    """Write buffer whose `flush` writes all of its contents to the file, or leaves the file unchanged."""

    def __init__(self, fd: int) -> None:
        super().__init__()
        self._fd = fd
        self.written = 0

    def tell(self) -> int:
        return self.written + super().tell()

    def flush(self) -> None:
        data = self.getvalue()
        try:
            at = 0
            while at < len(data):
                at += os.write(self._fd, data[at:])
        except OSError:
            with contextlib.suppress(OSError):
                os.ftruncate(self._fd, self.written)
            raise
        self.written += len(data)
        self.seek(0)
        self.truncate(0)


class RunFile:
    """A new file in `directory`, named after its start time. Methods raise OSError; the file then stays readable."""

    def __init__(self, directory: Path, preface: Preface, begin: datetime) -> None:
        """Create the directory if necessary, and the file with its preface."""
        directory.mkdir(parents=True, exist_ok=True)
        self.path, self.fd = _created(directory, begin)
        self.messages = self._flushed = 0
        self._spool = _Spool(self.fd)
        try:
            self._writer = RunWriter(self._spool, preface, round(begin.timestamp() * 1e9), compressed=False)
            self._spool.flush()
        except OSError:
            self.abandon()
            self.path.unlink(missing_ok=True)
            raise

    @property
    def size_bytes(self) -> int:
        """Bytes written to the operating system."""
        return self._spool.written

    @property
    def pending(self) -> int:
        """Number of messages not yet written to the operating system."""
        return self.messages - self._flushed

    def write(self, message: RawMessage) -> None:
        """Buffer one message until the next `flush`."""
        self._writer.write(message)
        self.messages += 1

    def flush(self) -> None:
        """Write everything to the operating system; it then survives a crash of this process."""
        self._spool.flush()
        self._flushed = self.messages

    def finish(self, why: str = "") -> None:
        """Write the footer and the reason `why`, sync to disk, and close."""
        self._writer.finish(why)
        self.flush()
        os.fsync(self.fd)
        os.close(self.fd)

    def abandon(self) -> None:
        """Close the file unfinished."""
        os.close(self.fd)


def _created(directory: Path, begin: datetime) -> tuple[Path, int]:
    stem = begin.astimezone(UTC).strftime(NAME)
    for number in range(1, _MAX_FILES_PER_SECOND):
        path = directory / f"{stem}{f'-{number}' if number > 1 else ''}{SUFFIX}"
        with contextlib.suppress(FileExistsError):
            return path, os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
    raise FileExistsError(f"{stem}{SUFFIX} and {_MAX_FILES_PER_SECOND - 1} more exist")


def pack(source: Path, target: Path, at: Callable[[int], None] = lambda _: None) -> Layout:
    """Write the readable messages of `source` to `target` as a finished file of compressed chunks, atomically.

    Both may be the same path, unless parts of it are unreadable or from another program. The new file gets the owner
    and mode of `source` if permitted. `at` is called with the number of messages written. Returns the layout of
    `source`. Raises OSError, RunError; no partial file remains then.
    """
    layout = read_layout(source)
    if layout.damage.unread_bytes and target.exists() and target.samefile(source):
        raise RunError(
            f"{source}: {layout.damage.unread_bytes:,} bytes cannot be read and would be lost if the file were "
            "replaced; write to another file"
        )
    if layout.foreign and target.exists() and target.samefile(source):
        raise RunError(f"{source}: holds messages of other programs, which would be lost; write to another file")
    if target.exists() and not target.is_file():
        raise RunError(f"{target}: is not a regular file; write to another file")
    part = target.with_name(f".{target.name}.part")
    count = 0
    try:
        with part.open("wb") as stream:
            _copy_ownership(stream.fileno(), source)
            preface = preface_of(layout)
            writer: RunWriter | None = None
            for message in read_messages(source, layout):
                writer = writer or RunWriter(stream, preface, message.log_time_ns, compressed=True)
                writer.write(message)
                count += 1
                at(count)
            writer = writer or RunWriter(stream, preface, 0, compressed=True)
            writer.finish()
            stream.flush()
            os.fsync(stream.fileno())
        part.rename(target)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    return layout


def _copy_ownership(fd: int, like: Path) -> None:
    """Copy owner and mode of another file, so that a service keeps its recording when root recovers it."""
    other = like.stat()
    with contextlib.suppress(PermissionError):
        os.fchown(fd, other.st_uid, other.st_gid)
        os.fchmod(fd, stat.S_IMODE(other.st_mode))
