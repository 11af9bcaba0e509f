"""What of the daemon depends on the system that the rig is: pads, poses, limits, observers, and how all is told.

`Core` asks one of these and knows no palm by itself. Another system is another class, named in `palmd.systems`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any, Protocol

from palmd.config import AnyConfig
from palmd.daemon.drivers import EndName
from palmd.daemon.exploration_requests import Source
from palmd.daemon.explorer_process import ExplorerProcess
from palmd.daemon.exploring import Senses
from palmd.daemon.poses import Poses
from palmd.daemon.setpoints import SetPoints
from palmd.daemon.smoothing import BatchingProcess
from palmd.devices.pad import PadDriver
from palmd.events import Event, FloatArray, LiveEstimate, PadSample, PalmMotion, ShapeEstimate
from palmd.messages import Explored, Fields, PadView
from palmd.motion.exploration import Exploration
from palmd.motion.limits import MotionLimits
from palmd.observer.observer import LiveObserver
from palmd.outlinefile import Outline
from palmd.quantities import Topic
from palmd.systems import LIVE, load_part

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
    """See the module. Everything is safe in the loop, but for what is there to start it."""

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

    def observer(
        self, outlines: Sequence[Outline], stack: ExitStack
    ) -> tuple[LiveObserver, BatchingProcess[Any] | None]:
        """Before the loop: who estimates, and the smoother's process beside it, if any, which ends with `stack`."""

    def explorer(self, stack: ExitStack) -> ExplorerProcess | None:
        """Before the loop: who decides explorations beside it, if anybody does, which ends with `stack`."""

    def info(self, observer: str, plans: Sequence[str]) -> tuple[Topic, Fields]:
        """Before the loop: what is published of the rig as configured."""

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

    def answered(self, t: float, answer: object) -> tuple[Topic, Fields]:
        """What is published of an answer of the smoother."""

    def shaped(self, shape: ShapeEstimate) -> tuple[Topic, Fields]:
        """What is published of an outline."""

    def glance(self, estimate: LiveEstimate) -> Fields:
        """What the status tells of the estimate."""

    def place(self, angles: Sequence[float], limits: Sequence[tuple[float, float]]) -> str:
        """Where the joints are and what their limits are, in words."""


def live_system(config: AnyConfig) -> LiveSystem:
    """The one that is configured."""
    system: LiveSystem = load_part(LIVE[config.system].loop)(config)
    return system
