"""MCAP, as palmd uses it: a writer whose file is whole after every flush, and a reader that forgives a torn end.

A run is written record by record, without chunks, so that what has been flushed survives whatever happens to the
recorder. Once it has ended, its messages are packed into compressed chunks. Both forms begin with the metadata and
attachments, then come schemas, channels and messages in the order in which they were received. Everything below is
plain bytes and files; what is in a run is `palmd.record.run`'s business.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import IO, Any, BinaryIO, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Metadata
from mcap.stream_reader import get_chunk_data_stream
from mcap.writer import CompressionType, Writer

from palmd.messages import Fields
from palmd.payload import unpacked
from palmd.quantities import SCHEMA, STAMP, Kind, Quantity, Topic
from palmd.record import MAGIC, RunError
from palmd.topics import TOPICS

PROFILE = "palmd"
MESSAGE_ENCODING, SCHEMA_ENCODING = "msgpack", "jsonschema"
RECORD_BYTES_MAX = 1 << 28  # a longer record is no record
_HEAD = struct.Struct("<BQ")  # of a record: opcode, length
_MESSAGE_HEAD = struct.Struct("<HIQQ")  # of a message: channel, sequence, log time, publish time
_FOOTER_BYTES = _HEAD.size + 20 + len(MAGIC)
_SEQUENCE_MODULUS = 1 << 32

Part = TypeVar("Part", Attachment, Channel, Metadata)


@dataclass(frozen=True, slots=True)
class RawMessage:
    """One message as it was published; times are Unix nanoseconds, of its arrival and of its stamp."""

    topic: str
    log_time_ns: int
    publish_time_ns: int
    sequence: int
    payload: bytes

    @property
    def fields(self) -> Fields:
        """What it says; raises RunError for a payload that is no msgpack map."""
        fields = unpacked(self.payload)
        if fields is None:
            raise RunError(f"{self.topic}, message {self.sequence}: is no msgpack map; the recording is damaged")
        return fields


@dataclass(frozen=True, slots=True)
class Preface:
    """What a file says before its messages: maps of texts, and attached files, by name."""

    metadata: Mapping[str, Mapping[str, str]]
    attachments: Mapping[str, bytes]


# ---------------------------------------------------------------------------------------------------- schemas

_JSON_TYPES: dict[Kind, dict[str, Any]] = {
    "number": {"type": "number"},
    "bool": {"type": "boolean"},
    "text": {"type": "string"},
    "numbers": {"type": "array", "items": {"type": "number"}},
    "texts": {"type": "array", "items": {"type": "string"}},
    "sds": {"type": "object", "additionalProperties": {"type": "number"}},
}
_BY_NAME = {topic.name: topic for topic in TOPICS}


def json_schema(name: str) -> dict[str, Any]:
    """The JSON schema of a topic's messages, as the table of topics has them; anything goes where it has none."""
    topic = _BY_NAME.get(name)
    if topic is None:
        return {"title": name, "type": "object"}
    return _table_schema(topic)


def _table_schema(topic: Topic) -> dict[str, Any]:
    quantities = (*STAMP, *topic.quantities)
    named = {each.name: _property(each) for each in quantities if not each.name.endswith("*")}
    families = {f"^{each.name[:-1]}": _property(each) for each in quantities if each.name.endswith("*")}
    schema = {"title": topic.name, "type": "object", "properties": named, "required": list(named)}
    return schema | ({"patternProperties": families} if families else {})


def _property(quantity: Quantity) -> dict[str, Any]:
    unit = f" ({quantity.unit})" if quantity.unit else ""
    return _JSON_TYPES[quantity.kind] | {"description": quantity.meaning + unit}


# ---------------------------------------------------------------------------------------------------- writing


class RunWriter:
    """Writes a run to a binary stream; nothing is sure to be there before the stream is flushed."""

    def __init__(self, stream: IO[bytes], preface: Preface, create_time_ns: int, *, compressed: bool) -> None:
        """Writes the preface at once; `compressed` packs messages into zstd chunks. Raises OSError."""
        self._writer = Writer(stream, compression=CompressionType.ZSTD, use_chunking=compressed)
        self._writer.start(PROFILE)
        self._channels: dict[str, int] = {}
        for name, values in preface.metadata.items():
            self._writer.add_metadata(name, dict(values))
        for name, data in preface.attachments.items():
            self._writer.add_attachment(create_time_ns, create_time_ns, name, _media_type(name), data)

    def write(self, message: RawMessage) -> None:
        """Append one message; its topic's schema goes before the first one. Raises OSError."""
        channel = self._channels.get(message.topic)
        if channel is None:
            channel = self._channels[message.topic] = self._begin(message.topic)
        self._writer.add_message(
            channel, message.log_time_ns, message.payload, message.publish_time_ns, message.sequence % _SEQUENCE_MODULUS
        )

    def finish(self) -> None:
        """Write the summary and the end; the stream stays open. Raises OSError."""
        self._writer.finish()  # type: ignore[no-untyped-call]

    def _begin(self, topic: str) -> int:
        data = json.dumps(json_schema(topic), ensure_ascii=False).encode()
        schema = self._writer.register_schema(topic, SCHEMA_ENCODING, data)
        return self._writer.register_channel(topic, MESSAGE_ENCODING, schema, {"schema": str(SCHEMA)})


