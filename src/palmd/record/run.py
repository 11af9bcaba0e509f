"""A recorded run, read back: its messages, the events that the observer was fed, its configuration and versions."""

from __future__ import annotations

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
from palmd.record import METADATA, RunError
from palmd.record.damage import Damage, described
from palmd.record.eventlog import EventLog
from palmd.record.mcapfile import Preface, RawMessage
from palmd.record.mcapread import Layout, read_layout, read_messages
from palmd.record.metadata import CONFIG, OUTLINES, RIG, preface_of
from palmd.record.outline_curves import OutlineCurves, curves_of
from palmd.record.scene import Scene, SceneWatch
from palmd.system.description import RigDescription
from palmd.system.rig_constants import RIG_NAMES
from palmd.systems import LIVE, TWO_PALMS, for_two_palms_only, load_part
from palmd.topics import SYSTEM_TOPICS

__all__ = [
    "AnyRun",
    "FedTick",
    "RecordedAnswers",
    "Run",
    "RunError",
    "Survey",
    "read_any_run",
    "read_run",
]

Read = TypeVar("Read")


@dataclass(frozen=True, slots=True)
class FedTick:
    """One tick of the loop: its time `t` (s), the events that the observer was fed in it, and its number."""

    t: float
    events: tuple[Event, ...]
    number: int


@dataclass(frozen=True, slots=True)
class Survey:
    """What a run holds of one topic: how many messages, from which number on, how many are missing between."""

    count: int
    first: int
    missing: int
    begin_ns: int
    end_ns: int


@dataclass(frozen=True, slots=True)
class AnyRun(ABC):
    """A recording of whichever system. What of its file is damaged is left out, and told by `notes`.

    What is read lazily may raise RunError or OSError. `metadata` holds versions, the configuration's hash, and which
    run it continues. `rig` is what the observer was told.
    """

    system: ClassVar[str]
    described: ClassVar[type]
    """What `rig` is."""
    says: ClassVar[MessageCodec]
    """Its messages."""

    path: Path
    layout: Layout
    metadata: Mapping[str, str]
    preface: Preface
    config: Any
    rig: Any

    @property
    def complete(self) -> bool:
        """Whether it was finished, and has its end still."""
        return self.layout.finished and not self.damage.cut

    @property
    def damage(self) -> Damage:
        """What of its file cannot be read."""
        return self.layout.damage

    @property
    def damage_notes(self) -> tuple[str, ...]:
        """How much of it is missing, if it is damaged."""
        said = described(self.damage, self.layout.begin_ns)
        return (f"{self.path}: {said}",) if said else ()

    @property
    def notes(self) -> tuple[str, ...]:
        """What whoever uses it should know: how much of it is missing, or that it was not finished."""
        unfinished = f"{self.path}: the recording was not finished; what there is of it is used"
        return self.damage_notes or (() if self.complete else (unfinished,))

    @property
    def topics(self) -> SystemTopics:
        """Those of its system."""
        return SYSTEM_TOPICS[self.system]

    def ticks(self) -> Iterator[FedTick]:
        """Every recorded tick with its events, bit for bit; an observer is in the same state only from number 0 on."""
        events_of = self.says.events_of
        return self._read(
            self.topics.events, lambda fields: FedTick(fields["t_tick_s"], events_of(fields), fields["seq"])
        )

    band: ClassVar[str] = "h_sd_m"
    """The field of its shape that tells the outline's one-sigma."""

    def scenes(self) -> Callable[[str, Fields], Scene | None] | None:
        """What makes scenes of its messages, by topic; None where there are none."""
        return None

    @abstractmethod
    def drawn(self, shape: Fields, estimate: Fields) -> OutlineCurves:
        """An outline as it was published, as curves for CAD."""

    @abstractmethod
    def observer(self) -> LiveObserver:
        """The one that it was made with, as it began, hearing the smoother's recorded answers."""

    def said(self, estimate: Any) -> Fields:
        """Its estimate as it is published."""
        return self.says.estimate_fields(estimate)

    def messages(self, *topics: str) -> Iterator[RawMessage]:
        """All intact messages, or those of these topics, as they were received."""
        for message in read_messages(self.path, self.layout):
            if not topics or message.topic in topics:
                yield message

    def survey(self) -> dict[str, Survey]:
        """What there is, by topic; reads the whole file."""
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
        """Raise RunError unless there are messages of each of these topics; reads no further than it must."""
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

    def _answers(self, topic: Topic, answer_of: Callable[[Fields], Read]) -> Iterator[tuple[float, Read]]:
        """What the smoother beside the loop had to say there, with the time (s) of the tick in which it was heard."""
        return self._read(topic, lambda fields: (fields["t_tick_s"], answer_of(fields)))


