"""Recordings with random damage, and the contents of their intact chunks according to the mcap library."""

from io import BytesIO

import rig_recording
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk

from palmd.record.mcapfile import RunWriter
from palmd.record.mcapread import read_layout, read_messages

CHUNK_BYTES = 20_000


class Chunked(RunWriter):
    """Writes chunks so small that a short recording has many."""

    def __init__(self, *arguments, **how):
        super().__init__(*arguments, **how)
        self._held = 0

    def write(self, message):
        super().write(message)
        self._held += len(message.payload)
        if self._held > CHUNK_BYTES:
            self._held = 0
            self._writer.flush()


def pack(path):
    """Rewrites the recorded run in many small chunks."""
    source = rig_recording.path()
    with path.open("wb") as stream:
        writer = Chunked(stream, read_layout(source).preface, 0, compressed=True)
        for message in read_messages(source):
            writer.write(message)
        writer.finish()


def chunks(data):
    """Position and messages of each chunk, read by the mcap library."""
    stream = BytesIO(data)
    reader = StreamReader(stream, emit_chunks=True)
    found, names = [], {}
    for record in reader.records:
        if isinstance(record, Chunk):
            end = reader._stream.count
            inner = breakup_chunk(record, validate_crc=True)
            names |= {each.id: each.topic for each in inner if hasattr(each, "topic")}
            messages = {
                (names[each.channel_id], each.sequence, each.data) for each in inner if isinstance(each, Message)
            }
            found.append((end - len(record.data) - 100, end, messages))
    return found


def damage(data, chance):
    """One random damage: the new bytes, and the ranges (begin, end) of old bytes that survive."""
    size = len(data)
    kind = chance.choice(["flip", "cut", "zero", "duplicate"])
    at, length = chance.randrange(size), chance.choice([1, 64, 4096, size // 20])
    if kind == "flip":
        changed = bytearray(data)
        changed[at] ^= chance.randrange(1, 256)
        return bytes(changed), [(0, at), (at + 1, size)]
    if kind == "cut":
        return data[:at], [(0, at)]
    if kind == "zero":
        return data[:at] + bytes(min(length, size - at)) + data[at + length :], [(0, at), (at + length, size)]
    return data[: at + length] + data[at:], [(0, at), (at, size)]


def intact_messages(parts, kept):
    """Messages of the chunks whose bytes all survive."""
    return set().union(*(m for b, e, m in parts if any(first <= b and e <= last for first, last in kept)))
