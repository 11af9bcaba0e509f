"""Plans for the daemon: read from a file, and compiled for the pose where the palms stand."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from palmd.config import ExploreSpec, MoveSpec, PlanSpec
from palmd.motion.check import compiled
from palmd.motion.limits import MotionLimits
from palmd.motion.plan import Trajectory, compile_plan
from palmd.motion.segments import Angles
from palmd.yamlfile import ConfigError, parse, read_document


@dataclass(frozen=True, slots=True)
class Plan:
    """A plan and its trajectory within `limits`, for palms that stand at `start` (rad)."""

    spec: PlanSpec
    trajectory: Trajectory
    limits: MotionLimits
    start: Angles | None

    @property
    def name(self) -> str:
        """The plan's own name."""
        return self.spec.name

    @property
    def explores(self) -> bool:
        """Whether it ends with an exploration."""
        return isinstance(self.spec.segments[-1], ExploreSpec)

    def serves(self, limits: MotionLimits, start: Angles) -> bool:
        """Whether the trajectory is right for these limits and this start; that of an exploration serves but once."""
        if self.explores:
            return False
        return limits is self.limits and (start == self.start or _begins_anywhere(self.spec))

    def compiled(self, limits: MotionLimits, start: Angles) -> Plan:
        """The same plan for other limits or another start; raises PlanError. Takes tens of milliseconds."""
        return Plan(self.spec, compile_plan(self.spec, limits, start), limits, start)


def read_plan(path: Path, limits: MotionLimits, start: Angles | None, text: str | None = None) -> Plan:
    """The plan in a file, or `text` that came from such a file; not for the loop.

    Raises ConfigError with file:line:col for all that is wrong.
    """
    if text is None and (path.is_fifo() or path.is_char_device() or path.is_socket()):
        raise ConfigError([f"{path}: is no file but something that may never end"])
    document = read_document(path, text)
    spec = parse(document, PlanSpec)
    return Plan(spec, compiled(document, spec, limits, start), limits, start)


def _begins_anywhere(spec: PlanSpec) -> bool:
    """Whether the plan begins by moving both palms, so that it does not matter where they stand."""
    first = spec.segments[0]
    return isinstance(first, MoveSpec) and None not in (first.move.phi1_deg, first.move.phi2_deg)
