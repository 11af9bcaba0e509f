"""Read MCAP files, damaged or not: the contents of a file (`layout_of`) and its messages (`messages_of`).

Chunks are verified by their checksum. A file that is still being written has messages outside chunks, without
checksums; such a message is accepted if it is a map with the fields of its topic. If damage has broken the order of the
records, stretches are read in the order of their times and duplicate messages are dropped, as a block may be stored
twice.
"""

from __future__ import annotations

import contextlib
import mmap
from collections import Counter, defaultdict, deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median_low
from typing import Any

from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Metadata, Statistics

from palmd import __version__
from palmd.messages import Fields
from palmd.payload import unpacked
from palmd.quantities import CONFIG, STAMP, Kind
from palmd.record import MAGIC, METADATA, RunError
from palmd.record.damage import Damage, LostStretch
from palmd.record.mcapfile import SEQUENCE_MODULUS, TOPICS_BY_NAME, Preface, RawMessage
from palmd.record.mcapscan import (
    MESSAGE_HEAD,
    SUMMARY,
    Buffer,
    FileRecord,
    Gap,
    attachment,
    framed,
    parsed,
    records,
    unpacked_chunk,
)

DAY_NS = 86_400 * 10**9
"""A time that differs by a day or more from the others is damaged; a file lasts an hour at most."""

_TYPES: dict[Kind, type | tuple[type, ...]] = {
    "number": (int, float),
    "bool": bool,
    "text": str,
    "numbers": list,
    "texts": list,
    "sds": dict,
}
_KINDS = {
    name: {each.name: _TYPES[each.kind] for each in topic.quantities if not each.name.endswith("*")}
    for name, topic in TOPICS_BY_NAME.items()
}
_FAMILIES = {
    name: tuple(each.name[:-1] for each in topic.quantities if each.name.endswith("*"))
    for name, topic in TOPICS_BY_NAME.items()
}
FOREIGN_ENCODINGS = frozenset(("ros1", "cdr", "protobuf", "flatbuffer", "cbor", "json"))
"""Encodings (MCAP registry) of messages that other programs add."""
_STAMPED = frozenset(each.name for each in STAMP)
_MAX_TIMES = 1001  # arrival times kept for the median
FOOTER_BYTES = 1 + 8 + 20 + len(MAGIC)  # opcode, length and content of the footer, and the magic bytes after it


@dataclass(frozen=True, slots=True)
class Layout:
    """The contents of a file.

    spans: byte ranges that hold messages, in reading order; `broken`: they may overlap. topics: by channel. finished:
    the file has a footer. packed: messages are in compressed chunks. same_version: written by this version of palmd.
    config: the first `palm/config`, empty for none. median_ns: median arrival time of the first messages. begin_ns,
    end_ns: first and last arrival. foreign: number of messages in other encodings, added by other programs, by topic;
    they are not read.
    """

    spans: tuple[tuple[int, int], ...]
    broken: bool
    topics: Mapping[int, str]
    preface: Preface
    finished: bool
    packed: bool
    same_version: bool
    count: int
    median_ns: int
    begin_ns: int
    end_ns: int
    config: Fields
    foreign: Mapping[str, int]
    damage: Damage


@contextlib.contextmanager
def mapped(path: Path) -> Iterator[Buffer]:
    """The bytes of a file; raises OSError."""
    with path.open("rb") as stream:
        if not stream.seek(0, 2):
            yield b""
            return
        with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
            yield data


def read_layout(path: Path) -> Layout:
    """Read the layout of a file; raises RunError if it has no MCAP record, OSError."""
    with mapped(path) as data:
        layout = layout_of(data)
        if layout is None:
            raise RunError(f"{path}: is not an MCAP file")
        return layout


def is_finished(path: Path) -> bool:
    """Whether the file ends with an MCAP footer; raises OSError."""
    with path.open("rb") as stream:
        if stream.seek(0, 2) < len(MAGIC) + FOOTER_BYTES:
            return False
        stream.seek(-FOOTER_BYTES, 2)
        end = stream.read()
    return end[0] == Opcode.FOOTER and end.endswith(MAGIC)


def is_packed(path: Path) -> bool:
    """Whether a file is finished and its messages are in compressed chunks; raises RunError, OSError."""
    layout = read_layout(path)
    return layout.finished and layout.packed


