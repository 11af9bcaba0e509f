"""A recorded run as arrays over time: one pass over its messages, and nothing thrown away that a report needs."""

from __future__ import annotations

import math
from array import array
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.messages import Fields, LogEntry, entries_of
from palmd.quantities import BODY, ESTIMATE, IMPROVEMENT, LOG, LOOP, RIG, SHAPE, STATE, SystemTopics, Topic
from palmd.record import RunError
from palmd.record.run import AnyRun, Survey
from palmd.topics import truth_of

Bools = npt.NDArray[np.bool_]

FOLLOWING_RATIO = "following_ratio"
"""Column of the motion: the largest following error over its limit."""

SD = "sd."
"""Before a field's name: the column of its one-sigma."""

CONSTANTS = tuple(quantity.name for quantity in ESTIMATE.quantities if truth_of(quantity) is BODY)
"""What is true of an object as long as it lies there."""


@dataclass(frozen=True, slots=True)
class TopicSeries:
    """The numbers of one topic: times t (n,) in s since the run's beginning, columns (n,) by field name, NaN for none.

    Booleans are 0 and 1. A one-sigma has its field's name after `SD`.
    """

    t: FloatArray
    columns: Mapping[str, FloatArray]

    def __getitem__(self, name: str) -> FloatArray:
        column = self.columns.get(name)
        return np.full(len(self.t), math.nan) if column is None else column


@dataclass(frozen=True, slots=True)
class OutlineAt:
    """One `palm/shape`: t (s), which object, whether the estimate was valid; theta (rad), h and h_sd (m), touched."""

    t: float
    number: int
    valid: bool
    theta: FloatArray
    h: FloatArray
    h_sd: FloatArray
    touched: Bools


@dataclass(frozen=True, slots=True)
class TrueBody:
    """One `rig/object`: what really lay there from t (s) on; h (m) on even normals from 0, `CONSTANTS`."""

    t: float
    h: FloatArray
    constants: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Spell:
    """Something that lasted from `begin` to `end` (s)."""

    what: str
    begin: float
    end: float


@dataclass(frozen=True, slots=True)
class FaultSpell:
    """A fault that stood from `begin` to `end` (s), with what the operator was told; `stands` at the run's end."""

    code: str
    severity: str
    hint: str
    begin: float
    end: float
    stands: bool = True


@dataclass(frozen=True, slots=True)
class Series:
    """A run as arrays; times in s since its first message.

    `invalid_reasons` counts the estimates that had each code, the most frequent first. `faults` are in the order in
    which they came, `log` the entries of `palm/log`, `improvements` the times of the smoother's answers, `counts` the
    last `palm/loop`. rig_off: what the last `palm/rig` says to be off, None without one. shape: the last outline or
    surface of a system whose outlines are not among `outlines`; empty for none.
    """

    run: AnyRun
    survey: Mapping[str, Survey]
    observer: str
    duration: float
    estimate: TopicSeries
    invalid_reasons: Mapping[str, int]
    contact: TopicSeries
    motion: TopicSeries
    loop: TopicSeries
    truth: TopicSeries
    outlines: tuple[OutlineAt, ...]
    bodies: tuple[TrueBody, ...]
    states: tuple[Spell, ...]
    arm_states: tuple[Spell, ...]
    segments: tuple[Spell, ...]
    faults: tuple[FaultSpell, ...]
    log: tuple[LogEntry, ...]
    improvements: FloatArray
    counts: Mapping[str, float]
    rig_off: tuple[str, ...] | None
    shape: Fields

    @property
    def valid(self) -> Bools:
        """Of each estimate, whether it was called valid."""
        return np.asarray(self.estimate["valid"] > 0.5)

    @property
    def objects(self) -> tuple[int, ...]:
        """The objects that were begun, by the number that the observer gave them."""
        numbers = np.unique(self.estimate["object"])
        return tuple(int(number) for number in numbers if number >= 1)


