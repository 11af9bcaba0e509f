"""Find the records of an MCAP file that may be damaged. Pure functions of the file's bytes.

A record is accepted if its fields fill it exactly and the next record begins where it ends. If the next one does not,
its contents decide: a checksum, or consistent inner lengths. After a damaged stretch the next record is searched by its
head (opcode and length) and accepted by its contents. A chunk with a damaged head but intact contents is still read.
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

RECORD_BYTES_MAX = 1 << 28  # a larger length is taken as damage
HEAD = struct.Struct("<BQ")
"""Head of a record: opcode, length."""
MESSAGE_HEAD = struct.Struct("<HIQQ")
"""Head of a message: channel, sequence, log time, publish time."""
SUMMARY = frozenset(
    (Opcode.STATISTICS, Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX, Opcode.SUMMARY_OFFSET)
)
"""Records that occur in the summary section only."""

_CHUNK_HEAD = struct.Struct("<QQQI")
_LENGTH, _LONG_LENGTH = struct.Struct("<I"), struct.Struct("<Q")
_FIXED = {Opcode.DATA_END: 4, Opcode.FOOTER: 20, Opcode.SUMMARY_OFFSET: 17}
_SELF_CHECKED = (Opcode.CHUNK, Opcode.ATTACHMENT, Opcode.MESSAGE, Opcode.FOOTER)
"""Records accepted after damage by their contents alone; others need a following record."""
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
        """The bytes after the head."""
        return data[self.begin + HEAD.size : self.end]


class Gap(NamedTuple):
    """Bytes from `begin` to `end` without a complete record."""

    begin: int
    end: int


def records(data: Buffer, begin: int = 0, end: int | None = None) -> Iterator[FileRecord | Gap]:
    """All records of a file, or of a byte range of it, and the gaps between them; never raises.

    Bytes after a footer are read as well: a damaged file may have a footer in its middle.
    """
    size = len(data) if end is None else min(end, len(data))  # the file may have been packed (shortened) meanwhile
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
    """Opcode and content of the records in a chunk with a valid checksum."""
    at = 0
    while at + HEAD.size <= len(data):
        opcode, length = HEAD.unpack_from(data, at)
        at += HEAD.size + length
        yield opcode, data[at - length : at]


def unpacked_chunk(content: bytes) -> bytes | None:
    """The decompressed records of a chunk; None if its checksum or format is wrong."""
    try:
        chunk = Chunk.read(_stream(content))
        if chunk.compression == "zstd" and zstandard.frame_content_size(chunk.data) > RECORD_BYTES_MAX:
            return None
        stream, length = get_chunk_data_stream(chunk, validate_crc=True)
        return stream.read(length)
    except Exception:  # each compression raises its own errors
        return None


def parsed(kind: type[Part], content: bytes) -> Part | None:
    """The record in `content`; None if it is damaged or shorter than `content`."""
    stream = _stream(content)
    try:
        record: Part = kind.read(stream)
    except Exception:  # missing bytes, invalid text, absurd lengths
        return None
    return record if stream.count == len(content) else None


def _record_at(data: Buffer, at: int, size: int) -> FileRecord | None:
    """The record with its head at `at`; None if that is not a valid head."""
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
    return followed or record.opcode == Opcode.FOOTER or _contents_intact(data, record)


def _headless_chunk(data: Buffer, at: int, size: int) -> FileRecord | None:
    """A chunk at `at` with a damaged head: found by its inner lengths and verified by its checksum."""
    begin = at + HEAD.size
    length = _chunk_length(data, begin, size)
    if length is None or length > RECORD_BYTES_MAX or begin + length > size:
        return None
    chunk = FileRecord(Opcode.CHUNK, at, begin + length)
    return chunk if unpacked_chunk(chunk.content(data)) else None


def _next(data: Buffer, at: int, size: int) -> int:
    """Start of the next record with intact contents from `at` on; `size` if there is none."""
    for found in _CANDIDATE.finditer(data, at, size):
        record = _record_at(data, found.start(), size)
        if record is not None and _fits(data, record) and _contents_intact(data, record):
            followed = record.end == size or _record_at(data, record.end, size) is not None
            if followed or record.opcode in _SELF_CHECKED:
                return record.begin
    return size


def _fits(data: Buffer, record: FileRecord) -> bool:
    """Whether the inner lengths of a record add up to its length; cheap."""
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
    """Length of a chunk's contents according to its inner lengths; None if they exceed `end`."""
    named = at + _CHUNK_HEAD.size
    if named + _LENGTH.size > end:
        return None
    held = named + _LENGTH.size + _LENGTH.unpack_from(data, named)[0]
    if held + _LONG_LENGTH.size > end:
        return None
    return int(held + _LONG_LENGTH.size + _LONG_LENGTH.unpack_from(data, held)[0] - at)


def _contents_intact(data: Buffer, record: FileRecord) -> bool:
    """Whether the contents of a record that fits are valid by themselves (checksum, decoding); expensive."""
    content = record.content(data)
    if record.opcode == Opcode.CHUNK:
        return unpacked_chunk(content) is not None
    if record.opcode == Opcode.ATTACHMENT:
        return attachment(content) is not None
    if record.opcode == Opcode.MESSAGE:
        return unpacked(content[MESSAGE_HEAD.size :]) is not None
    return True


def attachment(content: bytes) -> Attachment | None:
    """The attached file in a record; None if its checksum is wrong."""
    found = parsed(Attachment, content)
    crc = _LENGTH.unpack(content[-4:])[0] if found is not None else 0
    return found if found is not None and crc in (0, zlib.crc32(content[:-4])) else None


def _stream(content: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(content))
