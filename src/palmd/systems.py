"""The table of systems: each rig that palmd supports is a row here with its own files. Names only, no imports.

A part is given as `module:object` and loaded by `load_part` on request, so that a rig loads nothing of another system.
A configuration, motion limits and a recording name their system in the key `system`.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

TWO_PALMS = "two_palms"
"""The default system."""


@dataclass(frozen=True, slots=True)
class LiveParts:
    """The parts of a system that can run live."""

    manual: str
    """Documentation for users."""
    demo: str
    """The shipped configuration that `palmd demo` runs."""
    config: str
    """Model of its configuration: a `palmd.config.any_config.AnyConfig`."""
    description: str
    """Makes the rig description for its observers: a dataclass of numbers."""
    plans: str
    """Its plans and their limits: a `palmd.motion.plan.PlanForm`."""
    topics: str
    """Its topics: a `palmd.quantities.SystemTopics`."""
    loop: str
    """Its part of the daemon: makes a `palmd.daemon.systems.LiveSystem` from the configuration."""
    rig: str
    """Its emulated rig: a `palmd.rig.emulated.EmulatedRig`, made from configuration and seed."""
    recording: str
    """Reader of its recordings, with evaluation by its observer: a `palmd.record.run.AnyRun`."""
    report: str
    """The report of a recording: makes a `palmd.report.sections.Report` from a `palmd.report.series.Series`."""
    comparison: str
    """Comparison of its estimates with its emulated rig: a `palmd.harness.comparison.AnyComparison`."""
    shows: str
    """What the first minute of its demo shows, in one sentence."""
    status: str
    """Makes the lines of `palmd ctl status` about joints and object from a status."""
    kernels: str
    """The kernels to compile for a configuration, or for any without one: as `palmd.observer.kernels.needed`."""
    implausible: str = ""
    """Check for implausible combinations of keys: see `palmd.plausibility`; empty for none."""


@dataclass(frozen=True, slots=True)
class SystemParts:
    """A system: its name as `rig.system` in files, its name in words, and its parts."""

    name: str
    words: str
    log: str
    """Reader, estimators and reconstruction of its event logs: a `palmd.record.systems.System`."""
    live: LiveParts | None = None
    """None if only logs are supported."""
    log_report: str = ""
    """Makes the `palmd.report.sections.Report` of a name and a result; empty if only recordings have one."""


SYSTEMS: Mapping[str, SystemParts] = {
    system.name: system
    for system in (
        SystemParts(
            TWO_PALMS,
            "two palms on a hinge",
            log="palmd.record.systems.two_palms:SYSTEM",
            live=LiveParts(
                manual="docs/start/bringup.md",
                demo="demo.yaml",
                config="palmd.config.two_palms:Config",
                description="palmd.config.two_palms:rig_description",
                plans="palmd.motion.plan:PLANS",
                topics="palmd.quantities:TWO_PALMS_TOPICS",
                loop="palmd.daemon.two_palms:LiveTwoPalms",
                rig="palmd.rig.world:World",
                recording="palmd.record.run:Run",
                report="palmd.report.sections:report_of",
                comparison="palmd.harness.comparison:Comparison",
                shows="Two palms turn an unknown object between them until its whole outline has been touched.",
                status="palmd.cli.board:status_lines",
                kernels="palmd.observer.kernels:needed",
                implausible="palmd.plausibility:implausible_rig",
            ),
        ),
        SystemParts(
            "pivot",
            "a pivoting grasp",
            log="palmd.record.systems.pivot:SYSTEM",
            live=LiveParts(
                manual="docs/start/pivot.md",
                demo="slide.yaml",
                config="palmd.config.pivot:PivotConfig",
                description="palmd.config.pivot:pivot_rig",
                plans="palmd.motion.pivot:PLANS",
                topics="palmd.pivot_quantities:PIVOT_TOPICS",
                loop="palmd.daemon.pivot_system:PivotGrasp",
                rig="palmd.rig.pivot_world:PivotWorld",
                recording="palmd.record.pivot_run:PivotRun",
                report="palmd.report.system_report:pivot_report",
                comparison="palmd.harness.system_comparisons:PivotComparison",
                shows="An arm lowers a body that turns freely in its gripper onto a pad, and moves it along the pad; "
                "the outline is estimated where it was touched.",
                status="palmd.cli.board:pivot_status",
                kernels="palmd.model.pivot:needed",
            ),
        ),
        SystemParts(
            "three_palms",
            "three palms in space",
            log="palmd.record.systems.three_palms:SYSTEM",
            log_report="palmd.report.body_report:body_report",
            live=LiveParts(
                manual="docs/start/three-palms.md",
                demo="three_palms.yaml",
                config="palmd.config.three_palms:ThreePalmsConfig",
                description="palmd.config.three_palms:three_palms_rig",
                plans="palmd.motion.three_palms:PLANS",
                topics="palmd.three_palms_quantities:PALM3_TOPICS",
                loop="palmd.daemon.three_palms_system:ThreePalmsInSpace",
                rig="palmd.rig.three_palms.world:ThreePalmsWorld",
                recording="palmd.record.three_palms_run:ThreePalmsRun",
                report="palmd.report.system_report:three_palms_report",
                comparison="palmd.harness.system_comparisons:ThreePalmsComparison",
                shows="Three palms sway an unknown body until its motion is known, then roll it on to new surface. "
                "Only touched surface is estimated.",
                status="palmd.cli.board:three_palms_status",
                kernels="palmd.observer.three_palms.needed:needed",
            ),
        ),
    )
}
LIVE: Mapping[str, LiveParts] = {system.name: system.live for system in SYSTEMS.values() if system.live}


def for_two_palms_only(name: str) -> str:
    """Error text for functions that support two palms only."""
    return f"is for {SYSTEMS[name].words}, but this supports {SYSTEMS[TWO_PALMS].words} only"


def load_part(name: str) -> Any:
    """The object of that name; loads its module."""
    return pkgutil.resolve_name(name)
