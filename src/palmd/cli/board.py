"""The last messages of a daemon, and the status of every system, formatted for a terminal. Pure."""

from __future__ import annotations

import math
import textwrap
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from palmd.bus.subscriber import Message
from palmd.messages import entries_of
from palmd.pivot_quantities import PIVOT
from palmd.quantities import CONTACT, ESTIMATE, INFO, LOG, LOOP, MOTION, RIG, STATE, Quantity, Topic, drawn
from palmd.system import pivot, three_palms
from palmd.system.mechanism import ENDS, JOINTS, PALMS
from palmd.three_palms_quantities import PALM3

Style = Literal["plain", "title", "good", "bad", "warning", "faint"]

_CELLS = 3  # per row
_LOGGED = 4  # log entries, newest first
_INDENT = 10
_RATE_OVER_S = 3.0
_MAX_TIMES = 1000
_SHORT = {"omega0": "w0", "mass": "m", "com_x": "x", "com_y": "y"}
_TRUST = {"nis": "nis", "observability": "obs"}
_TRAFFIC_COUNTERS = ("bytes", "packets", "lines", "acks", "setpoints", "bytes_read", "bytes_written", "opens")
_STATE_STYLES: dict[str, Style] = {"tracking": "good", "hold": "warning", "fault": "bad"}
_SEVERITY_STYLES: dict[str, Style] = {"stop": "bad", "hold": "bad", "degrade": "warning", "note": "faint"}


@dataclass(frozen=True, slots=True)
class BoardRow:
    """One line of text with its style."""

    text: str
    style: Style = "plain"


class Board:
    """The last message and the rate of each topic."""

    def __init__(self, address: str) -> None:
        """`address` is that of the publisher."""
        self.address = address
        self._last: dict[str, Message] = {}
        self._times: dict[str, deque[float]] = {}

    @property
    def heard(self) -> bool:
        """Whether any message has arrived."""
        return bool(self._last)

    def take(self, message: Message) -> None:
        """Process one message."""
        self._last[message.topic] = message
        self._times.setdefault(message.topic, deque(maxlen=_MAX_TIMES)).append(message.t_recv)

    def channels(self, t: float) -> list[tuple[str, float, float]]:
        """Return name, rate (1/s, NaN before two messages) and age (s) of every topic, at t (s)."""
        return [(name, self._rate(name, t), t - message.t_recv) for name, message in sorted(self._last.items())]

    def _rate(self, name: str, t: float) -> float:
        times = [each for each in self._times[name] if each > t - _RATE_OVER_S]
        return (len(times) - 1) / (times[-1] - times[0]) if len(times) > 1 and times[-1] > times[0] else math.nan

    def fields(self, topic: Topic) -> Mapping[str, Any]:
        """Return the last message of a topic, empty before the first."""
        message = self._last.get(topic.name)
        return {} if message is None else message.fields

    def age(self, topic: Topic, t: float) -> float:
        """Return the age (s) of a topic's last message at t (s, monotonic clock); infinite before the first."""
        message = self._last.get(topic.name)
        return math.inf if message is None else t - message.t_recv

    def silence(self, t: float) -> float:
        """Return the age (s) of the newest message of all topics."""
        return min((t - message.t_recv for message in self._last.values()), default=math.inf)


def frame(board: Board, t: float) -> list[BoardRow]:
    """Return all rows at t (s, monotonic clock)."""
    if not board.heard:
        return [BoardRow(f"no data from {board.address}: check that palmd runs there", "warning")]
    rows = [_head(board)]
    silence = board.silence(t)
    if silence > LOOP.stale_s:
        rows.append(BoardRow(f"no data from {board.address} for {silence:.0f} s; the following data are old", "bad"))
    rows += _faults(board)
    rows += [BoardRow(f"  rig     {each}", "warning") for each in board.fields(RIG).get("contradictions", ())]
    for topic, block in (
        (ESTIMATE, estimate),
        (CONTACT, _contact),
        (MOTION, _motion),
        (LOOP, _loop),
    ):
        fields = board.fields(topic)
        if fields:
            age = board.age(topic, t)
            old = f"  {age:.1f} s old" if age > topic.stale_s else ""
            rows += [BoardRow(""), *_titled(topic.name.removeprefix("palm/"), old, block(fields))]
    log = board.fields(LOG)
    if log.get("number"):
        rows += [BoardRow(""), *_titled("log", "", _log(log, board.age(LOG, t)))]
    return [*rows, BoardRow(""), *_titled("topics", "", _channels(board, t))]


