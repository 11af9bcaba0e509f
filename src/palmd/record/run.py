"""Read a recorded run: its messages, the events that the observer received, its configuration and versions."""

from __future__ import annotations

import contextlib
import json
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np
import yaml
from pydantic import TypeAdapter

from palmd import messages
from palmd.config.any_config import AnyConfig
from palmd.config.two_palms import Config
from palmd.events import Event, Improvement, Unexplained
from palmd.messages import Fields, MessageCodec, improvement_of
from palmd.observer.observer import LiveObserver, Observer
from palmd.outlinefile import Outline, OutlineError, read_library
from palmd.quantities import EVENTS, IMPROVEMENT, SCHEMA, UNEXPLAINED, SystemTopics, Topic
from palmd.record import METADATA
from palmd.record import RunError as RunError
from palmd.record.damage import Damage, damage_text
from palmd.record.eventlog import EventLog
from palmd.record.mcapfile import Preface, RawMessage
from palmd.record.mcapread import Layout, read_layout, read_messages
from palmd.record.metadata import CONFIG, OUTLINES, RIG, preface_of
from palmd.record.outline_files import OutlineCurves, curves_of
from palmd.record.scene import Scene, SceneBuilder
from palmd.system.description import RigDescription
from palmd.system.rig_constants import RIG_NAMES
from palmd.systems import LIVE, TWO_PALMS, for_two_palms_only, load_part
from palmd.topics import SYSTEM_TOPICS

Read = TypeVar("Read")


@dataclass(frozen=True, slots=True)
class FedTick:
    """One tick of the loop: its time `t` (s), the events that the observer received in it, and its number."""

    t: float
    events: tuple[Event, ...]
    number: int


@dataclass(frozen=True, slots=True)
class Survey:
    """One topic of a run: number of messages, first sequence number, missing messages, first and last arrival (ns)."""

    count: int
    first: int
    missing: int
    begin_ns: int
    end_ns: int


@dataclass(frozen=True, slots=True)
class AnyRun(ABC):
    """A recording of any system. Damaged parts of its file are skipped; `notes` describe them.

    Reading messages may raise RunError or OSError. `metadata` holds versions, the configuration's hash, and the run
    that this one continues. `rig` is the description that the observer used.
    """

    system: ClassVar[str]
    rig_type: ClassVar[type]
    """Type of `rig`."""
    codec: ClassVar[MessageCodec]
    """Codec of the system's messages."""

    path: Path
    layout: Layout
    metadata: Mapping[str, str]
    preface: Preface
    config: Any
    rig: Any

    @property
    def complete(self) -> bool:
        """Whether the file was finished and its end is intact."""
        return self.layout.finished and not self.damage.cut

    @property
    def damage(self) -> Damage:
        """The unreadable parts of the file."""
        return self.layout.damage

    @property
    def damage_notes(self) -> tuple[str, ...]:
        """One line on the missing parts, empty if the file is not damaged."""
        text = damage_text(self.damage, self.layout.begin_ns)
        return (f"{self.path}: {text}",) if text else ()

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks for the user: missing parts, or that the file was not finished."""
        unfinished = f"{self.path}: the recording was not finished; its messages up to the end are used"
        return self.damage_notes or (() if self.complete else (unfinished,))

    @property
    def topics(self) -> SystemTopics:
        """The topics of the system."""
        return SYSTEM_TOPICS[self.system]

    def ticks(self) -> Iterator[FedTick]:
        """Every recorded tick with its events, bit for bit; only from tick 0 on is an observer's state reproduced."""
        events_of = self.codec.events_of
        return self._read(
            self.topics.events, lambda fields: FedTick(fields["t_tick_s"], events_of(fields), fields["seq"])
        )

    sd_field: ClassVar[str] = "h_sd_m"
    """Field of the shape message with the outline's standard deviation."""

    def scene_builder(self) -> Callable[[str, Fields], Scene | None] | None:
        """A function that makes scenes from topics and messages; None if the system has none."""
        return None

    @abstractmethod
    def outline_curves(self, shape: Fields, estimate: Fields) -> OutlineCurves:
        """A published outline as curves for CAD."""

    @abstractmethod
    def observer(self) -> LiveObserver:
        """A new observer as configured for the run, which receives the smoother's recorded answers."""

    def messages(self, *topics: str) -> Iterator[RawMessage]:
        """All intact messages, or those of the given topics, in the order of reception."""
        for message in read_messages(self.path, self.layout):
            if not topics or message.topic in topics:
                yield message

    def survey(self) -> dict[str, Survey]:
        """Message counts by topic; reads the whole file."""
        found: dict[str, Survey] = {}
        last: dict[str, int] = {}
        for message in self.messages():
            topic, number, t = message.topic, message.sequence, message.log_time_ns
            before = found.get(topic)
            if before is None:
                found[topic] = Survey(1, number, 0, t, t)
            else:
                missing = before.missing + max(0, number - last[topic] - 1)
                found[topic] = Survey(before.count + 1, before.first, missing, before.begin_ns, t)
            last[topic] = number
        return found

    def require(self, *topics: Topic) -> None:
        """Raise RunError unless there are messages of each of the given topics; reads only as far as necessary."""
        wanted = {topic.name for topic in topics}
        for message in self.messages():
            wanted.discard(message.topic)
            if not wanted:
                return
        raise RunError(f"{self.path}: holds no {' and no '.join(sorted(wanted))}")

    def _read(self, topic: Topic, read: Callable[[Fields], Read]) -> Iterator[Read]:
        for message in self.messages(topic.name):
            try:
                yield read(message.fields)
            except (KeyError, ValueError, TypeError) as error:
                raise RunError(f"{self.path}: {topic.name}, message {message.sequence}: {error!r}") from None

    def _smoother_answers(self, topic: Topic, answer_of: Callable[[Fields], Read]) -> Iterator[tuple[float, Read]]:
        """The smoother's answers in a topic, with the time (s) of the tick in which the loop received each."""
        return self._read(topic, lambda fields: (fields["t_tick_s"], answer_of(fields)))


