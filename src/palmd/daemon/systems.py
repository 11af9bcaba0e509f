"""What of the daemon depends on the system that the rig is: pads, poses, limits, explorations, and how all is told.

`Core` asks one of these and knows no palm by itself. Another system is another class, made in `daemon.app`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from palmd.config import Config, rig_description
from palmd.daemon.drivers import EndName
from palmd.daemon.exploration_requests import Source
from palmd.daemon.exploring import Exploring, Senses
from palmd.daemon.poses import Poses, make_poses
from palmd.daemon.setpoints import SetPoints
from palmd.daemon.swap import SwapWatch
from palmd.devices.pad import PadDriver, make_pad
from palmd.events import Estimate, Event, FloatArray, Improvement, PadSample, PalmMotion, ShapeEstimate, Unexplained
from palmd.messages import (
    Explored,
    Fields,
    PadView,
    contact_fields,
    estimate_at_a_glance,
    estimate_fields,
    events_fields,
    improvement_fields,
    motion_fields,
    shape_fields,
    sound,
    unexplained_fields,
)
from palmd.motion.check import motion_limits
from palmd.motion.exploration import Exploration
from palmd.motion.limits import MotionLimits
from palmd.observer.observer import LiveAnswer, LiveEstimate, LiveObserver
from palmd.quantities import CONTACT, ESTIMATE, EVENTS, IMPROVEMENT, MOTION, SHAPE, UNEXPLAINED, Topic
from palmd.system.mechanism import JOINTS, NAMING, PALMS
from palmd.system.rig_constants import prior_sds

Messages = list[tuple[Topic, Fields]]


@dataclass(frozen=True, slots=True)
class TickReport:
    """What is told of a tick at `t` (s)."""

    t: float
    estimate: LiveEstimate
    pads: Sequence[PadView]
    arm_age: float
    commanded: PalmMotion | None
    actual: PalmMotion | None
    plan: str
    segment: int
    progress: float
    arm_state: str
    fed: Sequence[Event]


class Explores(Protocol):
    """The loop's side of an exploration, as `Exploring`."""

    silent: bool
    dropped: int

    @property
    def possible(self) -> bool:
        """Whether there is anybody to decide."""

    @property
    def under_way(self) -> Exploration | None:
        """The exploration in hand."""

    @property
    def reason(self) -> str:
        """Why the present exploration, or the last one, is where it is."""

    @property
    def explored(self) -> Explored:
        """What `palm/state` says of it."""

    def prepare(self) -> None:
        """A plan that explores is in hand."""

    def told(self) -> dict[str, Any] | None:
        """How far it is, or came, and why it stands; None before the first."""

    def step(self, t: float, senses: Senses) -> None:
        """One tick at `t` (s)."""


class LiveSystem(Protocol):
    """See the module. Everything is safe in the loop."""

    poses: Poses
    limits: MotionLimits
    joints: tuple[str, ...]
    """How the status names them, unit included."""
    outside: float
    """How far outside the limits the joints may be found while commanded (their unit)."""
    jogs: bool
    """Whether the `jog` command, which turns palms, is for it."""
    rig_priors: FloatArray
    """One-sigma of each of the rig's constants that are estimated and told; none: no such message."""

    def pads(self) -> dict[EndName, PadDriver]:
        """A driver for each pad."""

    def exploring(self, setpoints: SetPoints, source: Source | None) -> Explores:
        """The loop's side of explorations."""

    def unknown(self, t: float, observer: LiveObserver) -> LiveEstimate:
        """An estimate that says nothing."""

    def sound(self, estimate: LiveEstimate) -> bool:
        """Whether everything is finite that must be when an estimate says `valid`."""

    def felt(self, sample: PadSample) -> None:
        """A reading was fed to the observer."""

    def conditions(self, t: float, actual: PalmMotion | None) -> Iterator[str]:
        """Codes of the fault table that hold by what only this system knows."""

    def excused(self, exploring: Explores) -> Collection[str]:
        """Codes that are no faults just now."""

    def tick(self, tick: TickReport) -> Messages:
        """What is published of every tick."""

    def answered(self, t: float, answer: LiveAnswer) -> tuple[Topic, Fields]:
        """What is published of an answer of the smoother."""

    def shaped(self, shape: ShapeEstimate) -> tuple[Topic, Fields]:
        """What is published of an outline."""

    def glance(self, estimate: LiveEstimate) -> Fields:
        """What the status tells of the estimate."""

    def place(self, angles: Sequence[float], limits: Sequence[tuple[float, float]]) -> str:
        """Where the joints are and what their limits are, in words."""


