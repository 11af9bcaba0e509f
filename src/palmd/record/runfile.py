"""One run on the disk while it is being recorded, and its packing when it has ended."""

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
_MOST_OF_ONE_SECOND = 100


class _Spool(BytesIO):
    """Collects what is written; `flush` brings it to the file as a whole, or leaves the file as it was."""

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
    """A new file in `directory`, named after its beginning. All of it raises OSError; the file then stays readable."""

    def __init__(self, directory: Path, preface: Preface, begin: datetime) -> None:
        """Makes the directory if it is not there; the file holds its preface at once."""
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
        """That have been handed to the operating system."""
        return self._spool.written

    @property
    def pending(self) -> int:
        """How many messages have not been."""
        return self.messages - self._flushed

    def write(self, message: RawMessage) -> None:
        """Append one message; nothing is safe before the next `flush`."""
        self._writer.write(message)
        self.messages += 1

    def flush(self) -> None:
        """Hand everything to the operating system: a death of this process then loses nothing of it."""
        self._spool.flush()
        self._flushed = self.messages

    def finish(self, why: str = "") -> None:
        """Write the end, and why it has come, bring everything to the disk, and close."""
        self._writer.finish(why)
        self.flush()
        os.fsync(self.fd)
        os.close(self.fd)

    def abandon(self) -> None:
        """Close without an end, as a file that cannot be written any further."""
        os.close(self.fd)


def _created(directory: Path, begin: datetime) -> tuple[Path, int]:
    stem = begin.astimezone(UTC).strftime(NAME)
    for number in range(1, _MOST_OF_ONE_SECOND):
        path = directory / f"{stem}{f'-{number}' if number > 1 else ''}{SUFFIX}"
        with contextlib.suppress(FileExistsError):
            return path, os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
    raise FileExistsError(f"{stem}{SUFFIX} and {_MOST_OF_ONE_SECOND - 1} more exist")


def pack(source: Path, target: Path, at: Callable[[int], None] = lambda _: None) -> Layout:
    """Write what can be read of `source` to `target` as a finished file of compressed chunks, and rename it into place.

    Both may be the same path, unless something in it cannot be read or is another program's. It belongs to whom
    `source` belongs to, as far as we may give it away. `at` is told the number of messages that are done.
    Returns what `source` holds. Raises OSError, RunError, and leaves no part of a file then.
    """
    layout = read_layout(source)
    if layout.damage.unread_bytes and target.exists() and target.samefile(source):
        raise RunError(
            f"{source}: {layout.damage.unread_bytes:,} bytes of it cannot be read, and would be lost in its place; "
            "write to another file"
        )
    if layout.foreign and target.exists() and target.samefile(source):
        raise RunError(f"{source}: holds messages of other programs, which would be lost; write to another file")
    if target.exists() and not target.is_file():
        raise RunError(f"{target}: is no file; write to a file")
    part = target.with_name(f".{target.name}.part")
    count = 0
    try:
        with part.open("wb") as stream:
            _give(stream.fileno(), source)
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


def _give(fd: int, like: Path) -> None:
    """The rights of another file: root, who recovers a service's recording, must not take it away from the service."""
    other = like.stat()
    with contextlib.suppress(PermissionError):
        os.fchown(fd, other.st_uid, other.st_gid)
        os.fchmod(fd, stat.S_IMODE(other.st_mode))
