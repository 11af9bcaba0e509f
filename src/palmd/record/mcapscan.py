"""The records of an MCAP file that may be damaged. Pure functions of the file's bytes.

A record is accepted if its fields fill it exactly and the next record begins where it ends. Where that fails, its
contents decide: a checksum, or lengths inside that fit. After a damaged stretch the next record is searched for by the
form of its head (opcode and length), and accepted by its contents alone. A chunk of which only the head is damaged is
read all the same.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from mmap import mmap
from typing import NamedTuple, TypeVar

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from mcap.stream_reader import get_chunk_data_stream

from palmd.payload import unpacked
from palmd.record import MAGIC

RECORD_BYTES_MAX = 1 << 28  # a longer record is no record
HEAD = struct.Struct("<BQ")
"""Of a record: opcode, length."""
MESSAGE_HEAD = struct.Struct("<HIQQ")
"""Of a message: channel, sequence, log time, publish time."""
SUMMARY = frozenset(
    (Opcode.STATISTICS, Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX, Opcode.SUMMARY_OFFSET)
)
"""The records that stand in the summary alone."""

_CHUNK_HEAD, _CHUNK_TIMES = struct.Struct("<QQQI"), 16
_LENGTH, _LONG_LENGTH = struct.Struct("<I"), struct.Struct("<Q")
_FIXED = {Opcode.DATA_END: 4, Opcode.FOOTER: 20, Opcode.SUMMARY_OFFSET: 17}
_VOUCHED = (Opcode.CHUNK, Opcode.ATTACHMENT, Opcode.MESSAGE, Opcode.FOOTER)
"""What is found after damage by its contents alone; of others the next record has to follow."""
_CANDIDATE = re.compile(rb"(?=[\x01-\x0f].{4}\x00{4})", re.DOTALL)

Buffer = bytes | mmap
Part = TypeVar("Part", Attachment, Channel, Chunk, Header, Metadata, Schema, Statistics)
_PARTS: dict[int, type] = {
    Opcode.HEADER: Header,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
    Opcode.STATISTICS: Statistics,
    Opcode.CHUNK_INDEX: ChunkIndex,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex,
    Opcode.METADATA_INDEX: MetadataIndex,
}


class FileRecord(NamedTuple):
    """A record from byte `begin` (its head) to `end`."""

    opcode: int
    begin: int
    end: int

    def content(self, data: Buffer) -> bytes:
        """What follows its head."""
        return data[self.begin + HEAD.size : self.end]


class Gap(NamedTuple):
    """Bytes from `begin` to `end` that hold no whole record."""

    begin: int
    end: int


def records(data: Buffer, begin: int = 0, end: int | None = None) -> Iterator[FileRecord | Gap]:
    """All records of a file, or of a stretch of it, and the gaps between them; never raises.

    What follows a footer is read as well: a damaged file may hold one in its middle.
    """
    size = len(data) if end is None else min(end, len(data))  # a file that is packed since is shorter
    at = begin
    if at == 0:
        at = len(MAGIC)
        if data[:at] != MAGIC:
            at = _next(data, 0, size)
            yield Gap(0, at)
    while at < size:
        record = _record_at(data, at, size)
        if record is None or not _accepted(data, record, size):
            chunk = _headless_chunk(data, at, size)
            if chunk is not None:
                yield Gap(at, at + HEAD.size)
                yield chunk
                at = chunk.end
                continue
            gap = Gap(at, _next(data, at + 1, size))
            yield gap
            at = gap.end
            continue
        yield record
        at = record.end
        if record.opcode == Opcode.FOOTER and data[at : at + len(MAGIC)] == MAGIC:
            at += len(MAGIC)


def framed(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Opcode and content of the records in a chunk whose checksum is right."""
    at = 0
    while at + HEAD.size <= len(data):
        opcode, length = HEAD.unpack_from(data, at)
        at += HEAD.size + length
        yield opcode, data[at - length : at]


def unpacked_chunk(content: bytes) -> bytes | None:
    """The records in a chunk, None where its checksum or its form is wrong."""
    try:
        chunk = Chunk.read(_stream(content))
        if chunk.compression == "zstd" and zstandard.frame_content_size(chunk.data) > RECORD_BYTES_MAX:
            return None
        stream, length = get_chunk_data_stream(chunk, validate_crc=True)
        return stream.read(length)
    except Exception:  # each compression has its own kinds
        return None