def series_of(run: AnyRun, survey: Mapping[str, Survey], at: Callable[[int], None] = lambda _: None) -> Series:
    """Everything a report needs of a run; `at` is told how many messages are done.

    Raises RunError for messages that are not what their topic says, and for a run without an estimate; OSError.
    """
    estimate = run.topics.estimate.name
    if estimate not in survey:
        raise RunError(f"{run.path}: holds no {estimate}: there is nothing to report")
    reader = _RunReader(run.topics)
    for number, message in enumerate(run.messages()):
        if message.topic in reader.takers:
            try:
                reader.take(message.topic, message.fields)
            except (KeyError, TypeError, ValueError) as error:
                raise RunError(f"{run.path}: {message.topic}, message {message.sequence}: {error!r}") from None
        at(number + 1)
    return reader.series(run, survey)


class _Columns:
    """Numbers of one topic while they are being read; a field that comes late has NaN before."""

    def __init__(self) -> None:
        self.t = array("d")
        self._columns: dict[str, array[float]] = {}

    def add(self, t: float, values: Iterable[tuple[str, float]]) -> None:
        count = len(self.t)
        for name, value in values:
            column = self._columns.get(name)
            if column is None:
                column = self._columns[name] = array("d")
            if len(column) < count:
                column.extend([math.nan] * (count - len(column)))
            column.append(value)
        self.t.append(t)

    def track(self) -> TopicSeries:
        count = len(self.t)
        for column in self._columns.values():
            column.extend([math.nan] * (count - len(column)))
        return TopicSeries(np.array(self.t), {name: np.array(column) for name, column in self._columns.items()})


class _Spells:
    """What is said again and again, as spells of the same."""

    def __init__(self) -> None:
        self._spells: list[Spell] = []

    def say(self, t: float, what: str) -> None:
        last = self._spells[-1] if self._spells else None
        if last is not None:
            self._spells[-1] = Spell(last.what, last.begin, t)
        if last is None or last.what != what:
            self._spells.append(Spell(what, t, t))

    def until(self, t: float) -> tuple[Spell, ...]:
        """All of them, the last one lasting until `t`."""
        if not self._spells:
            return ()
        *before, last = self._spells
        return (*before, Spell(last.what, last.begin, t))


