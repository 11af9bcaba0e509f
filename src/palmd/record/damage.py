"""Damage of a recording: unreadable bytes, missing messages and seconds, as numbers and as text. Pure."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class LostStretch:
    """Bytes from `begin` to `end` without an intact message.

    after_ns, before_ns: arrival times (Unix ns) of the last message before and the first message after them; None at
    the beginning and end of the file.
    """

    begin: int
    end: int
    after_ns: int | None
    before_ns: int | None

    @property
    def seconds(self) -> float | None:
        """Time between the messages before and after it; None at the beginning and end of the file."""
        if self.after_ns is None or self.before_ns is None:
            return None
        return max(0.0, (self.before_ns - self.after_ns) * 1e-9)


@dataclass(frozen=True, slots=True)
class Damage:
    """The unreadable parts of a recording.

    lost: stretches that should hold messages. messages: number of missing messages, a lower bound unless `exact`:
    messages lost at the beginning or end can only be counted from the file's statistics record. torn_bytes: incomplete
    last record of a file that was never finished. preface_bytes: unreadable metadata and attachments. index_bytes:
    unreadable bytes after the messages; no message is lost with them. cut: the file was finished, but its end is
    missing. further_bytes: size of another file that was appended to it.
    """

    lost: tuple[LostStretch, ...] = ()
    messages: int = 0
    exact: bool = True
    torn_bytes: int = 0
    preface_bytes: int = 0
    index_bytes: int = 0
    further_bytes: int = 0
    cut: bool = False

    @property
    def lost_bytes(self) -> int:
        """Bytes of all lost stretches."""
        return sum(each.end - each.begin for each in self.lost)

    @property
    def seconds(self) -> float:
        """Total duration of the lost stretches whose duration is known."""
        return sum(each.seconds or 0.0 for each in self.lost)

    @property
    def damaged(self) -> bool:
        """Whether the file is damaged; an incomplete last record (`torn_bytes`) does not count."""
        return bool(self.lost or self.preface_bytes or self.index_bytes or self.further_bytes or self.cut)

    @property
    def unread_bytes(self) -> int:
        """Number of all unreadable bytes."""
        return self.lost_bytes + self.torn_bytes + self.preface_bytes + self.index_bytes + self.further_bytes


def damage_text(damage: Damage, begin_ns: int) -> str:
    """Describe the damage, with times relative to the run's first message; empty if the file is not damaged."""
    if not damage.damaged:
        return ""
    parts = []
    if damage.lost:
        parts.append(_missing(damage, begin_ns))
    if damage.preface_bytes:
        parts.append(f"{damage.preface_bytes:,} bytes of its metadata or attached files cannot be read")
    if damage.index_bytes:
        parts.append(f"{damage.index_bytes:,} bytes of its index cannot be read; no message is lost with them")
    if damage.further_bytes:
        further = f"its last {damage.further_bytes:,} bytes are another recording"
        parts.append(f"{further}, which is not read: extract it with `tail -c {damage.further_bytes}`")
    if damage.cut:
        parts.append("its end is missing")
    return "the file is damaged: " + "; ".join(parts)


def _missing(damage: Damage, begin_ns: int) -> str:
    stretches = f"{len(damage.lost)} stretch" + ("es" if len(damage.lost) > 1 else "")
    count = f"{damage.messages:,} message" + (" is" if damage.messages == 1 else "s are")
    count = count if damage.exact else f"at least {count}" if damage.messages else "an unknown number of messages is"
    first, last = damage.lost[0], damage.lost[-1]
    begin = "its beginning" if first.after_ns is None else f"{(first.after_ns - begin_ns) * 1e-9:.2f} s"
    end = "its end" if last.before_ns is None else f"{(last.before_ns - begin_ns) * 1e-9:.2f} s"
    between = f"between {begin} and {end}"
    lasting = f" of {damage.seconds:.2f} s" if damage.seconds else ""
    if damage.exact and not damage.messages:
        count = "no message is"
    return f"{count} missing, {damage.lost_bytes:,} bytes in {stretches}{lasting}, {between}"
