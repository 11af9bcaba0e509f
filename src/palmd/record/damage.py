"""What of a recording cannot be read: how many bytes, messages and seconds, as numbers and in words. Pure."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class LostStretch:
    """Bytes from `begin` to `end` that hold no intact message.

    after_ns, before_ns: arrival (Unix ns) of the last message before them and of the first one after them, None at
    the file's beginning and end.
    """

    begin: int
    end: int
    after_ns: int | None
    before_ns: int | None

    @property
    def seconds(self) -> float | None:
        """How long the messages on both sides are apart; None at the file's beginning and end."""
        if self.after_ns is None or self.before_ns is None:
            return None
        return max(0.0, (self.before_ns - self.after_ns) * 1e-9)


@dataclass(frozen=True, slots=True)
class Damage:
    """What of a file cannot be read.

    lost: stretches that should hold messages. messages: how many are missing, at least that many unless `exact`: what
    stood at a lost end or beginning is counted by the file's own statistics alone. torn_bytes: at the end of a file
    that was never finished, the part of a record that its recorder did not get to write. preface_bytes: of metadata
    and attached files. index_bytes: of what follows the messages, which costs no message. cut: the file was finished
    once, and its end is missing. further_bytes: of another file that was appended to it.
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
        """In all stretches that should hold messages."""
        return sum(each.end - each.begin for each in self.lost)

    @property
    def seconds(self) -> float:
        """How long all stretches together last, as far as that is known."""
        return sum(each.seconds or 0.0 for each in self.lost)

    @property
    def damaged(self) -> bool:
        """Whether something is damaged, beyond the end of a recorder that was killed."""
        return bool(self.lost or self.preface_bytes or self.index_bytes or self.further_bytes or self.cut)

    @property
    def unread_bytes(self) -> int:
        """All bytes that cannot be read."""
        return self.lost_bytes + self.torn_bytes + self.preface_bytes + self.index_bytes + self.further_bytes


def described(damage: Damage, begin_ns: int) -> str:
    """What is missing, in words, with times since the run's first message; empty if the file is not damaged."""
    if not damage.damaged:
        return ""
    parts = []
    if damage.lost:
        parts.append(_missing(damage, begin_ns))
    if damage.preface_bytes:
        parts.append(f"{damage.preface_bytes:,} bytes of its metadata or attached files cannot be read")
    if damage.index_bytes:
        parts.append(f"{damage.index_bytes:,} bytes of its index cannot be read, which costs no message")
    if damage.further_bytes:
        further = f"its last {damage.further_bytes:,} bytes are another recording"
        parts.append(f"{further}, which is not read: `tail -c {damage.further_bytes}` takes it out")
    if damage.cut:
        parts.append("its end is missing")
    return "the file is damaged: " + "; ".join(parts)


def _missing(damage: Damage, begin_ns: int) -> str:
    places = f"{len(damage.lost)} place" + ("s" if len(damage.lost) > 1 else "")
    count = f"{damage.messages:,} message" + (" is" if damage.messages == 1 else "s are")
    count = count if damage.exact else f"at least {count}" if damage.messages else "an unknown number of messages is"
    first, last = damage.lost[0], damage.lost[-1]
    begin = "its beginning" if first.after_ns is None else f"{(first.after_ns - begin_ns) * 1e-9:.2f} s"
    end = "its end" if last.before_ns is None else f"{(last.before_ns - begin_ns) * 1e-9:.2f} s"
    between = f"between {begin} and {end}"
    lasting = f" of {damage.seconds:.2f} s" if damage.seconds else ""
    if damage.exact and not damage.messages:
        count = "no message is"
    return f"{count} missing, {damage.lost_bytes:,} bytes in {places}{lasting}, {between}"