class _RunReader:
    def __init__(self, topics: SystemTopics) -> None:
        self._topics = topics
        self.takers: dict[str, Callable[[float, Fields], None]] = {
            topics.estimate.name: self._take_estimate,
            topics.shape.name: self._take_shape if topics.shape is SHAPE else self._keep_shape,
            topics.contact.name: self._numbers(topics.contact),
            topics.motion.name: self._take_motion,
            STATE.name: self._take_state,
            LOOP.name: self._take_loop,
            RIG.name: self._take_rig,
            LOG.name: self._take_log,
            IMPROVEMENT.name: lambda t, _: self._improvements.append(t),
            topics.truth.name: self._numbers(topics.truth),
            BODY.name: self._take_body,
        }
        tracks = topics.estimate, topics.contact, topics.motion, LOOP, topics.truth
        self._columns = {topic.name: _Columns() for topic in tracks}
        self._shape: Fields = {}
        self._begin_ns: int | None = None
        self._end = 0.0
        self._reasons: Counter[str] = Counter()
        self._observer = ""
        self._number, self._valid = 0, False
        self._outlines: list[OutlineAt] = []
        self._bodies: list[TrueBody] = []
        self._rig_off: tuple[str, ...] | None = None
        self._states, self._arm_states, self._segments = _Spells(), _Spells(), _Spells()
        self._standing: dict[str, FaultSpell] = {}
        self._faults: list[FaultSpell] = []
        self._log: list[LogEntry] = []
        self._improvements = array("d")
        self._estimated = _names(topics.estimate)
        self._moved = _names(topics.motion)

    def take(self, topic: str, fields: Fields) -> None:
        now = int(fields["mono_ns"])
        if self._begin_ns is None:
            self._begin_ns = now
        t = (now - self._begin_ns) * 1e-9
        self._end = max(self._end, t)
        self.takers[topic](t, fields)

    def series(self, run: AnyRun, survey: Mapping[str, Survey]) -> Series:
        end = self._end
        faults = [*self._faults, *(replace(fault, end=end) for fault in self._standing.values())]
        tracks = {topic: columns.track() for topic, columns in self._columns.items()}
        loop = tracks[LOOP.name]
        return Series(
            run=run,
            survey=survey,
            observer=self._observer,
            duration=end,
            estimate=tracks[self._topics.estimate.name],
            invalid_reasons=dict(self._reasons.most_common()),
            contact=tracks[self._topics.contact.name],
            motion=tracks[self._topics.motion.name],
            loop=loop,
            truth=tracks[self._topics.truth.name],
            outlines=tuple(self._outlines),
            bodies=tuple(self._bodies),
            states=self._states.until(end),
            arm_states=self._arm_states.until(end),
            segments=self._segments.until(end),
            faults=tuple(sorted(faults, key=lambda spell: spell.begin)),
            log=tuple(self._log),
            improvements=np.array(self._improvements),
            counts={name: float(column[-1]) for name, column in loop.columns.items()},
            rig_off=self._rig_off,
            shape=self._shape,
        )

    def _numbers(self, topic: Topic) -> Callable[[float, Fields], None]:
        names = _names(topic)
        return lambda t, fields: self._columns[topic.name].add(t, [(name, float(fields[name])) for name in names])

    def _take_estimate(self, t: float, fields: Fields) -> None:
        values = [(name, float(fields[name])) for name in self._estimated]
        values += [(SD + name, float(sd)) for name, sd in fields["sd"].items()]
        self._columns[self._topics.estimate.name].add(t, values)
        self._reasons.update(fields.get("invalid_reasons", ()))
        self._observer, self._number, self._valid = fields["observer"], int(fields["object"]), bool(fields["valid"])

    def _take_shape(self, t: float, fields: Fields) -> None:
        theta, h, h_sd, touched = (
            np.array(fields[name], dtype=np.float64) for name in ("theta_rad", "h_m", "h_sd_m", "touched")
        )
        if not len(theta) == len(h) == len(h_sd) == len(touched):
            raise ValueError("its lists differ in length")
        self._outlines.append(OutlineAt(t, self._number, self._valid, theta, h, h_sd, np.asarray(touched > 0.5)))

    def _keep_shape(self, _: float, fields: Fields) -> None:
        self._shape = fields

    def _take_motion(self, t: float, fields: Fields) -> None:
        values = [(name, float(fields[name])) for name in self._moved]
        self._columns[self._topics.motion.name].add(t, [*values, *_following(fields)])
        self._arm_states.say(t, fields["arm_state"])
        segment = int(fields["segment"])
        self._segments.say(t, "" if segment < 0 else f"{fields['plan']} {segment}")

    def _take_state(self, t: float, fields: Fields) -> None:
        self._states.say(t, fields["state"])
        told = dict(zip(fields["faults"], zip(fields["severities"], fields["hints"], strict=True), strict=True))
        for code in [code for code in self._standing if code not in told]:
            self._faults.append(replace(self._standing.pop(code), end=t, stands=False))
        for code, (severity, hint) in told.items():
            self._standing.setdefault(code, FaultSpell(code, severity, hint, t, t))

    def _take_log(self, _: float, fields: Fields) -> None:
        told = self._log[-1].number if self._log else -1
        begin_s = (self._begin_ns or 0) * 1e-9
        self._log += [replace(entry, t_s=entry.t_s - begin_s) for entry in entries_of(fields) if entry.number > told]

    def _take_loop(self, t: float, fields: Fields) -> None:
        numbers = [(name, float(value)) for name, value in fields.items() if isinstance(value, int | float)]
        self._columns[LOOP.name].add(t, numbers)

    def _take_rig(self, _: float, fields: Fields) -> None:
        self._rig_off = tuple(fields["off"])

    def _take_body(self, t: float, fields: Fields) -> None:
        h = np.array(fields["h_m"], dtype=np.float64)
        self._bodies.append(TrueBody(t, h, {name: float(fields[name]) for name in CONSTANTS}))


def _following(fields: Fields) -> Iterator[tuple[str, float]]:
    """The largest ratio of a joint's following error to its limit, where both are published."""
    errors, limits = (
        [fields[name] for name in fields if name.startswith(f"following_{each}_")] for each in ("error", "limit")
    )
    if errors and limits and errors[0]:
        each = errors[0]
        most = limits[0] if isinstance(limits[0], list) else [limits[0]] * len(each)
        ratios = [abs(error) / limit for error, limit in zip(each, most, strict=False) if limit > 0.0]
        yield FOLLOWING_RATIO, max((ratio for ratio in ratios if math.isfinite(ratio)), default=math.nan)


def _names(topic: Topic) -> tuple[str, ...]:
    return tuple(field.name for field in topic.quantities if field.kind in ("number", "bool"))