class RecordedAnswers(Generic[Read]):
    """The smoother's answers in the ticks in which they came, for an observer that hears them again."""

    def __init__(self, answers: Iterable[tuple[float, Read]]) -> None:
        self._answers = dict(answers)

    def submit(self, t: float, *_: object) -> None:
        """They are what they were."""

    def collect(self, t: float) -> Read | None:
        """That of the tick at t (s)."""
        return self._answers.get(t)


@dataclass(frozen=True, slots=True)
class Run(AnyRun):
    """A recording of two palms.

    The configuration's `observer.shape` is left out: `outlines` has what was in it.
    """

    system: ClassVar[str] = TWO_PALMS
    described: ClassVar[type] = RigDescription
    says: ClassVar[MessageCodec] = messages

    config: Config
    rig: RigDescription

    def scenes(self) -> Callable[[str, Fields], Scene | None]:
        """Palms and outline in the world frame."""
        return SceneWatch(self.config).take

    def drawn(self, shape: Fields, estimate: Fields) -> OutlineCurves:
        """About the centre of mass."""
        theta, h, h_sd, touched = (np.array(shape[name]) for name in ("theta_rad", "h_m", "h_sd_m", "touched"))
        name = f"{self.path.stem}, object {estimate['object']}, as it was known at the end"
        told = {"rho_m": estimate["rho_m"], "mass_kg": estimate["mass_kg"]}
        return curves_of(name, theta, h, h_sd, touched > 0, **told)

    def observer(self) -> Observer:
        """As configured."""
        from palmd import observer

        settings = self.config.observer
        answers: list[tuple[float, Improvement | Unexplained]] = [*self.improvements(), *self.unexplained()]
        smoothing = RecordedAnswers(answers) if settings.smoother else None
        return observer.make(settings.primary, self.rig, smoothing=smoothing, outlines=self.outlines())

    def events(self) -> Iterator[tuple[float, Event]]:
        """Every event with the time (s) of the tick in which the observer was fed it."""
        for tick in self.ticks():
            for event in tick.events:
                yield tick.t, event

    def improvements(self) -> Iterator[tuple[float, Improvement]]:
        """What the smoother beside the loop had to say, with the time (s) of the tick in which it was heard."""

        def read(fields: Fields) -> tuple[float, Improvement]:
            if "spread" not in fields or len(fields["rig"]) != len(RIG_NAMES):
                raise RunError(
                    f"{self.path}: its smoother's answers are of another version, and this palmd cannot check them;"
                    f" `palmd estimate {self.path}` runs the smoother anew"
                )
            return fields["t_tick_s"], improvement_of(fields)

        return self._read(IMPROVEMENT, read)

    def unexplained(self) -> Iterator[tuple[float, Unexplained]]:
        """When it had to say that nothing explains the readings, likewise."""
        return self._answers(UNEXPLAINED, lambda fields: Unexplained(fields["t_s"]))

    def event_log(self) -> EventLog:
        """The run in the neutral form of event logs; raises RunError when there are no events in it."""
        self.require(EVENTS)
        events = tuple(event for _, event in self.events())
        if not events:
            raise RunError(f"{self.path}: {EVENTS.name} tells of no event: neither pad nor arm was heard")
        return EventLog(self.rig, events, self.notes)

    def outlines(self) -> tuple[Outline, ...]:
        """The stored outlines that the observer had to choose from, empty without any."""
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
    """The recording of two palms in a file, finished or not; raises RunError as `read_any_run`, and for others."""
    run = read_any_run(path)
    if not isinstance(run, Run):
        why = for_two_palms_only(run.system)
        raise RunError(f"{path}: {why}; palmd replay shows it, with --check again through its observer")
    return run