class RecordedAnswers(Generic[Read]):
    """Stands in for the smoother: gives an observer the recorded answers, each in the tick in which it was received."""

    def __init__(self, answers: Iterable[tuple[float, Read]]) -> None:
        self._smoother_answers = dict(answers)

    def submit(self, t: float, *_: object) -> None:
        """Ignore new data; the answers are recorded."""

    def collect(self, t: float) -> Read | None:
        """The answer received in the tick at t (s)."""
        return self._smoother_answers.get(t)


@dataclass(frozen=True, slots=True)
class Run(AnyRun):
    """A recording of two palms.

    The configuration's `observer.shape` is None; `outlines` returns the recorded outlines instead.
    """

    system: ClassVar[str] = TWO_PALMS
    rig_type: ClassVar[type] = RigDescription
    codec: ClassVar[MessageCodec] = messages

    config: Config
    rig: RigDescription

    def scene_builder(self) -> Callable[[str, Fields], Scene | None]:
        """A function that makes scenes: palms and outline in the world frame."""
        return SceneBuilder(self.config).take

    def outline_curves(self, shape: Fields, estimate: Fields) -> OutlineCurves:
        """The outline about the centre of mass as curves for CAD."""
        theta, h, h_sd, touched = (np.array(shape[name]) for name in ("theta_rad", "h_m", "h_sd_m", "touched"))
        name = f"{self.path.stem}, object {estimate['object']}, last valid estimate"
        body = {"rho_m": estimate["rho_m"], "mass_kg": estimate["mass_kg"]}
        return curves_of(name, theta, h, h_sd, touched > 0, **body)

    def observer(self) -> Observer:
        """The configured observer with the smoother's recorded answers."""
        from palmd import observer

        settings = self.config.observer
        answers: list[tuple[float, Improvement | Unexplained]] = [*self.improvements(), *self.unexplained()]
        smoothing = RecordedAnswers(answers) if settings.smoother else None
        return observer.make(settings.primary, self.rig, smoothing=smoothing, outlines=self.outlines())

    def events(self) -> Iterator[tuple[float, Event]]:
        """Every event with the time (s) of the tick in which the observer received it."""
        for tick in self.ticks():
            for event in tick.events:
                yield tick.t, event

    def improvements(self) -> Iterator[tuple[float, Improvement]]:
        """The improved estimates of the smoother, with the time (s) of the tick in which the loop received each."""

        def read(fields: Fields) -> Improvement:
            if "spread" not in fields or len(fields["rig"]) != len(RIG_NAMES):
                raise RunError(
                    f"{self.path}: its smoother's answers are of another version and cannot be checked by this palmd;"
                    f" `palmd estimate {self.path}` runs the smoother again"
                )
            return improvement_of(fields)

        return self._smoother_answers(IMPROVEMENT, read)

    def unexplained(self) -> Iterator[tuple[float, Unexplained]]:
        """The smoother's reports that no hypothesis explains the readings, with tick times (s) as in `improvements`."""
        return self._smoother_answers(UNEXPLAINED, lambda fields: Unexplained(fields["t_s"]))

    def event_log(self) -> EventLog:
        """The run as an event log; raises RunError if it holds no events."""
        self.require(EVENTS)
        events = tuple(event for _, event in self.events())
        if not events:
            raise RunError(f"{self.path}: {EVENTS.name} holds no events: no data came from pads or arm")
        return EventLog(self.rig, events, self.notes)

    def outlines(self) -> tuple[Outline, ...]:
        """The stored outlines that the observer could recognise, empty for none."""
        files = {name: data for name, data in self.preface.attachments.items() if name.startswith(OUTLINES)}
        if not files:
            return ()
        with tempfile.TemporaryDirectory(prefix="palmd-outlines-") as folder:
            for name, data in files.items():
                (Path(folder) / Path(name).name).write_bytes(data)
            try:
                return read_library(Path(folder))
            except OutlineError as error:
                raise RunError(f"{self.path}: its stored outlines: {error}") from None


