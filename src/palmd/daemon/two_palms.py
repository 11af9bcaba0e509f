"""What of the daemon is that of two palms on a hinge: see `daemon.systems`."""

from __future__ import annotations

import dataclasses
import logging
import math
from collections.abc import Collection, Iterator, Sequence
from contextlib import ExitStack

from palmd import __version__, observer
from palmd.config import Config, rig_description
from palmd.daemon.drivers import EndName
from palmd.daemon.exploration_requests import Source
from palmd.daemon.explorer_process import ExplorerProcess
from palmd.daemon.exploring import Exploring
from palmd.daemon.poses import Poses, make_poses
from palmd.daemon.setpoints import SetPoints
from palmd.daemon.smoothing import SmootherProcess
from palmd.daemon.swap import SwapWatch
from palmd.daemon.systems import Explores, Messages, TickReport
from palmd.devices.pad import PadDriver, make_pad
from palmd.events import Estimate, Improvement, LiveEstimate, PadSample, PalmMotion, ShapeEstimate, Unexplained
from palmd.messages import (
    Fields,
    contact_fields,
    estimate_at_a_glance,
    estimate_fields,
    events_fields,
    improvement_fields,
    info_fields,
    motion_fields,
    shape_fields,
    sound,
    unexplained_fields,
)
from palmd.motion.check import motion_limits
from palmd.motion.limits import MotionLimits
from palmd.observer.observer import LiveObserver, Observer
from palmd.outlinefile import Outline
from palmd.quantities import CONTACT, ESTIMATE, EVENTS, IMPROVEMENT, INFO, MOTION, SHAPE, UNEXPLAINED, Topic
from palmd.system.mechanism import JOINTS, NAMING, PALMS
from palmd.system.rig_constants import prior_sds

log = logging.getLogger(__name__)


class LiveTwoPalms:
    """Two palms on a hinge; see `LiveSystem`."""

    def __init__(self, config: Config) -> None:
        self.poses: Poses = make_poses(config)
        self.limits: MotionLimits = motion_limits(config)
        self.joints = NAMING.measured
        self.outside = math.radians(1.0)
        self.jogs = True
        self._config, self._rig = config, rig_description(config)
        self.rig_priors = prior_sds(self._rig)
        self._swap = SwapWatch()

    def observer(self, outlines: Sequence[Outline], stack: ExitStack) -> tuple[Observer, SmootherProcess | None]:
        """As configured."""
        smoother = self._smoother(stack)
        name = self._config.observer.primary
        return observer.make(name, self._rig, smoothing=smoother, outlines=outlines), smoother

    def _smoother(self, stack: ExitStack) -> SmootherProcess | None:
        settings = self._config.observer
        if settings.primary != "shape" or not settings.smoother or settings.shape is not None:
            return None
        try:
            smoother = SmootherProcess(self._rig)
        except OSError as error:
            log.warning("no smoother beside the loop: %s", error)
            return None
        stack.callback(smoother.close)
        return smoother

    def explorer(self, stack: ExitStack) -> ExplorerProcess | None:
        """Who foresees motions of an outline."""
        if not self._config.explores:
            return None
        explorer = ExplorerProcess(self._rig)
        stack.callback(explorer.close)
        return explorer

    def info(self, observer: str, plans: Sequence[str]) -> tuple[Topic, Fields]:
        """`palm/info`."""
        return INFO, info_fields(__version__, observer, self._config, plans)

    def pads(self) -> dict[EndName, PadDriver]:
        """One for each palm."""
        return {f"pad{palm}": make_pad(palm, pad) for palm, pad in zip(PALMS, self._config.pads.each(), strict=True)}

    def exploring(self, setpoints: SetPoints, source: Source | None) -> Exploring:
        """Decided beside the loop."""
        return Exploring(setpoints, source)

    def unknown(self, t: float, observer: LiveObserver) -> Estimate:
        """Without a number."""
        values = {
            field.name: math.nan
            for field in dataclasses.fields(Estimate)
            if field.name not in ("t", "valid", "observer", "object_count", "sd")
        }
        return Estimate(t=t, valid=False, observer=observer.name, object_count=observer.object_count, sd={}, **values)

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

    def answered(self, t: float, answer: object) -> tuple[Topic, Fields]:
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
