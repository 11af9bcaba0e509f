"""The table of commands: what each is called, what it is for, and the module that is imported when it is called."""

from __future__ import annotations

import argparse
import importlib
from types import ModuleType
from typing import NamedTuple

from palmd.console.arguments import Parser
from palmd.console.extras import missing


class Command(NamedTuple):
    """One command.

    `module`, in the package, has a docstring, `add_arguments(parser)` and `run(arguments) -> int`; it is None where
    only the commands below do something. `palmd report paper` takes its arguments from `report`.
    """

    name: str
    module: str | None
    help: str


COMMANDS = (
    Command("demo", "cli.demo", "emulated rig and daemon together: an unknown object, live estimates"),
    Command("run", "cli.run", "the daemon"),
    Command("record", "cli.record", "keep what a daemon publishes: one file a run"),
    Command("runs", "cli.runs", "recordings listed, searched, compared, grouped by object"),
    Command("recover", "cli.recover", "make a whole recording of one that was cut off"),
    Command("rig", "cli.rig", "the emulated rig alone, its ports on pseudo-terminals"),
    Command("ctl", "cli.ctl", "tell a running daemon what to do: status, arm, start, hold, stop, reset, plan, jog"),
    Command("top", "cli.top", "live status of a running daemon in this terminal"),
    Command("view", "cli.view", "live page of a running daemon for browsers on this machine"),
    Command("jog", "cli.jog", "turn the palms by the arrow keys, for as long as one is held"),
    Command("explore", "cli.explore", "have a running daemon find the whole outline of what lies on the palms"),
    Command("replay", "cli.replay", "publish a recorded run again, or check that the observer still says the same"),
    Command("bundle", "cli.bundle", "a recorded run with versions and doctor's findings as one zip, for a bug report"),
    Command("why", "cli.why", "what made a recorded run hold or stop, in plain words with the evidence"),
    Command("export", "cli.export", "a recorded run as event log, CSV, MCAP with JSON, or for rerun"),
    Command("keys", "cli.keys", "who may listen to a daemon and command it: new, allow, revoke, list"),
    Command("check", "cli.check", "find what is wrong with configurations and motion plans"),
    Command("estimate", "cli.estimate", "an event log or a recorded run through the daemon's observer"),
    Command(
        "reconstruct", "cli.reconstruct", "outline and motion from a whole event log or recorded run at once, offline"
    ),
    Command(
        "recognise",
        "cli.recognise",
        "which of the stored outlines lies on the palms, from an event log or recorded run",
    ),
    Command("calibrate", None, "measure what the configuration must know"),
    Command(
        "calibrate pad",
        "calibration.pad",
        "one touchpad: noise, resolution, timing, dead band, with a marble rolled over it",
    ),
    Command(
        "calibrate arm", "calibration.arm", "the arm's base and the palms' lengths, while you swing the palms by hand"
    ),
    Command(
        "calibrate gravity",
        "calibration.gravity",
        "gravity and the arm's yaw, with a ball or cylinder that rolls down the palms",
    ),
    Command(
        "calibrate pads",
        "calibration.pads",
        "both touchpads: zero, scale, sign, with a turned cylinder between the palms",
    ),
    Command(
        "calibrate standoff",
        "calibration.standoff",
        "both touchpads: height above the hinge line, zero, scale, sign, with two such cylinders",
    ),
    Command(
        "calibrate force", "calibration.force", "both touchpads: newtons per count, by the weight of that cylinder"
    ),
    Command("calibrate curvature", "calibration.curvature", "palms that are arcs: their curvature, with that cylinder"),
    Command(
        "calibrate height", "calibration.height", "a pivoting gripper's height over the pad, with a dragged cylinder"
    ),
    Command(
        "calibrate self",
        "calibration.self_calibration",
        "the pads' zeros and the palms' angles, from recorded runs with any objects",
    ),
    Command(
        "observability",
        "lab.observability",
        "what the paper's systems can observe: rank and conditioning, maps over the rates",
    ),
    Command(
        "outlook", "lab.outlook", "the paper's last questions: what curved palms cover, what a pivoting grasp can tell"
    ),
    Command("compare", "lab.compare", "a reconstruction with a camera's track of the same run"),
    Command("report", "cli.report", "a recorded run as a page or PDF to print; paper: the runs of CMU-CS-01-107 again"),
    Command("report paper", "lab.paper", "the runs behind the figures of CMU-CS-01-107 again: its method and palmd's"),
    Command("bench", None, "studies of many runs"),
    Command(
        "bench montecarlo",
        "lab.bench_montecarlo",
        "random objects reconstructed blind, scored against their truth and the Cramér–Rao bound",
    ),
    Command(
        "bench sbc",
        "lab.bench_sbc",
        "simulation-based calibration: whether blind reconstructions are as sure as they may be",
    ),
    Command("bench off", "lab.bench_off", "one thing is not as described: what is claimed, how far off, what is named"),
    Command(
        "bench explore", "lab.bench_explore", "unknown objects explored in the emulated rig, beside who knows them"
    ),
    Command(
        "bench recognise", "lab.bench_recognise", "which of twenty similar objects lies on the palms, or none of them"
    ),
    Command("bench curved", "lab.bench_curved", "curved palms: reconstructed blind, explored, and how much they touch"),
    Command(
        "bench pivot",
        "lab.bench_pivot",
        "objects in a pivoting grasp reconstructed blind: outline about the pivot, friction",
    ),
    Command("bench space", "lab.bench_space", "bodies between three palms in space reconstructed blind, with seeds"),
    Command(
        "bench things",
        "lab.bench_things",
        "dice, nuts, coins, blocks: how often a live estimate is wrong",
    ),
    Command("bench parts", "lab.bench_parts", "what better or worse sensors and servos would do to the outline"),
    Command("bench speed", "lab.bench_speed", "how fast palmd is on this machine, as ratios to references beside it"),
    Command("bench engines", "lab.bench_engines", "physics engines as judges: vibrating palms with dry friction"),
    Command("bench peers", "lab.bench_peers", "palmd's estimators beside general-purpose ones"),
    Command(
        "bench field",
        "lab.bench_field",
        "the field's benchmark: 200 runs with their truth, baselines, a scorer for anybody's results",
    ),
    Command(
        "bench faults",
        "lab.bench_faults",
        "every fault provoked on the emulated rig: what comes of it, how soon the arm stands",
    ),
    Command(
        "bench simulate",
        "lab.bench_simulate",
        "daemon and rig in virtual time with everything that may go wrong at once: what must hold all the same",
    ),
    Command("bench soak", "lab.bench_soak", "the demo for an hour with random mischief: leaks, lateness, lost packets"),
    Command(
        "latency", "lab.latency", "how late the control loop is on this machine, idle and busy, beside a bare timer"
    ),
    Command(
        "doctor",
        "doctor.command",
        "what is missing and how to mend it; the arm's controller and the pads put to the test",
    ),
    Command("init", "cli.init", "ask what the rig is made of, and write a configuration of it"),
    Command("build", "cli.build", "compile the observers now; the first run does it otherwise"),
    Command("completion", "cli.completion", "what has a shell complete palmd's commands, options and files"),
    Command("install", "cli.install", "services of this palmd for systemd: units, account, udev rules"),
)
"""In the order in which `palmd --help` lists them; this table alone names the modules of `palmd.lab`."""


def below(name: str = "") -> dict[str, Command]:
    """The commands that stand one level below another, by their last word; those at the top by default."""
    head = f"{name} " if name else ""
    found = {each.name.removeprefix(head): each for each in COMMANDS if each.name.startswith(head)}
    return {word: each for word, each in found.items() if " " not in word}


def said(command: Command) -> str:
    """What a command is for, in the words of a list; with the names of the commands that it consists of."""
    return command.help if command.module else f"{command.help}: {', '.join(below(command.name))}"


def loaded(command: Command) -> ModuleType:
    """Its module; raises CliError, with what mends it, for a package that only the laboratory needs."""
    try:
        return importlib.import_module(f"palmd.{command.module}")
    except ModuleNotFoundError as error:
        if not f"{command.module}".startswith("lab.") or (error.name or "").startswith("palmd"):
            raise
        raise missing(f"palmd {command.name}", error.name or "a package", "lab") from None


def parser_of(command: Command, module: ModuleType) -> argparse.ArgumentParser:
    """What takes the arguments of a command that has a module."""
    parser = Parser(prog=f"palmd {command.name}", description=module.__doc__)
    module.add_arguments(parser)
    return parser