def fitted(rows: Sequence[BoardRow], columns: int, lines: int) -> list[BoardRow]:
    """Fit the rows to a terminal of this size: wrap long rows; if there are too many, drop blank, then faint ones."""
    shown = [BoardRow(part, row.style) for row in rows for part in _wrapped(row.text, columns)]
    for spare in (lambda row: not row.text, lambda row: row.style == "faint"):
        for index in reversed(range(len(shown))):
            if len(shown) > lines and spare(shown[index]):
                del shown[index]
    if len(shown) > lines:
        more = len(shown) - lines + 1
        shown = [*shown[: lines - 1], BoardRow(f"... {more} more lines: make the terminal higher", "warning")]
    return shown


def _wrapped(text: str, columns: int) -> list[str]:
    if len(text) <= columns or columns <= 2 * _INDENT:
        return [text[:columns]]
    return textwrap.wrap(text, columns, subsequent_indent=" " * _INDENT, break_on_hyphens=False)


def _head(board: Board) -> BoardRow:
    state, info = board.fields(STATE), board.fields(INFO)
    name = str(state.get("state", "unknown"))
    words = f"palmd {info.get('version', '')}".rstrip()
    control = f"control: {state.get('control') or 'nobody'}" + (", UNATTENDED" if state.get("unattended") else "")
    return BoardRow(f"{words}  {name.upper()}  {board.address}  {control}", _STATE_STYLES.get(name, "title"))


def _faults(board: Board) -> Iterator[BoardRow]:
    state = board.fields(STATE)
    columns = (state.get(name, ()) for name in ("faults", "severities", "hints"))
    for code, severity, hint in zip(*columns, strict=False):
        yield BoardRow(f"  {severity:8}{code}: {hint}", _SEVERITY_STYLES.get(severity, "plain"))


def _titled(title: str, old: str, rows: Iterable[BoardRow]) -> Iterator[BoardRow]:
    """Yield a block with its title in front of the first row and its age behind it."""
    for number, row in enumerate(rows):
        text = f"{'' if number else title:{_INDENT}}{row.text}{'' if number else old}"
        yield BoardRow(text, "bad" if old else row.style)


def estimate(e: Mapping[str, Any]) -> Iterator[BoardRow]:
    """Yield rows of an estimate: validity and consistency, then its values with their standard deviations."""
    valid = bool(e.get("valid"))
    word = "valid" if valid else "not valid"
    trust = ", ".join(f"{word} {_shown(e, ESTIMATE[name])}" for name, word in _TRUST.items())
    yield BoardRow(
        f"{word}, {e.get('observer', '')}, object {e.get('object', 0)}, touched {_share(e.get('touched'))}, {trust}",
        "good" if valid else "warning",
    )
    style: Style = "plain" if valid else "faint"
    for row in _values(e):
        yield BoardRow(row, style)


def status_lines(result: Mapping[str, Any]) -> list[str]:
    """Return the palms' angles and the estimate from a status reply, as text lines."""
    angles = _angles(result, JOINTS)
    lines = [f"angles  {', '.join(angles)}"] if angles else []
    rows = estimate(result["estimate"]) if "estimate" in result else ()
    return lines + [f"{'' if number else 'object':8}{row.text}" for number, row in enumerate(rows)]