def read_messages(path: Path, layout: Layout | None = None) -> Iterator[RawMessage]:
    """The intact messages of a file; raises RunError if it is not an MCAP file, OSError."""
    layout = layout or read_layout(path)
    with mapped(path) as data:
        yield from messages_of(data, layout)


def layout_of(data: Buffer) -> Layout | None:
    """Scan a whole file; None if it is not an MCAP file. Never raises."""
    scan = _Scan()
    for item in records(data):
        if scan.ends_before(data, item.begin):
            break
        scan.take(data, item)
    if not scan.spans and not scan.known and data[: len(MAGIC)] != MAGIC:
        return None
    return scan.layout(data)


def messages_of(data: Buffer, layout: Layout) -> Iterator[RawMessage]:
    """The intact messages, without duplicates. Never raises."""
    seen: set[tuple[str, int, int]] = set()
    last_ns = layout.median_ns
    for begin, end in layout.spans:
        for message in _messages(data, begin, end, layout.topics, same_version=layout.same_version):
            if layout.broken:
                key = message.topic, message.sequence, message.log_time_ns
                if key in seen:
                    continue
                seen.add(key)
            log_ns, publish_ns = sane_times(message, last_ns, layout.median_ns)
            last_ns = log_ns
            if (log_ns, publish_ns) != (message.log_time_ns, message.publish_time_ns):
                message = RawMessage(message.topic, log_ns, publish_ns, message.sequence, message.payload)
            yield message


def sane_times(message: RawMessage, last_ns: int, median_ns: int) -> tuple[int, int]:
    """Arrival and stamp. An arrival a day or more off the median is replaced by the previous message's, such a stamp by
    the arrival."""
    log_ns = message.log_time_ns if abs(message.log_time_ns - median_ns) < DAY_NS else last_ns
    return log_ns, message.publish_time_ns if abs(message.publish_time_ns - log_ns) < DAY_NS else log_ns


def _messages(
    data: Buffer, begin: int, end: int, topics: Mapping[int, str], *, same_version: bool
) -> Iterator[RawMessage]:
    """The messages of one span."""
    for item in records(data, begin, end):
        if isinstance(item, Gap):
            continue
        if item.opcode == Opcode.CHUNK:
            inner = unpacked_chunk(item.content(data))
            for opcode, content in framed(inner or b""):
                if opcode == Opcode.MESSAGE:
                    yield from _message(content, topics)
        elif item.opcode == Opcode.MESSAGE:
            for message in _message(item.content(data), topics):
                if is_plausible(message, same_version=same_version):
                    yield message


def _message(content: bytes, topics: Mapping[int, str]) -> Iterator[RawMessage]:
    channel, sequence, log_time, publish_time = MESSAGE_HEAD.unpack_from(content)
    if channel in topics:
        yield RawMessage(topics[channel], log_time, publish_time, sequence, content[MESSAGE_HEAD.size :])


def is_plausible(message: RawMessage, *, same_version: bool) -> bool:
    """Whether a message without checksum is a map with the right sequence number and the fields of its topic.

    A flipped byte in a field name makes one field unknown and another one missing; one in a value usually changes its
    type. Fields are not checked for messages of other versions of palmd (`same_version` False), which may differ.
    """
    fields = unpacked(message.payload)
    number = None if fields is None else fields.get("seq")
    if fields is None or not isinstance(number, int) or number % SEQUENCE_MODULUS != message.sequence:
        return False
    kinds = _KINDS.get(message.topic)
    if kinds is None or not same_version:
        return True
    if not all(isinstance(value, kinds[name]) for name, value in fields.items() if name in kinds):
        return False
    families = _FAMILIES[message.topic]
    return kinds.keys() <= fields.keys() or all(
        name in kinds or name in _STAMPED or name.startswith(families) for name in fields
    )


