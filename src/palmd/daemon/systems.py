"""What of the daemon depends on the system that the rig is: pads, poses, limits, observers, and how all is told.

`Core` asks one of these and knows no palm by itself. Another system is another class, named in `palmd.systems`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Sequence
from contextlib import ExitStack
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np

from palmd import __version__
from palmd.config.any_config import AnyConfig
from palmd.config.guards import pad_force_limits
from palmd.daemon.drivers import EndName
from palmd.daemon.exploration_requests import Source
from palmd.daemon.explorer_process import ExplorerProcess
from palmd.daemon.exploring import Explores, Exploring
from palmd.daemon.guards.arm import GuardLimits
from palmd.daemon.guards.force import ForceGuard
from palmd.daemon.poses import Poses
from palmd.daemon.setpoints import SetPoints
from palmd.daemon.smoothing import BatchingProcess
from palmd.devices.pad import PadDriver, make_pad
from palmd.events import Event, FloatArray, LiveEstimate, PadSample, PalmMotion, ShapeEstimate
from palmd.messages import Fields, MessageCodec, sound
from palmd.motion.check import motion_limits
from palmd.motion.limits import MotionLimits
from palmd.observer.observer import LiveObserver
from palmd.outlinefile import Outline
from palmd.quantities import Topic
from palmd.system.naming import Naming
from palmd.systems import LIVE, load_part
from palmd.topics import SYSTEM_TOPICS

Configured = TypeVar("Configured", bound=AnyConfig)
Estimated = TypeVar("Estimated", bound=LiveEstimate)


class LiveSystem(ABC, Generic[Configured, Estimated]):
    """See the module. Everything is safe in the loop, but for what is there to start it."""

    poses: Poses
    guards: GuardLimits
    """What the arm's reports are judged by."""
    says: ClassVar[MessageCodec]
    """Its messages."""
    naming: ClassVar[Naming]
    """What joints and pads are called."""
    outside: ClassVar[float]
    """How far outside the limits the joints may be found while commanded (their unit)."""
    jogs: ClassVar[bool] = False
    """Whether the `jog` command, which turns palms, is for it."""

    def __init__(self, config: Configured) -> None:
        self._config, self.topics = config, SYSTEM_TOPICS[config.system]
        self._named = tuple(each.source for each in self.topics.estimate.quantities if each.role == "named")
        self.limits: MotionLimits = motion_limits(config)
        self.joints = self.naming.measured
        """How the status names them, unit included."""
        self.free: Collection[int] = ()
        """Joints that need not go where they are commanded, and tell nothing of how late the arm follows."""
        self.rig_priors: FloatArray = np.zeros(0)
        """One-sigma of each of the rig's constants that are estimated and told; none: no such message."""

    # ---- before the loop ---------------------------------------------------------------------------------

    @abstractmethod
    def observer(
        self, outlines: Sequence[Outline], stack: ExitStack
    ) -> tuple[LiveObserver, BatchingProcess[Any] | None]:
        """Who estimates, and the smoother's process beside the loop, if any, which ends with `stack`."""

    def explorer(self, stack: ExitStack) -> ExplorerProcess | None:
        """Who decides explorations beside the loop, if anybody does, which ends with `stack`."""
        del stack
        return None

    def info(self, observer: str, plans: Sequence[str]) -> Fields:
        """What is published of the rig as configured."""
        return self.says.info_fields(__version__, observer, self._config, plans)

    def pads(self) -> dict[EndName, PadDriver]:
        """A driver for each pad."""
        pads = zip(self.naming.pads, self._config.pads.each(), strict=True)
        return {f"pad{number}": make_pad(number, pad) for number, pad in pads}

    def force_guard(self) -> ForceGuard:
        """What watches the forces that the pads tell."""
        named = dict(zip(self.naming.pads, self._config.pads.each(), strict=True))
        return ForceGuard(pad_force_limits(self._config.limits.force_n, named), self.naming.pads)

    def exploring(self, setpoints: SetPoints, source: Source | None) -> Explores:
        """The loop's side of explorations, which are decided beside it or in it."""
        return Exploring(setpoints, source)

    # ---- in the loop -------------------------------------------------------------------------------------

    @abstractmethod
    def unknown(self, t: float, observer: LiveObserver) -> Estimated:
        """An estimate that says nothing."""

    def sound(self, estimate: Estimated) -> bool:
        """Whether everything is finite that must be when an estimate says `valid`."""
        return sound(estimate, self._named)

    def felt(self, sample: PadSample) -> None:
        """A reading was fed to the observer."""
        del sample

    def conditions(self, t: float, actual: PalmMotion | None) -> Iterator[str]:
        """Codes of the fault table that hold by what only this system knows."""
        del t, actual
        return iter(())

    def evidence(self, code: str) -> str:
        """What speaks for one of these codes, in words with numbers; empty where there is no more to say."""
        del code
        return ""

    @property
    def sticking(self) -> tuple[float, ...] | None:
        """Where the contacts of an object are that friction without dither holds (m); None: of none that is known."""
        return None

    def excused(self, exploring: Explores) -> Collection[str]:
        """Codes that are no faults just now."""
        del exploring
        return ()

    def said(self, estimate: Estimated) -> Fields:
        """What is published of an estimate."""
        return self.says.estimate_fields(estimate)

    def fed(self, t: float, events: Sequence[Event]) -> Fields:
        """What is published of the events that the observer was fed in the tick at `t` (s)."""
        return self.says.events_fields(t, events)

    @abstractmethod
    def answered(self, t: float, answer: Any) -> tuple[Topic, Fields]:
        """What is published of an answer of the smoother."""

    @abstractmethod
    def shaped(self, shape: ShapeEstimate) -> tuple[Topic, Fields]:
        """What is published of an outline."""

    def glance(self, estimate: Estimated) -> Fields:
        """What the status tells of the estimate."""
        return self.says.estimate_at_a_glance(estimate)

    @abstractmethod
    def place(self, angles: Sequence[float], limits: Sequence[tuple[float, float]]) -> str:
        """Where the joints are and what their limits are, in words."""


AnySystem = LiveSystem[Any, Any]


def live_system(config: AnyConfig) -> AnySystem:
    """The one that is configured."""
    system: AnySystem = load_part(LIVE[config.system].loop)(config)
    return system
