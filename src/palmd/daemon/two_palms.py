"""The daemon's system of two palms on a hinge: see `daemon.systems`."""

from __future__ import annotations

import dataclasses
import logging
import math
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from functools import partial
from typing import Any, ClassVar

from palmd import messages, observer
from palmd.config.two_palms import Config, rig_description
from palmd.daemon.explorer_process import ExplorerProcess
from palmd.daemon.guards.arm import GuardLimits
from palmd.daemon.guards.following import FollowingLimits, JointScale, noise_of_difference
from palmd.daemon.guards.rig_contradiction import arc_contradiction, no_contradiction
from palmd.daemon.guards.signs import SignWatch
from palmd.daemon.poses import ArcPoses, Poses, make_poses
from palmd.daemon.smoothing import SmootherProcess
from palmd.daemon.swap import SwapWatch
from palmd.daemon.systems import LiveSystem
from palmd.events import Estimate, Improvement, PadSample, PalmMotion, ShapeEstimate, Unexplained
from palmd.messages import Fields, MessageCodec, improvement_fields, shape_fields, unexplained_fields
from palmd.observer.observer import LiveObserver, Observer
from palmd.observer.sticking import StickingWatch
from palmd.outlinefile import Outline
from palmd.quantities import IMPROVEMENT, SHAPE, UNEXPLAINED, Topic
from palmd.system.mechanism import JOINTS, NAMING
from palmd.system.rig_constants import prior_sds

log = logging.getLogger(__name__)


class LiveTwoPalms(LiveSystem[Config, Estimate]):
    """Two palms on a hinge; see `LiveSystem`."""

    codec: ClassVar[MessageCodec] = messages
    naming = NAMING
    limit_tolerance = math.radians(1.0)
    can_jog = True

    def __init__(self, config: Config) -> None:
        super().__init__(config)
        self.poses = make_poses(config)
        self.guards = _guard_limits(config, self.poses)
        self._rig = rig_description(config)
        self.rig_prior_sds = prior_sds(self._rig)
        self._swap, self._sticking = SwapWatch(), StickingWatch(self._rig.vibration, self._rig.gravity)
        pads = config.pads.each()
        self._signs = SignWatch([pad.zero_mm * 1e-3 for pad in pads], [pad.length_mm * 5e-4 for pad in pads])

    def observer(self, outlines: Sequence[Outline], stack: ExitStack) -> tuple[Observer, SmootherProcess | None]:
        """The configured observer and its smoother process."""
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
            log.warning("the smoother process cannot be started: %s", error)
            return None
        stack.callback(smoother.close)
        return smoother

    def explorer(self, stack: ExitStack) -> ExplorerProcess | None:
        """The process that predicts motions and decides explorations."""
        if not self._config.explores:
            return None
        explorer = ExplorerProcess(self._rig)
        stack.callback(explorer.close)
        return explorer

    def invalid_estimate(self, t: float, observer: LiveObserver) -> Estimate:
        """All values are NaN."""
        values: dict[str, Any] = {
            field.name: math.nan
            for field in dataclasses.fields(Estimate)
            if field.name not in ("t", "valid", "observer", "object_count", "sd", "invalid_reasons")
        }
        return Estimate(t=t, valid=False, observer=observer.name, object_count=observer.object_count, sd={}, **values)

    def feed_reading(self, sample: PadSample) -> None:
        """Pass a reading to the tests for swapped pads, wrong signs and a sticking object."""
        self._swap.feed(sample)
        self._signs.feed(sample)
        self._sticking.feed(sample)

    def conditions(self, t: float, actual: PalmMotion | None) -> Iterator[str]:
        """Swapped or mirrored pads. Whether the object sticks is updated as well, but is no fault."""
        self._swap.look(t, actual)
        if not self._rig.curved:  # on curved palms the contact normals are not the palms' normals
            self._sticking.look(t, actual)
            self._signs.look(t, actual)
        if self._swap.swapped:
            yield "pads-swapped"
        if self._signs.wrong:
            yield "pads-mirrored"

    def evidence(self, code: str) -> str:
        """Which pads are mirrored."""
        if code != "pads-mirrored":
            return ""
        keys = " and ".join(f"pads.palm{pad}.sign" for pad in self._signs.wrong)
        return f"the sign of {keys} is wrong by odds of e^{self._signs.log_odds:.0f}"

    @property
    def sticking(self) -> tuple[float, ...] | None:
        """Judged by the pads' forces."""
        return self._sticking.contacts

    def answer_message(self, t: float, answer: Improvement | Unexplained) -> tuple[Topic, Fields]:
        """`palm/improvement` or `palm/unexplained`."""
        if isinstance(answer, Unexplained):
            return UNEXPLAINED, unexplained_fields(t, answer)
        return IMPROVEMENT, improvement_fields(t, answer)

    def shape_message(self, shape: ShapeEstimate) -> tuple[Topic, Fields]:
        """`palm/shape`."""
        return SHAPE, shape_fields(shape)

    def describe_joints(self, angles: Sequence[float], limits: Sequence[tuple[float, float]]) -> str:
        """In degrees."""
        deg = math.degrees
        each = [
            f"{joint} is {deg(angle):.1f}°, its limits are {deg(low):g}° and {deg(high):g}°"
            for joint, angle, (low, high) in zip(JOINTS, angles, limits, strict=True)
        ]
        return ", ".join([*each, f"phi12 is {deg(sum(angles)):.1f}°, it must stay below {deg(self.limits.top):.1f}°"])


def _guard_limits(config: Config, poses: Poses) -> GuardLimits:
    """Limits of the configured rig; a tool is checked if an arm holds palm 2."""
    error, arm = config.limits.following_error, config.arm
    held = poses if isinstance(poses, ArcPoses) else None
    play = 2.0 * math.radians(arm.play_sd_deg)
    return GuardLimits(
        FollowingLimits(
            at_rest=math.radians(error.at_rest_deg),
            at_full_rate=math.radians(error.at_full_rate_deg),
            rate=math.radians(config.limits.rate_deg_s),
            noise=noise_of_difference(arm.angle_noise_rad) + arm.goal_rounding_rad + play,
            tool=(error.at_rest_mm * 1e-3, error.at_full_rate_mm * 1e-3) if held else None,
        ),
        JointScale(JOINTS, "°", math.degrees(1.0)),
        partial(arc_contradiction, held.geometry) if held else no_contradiction,
    )