def parsed(kind: type[Part], content: bytes) -> Part | None:
    """The record in `content`; None where it is damaged, or something is left over."""
    stream = _stream(content)
    try:
        record: Part = kind.read(stream)
    except Exception:  # bytes that run out, text that is no text, lengths beyond all reason
        return None
    return record if stream.count == len(content) else None


def _record_at(data: Buffer, at: int, size: int) -> FileRecord | None:
    """The record whose head stands at `at`; None where no record has such a head."""
    if at + HEAD.size > size:
        return None
    opcode, length = HEAD.unpack_from(data, at)
    end = at + HEAD.size + length
    if not 1 <= opcode <= Opcode.DATA_END or length > RECORD_BYTES_MAX or end > size:
        return None
    return FileRecord(opcode, at, end)


def _accepted(data: Buffer, record: FileRecord, size: int) -> bool:
    if not _fits(data, record):
        return False
    followed = record.end == size or _record_at(data, record.end, size) is not None
    return followed or record.opcode == Opcode.FOOTER or _sound(data, record)


def _headless_chunk(data: Buffer, at: int, size: int) -> FileRecord | None:
    """The chunk at `at` whose head is damaged: its own lengths say where it ends, its checksum that it is one."""
    begin = at + HEAD.size
    length = _chunk_length(data, begin, size)
    if length is None or length > RECORD_BYTES_MAX or begin + length > size:
        return None
    chunk = FileRecord(Opcode.CHUNK, at, begin + length)
    return chunk if unpacked_chunk(chunk.content(data)) else None


def _next(data: Buffer, at: int, size: int) -> int:
    """Where, from `at` on, the next record begins whose contents are sound; the end where there is none."""
    for found in _CANDIDATE.finditer(data, at, size):
        record = _record_at(data, found.start(), size)
        if record is not None and _fits(data, record) and _sound(data, record):
            followed = record.end == size or _record_at(data, record.end, size) is not None
            if followed or record.opcode in _VOUCHED:
                return record.begin
    return size


def _fits(data: Buffer, record: FileRecord) -> bool:
    """Whether the lengths in a record make up its own length; cheap."""
    opcode, at, length = record.opcode, record.begin + HEAD.size, record.end - record.begin - HEAD.size
    if opcode == Opcode.MESSAGE:
        return length >= MESSAGE_HEAD.size
    if opcode == Opcode.CHUNK:
        return length == _chunk_length(data, at, record.end)
    if opcode == Opcode.MESSAGE_INDEX:
        return length >= 6 and length == 6 + _LENGTH.unpack_from(data, at + 2)[0] and (length - 6) % 16 == 0
    if opcode in _PARTS:
        return parsed(_PARTS[opcode], record.content(data)) is not None
    if opcode == Opcode.ATTACHMENT:
        return length >= 36
    return length == _FIXED[Opcode(opcode)]


def _chunk_length(data: Buffer, at: int, end: int) -> int | None:
    """How long a chunk's contents are by the lengths in it."""
    named = at + _CHUNK_HEAD.size
    if named + _LENGTH.size > end:
        return None
    held = named + _LENGTH.size + _LENGTH.unpack_from(data, named)[0]
    if held + _LONG_LENGTH.size > end:
        return None
    return int(held + _LONG_LENGTH.size + _LONG_LENGTH.unpack_from(data, held)[0] - at)


def _sound(data: Buffer, record: FileRecord) -> bool:
    """Whether the contents of a record that fits vouch for it without what follows; expensive."""
    content = record.content(data)
    if record.opcode == Opcode.CHUNK:
        return unpacked_chunk(content) is not None
    if record.opcode == Opcode.ATTACHMENT:
        return attachment(content) is not None
    if record.opcode == Opcode.MESSAGE:
        return unpacked(content[MESSAGE_HEAD.size :]) is not None
    return True


def attachment(content: bytes) -> Attachment | None:
    """The attached file in a record, None where its checksum is wrong."""
    found = parsed(Attachment, content)
    crc = _LENGTH.unpack(content[-4:])[0] if found is not None else 0
    return found if found is not None and crc in (0, zlib.crc32(content[:-4])) else None


def _stream(content: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(content))
