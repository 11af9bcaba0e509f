"""Write MCAP files that are readable after every flush.

A run is recorded record by record, without chunks, so flushed data survive a crash of the recorder. After the run its
messages are packed into compressed chunks. Both forms begin with metadata and attachments, followed by schemas,
channels and messages in the order of reception. The channels are repeated every megabyte outside the chunks, so that a
damaged chunk does not remove the topic names of others. `palmd.record.mcapread` reads these files.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from mcap.data_stream import RecordBuilder
from mcap.records import Channel, McapRecord, Schema
from mcap.writer import CompressionType, Writer

from palmd.aliases import with_standard_names
from palmd.messages import Fields
from palmd.payload import unpacked
from palmd.quantities import SCHEMA, STAMP, Kind, Quantity, Topic
from palmd.record import END, RunError
from palmd.topics import TOPICS

PROFILE = "palmd"
MESSAGE_ENCODING, SCHEMA_ENCODING = "msgpack", "jsonschema"
SEQUENCE_MODULUS = 1 << 32

_MEDIA_TYPES = {".yaml": "application/yaml", ".json": "application/json"}
REPEAT_CHANNELS_BYTES = 1 << 20  # bytes of messages between repetitions of the channel records


@dataclass(frozen=True, slots=True)
class RawMessage:
    """One message as published; log time is its arrival, publish time its stamp (Unix ns)."""

    topic: str
    log_time_ns: int
    publish_time_ns: int
    sequence: int
    payload: bytes

    @property
    def fields(self) -> Fields:
        """The decoded payload under standard names; raises RunError if it is not a msgpack map."""
        fields = unpacked(self.payload)
        if fields is None:
            raise RunError(f"{self.topic}, message {self.sequence}: not a msgpack map; the recording is damaged")
        return with_standard_names(self.topic, fields)


@dataclass(frozen=True, slots=True)
class Preface:
    """Metadata records (maps of texts) and attached files that precede the messages, by name."""

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
TOPICS_BY_NAME = {topic.name: topic for topic in TOPICS}


def json_schema(name: str) -> dict[str, Any]:
    """The JSON schema of a topic's messages from the table of topics; an unconstrained object for unknown topics."""
    topic = TOPICS_BY_NAME.get(name)
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
    """Writes a run to a binary stream; messages are stored only when the stream is flushed."""

    def __init__(self, stream: IO[bytes], preface: Preface, create_time_ns: int, *, compressed: bool) -> None:
        """Write the preface; `compressed` packs messages into zstd chunks. Raises OSError."""
        self._writer = Writer(stream, compression=CompressionType.ZSTD, use_chunking=compressed)
        self._writer.start(PROFILE)
        self._stream, self._compressed = stream, compressed
        self._channels: dict[str, int] = {}
        self._records: dict[str, Channel] = {}
        self._bytes = 0
        for name, values in preface.metadata.items():
            self._writer.add_metadata(name, dict(values))
        for name, data in preface.attachments.items():
            self._writer.add_attachment(
                create_time_ns, create_time_ns, name, _MEDIA_TYPES.get(Path(name).suffix, "text/plain"), data
            )

    def write(self, message: RawMessage) -> None:
        """Append one message, preceded by schema and channel for the first of its topic. Raises OSError."""
        channel = self._channels.get(message.topic)
        if channel is None:
            channel = self._channels[message.topic] = self._register(message.topic)
        self._bytes += len(message.payload)
        if self._bytes >= REPEAT_CHANNELS_BYTES:
            self._bytes = 0
            self._repeat_channels()
        self._writer.add_message(
            channel, message.log_time_ns, message.payload, message.publish_time_ns, message.sequence % SEQUENCE_MODULUS
        )

    def finish(self, why: str = "") -> None:
        """Write the reason `why` (if given), the summary and the footer; the stream stays open. Raises OSError."""
        self._repeat_channels()
        if why:
            self._writer.add_metadata(END, {"why": why})
        self._writer.finish()  # type: ignore[no-untyped-call]

    def _register(self, topic: str) -> int:
        data = json.dumps(json_schema(topic), ensure_ascii=False).encode()
        schema = self._writer.register_schema(topic, SCHEMA_ENCODING, data)
        metadata = {"schema": str(SCHEMA)}
        channel = self._writer.register_channel(topic, MESSAGE_ENCODING, schema, metadata)
        self._records[topic] = Channel(channel, topic, MESSAGE_ENCODING, metadata, schema)
        if self._compressed:  # without chunks the library has just written both to the stream
            self._write_outside_chunks(
                Schema(data=data, encoding=SCHEMA_ENCODING, id=schema, name=topic), self._records[topic]
            )
        return channel

    def _repeat_channels(self) -> None:
        self._write_outside_chunks(*self._records.values())

    def _write_outside_chunks(self, *some: McapRecord) -> None:
        """Write records directly to the stream; the library buffers nothing but the contents of a chunk."""
        builder = RecordBuilder()
        for record in some:
            record.write(builder)
        self._stream.write(builder.end())  # type: ignore[no-untyped-call]
