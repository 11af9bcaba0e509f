"""Motion plans for the daemon: read from files and compiled for the present pose of the palms."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

from palmd.config.any_config import AnyConfig
from palmd.config.plans import AnyPlanSpec, ExploreSpec
from palmd.config.two_palms import MoveSpec
from palmd.motion.check import compile_any, compiled, plan_spec
from palmd.motion.limits import MotionLimits
from palmd.motion.plan import Trajectory
from palmd.motion.segments import Angles
from palmd.yamlfile import ConfigError, Document, is_plan, read_document


@dataclass(frozen=True, slots=True)
class Plan:
    """A plan and its trajectory within `limits`, for palms at `start` (rad)."""

    spec: AnyPlanSpec
    trajectory: Trajectory
    limits: MotionLimits
    start: Angles | None

    @property
    def name(self) -> str:
        """The plan's name."""
        return self.spec.name

    @property
    def explores(self) -> bool:
        """Whether it ends with an exploration."""
        return isinstance(self.spec.segments[-1], ExploreSpec)

    def is_valid_for(self, limits: MotionLimits, start: Angles) -> bool:
        """Whether the trajectory fits these limits and this start; that of an exploration can be used only once."""
        if self.explores:
            return False
        return limits is self.limits and (start == self.start or _independent_of_start(self.spec))

    def with_limits(self, limits: MotionLimits) -> Plan:
        """The same plan with the caller's own limits object: a plan from another process has a copy."""
        return replace(self, limits=limits)

    def compiled(self, limits: MotionLimits, start: Angles) -> Plan:
        """The same plan for other limits or another start; raises PlanError. Takes tens of milliseconds."""
        return Plan(self.spec, compile_any(self.spec, limits, start), limits, start)


def read_plan(path: Path, limits: MotionLimits, start: Angles | None) -> Plan:
    """The plan in a file; not for the loop. Raises ConfigError with file:line:col for each error."""
    with contextlib.suppress(OSError):  # reported by `read_document` below
        if path.is_fifo() or path.is_char_device() or path.is_socket():
            raise ConfigError([f"{path}: is not a regular file"])
    return _plan(read_document(path), limits, start)


def plan_in(text: str, name: str, limits: MotionLimits, start: Angles | None) -> Plan:
    """The plan in `text`; `name` is its file on the sender's machine. Not for the loop. Raises as `read_plan`.

    Errors may quote the text, since it is the sender's own.
    """
    return _plan(read_document(Path(name), text), limits, start)


@dataclass(frozen=True, slots=True)
class PlanFolder:
    """The folder from which plans are loaded by name: that of the configured plan, None without one.

    `base` is the configuration's folder, relative to which names may also be given.
    """

    folder: Path | None
    base: Path

    @classmethod
    def of(cls, config: AnyConfig, base: Path) -> Self:
        """The plan folder of a configuration in the folder `base`."""
        return cls(None if config.plan is None else config.plan.parent, base)

    def load(self, name: str, limits: MotionLimits, start: Angles | None) -> Plan:
        """The plan in the file `name`; not for the loop. Raises ConfigError as `read_plan` does.

        Nothing outside the folder is opened, whatever `..` and links point to, and no content of a file that is not a
        plan is reported: it may be a key.
        """
        path = self._file(name)
        if path is None:
            raise ConfigError(
                [f"{name}: no such file beside the configured plan; palmd ctl plan FILE sends a file from elsewhere"]
            )
        try:
            document = read_document(path)
        except ConfigError:
            raise _no_plan(name) from None
        if not is_plan(document):
            raise _no_plan(name)
        return _plan(replace(document, path=Path(name)), limits, start)

    def names(self) -> list[str]:
        """The names of all plans, as `load` takes them, in alphabetical order; not for the loop."""
        if self.folder is None:
            return []
        with contextlib.suppress(OSError):
            names = sorted(path.name for path in self.folder.iterdir())
            return [name for name in names if (path := self._file(name)) is not None and _holds_plan(path)]
        return []

    def _file(self, name: str) -> Path | None:
        if self.folder is None:
            return None
        with contextlib.suppress(OSError, RuntimeError):  # RuntimeError: links that form a cycle
            root = self.folder.resolve()
            for parent in (self.folder, self.base):
                path = (parent / name).resolve()
                if path.parent == root and path.is_file():
                    return path
        return None


def _holds_plan(path: Path) -> bool:
    with contextlib.suppress(OSError, ConfigError):
        return path.suffix in (".yaml", ".yml") and is_plan(read_document(path))
    return False


def _no_plan(name: str) -> ConfigError:
    return ConfigError([f"{name}: is not a motion plan; palmd check reports what is wrong with a file"])


def _plan(document: Document, limits: MotionLimits, start: Angles | None) -> Plan:
    spec = plan_spec(document, limits)
    return Plan(spec, compiled(document, spec, limits, start), limits, start)


def _independent_of_start(spec: AnyPlanSpec) -> bool:
    """Whether the plan begins by moving both palms, so that their start pose does not matter."""
    first = spec.segments[0]
    return isinstance(first, MoveSpec) and None not in first.move.each()