def read_run(path: Path) -> Run:
    """Read a recording of two palms, finished or not; raises RunError as `read_any_run`, and for other systems."""
    run = read_any_run(path)
    if not isinstance(run, Run):
        why = for_two_palms_only(run.system)
        raise RunError(f"{path}: {why}; use palmd replay to show it, and palmd replay --check to recheck its observer")
    return run


def read_any_run(path: Path) -> AnyRun:
    """Read a recording of any system, finished or not. Not for the loop.

    Raises RunError for a file that cannot be read, is not an MCAP file, is not a recording of palmd, has another schema
    version, or holds no messages.
    """
    try:
        layout = read_layout(path)
    except FileNotFoundError:
        raise RunError(f"{path}: no such file; `palmd runs FOLDER` lists the recordings in a folder") from None
    except IsADirectoryError:
        raise RunError(f"{path}: is a folder; name a recording in it: `palmd runs FOLDER` lists them") from None
    except OSError as error:
        raise RunError(f"{path}: {error.strerror or error}") from None
    preface, empty = preface_of(layout), not layout.count
    complete = layout.finished and not layout.damage.cut
    metadata = preface.metadata.get(METADATA)
    if metadata is None and empty and not complete:
        raise RunError(f"{path}: is truncated before its first message: there is nothing left in it")
    if metadata is None:
        raise RunError(f"{path}: is an MCAP file, but not a recording of palmd")
    if metadata.get("schema") != str(SCHEMA):
        raise RunError(f"{path}: has messages of schema {metadata.get('schema')}; this palmd reads schema {SCHEMA}")
    if empty:
        damage = damage_text(layout.damage, layout.begin_ns)
        why = damage or ("the recording ended before any arrived" if complete else "it is truncated before the first")
        raise RunError(f"{path}: holds no messages{' that can be read' * bool(damage)}: {why}")
    values = _config_values(path, preface)
    rig = values.get("rig")
    named = str(rig.get("system", TWO_PALMS)) if isinstance(rig, dict) else TWO_PALMS
    if named not in LIVE:
        raise RunError(f"{path}: is a recording of a system that this palmd does not know: {named}")
    kind: type[AnyRun] = load_part(LIVE[named].recording)
    model: type[AnyConfig] = load_part(LIVE[named].config)
    with _reading(path, "configuration"):
        if "observer" in values:
            values["observer"]["shape"] = None  # a path on the machine that recorded it
        config = model.model_validate(values)
    with _reading(path, "description of the rig"):
        described: Any = TypeAdapter(kind.rig_type).validate_python(json.loads(preface.attachments[RIG]))
    return kind(path, layout, metadata, preface, config, described)


@contextlib.contextmanager
def _reading(path: Path, what: str) -> Iterator[None]:
    """Context that raises RunError if an attached file has invalid contents."""
    try:
        yield
    except (KeyError, TypeError, ValueError, RecursionError, yaml.YAMLError) as error:
        raise RunError(f"{path}: its {what} cannot be read: {str(error).splitlines()[0]}") from None


def _config_values(path: Path, preface: Preface) -> dict[str, Any]:
    if CONFIG not in preface.attachments:
        raise RunError(f"{path}: holds no configuration: neither the attached file {CONFIG} nor a palm/config message")
    with _reading(path, "configuration"):
        values = yaml.safe_load(preface.attachments[CONFIG])
        if not isinstance(values, dict):
            raise TypeError("it is not a map")
    return values
