"""Export of a recorded run as MCAP with JSON messages, for readers without msgpack: Foxglove and Lichtblick."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer

from palmd.jsonvalues import or_none
from palmd.messages import Fields
from palmd.record.mcapfile import SCHEMA_ENCODING, json_schema
from palmd.record.run import AnyRun
from palmd.record.scene import Scene
from palmd.record.tables import field_examples

MESSAGE_ENCODING = "json"
EXPORTED = "palmd-export"
SCENE = "scene"
_SCENE = ("palms_x_m", "palms_y_m", "outline_x_m", "outline_y_m", "com_x_m", "com_y_m")
_TYPES = {bool: "boolean", int: "number", float: "number", str: "string"}


def write_json(run: AnyRun, path: Path, done: Callable[[], None]) -> None:
    """Write every message with its times (null for NaN), and a topic `scene`: palms and outline in the world frame (m).

    `done` is called twice for each message. Raises RunError, OSError.
    """
    scenes = run.scene_builder()
    known = field_examples(run, done)
    if scenes is not None:
        known |= {SCENE: {"valid": True} | {name: [0.0] for name in _SCENE}}
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start()
        writer.add_metadata(EXPORTED, dict(run.metadata))
        channels = {topic: _channel(writer, topic, fields) for topic, fields in known.items()}
        drawn = 0
        for message in run.messages():
            fields = message.fields
            times = message.log_time_ns, message.publish_time_ns
            _write(writer, channels[message.topic], fields, times, message.sequence)
            scene = None if scenes is None else scenes(message.topic, fields)
            if scene is not None:
                _write(writer, channels[SCENE], _scene_fields(scene), times, drawn)
                drawn += 1
            done()
        writer.finish()  # type: ignore[no-untyped-call]


def schema(topic: str, fields: Fields) -> dict[str, Any]:
    """A JSON schema of messages like `fields`, in the subset that those readers support.

    They need every property of every object by name, without patterns and with a single type; the schema therefore does
    not state that a number may be null.
    """
    documented = json_schema(topic).get("properties", {})
    properties = {
        name: _typed(name, value)
        | {key: text for key, text in documented.get(name, {}).items() if key == "description"}
        for name, value in fields.items()
    }
    return {"title": topic, "type": "object", "properties": properties}


def _typed(name: str, value: Any) -> dict[str, Any]:
    if isinstance(value, dict):
        return schema(name, value)
    if isinstance(value, list):
        return {"type": "array", "items": _typed(name, value[0] if value else 0.0)}
    return {"type": _TYPES[type(value)]}


def _channel(writer: Writer, topic: str, fields: Fields) -> int:
    data = json.dumps(schema(topic, fields), ensure_ascii=False).encode()
    return writer.register_channel(topic, MESSAGE_ENCODING, writer.register_schema(topic, SCHEMA_ENCODING, data))


def _write(writer: Writer, channel: int, fields: Fields, times: tuple[int, int], sequence: int) -> None:
    data = json.dumps(or_none(fields), allow_nan=False, separators=(",", ":"), ensure_ascii=False).encode()
    writer.add_message(channel, times[0], data, times[1], sequence)


def _scene_fields(scene: Scene) -> Fields:
    curves = (scene.palms, scene.outline, scene.centre[None])
    columns = (column.tolist() for points in curves for column in points.T)
    return {"valid": scene.valid} | dict(zip(_SCENE, columns, strict=True))