class _Scan:
    """State of a scan through a file, from its beginning to its end."""

    def __init__(self) -> None:
        self.known = False  # whether any record was found
        self.spans: list[tuple[int, int, int]] = []  # begin, end, first arrival
        self._open = False
        self._broken = False
        self._lost: list[LostStretch] = []  # `before_ns` is None until a message follows
        self._names: defaultdict[int, Counter[str]] = defaultdict(Counter)
        self._metadata: dict[str, Mapping[str, str]] = {}
        self._attachments: dict[str, bytes] = {}
        self._statistics: Statistics | None = None
        self._count = self._preface_bytes = self._index_bytes = 0
        self._times: list[int] = []
        self._begin_ns = self._last_ns = self._prefaced_ns = -1
        self._config: Fields = {}
        self._configured: set[int] = set()  # channels of palm/config
        self._foreign_channels: dict[int, str] = {}
        self._foreign: Counter[str] = Counter()
        self._latest: deque[int] = deque(maxlen=_MAX_TIMES)
        self._after_preface = self._after_data = self._finished = False
        self._plain = self._compressed = False
        self._tail: Gap | None = None
        self._end = -1  # byte after the footer's magic bytes, -1 before it is found
        self._further_bytes = 0

    def ends_before(self, data: Buffer, at: int) -> bool:
        """Whether the file has ended at `at` and another file was appended to it."""
        if at != self._end or data[at : at + len(MAGIC)] != MAGIC:
            return False
        self._further_bytes = len(data) - at
        return True

    def take(self, data: Buffer, item: FileRecord | Gap) -> None:
        """Process the next record or gap."""
        if isinstance(item, Gap):
            self._gap(item.begin, item.end)
            self._tail = item if item.end == len(data) else None
            return
        self.known = True
        self._after_preface |= item.opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK)
        content = item.content(data)
        match item.opcode:
            case Opcode.CHUNK:
                self._chunk(item, content)
            case Opcode.MESSAGE:
                self._plain = True
                self._unchunked_message(item, content)
            case Opcode.CHANNEL:
                self._channel(content)
            case Opcode.METADATA:
                one = parsed(Metadata, content)
                if one is not None:
                    self._metadata.setdefault(one.name, one.metadata)
            case Opcode.ATTACHMENT:
                file = attachment(content)
                if file is None:
                    self._preface_bytes += item.end - item.begin
                else:
                    self._attachments.setdefault(file.name, file.data)
            case Opcode.STATISTICS:
                self._statistics = parsed(Statistics, content)
            case Opcode.FOOTER:
                if data[item.end : item.end + len(MAGIC)] == MAGIC:
                    self._finished, self._end = True, item.end + len(MAGIC)
        self._after_data |= item.opcode in SUMMARY or item.opcode == Opcode.DATA_END

    def _chunk(self, item: FileRecord, content: bytes) -> None:
        inner = unpacked_chunk(content)
        if inner is None:
            self._gap(item.begin, item.end)
            return
        self._after_data = False
        chunk = parsed(Chunk, content)
        self._compressed |= chunk is not None and bool(chunk.compression)
        self._plain |= chunk is not None and not chunk.compression
        for opcode, each in framed(inner):
            if opcode == Opcode.CHANNEL:
                self._channel(each)
            elif opcode == Opcode.MESSAGE and not self._is_foreign(each):
                self._add_message(item, each)

    def _unchunked_message(self, item: FileRecord, content: bytes) -> None:
        if self._is_foreign(content):
            return
        channel = MESSAGE_HEAD.unpack_from(content)[0]
        names = self._names.get(channel)
        named = {channel: names.most_common(1)[0][0] if names else ""}
        if not all(is_plausible(each, same_version=self._same_version) for each in _message(content, named)):
            self._gap(item.begin, item.end)
            return
        self._after_data = False
        self._add_message(item, content)

    def _is_foreign(self, content: bytes) -> bool:
        """Whether a message was added by another program; counts it."""
        topic = self._foreign_channels.get(MESSAGE_HEAD.unpack_from(content)[0])
        if topic is not None:
            self._foreign[topic] += 1
        return topic is not None

    @property
    def _same_version(self) -> bool:
        return self._metadata.get(METADATA, {}).get("palmd") == __version__

    def _channel(self, content: bytes) -> None:
        channel = parsed(Channel, content)
        if channel is not None and channel.message_encoding in FOREIGN_ENCODINGS:
            self._foreign_channels[channel.id] = channel.topic
        elif channel is not None:
            self._names[channel.id][channel.topic] += 1
            if channel.topic == CONFIG.name:
                self._configured.add(channel.id)

    def _add_message(self, item: FileRecord, content: bytes) -> None:
        """Register a message of this record (a chunk or the message itself)."""
        channel, _, log_ns, _ = MESSAGE_HEAD.unpack_from(content)
        if channel in self._configured and not self._config:
            self._config = unpacked(content[MESSAGE_HEAD.size :]) or {}
        self._count += 1
        if len(self._times) < _MAX_TIMES:
            self._times.append(log_ns)
        self._latest.append(log_ns)
        if self._begin_ns < 0:
            self._begin_ns = log_ns
        if self._lost and self._lost[-1].before_ns is None:
            self._lost = [replace(each, before_ns=log_ns) if each.before_ns is None else each for each in self._lost]
        self._last_ns = log_ns
        if self._open:
            begin, _, first = self.spans[-1]
            self.spans[-1] = begin, item.end, first
        else:
            self.spans.append((item.begin, item.end, log_ns))
            self._open = True

    def _gap(self, begin: int, end: int) -> None:
        self._open = False
        self._broken = True
        if not self._after_preface:
            self._preface_bytes += end - begin
        elif self._after_data:
            self._index_bytes += end - begin
        elif self._lost and self._lost[-1].before_ns is None and self._lost[-1].end == begin:
            self._lost[-1] = replace(self._lost[-1], end=end)
        else:
            self._lost.append(LostStretch(begin, end, self._last_ns if self._count else None, None))

    def layout(self, data: Buffer) -> Layout:
        """The layout after the whole file was processed."""
        spans = sorted(self.spans, key=lambda span: span[2]) if self._broken else self.spans
        topics = {channel: names.most_common(1)[0][0] for channel, names in self._names.items()}
        median_ns = median_low(self._times) if self._times else 0
        begin_ns = next((t for t in self._times if abs(t - median_ns) < DAY_NS), self._begin_ns)
        end_ns = next((t for t in reversed(self._latest) if abs(t - median_ns) < DAY_NS), self._last_ns)
        found = Layout(
            spans=tuple((begin, end) for begin, end, _ in spans),
            broken=self._broken and len(spans) > 1,
            topics=topics,
            preface=Preface(self._metadata, self._attachments),
            finished=self._finished,
            packed=self._compressed and not self._plain,
            same_version=self._same_version,
            count=self._count,
            median_ns=median_ns,
            begin_ns=begin_ns,
            end_ns=end_ns,
            config=self._config,
            foreign=dict(self._foreign),
            damage=Damage(),
        )
        return replace(found, **self._count_and_damage(data, found))

    def _count_and_damage(self, data: Buffer, found: Layout) -> dict[str, Any]:
        """The fields `count` (messages, without duplicates) and `damage` of the layout."""
        lost, torn = self._lost, 0
        once_finished = found.packed or self._after_data
        if self._tail is not None and not once_finished and lost and lost[-1].end == len(data):
            torn, lost = lost[-1].end - lost[-1].begin, lost[:-1]
        count, missing = (_counted(data, found, lost)) if lost else (self._count, 0)
        total = self._statistics.message_count - self._foreign.total() if self._statistics is not None else None
        known = total is not None and total >= count
        damage = Damage(
            lost=tuple(lost),
            messages=(total - count if known and total is not None else missing) if lost else 0,
            exact=known or all(each.after_ns is not None and each.before_ns is not None for each in lost),
            torn_bytes=torn,
            preface_bytes=self._preface_bytes,
            index_bytes=self._index_bytes,
            further_bytes=self._further_bytes,
            cut=once_finished and not self._finished,
        )
        return {"count": count, "damage": damage}


def _counted(data: Buffer, layout: Layout, lost: Sequence[LostStretch]) -> tuple[int, int]:
    """Number of messages, and of messages missing (by sequence number) in lost stretches."""
    last: dict[str, tuple[int, int]] = {}
    count = missing = 0
    for message in messages_of(data, layout):
        count += 1
        t0, number = last.get(message.topic, (message.log_time_ns, message.sequence))
        skipped = message.sequence - number - 1
        if skipped > 0 and any(_between(each, t0, message.log_time_ns) for each in lost):
            missing += skipped
        last[message.topic] = message.log_time_ns, message.sequence
    return count, missing


def _between(lost: LostStretch, begin_ns: int, end_ns: int) -> bool:
    """Whether a lost stretch lies between two arrival times."""
    return lost.after_ns is not None and begin_ns <= lost.after_ns and end_ns >= (lost.before_ns or lost.after_ns)