def _values(e: Mapping[str, Any]) -> Iterator[str]:
    """Yield the main values of an estimate with their standard deviations, in rows of equal cells."""
    values, sds = (e, e.get("sd") or {}) if e.get("valid") else ({}, {})  # no numbers while invalid
    yield from _in_columns(22, [
        f"{_SHORT.get(quantity.source, quantity.source):4}{_shown(values, quantity):>7}"
        f" ±{_shown(sds, quantity)} {quantity.shown.unit}"
        for quantity in ESTIMATE.quantities
        if quantity.glance
    ])  # fmt: skip


def _contact(c: Mapping[str, Any]) -> Iterator[BoardRow]:
    for pad in PALMS:
        touch = bool(c.get(f"touch{pad}"))
        batch = ", batched" if c.get(f"batch{pad}") else ""  # several packets in one read
        place, age = CONTACT[f"s{pad}_m"], CONTACT[f"age{pad}_ms"]
        yield BoardRow(
            f"pad {pad}  {'touched' if touch else 'untouched':10}{_shown(c, place):>7} {place.shown.unit}"
            f"  pressure {_number(c.get(f'pressure{pad}'), 1, 0):>3}"
            f"  age {_shown(c, age):>4} {age.shown.unit}{batch}",
            "plain" if touch else "warning",
        )
    age = CONTACT["arm_age_ms"]
    yield BoardRow(f"arm    age {_shown(c, age)} {age.shown.unit}")


def _motion(m: Mapping[str, Any]) -> Iterator[BoardRow]:
    angles = []
    for joint in JOINTS:
        actual, commanded = (MOTION[f"{joint}{what}_rad"] for what in ("", "_cmd"))
        unit = actual.shown.unit
        angles.append(f"{joint} {_shown(m, actual):>7}{unit} commanded {_shown(m, commanded):>7}{unit}")
    yield BoardRow("   ".join(angles))
    plan = m.get("plan") or "none"
    segment = m.get("segment", -1)
    where = f", segment {segment}, {_share(m.get('progress'))}" if segment >= 0 else ", not running"
    yield BoardRow(f"arm    {m.get('arm_state') or 'unknown'}   plan {plan}{where}")


def _loop(fields: Mapping[str, Any]) -> Iterator[BoardRow]:
    rss = LOOP["rss_mb"]
    yield BoardRow(
        f"ticks {fields.get('ticks', 0)}, overruns {fields.get('overruns', 0)}, "
        f"{fields.get('backend', '')} backend, {_shown(fields, rss)} {rss.shown.unit}"
    )
    for name in ("lateness", "work"):
        shown = (f"{q.symbol} {_shown(fields, q):>6} {q.shown.unit}" for q in drawn(LOOP, chart=name))
        yield BoardRow(f"{name:10}{'  '.join(shown)}")
    for port in ENDS:
        yield from _error_counters(port, fields)


def _log(fields: Mapping[str, Any], age_s: float) -> Iterator[BoardRow]:
    """Yield the last log entries; `age_s` is the age of the message."""
    t = fields["mono_ns"] * 1e-9 + age_s
    for entry in reversed(entries_of(fields)[-_LOGGED:]):
        yield BoardRow(f"{ago(t - entry.t_s)}  {entry.line}", _SEVERITY_STYLES.get(entry.severity, "faint"))


def ago(seconds: float) -> str:
    """Format an age as text of constant length."""
    for most, unit_s, unit in ((100.0, 1.0, "s"), (6000.0, 60.0, "min")):
        if seconds < most:
            return f"{seconds / unit_s:5.1f} {unit:3} ago"
    return f"{seconds / 3600.0:5.1f} h   ago"


def _channels(board: Board, t: float) -> Iterator[BoardRow]:
    """Yield rate and age of each topic."""
    channels = [(name.removeprefix("palm/"), rate, age) for name, rate, age in board.channels(t)]
    widest = max((len(name) for name, _, _ in channels), default=0)
    cells = [f"{name:{widest}}{_number(rate, 1.0, 0):>4}/s{_age(age):>7}" for name, rate, age in channels]
    for row in _in_columns(21, cells):
        yield BoardRow(row, "faint")