def _media_type(name: str) -> str:
    return {".yaml": "application/yaml", ".json": "application/json"}.get(Path(name).suffix, "text/plain")


# ---------------------------------------------------------------------------------------------------- reading


@dataclass(slots=True)
class Tail:
    """Where reading ended: `torn_bytes` at the end of the file hold no whole record."""

    torn_bytes: int = 0


def is_finished(path: Path) -> bool:
    """Whether the file ends as a finished MCAP file does; raises OSError."""
    with path.open("rb") as stream:
        if stream.seek(0, 2) < len(MAGIC) + _FOOTER_BYTES:
            return False
        stream.seek(-_FOOTER_BYTES, 2)
        end = stream.read()
    return end[0] == Opcode.FOOTER and end.endswith(MAGIC)


def is_packed(path: Path) -> bool:
    """Whether the file is finished, and its messages in chunks; raises RunError, OSError."""
    with path.open("rb") as stream:
        contents = (opcode for opcode, _ in _records(path, stream, Tail()) if opcode in (Opcode.MESSAGE, Opcode.CHUNK))
        return is_finished(path) and next(contents, None) == Opcode.CHUNK


def read_preface(path: Path) -> Preface:
    """Metadata and attachments before the first message, but for damaged ones; raises RunError, OSError."""
    metadata: dict[str, Mapping[str, str]] = {}
    attachments: dict[str, bytes] = {}
    with path.open("rb") as stream:
        for opcode, content in _records(path, stream, Tail()):
            if opcode == Opcode.METADATA:
                one = _parsed(Metadata, content)
                if one is not None:
                    metadata[one.name] = one.metadata
            elif opcode == Opcode.ATTACHMENT:
                file = _parsed(Attachment, content)
                if file is not None:
                    attachments[file.name] = file.data
            elif opcode in (Opcode.MESSAGE, Opcode.CHUNK):
                break
    return Preface(metadata, attachments)


def read_messages(path: Path, tail: Tail | None = None) -> Iterator[RawMessage]:
    """The messages in the order of the file, up to where it ends or makes no sense; raises RunError, OSError.

    `tail` is told, once all have been read, how much at the end was left out.
    """
    topics: dict[int, str] = {}
    tail = tail or Tail()
    with path.open("rb") as stream:
        for opcode, content in _records(path, stream, tail):
            if opcode == Opcode.CHUNK:
                inner = _unpacked(content)
                if inner is None:
                    tail.torn_bytes = path.stat().st_size - stream.tell() + len(content) + _HEAD.size
                    return
                for inner_opcode, inner_content in _framed(BytesIO(inner), len(inner), Tail()):
                    yield from _message(inner_opcode, inner_content, topics)
            elif opcode == Opcode.DATA_END:
                return
            else:
                yield from _message(opcode, content, topics)


def _message(opcode: int, content: bytes, topics: dict[int, str]) -> Iterator[RawMessage]:
    """The message that a record is, if it is one; a channel is added to `topics`."""
    if opcode == Opcode.CHANNEL:
        channel = _parsed(Channel, content)
        if channel is not None:
            topics[channel.id] = channel.topic
    elif opcode == Opcode.MESSAGE and len(content) >= _MESSAGE_HEAD.size:
        channel_id, sequence, log_time, publish_time = _MESSAGE_HEAD.unpack_from(content)
        if channel_id in topics:
            payload = content[_MESSAGE_HEAD.size :]
            yield RawMessage(topics[channel_id], log_time, publish_time, sequence, payload)


def _records(path: Path, stream: BinaryIO, tail: Tail) -> Iterator[tuple[int, bytes]]:
    """Opcode and content of each whole record; raises RunError."""
    if stream.read(len(MAGIC)) != MAGIC:
        raise RunError(f"{path}: is no MCAP file")
    size = stream.seek(0, 2)
    stream.seek(len(MAGIC))
    yield from _framed(stream, size, tail)


def _framed(stream: IO[bytes], size: int, tail: Tail) -> Iterator[tuple[int, bytes]]:
    at = stream.tell()
    while at < size:
        head = stream.read(_HEAD.size)
        opcode, length = _HEAD.unpack(head) if len(head) == _HEAD.size else (0, 0)
        if not opcode or length > min(RECORD_BYTES_MAX, size - at - _HEAD.size):
            tail.torn_bytes = size - at
            return
        yield opcode, stream.read(length)
        if opcode == Opcode.FOOTER:
            return
        at += _HEAD.size + length


def _unpacked(content: bytes) -> bytes | None:
    """What is in a chunk, None where it is damaged."""
    try:
        stream, length = get_chunk_data_stream(Chunk.read(_stream(content)), validate_crc=True)
        return stream.read(length)
    except Exception:  # each compression has its own kinds
        return None


def _parsed(kind: type[Part], content: bytes) -> Part | None:
    """The record in `content`, None where it is damaged."""
    try:
        record: Part = kind.read(_stream(content))
    except Exception:  # bytes that run out, text that is no text, lengths beyond all reason
        return None
    return record


def _stream(content: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(content))
