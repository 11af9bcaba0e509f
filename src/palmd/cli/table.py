"""Table of commands: name, module and description of each; modules are imported when called."""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Mapping
from types import ModuleType
from typing import NamedTuple

from palmd.console.arguments import Parser


class Command(NamedTuple):
    """One command.

    `module`, in the package, has a docstring, `add_arguments(parser)` and `run(arguments) -> int`; it is None for a
    group of commands.
    """

    name: str
    module: str | None
    help: str


COMMANDS = (
    Command("demo", "cli.demo", "run an emulated rig and the daemon on an unknown object"),
    Command("demo rig", "cli.rig", "run the emulated rig alone, its ports on pseudo-terminals"),
    Command("run", "cli.run", "run the daemon"),
    Command("ctl", "cli.ctl", "command a running daemon"),
    Command("ctl explore", "cli.explore", "have a running daemon touch the whole outline of the object"),
    Command("jog", "cli.jog", "turn the palms with the arrow keys"),
    Command("top", "cli.top", "show the live status of a running daemon in this terminal"),
    Command("view", "cli.view", "serve the live page of a running daemon to browsers on this machine"),
    Command("record", "cli.record", "record what a daemon publishes, one file a run"),
    Command(
        "record capture", "cli.capture", "make the first recording of a rig, guided: check, calibrate, record, bundle"
    ),
    Command("record bundle", "cli.bundle", "pack a recorded run, versions and findings for a bug report"),
    Command("runs", "cli.runs", "list, search and compare recordings"),
    Command("runs compare", "cli.compare", "compare runs with each other, with the truth or with an external track"),
    Command("runs recover", "cli.recover", "repair a recording that was cut off or damaged"),
    Command("replay", "cli.replay", "publish a recorded run again, or check that the observer repeats its estimates"),
    Command("why", "cli.why", "explain why a recorded run held or stopped"),
    Command("report", "cli.report", "make a page or PDF of a recorded run"),
    Command("export", "cli.export", "convert a recorded run to an event log, CSV, MCAP with JSON, or rerun's format"),
    Command("estimate", "cli.estimate", "run the daemon's observer over an event log or a recorded run"),
    Command("reconstruct", "cli.reconstruct", "estimate outline and motion from a whole event log or recorded run"),
    Command("recognise", "cli.recognise", "find which of the stored outlines the object of a run has"),
    Command("calibrate", None, "measure values for the configuration"),
    Command(
        "calibrate pad",
        "calibration.pad",
        "measure a touchpad's noise, resolution, timing and dead band, with a marble",
    ),
    Command(
        "calibrate arm", "calibration.arm", "measure the arm's base and the palms' lengths, by swinging them by hand"
    ),
    Command(
        "calibrate gravity", "calibration.gravity", "measure gravity's direction and the arm's yaw, with a rolling ball"
    ),
    Command(
        "calibrate pads", "calibration.pads", "measure both touchpads' zero, scale and sign, with a turned cylinder"
    ),
    Command(
        "calibrate standoff",
        "calibration.standoff",
        "measure both touchpads' height above the hinge line, zero, scale and sign, with two turned cylinders",
    ),
    Command(
        "calibrate force", "calibration.force", "measure both touchpads' newtons per count, with a cylinder's weight"
    ),
    Command("calibrate curvature", "calibration.curvature", "measure the curvature of curved palms, with a cylinder"),
    Command(
        "calibrate height",
        "calibration.height",
        "measure a pivoting gripper's height over the pad, with a dragged cylinder",
    ),
    Command(
        "calibrate vibration", "calibration.vibration", "measure the palms' vibration speed, with an accelerometer"
    ),
    Command(
        "calibrate self",
        "calibration.self_calibration",
        "estimate the pads' zeros and the palms' angles, from recorded runs with any objects",
    ),
    Command("check", "cli.check", "validate configurations and motion plans"),
    Command("init", "cli.init", "write a configuration from questions about the rig"),
    Command("doctor", "doctor.command", "find what is missing or misconfigured, and test the pads"),
    Command("doctor arm", "doctor.arm", "test the arm or the servos: state, latency, a small motion"),
    Command("doctor latency", "doctor.latency", "measure how late the loop is on this machine, idle and busy"),
    Command("doctor build", "cli.build", "compile the observers now instead of at the first run"),
    Command("install", "cli.install", "install palmd's systemd services"),
    Command("install completion", "cli.completion", "print the shell completion script"),
    Command("keys", "cli.keys", "create and manage the keys of daemons and clients"),
)
"""In the order of `palmd --help`. A name of two words is a subcommand of its first word."""

RENAMED = {
    "explore": "ctl explore",
    "recover": "runs recover",
    "latency": "doctor latency",
    "build": "doctor build",
    "completion": "install completion",
    "report camera": "runs compare",
}
"""Command names before 1.0, which work until 2.0 with a note, and their new names."""

SHORT = {
    "rig": "demo rig",
    "capture": "record capture",
    "bundle": "record bundle",
    "compare": "runs compare",
}
"""Short names, which `palmd --help` does not list, and the names that they stand for."""

CONFORMANCE = "python -m tools.conformance"
"""Command that runs a conformance suite in a checkout."""

STUDIES = "python -m tools.studies"
"""Command that runs a study in a checkout."""

_SUITES = f"palmd doctor arm tests the actuator; the conformance suites run in a checkout: {CONFORMANCE}"
_STUDY = f"studies are not installed; in a checkout run: {STUDIES}"

MOVED = {
    "doctor --arm-conformance": f"{_SUITES} arm PORT",
    "doctor --actuator-conformance": f"{_SUITES} arm PORT, or servos PORT",
    "bench": f"{_STUDY} NAME",
    "observability": "this study is finished; its results are in docs/theory/paper.md",
    "report paper": f"{_STUDY} paper",
    "outlook": "this study is finished; its results are in docs/theory/outlook.md",
}
"""Messages for former commands that run in a checkout now; NAME is replaced by the next word."""


def subcommands(name: str = "") -> dict[str, Command]:
    """Return the subcommands of a command by their last word; by default the top-level commands."""
    head = f"{name} " if name else ""
    found = {each.name.removeprefix(head): each for each in COMMANDS if each.name.startswith(head)}
    return {word: each for word, each in found.items() if " " not in word}


def load_module(command: Command) -> ModuleType:
    """Import and return the command's module."""
    return importlib.import_module(f"palmd.{command.module}")


def parser_of(command: Command, module: ModuleType, program: str = "palmd") -> argparse.ArgumentParser:
    """Create the parser of a command that has a module; its help lists the subcommands."""
    names = subcommands(command.name)
    parser = Parser(
        prog=f"{program} {command.name}",
        description=module.__doc__,
        epilog=f"subcommands:\n{listing(names)}" if names else None,
        formatter_class=argparse.RawDescriptionHelpFormatter if names else argparse.HelpFormatter,
    )
    module.add_arguments(parser)
    return parser


def listing(commands: Mapping[str, Command]) -> str:
    """One line per command: word and description."""
    width = max(map(len, commands))
    return "\n".join(f"  {name:{width}}  {each.help}" for name, each in commands.items())
