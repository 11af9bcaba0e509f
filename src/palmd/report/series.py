"""A recorded run as arrays over time, with everything that a report needs, read in one pass."""

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
"""Column of the motion: the largest following error divided by its limit."""

SD = "sd."
"""Prefix of a field's name for the column of its standard deviation."""

SDS = 2.0
"""Half-width of every band of the report in standard deviations."""

CONSTANTS = tuple(quantity.name for quantity in ESTIMATE.quantities if truth_of(quantity) is BODY)
"""Estimated fields that are constants of the object."""


@dataclass(frozen=True, slots=True)
class TopicSeries:
    """The numbers of one topic: times t (n,) in s since the run's beginning, columns (n,) by field name, NaN if absent.

    Booleans are 0 and 1. A standard deviation has its field's name with prefix `SD`.
    """

    t: FloatArray
    columns: Mapping[str, FloatArray]

    def __getitem__(self, name: str) -> FloatArray:
        column = self.columns.get(name)
        return np.full(len(self.t), math.nan) if column is None else column


@dataclass(frozen=True, slots=True)
class OutlineAt:
    """One `palm/shape`: t (s), object number, validity of the estimate; theta (rad), h and h_sd (m), touched."""

    t: float
    number: int
    valid: bool
    theta: FloatArray
    h: FloatArray
    h_sd: FloatArray
    touched: Bools


@dataclass(frozen=True, slots=True)
class TrueBody:
    """One `rig/object`: the true object from t (s) on; h (m) on evenly spaced normals from 0, `CONSTANTS`."""

    t: float
    h: FloatArray
    constants: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Interval:
    """A labelled interval from `begin` to `end` (s), for example of a state."""

    label: str
    begin: float
    end: float


@dataclass(frozen=True, slots=True)
class FaultInterval:
    """A fault that was active from `begin` to `end` (s), with the operator's hint; `active_at_end`: of the run."""

    code: str
    severity: str
    hint: str
    begin: float
    end: float
    active_at_end: bool = True


@dataclass(frozen=True, slots=True)
class Series:
    """A run as arrays; times in s since its first message.

    invalid_reasons: number of estimates per code, in descending order. faults: in order of appearance. log: entries of
    `palm/log`. improvements: times of the smoother's answers. counts: the last `palm/loop`. rig_deviations: deviations
    of the rig in the last `palm/rig`, None without one. shape: the last shape message of systems other than two palms,
    empty for none.
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
    states: tuple[Interval, ...]
    arm_states: tuple[Interval, ...]
    segments: tuple[Interval, ...]
    faults: tuple[FaultInterval, ...]
    log: tuple[LogEntry, ...]
    improvements: FloatArray
    counts: Mapping[str, float]
    rig_deviations: tuple[str, ...] | None
    shape: Fields

    @property
    def valid(self) -> Bools:
        """Validity of each estimate."""
        return np.asarray(self.estimate["valid"] > 0.5)

    @property
    def objects(self) -> tuple[int, ...]:
        """The objects of the run, by the observer's numbers."""
        numbers = np.unique(self.estimate["object"])
        return tuple(int(number) for number in numbers if number >= 1)


def series_of(run: AnyRun, survey: Mapping[str, Survey], at: Callable[[int], None] = lambda _: None) -> Series:
    """Read a run; `at` is called with the number of messages read.

    Raises RunError for messages with wrong fields and for a run without an estimate; OSError.
    """
    estimate = run.topics.estimate.name
    if estimate not in survey:
        raise RunError(f"{run.path}: holds no {estimate}: there is nothing to report")
    reader = _RunReader(run.topics)
    for number, message in enumerate(run.messages()):
        if message.topic in reader.handlers:
            try:
                reader.take(message.topic, message.fields)
            except (KeyError, TypeError, ValueError) as error:
                raise RunError(f"{run.path}: {message.topic}, message {message.sequence}: {error!r}") from None
        at(number + 1)
    return reader.series(run, survey)


class _Columns:
    """Numbers of one topic while they are being read; missing values are NaN."""

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

    def as_series(self) -> TopicSeries:
        count = len(self.t)
        for column in self._columns.values():
            column.extend([math.nan] * (count - len(column)))
        return TopicSeries(np.array(self.t), {name: np.array(column) for name, column in self._columns.items()})


class _IntervalBuilder:
    """Builds intervals from a repeatedly published label."""

    def __init__(self) -> None:
        self._intervals: list[Interval] = []

    def observe(self, t: float, label: str) -> None:
        last = self._intervals[-1] if self._intervals else None
        if last is not None:
            self._intervals[-1] = Interval(last.label, last.begin, t)
        if last is None or last.label != label:
            self._intervals.append(Interval(label, t, t))

    def until(self, t: float) -> tuple[Interval, ...]:
        """All intervals, the last one extended to `t`."""
        return tuple(self._intervals[:-1]) + tuple(replace(last, end=t) for last in self._intervals[-1:])


