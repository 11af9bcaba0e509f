"""What a daemon has said last, and a screenful of it. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from palmd.bus.subscriber import Message

Style = Literal["plain", "title", "good", "bad", "warning", "faint"]

STALE_S = {"palm/estimate": 0.5, "palm/contact": 0.5, "palm/motion": 0.5, "palm/state": 1.0, "palm/loop": 3.0}
"""How old the last message of a topic may be before it is said."""

_PASSING = ("bytes", "packets", "lines", "acks", "setpoints", "bytes_read", "bytes_written", "opens")
_STATE_STYLES: dict[str, Style] = {"tracking": "good", "hold": "warning", "fault": "bad"}
_SEVERITY_STYLES: dict[str, Style] = {"stop": "bad", "hold": "bad", "degrade": "warning", "note": "faint"}


@dataclass(frozen=True, slots=True)
class BoardRow:
    """One line of text, and how to show it."""

    text: str
    style: Style = "plain"


class Board:
    """The last message of each topic."""

    def __init__(self, address: str) -> None:
        """`address` is where they come from."""
        self.address = address
        self._last: dict[str, Message] = {}

    @property
    def heard(self) -> bool:
        """Whether anything has come at all."""
        return bool(self._last)

    def take(self, message: Message) -> None:
        """One message."""
        self._last[message.topic] = message

    def fields(self, topic: str) -> Mapping[str, Any]:
        """The last message of a topic, empty before the first."""
        message = self._last.get(topic)
        return {} if message is None else message.fields

    def age(self, topic: str, t: float) -> float:
        """How long ago (s) it came, at t (s, monotonic clock); infinite before the first."""
        message = self._last.get(topic)
        return math.inf if message is None else t - message.t_recv

    def silence(self, t: float) -> float:
        """How long (s) nothing at all has come."""
        return min((self.age(topic, t) for topic in self._last), default=math.inf)


def frame(board: Board, t: float) -> list[BoardRow]:
    """Everything there is to see at t (s, monotonic clock)."""
    if not board.heard:
        return [BoardRow(f"no data from {board.address}: is a palmd running there?", "warning")]
    rows = [_head(board)]
    silence = board.silence(t)
    if silence > max(STALE_S.values()):
        rows.append(BoardRow(f"no data from {board.address} for {silence:.0f} s; what follows is old", "bad"))
    rows += _faults(board)
    for topic, block in (
        ("palm/estimate", _estimate),
        ("palm/contact", _contact),
        ("palm/motion", _motion),
        ("palm/loop", _loop),
    ):
        fields = board.fields(topic)
        if fields:
            age = board.age(topic, t)
            old = f"  {age:.1f} s old" if age > STALE_S[topic] else ""
            rows += [BoardRow(""), *_titled(topic.removeprefix("palm/"), old, block(fields))]
    return rows


def _head(board: Board) -> BoardRow:
    state, info = board.fields("palm/state"), board.fields("palm/info")
    name = str(state.get("state", "unknown"))
    words = f"palmd {info.get('version', '')}".rstrip()
    return BoardRow(f"{words}  {name.upper()}  {board.address}", _STATE_STYLES.get(name, "title"))


def _faults(board: Board) -> Iterator[BoardRow]:
    state = board.fields("palm/state")
    columns = (state.get(name, ()) for name in ("faults", "severities", "hints"))
    for code, severity, hint in zip(*columns, strict=False):
        yield BoardRow(f"  {severity:8}{code}: {hint}", _SEVERITY_STYLES.get(severity, "plain"))


def _titled(title: str, old: str, rows: Iterable[BoardRow]) -> Iterator[BoardRow]:
    """The block with its title in front of the first row, and how old it is behind."""
    for number, row in enumerate(rows):
        text = f"{'' if number else title:10}{row.text}{'' if number else old}"
        yield BoardRow(text, "bad" if old else row.style)


def _estimate(e: Mapping[str, Any]) -> Iterator[BoardRow]:
    valid = bool(e.get("valid"))
    word = "valid" if valid else "not valid"
    yield BoardRow(
        f"{word}, {e.get('observer', '')} observer, object {e.get('object', 0)}, touched {_share(e.get('touched'))}, "
        f"nis {_number(e.get('nis'), 1, 2)}, observability {_number(e.get('observability'), 1, 3)}",
        "good" if valid else "warning",
    )
    style: Style = "plain" if valid else "faint"
    for names in (
        (("r1_m", "r1", 1e3, 2, "mm"), ("r2_m", "r2", 1e3, 2, "mm"), ("rho_m", "rho", 1e3, 2, "mm")),
        (("s1_m", "s1", 1e3, 2, "mm"), ("s2_m", "s2", 1e3, 2, "mm"), ("mu", "mu", 1.0, 3, "")),
        (("psi_rad", "psi", math.degrees(1), 1, "°"), ("omega0_rad_s", "omega0", math.degrees(1), 1, "°/s"),
         ("mass_kg", "mass", 1e3, 1, "g")),
        (("f1_n", "f1", 1.0, 2, "N"), ("f2_n", "f2", 1.0, 2, "N"), ("com_y_m", "com y", 1e3, 2, "mm")),
    ):  # fmt: skip
        cells = [
            f"{label:7}{_number(e.get(name), scale, digits):>9}"
            f" ±{_number(e.get('sd', {}).get(name), scale, digits)} {unit}"
            for name, label, scale, digits, unit in names
        ]
        yield BoardRow("".join(f"{cell:29}" for cell in cells).rstrip(), style)


def _contact(c: Mapping[str, Any]) -> Iterator[BoardRow]:
    for pad in (1, 2):
        touch = bool(c.get(f"touch{pad}"))
        batch = ", several packets in one read" if c.get(f"batch{pad}") else ""
        yield BoardRow(
            f"pad {pad}  {'touched' if touch else 'untouched':10}{_number(c.get(f's{pad}_m'), 1e3, 2):>7} mm"
            f"  pressure {_number(c.get(f'pressure{pad}'), 1, 0):>3}"
            f"  age {_number(c.get(f'age{pad}_ms'), 1, 0):>4} ms{batch}",
            "plain" if touch else "warning",
        )
    yield BoardRow(f"arm    age {_number(c.get('arm_age_ms'), 1, 0)} ms")


def _motion(m: Mapping[str, Any]) -> Iterator[BoardRow]:
    degrees = math.degrees(1)
    for palm in (1, 2):
        yield BoardRow(
            f"phi{palm}   {_number(m.get(f'phi{palm}_rad'), degrees, 2):>7}°"
            f"  commanded {_number(m.get(f'phi{palm}_cmd_rad'), degrees, 2):>7}°"
        )
    plan = m.get("plan") or "none"
    segment = m.get("segment", -1)
    where = f", segment {segment}, {_share(m.get('progress'))}" if segment >= 0 else ", not running"
    yield BoardRow(f"arm    {m.get('arm_state') or 'unknown'}   plan {plan}{where}")


def _loop(fields: Mapping[str, Any]) -> Iterator[BoardRow]:
    rss_mb = _number(fields.get("rss_mb"), 1, 0)
    yield BoardRow(
        f"ticks {fields.get('ticks', 0)}, overruns {fields.get('overruns', 0)}, "
        f"{fields.get('backend', '')} backend, {rss_mb} MB"
    )
    for name in ("lateness", "work"):
        values = "  ".join(
            f"{part} {_number(fields.get(f'{name}_{part}_ms'), 1, 2):>6} ms" for part in ("p50", "p99", "max")
        )
        yield BoardRow(f"{name:10}{values}")
    for port in ("pad1", "pad2", "arm"):
        yield from _troubles(port, fields)


def _troubles(port: str, fields: Mapping[str, Any]) -> Iterator[BoardRow]:
    """What has gone wrong on a port since the start, by cause: its counters but for those of normal traffic."""
    counters = {
        name.removeprefix(f"{port}_").removeprefix("port_"): n for name, n in fields.items() if f"{port}_" in name
    }
    causes = [f"{name} {n}" for name, n in counters.items() if isinstance(n, int) and n and name not in _PASSING]
    if causes:
        yield BoardRow(f"{port:10}{', '.join(causes)}", "faint")


def _number(value: Any, scale: float, digits: int) -> str:
    """The value times scale, or a dash for none."""
    if not isinstance(value, int | float) or not math.isfinite(value):
        return "–"
    return f"{value * scale:.{digits}f}"


def _share(value: Any) -> str:
    return f"{_number(value, 100.0, 0)} %"