def read_any_run(path: Path) -> AnyRun:
    """The recording in a file, finished or not; raises RunError when it cannot be used.

    That is a file that cannot be read, is no MCAP file, none of palmd's, of another schema version, or holds no
    messages. Not for the loop.
    """
    try:
        layout = read_layout(path)
    except FileNotFoundError:
        raise RunError(f"{path}: no such file; `palmd runs FOLDER` lists what has been recorded there") from None
    except IsADirectoryError:
        raise RunError(f"{path}: is a folder; a run is a file in one: `palmd runs FOLDER` lists them") from None
    except OSError as error:
        raise RunError(f"{path}: {error.strerror or error}") from None
    preface, empty = preface_of(layout), not layout.count
    complete = layout.finished and not layout.damage.cut
    metadata = preface.metadata.get(METADATA)
    if metadata is None and empty and not complete:
        raise RunError(f"{path}: is cut off before its first message: there is nothing left in it")
    if metadata is None:
        raise RunError(f"{path}: is an MCAP file, but no recording of palmd")
    if metadata.get("schema") != str(SCHEMA):
        raise RunError(f"{path}: has messages of schema {metadata.get('schema')}; this palmd reads schema {SCHEMA}")
    if empty:
        damage = described(layout.damage, layout.begin_ns)
        why = damage or ("the recording was finished before any came" if complete else "it is cut off before the first")
        raise RunError(f"{path}: holds no messages{' that can be read' * bool(damage)}: {why}")
    values = _config_values(path, preface)
    rig = values.get("rig")
    named = str(rig.get("system", TWO_PALMS)) if isinstance(rig, dict) else TWO_PALMS
    if named not in LIVE:
        raise RunError(f"{path}: is of a system that this palmd does not know: {named}")
    kind: type[AnyRun] = load_part(LIVE[named].recording)
    config = _config(path, load_part(LIVE[named].config), values)
    return kind(path, layout, metadata, preface, config, _rig(path, preface, kind.described))


def _config_values(path: Path, preface: Preface) -> dict[str, Any]:
    if CONFIG not in preface.attachments:
        raise RunError(f"{path}: holds no configuration: neither the attached file {CONFIG} nor a palm/config")
    try:
        values = yaml.safe_load(preface.attachments[CONFIG])
        if not isinstance(values, dict):
            raise TypeError("it is no map")
        return values
    except (TypeError, ValueError, RecursionError, yaml.YAMLError) as error:
        raise RunError(f"{path}: its configuration cannot be read: {str(error).splitlines()[0]}") from None


def _config(path: Path, model: type[AnyConfig], values: dict[str, Any]) -> AnyConfig:
    try:
        if "observer" in values:
            values["observer"]["shape"] = None  # a path on the machine that recorded it
        return model.model_validate(values)
    except (TypeError, ValueError, RecursionError) as error:
        raise RunError(f"{path}: its configuration cannot be read: {str(error).splitlines()[0]}") from None


def _rig(path: Path, preface: Preface, described: type) -> Any:
    try:
        return TypeAdapter(described).validate_python(json.loads(preface.attachments[RIG]))
    except (KeyError, ValueError) as error:
        raise RunError(f"{path}: its description of the rig cannot be read: {str(error).splitlines()[0]}") from None