class _RunReader:
    def __init__(self, topics: SystemTopics) -> None:
        self.handlers: dict[str, Callable[[float, Fields], None]] = {
            topics.estimate.name: self._take_estimate,
            topics.shape.name: self._take_shape if topics.shape is SHAPE else self._keep_shape,
            topics.contact.name: self._numbers("contact", topics.contact),
            topics.motion.name: self._take_motion,
            STATE.name: self._take_state,
            LOOP.name: self._take_loop,
            RIG.name: self._take_rig,
            LOG.name: self._take_log,
            IMPROVEMENT.name: lambda t, _: self._improvements.append(t),
            topics.truth.name: self._numbers("truth", topics.truth),
            BODY.name: self._take_body,
        }
        self._columns = {role: _Columns() for role in ("estimate", "contact", "motion", "loop", "truth")}
        self._shape: Fields = {}
        self._begin_ns: int | None = None
        self._end = 0.0
        self._reasons: Counter[str] = Counter()
        self._observer = ""
        self._number, self._valid = 0, False
        self._outlines: list[OutlineAt] = []
        self._bodies: list[TrueBody] = []
        self._rig_deviations: tuple[str, ...] | None = None
        self._states, self._arm_states, self._segments = _IntervalBuilder(), _IntervalBuilder(), _IntervalBuilder()
        self._active: dict[str, FaultInterval] = {}
        self._faults: list[FaultInterval] = []
        self._log: list[LogEntry] = []
        self._improvements = array("d")
        self._estimate_names = _names(topics.estimate)
        self._motion_names = _names(topics.motion)

    def take(self, topic: str, fields: Fields) -> None:
        now = int(fields["mono_ns"])
        if self._begin_ns is None:
            self._begin_ns = now
        t = (now - self._begin_ns) * 1e-9
        self._end = max(self._end, t)
        self.handlers[topic](t, fields)

    def series(self, run: AnyRun, survey: Mapping[str, Survey]) -> Series:
        end = self._end
        faults = [*self._faults, *(replace(fault, end=end) for fault in self._active.values())]
        columns = {role: each.as_series() for role, each in self._columns.items()}
        return Series(
            run=run,
            survey=survey,
            observer=self._observer,
            duration=end,
            invalid_reasons=dict(self._reasons.most_common()),
            outlines=tuple(self._outlines),
            bodies=tuple(self._bodies),
            states=self._states.until(end),
            arm_states=self._arm_states.until(end),
            segments=self._segments.until(end),
            faults=tuple(sorted(faults, key=lambda interval: interval.begin)),
            log=tuple(self._log),
            improvements=np.array(self._improvements),
            counts={name: float(column[-1]) for name, column in columns["loop"].columns.items()},
            rig_deviations=self._rig_deviations,
            shape=self._shape,
            **columns,
        )

    def _numbers(self, role: str, topic: Topic) -> Callable[[float, Fields], None]:
        names = _names(topic)
        return lambda t, fields: self._columns[role].add(t, [(name, float(fields[name])) for name in names])

    def _take_estimate(self, t: float, fields: Fields) -> None:
        values = [(name, float(fields[name])) for name in self._estimate_names]
        values += [(SD + name, float(sd)) for name, sd in fields["sd"].items()]
        self._columns["estimate"].add(t, values)
        self._reasons.update(fields.get("invalid_reasons", ()))
        self._observer, self._number, self._valid = fields["observer"], int(fields["object"]), bool(fields["valid"])

    def _take_shape(self, t: float, fields: Fields) -> None:
        theta, h, h_sd, touched = (
            np.array(fields[name], dtype=np.float64) for name in ("theta_rad", "h_m", "h_sd_m", "touched")
        )
        if not len(theta) == len(h) == len(h_sd) == len(touched):
            raise ValueError("the lists differ in length")
        self._outlines.append(OutlineAt(t, self._number, self._valid, theta, h, h_sd, np.asarray(touched > 0.5)))

    def _keep_shape(self, _: float, fields: Fields) -> None:
        self._shape = fields

    def _take_motion(self, t: float, fields: Fields) -> None:
        values = [(name, float(fields[name])) for name in self._motion_names]
        self._columns["motion"].add(t, [*values, *_following(fields)])
        self._arm_states.observe(t, fields["arm_state"])
        segment = int(fields["segment"])
        self._segments.observe(t, "" if segment < 0 else f"{fields['plan']} {segment}")

    def _take_state(self, t: float, fields: Fields) -> None:
        self._states.observe(t, fields["state"])
        published = dict(zip(fields["faults"], zip(fields["severities"], fields["hints"], strict=True), strict=True))
        for code in [code for code in self._active if code not in published]:
            self._faults.append(replace(self._active.pop(code), end=t, active_at_end=False))
        for code, (severity, hint) in published.items():
            self._active.setdefault(code, FaultInterval(code, severity, hint, t, t))

    def _take_log(self, _: float, fields: Fields) -> None:
        last = self._log[-1].number if self._log else -1
        begin_s = (self._begin_ns or 0) * 1e-9
        self._log += [replace(entry, t_s=entry.t_s - begin_s) for entry in entries_of(fields) if entry.number > last]

    def _take_loop(self, t: float, fields: Fields) -> None:
        numbers = [(name, float(value)) for name, value in fields.items() if isinstance(value, int | float)]
        self._columns["loop"].add(t, numbers)

    def _take_rig(self, _: float, fields: Fields) -> None:
        self._rig_deviations = tuple(fields["contradictions"])

    def _take_body(self, t: float, fields: Fields) -> None:
        h = np.array(fields["h_m"], dtype=np.float64)
        self._bodies.append(TrueBody(t, h, {name: float(fields[name]) for name in CONSTANTS}))


def _following(fields: Fields) -> Iterator[tuple[str, float]]:
    """The largest ratio of a joint's following error to its limit, if both are published."""
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
