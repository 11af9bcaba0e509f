"""MCAP as palmd writes it: a file that is readable after every flush.

A run is written record by record, without chunks, so that what has been flushed survives whatever happens to the
recorder. Once it has ended, its messages are packed into compressed chunks. Both forms begin with the metadata and
attachments, then come schemas, channels and messages in the order in which they were received. The channels are
repeated every megabyte, outside the chunks: a damaged chunk then costs no other chunk the names of its topics.
`palmd.record.mcapread` reads such files.
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

from palmd.messages import Fields
from palmd.payload import unpacked
from palmd.quantities import SCHEMA, STAMP, Kind, Quantity, Topic
from palmd.record import END, RunError
from palmd.topics import TOPICS

PROFILE = "palmd"
MESSAGE_ENCODING, SCHEMA_ENCODING = "msgpack", "jsonschema"
SEQUENCE_MODULUS = 1 << 32

REPEATED_BYTES = 1 << 20  # of messages, between repetitions of the channels


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
BY_NAME = {topic.name: topic for topic in TOPICS}


def json_schema(name: str) -> dict[str, Any]:
    """The JSON schema of a topic's messages, as the table of topics has them; anything goes where it has none."""
    topic = BY_NAME.get(name)
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
        self._stream, self._compressed = stream, compressed
        self._channels: dict[str, int] = {}
        self._records: dict[str, Channel] = {}
        self._bytes = 0
        for name, values in preface.metadata.items():
            self._writer.add_metadata(name, dict(values))
        for name, data in preface.attachments.items():
            self._writer.add_attachment(create_time_ns, create_time_ns, name, _media_type(name), data)

    def write(self, message: RawMessage) -> None:
        """Append one message; its topic's schema goes before the first one. Raises OSError."""
        channel = self._channels.get(message.topic)
        if channel is None:
            channel = self._channels[message.topic] = self._begin(message.topic)
        self._bytes += len(message.payload)
        if self._bytes >= REPEATED_BYTES:
            self._bytes = 0
            self._repeat()
        self._writer.add_message(
            channel, message.log_time_ns, message.payload, message.publish_time_ns, message.sequence % SEQUENCE_MODULUS
        )

    def finish(self, why: str = "") -> None:
        """Write why it ends, where that is told, the summary and the end; the stream stays open. Raises OSError."""
        self._repeat()
        if why:
            self._writer.add_metadata(END, {"why": why})
        self._writer.finish()  # type: ignore[no-untyped-call]

    def _begin(self, topic: str) -> int:
        data = json.dumps(json_schema(topic), ensure_ascii=False).encode()
        schema = self._writer.register_schema(topic, SCHEMA_ENCODING, data)
        told = {"schema": str(SCHEMA)}
        channel = self._writer.register_channel(topic, MESSAGE_ENCODING, schema, told)
        self._records[topic] = Channel(channel, topic, MESSAGE_ENCODING, told, schema)
        if self._compressed:  # else the library has just written both there
            self._beside(Schema(data=data, encoding=SCHEMA_ENCODING, id=schema, name=topic), self._records[topic])
        return channel

    def _repeat(self) -> None:
        self._beside(*self._records.values())

    def _beside(self, *some: McapRecord) -> None:
        """Write records outside of the chunks; the library has nothing unwritten but a chunk's contents."""
        builder = RecordBuilder()
        for record in some:
            record.write(builder)
        self._stream.write(builder.end())  # type: ignore[no-untyped-call]


def _media_type(name: str) -> str:
    return {".yaml": "application/yaml", ".json": "application/json"}.get(Path(name).suffix, "text/plain")
