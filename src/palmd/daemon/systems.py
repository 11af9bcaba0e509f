"""The system-dependent part of the daemon: pads, poses, limits, observers and messages.

`Core` gets all of this from one `LiveSystem` and has no knowledge of palms. A further system is a further class, listed
in `palmd.systems`.
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
from palmd.daemon.exploration_requests import DecisionSource
from palmd.daemon.explorer_process import ExplorerProcess
from palmd.daemon.exploring import DelegatedExploration, ExplorationControl
from palmd.daemon.guards.arm import GuardLimits
from palmd.daemon.guards.force import ForceGuard
from palmd.daemon.poses import Poses
from palmd.daemon.setpoints import SetPoints
from palmd.daemon.smoothing import BatchingProcess
from palmd.devices.pad import PadDriver, make_pad
from palmd.events import Event, FloatArray, LiveEstimate, PadSample, PalmMotion, ShapeEstimate
from palmd.messages import Fields, MessageCodec, named_state_is_finite
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
    """See the module. All methods are safe in the loop, except those that start it."""

    poses: Poses
    guards: GuardLimits
    """Limits for judging the arm's reports."""
    codec: ClassVar[MessageCodec]
    """Builders of its messages."""
    naming: ClassVar[Naming]
    """Names of its joints and pads."""
    limit_tolerance: ClassVar[float]
    """How far outside the limits the joints may be while commanded (their unit)."""
    can_jog: ClassVar[bool] = False
    """Whether the `jog` command, which turns palms, applies to it."""

    def __init__(self, config: Configured) -> None:
        self._config, self.topics = config, SYSTEM_TOPICS[config.system]
        self._named_fields = tuple(each.source for each in self.topics.estimate.quantities if each.role == "named")
        self.limits: MotionLimits = motion_limits(config)
        self.joints = self.naming.measured
        """Names of the joint angles in the status, unit included."""
        self.free: Collection[int] = ()
        """Joints that need not follow their set-points and are not used to estimate the arm's lag."""
        self.rig_prior_sds: FloatArray = np.zeros(0)
        """Prior standard deviation of each estimated rig constant; empty: `palm/rig` is not published."""

    # ---- before the loop ---------------------------------------------------------------------------------

    @abstractmethod
    def observer(
        self, outlines: Sequence[Outline], stack: ExitStack
    ) -> tuple[LiveObserver, BatchingProcess[Any] | None]:
        """The observer, and the smoother's process beside the loop, if any, which ends with `stack`."""

    def explorer(self, stack: ExitStack) -> ExplorerProcess | None:
        """The process that decides explorations, if any, which ends with `stack`."""
        del stack
        return None

    def info(self, observer: str, plans: Sequence[str]) -> Fields:
        """The fields published about the configured rig."""
        return self.codec.info_fields(__version__, observer, self._config, plans)

    def pads(self) -> dict[EndName, PadDriver]:
        """A driver for each pad."""
        pads = zip(self.naming.pads, self._config.pads.each(), strict=True)
        return {f"pad{number}": make_pad(number, pad) for number, pad in pads}

    def force_guard(self) -> ForceGuard:
        """The guard of the pads' forces."""
        named = dict(zip(self.naming.pads, self._config.pads.each(), strict=True))
        return ForceGuard(pad_force_limits(self._config.limits.force_n, named), self.naming.pads)

    def exploration_control(self, setpoints: SetPoints, source: DecisionSource | None) -> ExplorationControl:
        """The loop's side of explorations."""
        return DelegatedExploration(setpoints, source)

    # ---- in the loop -------------------------------------------------------------------------------------

    @abstractmethod
    def invalid_estimate(self, t: float, observer: LiveObserver) -> Estimated:
        """An estimate without values."""

    def is_finite(self, estimate: Estimated) -> bool:
        """Whether all fields are finite that must be in a valid estimate."""
        return named_state_is_finite(estimate, self._named_fields)

    def feed_reading(self, sample: PadSample) -> None:
        """Take a reading that the observer was fed."""
        del sample

    def conditions(self, t: float, actual: PalmMotion | None) -> Iterator[str]:
        """Fault codes whose condition only this system can judge."""
        del t, actual
        return iter(())

    def evidence(self, code: str) -> str:
        """Evidence for one of these codes, in words with numbers; empty if there is none."""
        del code
        return ""

    @property
    def sticking(self) -> tuple[float, ...] | None:
        """Contact positions (m) of an object held by friction without dither; None if none is known to stick."""
        return None

    def suppressed_faults(self, exploring: ExplorationControl) -> Collection[str]:
        """Fault codes that do not apply at present."""
        del exploring
        return ()

    def estimate_fields(self, estimate: Estimated) -> Fields:
        """The message fields of an estimate."""
        return self.codec.estimate_fields(estimate)

    def events_fields(self, t: float, events: Sequence[Event]) -> Fields:
        """The message fields of the events that the observer was fed in the tick at `t` (s)."""
        return self.codec.events_fields(t, events)

    @abstractmethod
    def answer_message(self, t: float, answer: Any) -> tuple[Topic, Fields]:
        """The message of a smoother's answer."""

    @abstractmethod
    def shape_message(self, shape: ShapeEstimate) -> tuple[Topic, Fields]:
        """The message of an outline."""

    def estimate_summary(self, estimate: Estimated) -> Fields:
        """The part of the estimate that the status contains."""
        return self.codec.estimate_summary(estimate)

    @abstractmethod
    def describe_joints(self, angles: Sequence[float], limits: Sequence[tuple[float, float]]) -> str:
        """The joints' values and limits, in words."""


AnySystem = LiveSystem[Any, Any]


def live_system(config: AnyConfig) -> AnySystem:
    """The configured system."""
    system: AnySystem = load_part(LIVE[config.system].loop)(config)
    return system
