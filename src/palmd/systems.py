"""The table of systems: every rig that palmd knows is a row here and has files of its own. Pure names.

A part is told as `module:object` and loaded by `load_part` when somebody asks for it, so that a rig loads nothing of
another system's. A configuration, the limits of its motion and a recording say by their `system` which row is theirs.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

TWO_PALMS = "two_palms"
"""The system that is meant where none is named."""


@dataclass(frozen=True, slots=True)
class LiveParts:
    """What of a system makes it run live."""

    manual: str
    """Where a user reads of it."""
    demo: str
    """The shipped configuration that `palmd demo` runs."""
    config: str
    """Model of its configuration: a `palmd.config.any_config.AnyConfig`."""
    description: str
    """What its observers are told of a configured rig: a dataclass of numbers."""
    plans: str
    """What its plans are, and what limits them: a `palmd.motion.plan.PlanForm`."""
    topics: str
    """What it publishes: a `palmd.quantities.SystemTopics`."""
    loop: str
    """What of the daemon is its own: makes a `palmd.daemon.systems.LiveSystem` of the configuration."""
    rig: str
    """Its emulated rig: a `palmd.rig.emulated.EmulatedRig`, made of configuration and seed."""
    recording: str
    """How a recording of it is read, and judged by its observer: a `palmd.record.run.AnyRun`."""
    report: str
    """The report of a recording: makes a `palmd.report.sections.Report` of a `palmd.report.series.Series`."""
    comparison: str
    """What an estimate is worth, against its emulated rig: a `palmd.harness.comparison.AnyComparison`."""
    shows: str
    """What one sees in the first minute of its demo, in one sentence."""
    status: str
    """What `palmd ctl status` says of where it stands and of its object: the lines, of a status."""
    kernels: str
    """What is compiled for a configuration, or for any without one: as `palmd.observer.kernels.needed`."""
    odd: str = ""
    """What in a configuration several keys together make hardly right: see `palmd.plausibility`; empty for nothing."""


@dataclass(frozen=True, slots=True)
class SystemParts:
    """A system: its name as `rig.system` in files, what it is in words, and where its parts are."""

    name: str
    words: str
    log: str
    """How its event logs are read, estimated and reconstructed: a `palmd.record.systems.System`."""
    live: LiveParts | None = None
    """None where there are logs only."""
    log_report: str = ""
    """What makes the report of a reconstructed event log; empty where only recordings have one."""


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
                odd="palmd.plausibility:odd_rig",
            ),
        ),
        SystemParts(
            "pivot",
            "a pivoting grasp",
            log="palmd.record.systems.pivot:SYSTEM",
            live=LiveParts(
                manual="docs/start/pivot.md",
                demo="pivot.yaml",
                config="palmd.config.pivot:PivotConfig",
                description="palmd.config.pivot:pivot_rig",
                plans="palmd.motion.pivot:PLANS",
                topics="palmd.pivot_quantities:PIVOT_TOPICS",
                loop="palmd.daemon.pivot_system:PivotGrasp",
                rig="palmd.rig.pivot_world:PivotWorld",
                recording="palmd.record.pivot_run:PivotRun",
                report="palmd.report.pivot_report:report_of",
                comparison="palmd.harness.pivot_comparison:PivotComparison",
                shows="An arm lowers a body that pivots in its gripper onto a pad and drags it over it; "
                "the outline is estimated once both sides of the body have been touched.",
                status="palmd.cli.pivot_status:status_lines",
                kernels="palmd.model.pivot:needed",
            ),
        ),
        SystemParts(
            "three_palms",
            "three palms in space",
            log="palmd.record.systems.three_palms:SYSTEM",
            log_report="palmd.report.command:run_body",
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
                report="palmd.report.three_palms_report:report_of",
                comparison="palmd.harness.three_palms_comparison:ThreePalmsComparison",
                shows="Three palms sway an unknown body until its motion is known, then roll it on to new surface. "
                "Only touched surface is estimated.",
                status="palmd.cli.three_palms_status:status_lines",
                kernels="palmd.observer.three_palms.needed:needed",
            ),
        ),
    )
}
LIVE: Mapping[str, LiveParts] = {system.name: system.live for system in SYSTEMS.values() if system.live}


def for_two_palms_only(name: str) -> str:
    """Why what is made for two palms is not for this system."""
    return f"is of {SYSTEMS[name].words}, and this is for {SYSTEMS[TWO_PALMS].words} only"


def load_part(name: str) -> Any:
    """The object of that name; loads its module."""
    return pkgutil.resolve_name(name)