class LiveTwoPalms:
    """Two palms on a hinge; see `LiveSystem`."""

    def __init__(self, config: Config) -> None:
        self.poses: Poses = make_poses(config)
        self.limits: MotionLimits = motion_limits(config)
        self.joints = NAMING.measured
        self.outside = math.radians(1.0)
        self.jogs = True
        self.rig_priors = prior_sds(rig_description(config))
        self._pads = config.pads
        self._swap = SwapWatch()

    def pads(self) -> dict[EndName, PadDriver]:
        """One for each palm."""
        return {f"pad{palm}": make_pad(palm, pad) for palm, pad in zip(PALMS, self._pads.each(), strict=True)}

    def exploring(self, setpoints: SetPoints, source: Source | None) -> Exploring:
        """Decided beside the loop."""
        return Exploring(setpoints, source)

    def unknown(self, t: float, observer: LiveObserver) -> Estimate:
        """Without a number."""
        return unknown_estimate(t, observer)

    def sound(self, estimate: LiveEstimate) -> bool:
        """By the named state."""
        return isinstance(estimate, Estimate) and sound(estimate)

    def felt(self, sample: PadSample) -> None:
        """Are the pads swapped?"""
        self._swap.feed(sample)

    def conditions(self, t: float, actual: PalmMotion | None) -> Iterator[str]:
        """Pads that are swapped."""
        self._swap.look(t, actual)
        if self._swap.swapped:
            yield "pads-swapped"

    def excused(self, exploring: Explores) -> Collection[str]:
        """None."""
        del exploring
        return ()

    def tick(self, tick: TickReport) -> Messages:
        """Estimate, contacts, motion, events."""
        assert isinstance(tick.estimate, Estimate)
        return [
            (ESTIMATE, estimate_fields(tick.estimate)),
            (CONTACT, contact_fields(tick.pads, tick.arm_age)),
            (
                MOTION,
                motion_fields(tick.commanded, tick.actual, tick.plan, tick.segment, tick.progress, tick.arm_state),
            ),
            (EVENTS, events_fields(tick.t, tick.fed)),
        ]

    def answered(self, t: float, answer: LiveAnswer) -> tuple[Topic, Fields]:
        """`palm/improvement`, or `palm/unexplained`."""
        if isinstance(answer, Unexplained):
            return UNEXPLAINED, unexplained_fields(t, answer)
        assert isinstance(answer, Improvement)
        return IMPROVEMENT, improvement_fields(t, answer)

    def shaped(self, shape: ShapeEstimate) -> tuple[Topic, Fields]:
        """`palm/shape`."""
        return SHAPE, shape_fields(shape)

    def glance(self, estimate: LiveEstimate) -> Fields:
        """A few of its quantities."""
        return estimate_at_a_glance(estimate) if isinstance(estimate, Estimate) else {}

    def place(self, angles: Sequence[float], limits: Sequence[tuple[float, float]]) -> str:
        """In degrees."""
        deg = math.degrees
        return ", ".join(
            f"{joint} is {deg(angle):.1f}°, its limits are {deg(low):g}° and {deg(high):g}°"
            for joint, angle, (low, high) in zip(JOINTS, angles, limits, strict=True)
        )


def unknown_estimate(t: float, observer: LiveObserver) -> Estimate:
    """An estimate that says nothing."""
    values = {
        field.name: math.nan
        for field in dataclasses.fields(Estimate)
        if field.name not in ("t", "valid", "observer", "object_count", "sd")
    }
    return Estimate(t=t, valid=False, observer=observer.name, object_count=observer.object_count, sd={}, **values)