def _in_columns(least: int, cells: Sequence[str]) -> Iterator[str]:
    """Yield rows of `_CELLS` cells, two spaces apart, each as wide as its column and at least `least`."""
    rows = [cells[first : first + _CELLS] for first in range(0, len(cells), _CELLS)]
    widths = [max(least, *map(len, cells[column::_CELLS])) for column in range(min(_CELLS, len(cells)))]
    for row in rows:
        yield "  ".join(f"{cell:{width}}" for cell, width in zip(row, widths, strict=False)).rstrip()


def _age(seconds: float) -> str:
    """Format a short age."""
    return f"{max(seconds, 0.0) * 1e3:.0f} ms" if seconds < 1.0 else f"{seconds:.0f} s"


def _error_counters(port: str, fields: Mapping[str, Any]) -> Iterator[BoardRow]:
    """Yield a port's nonzero error counters since the start: all counters except those of normal traffic."""
    counters = {
        name.removeprefix(f"{port}_").removeprefix("port_"): n for name, n in fields.items() if f"{port}_" in name
    }
    causes = [
        f"{name} {n}" for name, n in counters.items() if isinstance(n, int) and n and name not in _TRAFFIC_COUNTERS
    ]
    if causes:
        yield BoardRow(f"{port:10}{', '.join(causes)}", "faint")


def _shown(fields: Mapping[str, Any], quantity: Quantity) -> str:
    """Format a quantity's value among the fields; a dash if there is none."""
    return _number(fields.get(quantity.name), quantity.shown.factor, quantity.shown.digits)


def _number(value: Any, scale: float, digits: int) -> str:
    """Format the value times scale; a dash if there is none."""
    if not isinstance(value, int | float) or not math.isfinite(value):
        return "–"
    return f"{value * scale:.{digits}f}"


def _share(value: Any) -> str:
    return f"{_number(value, 100.0, 0)} %"


def pivot_status(result: Mapping[str, Any]) -> list[str]:
    """Return the gripper's position and the estimate from a status reply, as text lines."""
    positions = [f"{axis} {result[axis + '_m'] * 1e3:.1f} mm" for axis in pivot.AXES if axis + "_m" in result]
    return _system_status(PIVOT, result["estimate"], "normals", "pivot", positions)


def three_palms_status(result: Mapping[str, Any]) -> list[str]:
    """Return the palms' angles and the estimate from a status reply, as text lines."""
    return _system_status(PALM3, result["estimate"], "directions", "palms", _angles(result, three_palms.JOINTS))


def _system_status(
    topic: Topic, estimate: Mapping[str, Any], directions: str, label: str, positions: Sequence[str]
) -> list[str]:
    """Status as text lines: the joints' `positions` labelled `label`, validity, and coverage of `directions`."""
    word = "valid" if estimate["valid"] else f"not valid: {estimate['reason']}"
    lines = [f"{label:7} {', '.join(positions)}"] if positions else []
    lines.append(f"object  {word}; {estimate['touched']:.0%} of the {directions} touched")
    values = []
    for each in topic.quantities:
        if each.glance and estimate[each.name] is not None:
            factor, digits, unit = each.shown.factor, each.shown.digits, each.shown.unit
            sd = estimate["sd"].get(each.name)
            band = "" if sd is None else f" ± {sd * factor:.{digits}f}"
            values.append(f"{each.symbol} {estimate[each.name] * factor:.{digits}f}{band} {unit}".rstrip())
    return [*lines, f"        {', '.join(values)}"] if values else lines


def _angles(result: Mapping[str, Any], joints: Sequence[str]) -> list[str]:
    return [f"{joint} {math.degrees(result[f'{joint}_rad']):.1f}°" for joint in joints if f"{joint}_rad" in result]
