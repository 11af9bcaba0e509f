"""Runs an emulated rig, the daemon and the live page in closed loop on an object unknown to palmd.

The rig has residual calibration errors, drawn by the seed (`--perfect`: none). The palms explore until the outline is
complete, and then stop. Progress goes to standard error; at the end one line on standard output compares the estimate
with the rig's truth. Without --seconds it runs until Ctrl-C.
"""

from __future__ import annotations

import argparse
import math
import tempfile
import time
from contextlib import ExitStack, suppress
from pathlib import Path

from palmd.bus.command_client import CommandClient
from palmd.bus.link import COMMAND, PUBLISH
from palmd.cli.build import prepare_kernels
from palmd.config.any_config import BusConfig
from palmd.config.two_palms import Config
from palmd.console.arguments import positive
from palmd.console.errors import RIG_FAILED, CliError, as_cli_error
from palmd.console.extras import require
from palmd.console.notes import open_page, say
from palmd.console.shipped import shipped
from palmd.harness.comparison import AnyComparison
from palmd.harness.operator import Operator, do, still_needed
from palmd.harness.processes import StopRequest
from palmd.harness.stack import Stack
from palmd.rig.app import add_object_arguments
from palmd.rig.imperfections import perfect
from palmd.systems import LIVE, SYSTEMS, TWO_PALMS, load_part
from palmd.yamlfile import ConfigError, load_any_config

MOTION_START_S = 30.0
LOOK_S = 0.1
PROGRESS_S = 1.0
RECORDED_S = 300.0  # for packing a recording of many hours
RUNS = Path("runs")
RIGS = {"adept": "demo.yaml", "tabletop": "tabletop.yaml"}
VARIANTS = {"cradle": "cradle.yaml", "pivot_rigid": "pivot.yaml"}  # of a system
DEMOS = VARIANTS | {name: live.demo for name, live in LIVE.items() if name != TWO_PALMS}
_RIGID = "pivot_rigid: a pivoting grasp without a slide, which needs minutes"
_STICKS = (
    "Its palms do not vibrate: an object with friction sticks, and no live estimate of it is valid. Its outline is "
    "estimated from the recording, by palmd reconstruct."
)
_WORLDS = {"none": "perfect", "calibrated": "with residual calibration errors"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("--seconds", type=positive(), default=math.inf, metavar="N", help="duration of the run in s")
    parser.add_argument("--no-browser", action="store_true", help="serve the live page, but do not open a browser")
    parser.add_argument("--seed", type=int, help="seed of object and noise; default: random, printed")
    add_object_arguments(parser)
    parser.add_argument(
        "--no-record", action="store_true", help=f"do not record; the default is to record into {RUNS}/"
    )
    parser.add_argument("--perfect", action="store_true", help="use an exactly known rig")
    which = parser.add_mutually_exclusive_group()
    others = "; ".join(f"{name}: {SYSTEMS[name].words}" for name in LIVE if name != TWO_PALMS)
    which.add_argument("--system", choices=DEMOS, help=f"cradle: two concave palms; {others}; {_RIGID}")
    which.add_argument("--rig", choices=RIGS, default="adept", help="an arm with VersaPads, or servos with strips")
    which.add_argument("--config", type=Path, help="configuration of rig and plan; default: the shipped one")


def run(arguments: argparse.Namespace) -> int:
    """Run the demo and clean up; return 3 if no estimate converged.

    Raises CliError if the rig or the daemon fails.
    """
    with as_cli_error(ConfigError):
        config = load_any_config(arguments.config or shipped(DEMOS.get(arguments.system, RIGS[arguments.rig])))
    if arguments.perfect:
        config = perfect(config)
    physics = arguments.physics
    if physics == "mujoco":
        require("--physics mujoco", "mujoco", "mujoco")
    prepare_kernels(config, say)
    rig_arguments = [] if arguments.seed is None else ["--seed", str(arguments.seed)]
    rig_arguments += [] if arguments.kind is None else ["--kind", arguments.kind]
    with StopRequest() as stop, tempfile.TemporaryDirectory(prefix="palmd-demo-") as name, ExitStack() as leaving:

        def show(page: str) -> None:
            say(f"  {page}")
            if not arguments.no_browser:
                open_page(page)

        stack = Stack(Path(name), config, RUNS.absolute(), give_up=lambda: stop.made, notify=say, show=show)
        leaving.enter_context(stack)
        if not stack.start_rig("--sockets", "--physics", physics, *rig_arguments):
            return 0  # stopped before the start
        say(LIVE[config.system].shows)
        if isinstance(config, Config) and config.rig.vibration.relation == "none":
            say(_STICKS)
        say(f"Seed {stack.rig_info['seed']}; the object is unknown to the daemon. Watch it with:")
        if not stack.start(record=not arguments.no_record, page=True):
            return 0
        world = _WORLDS.get(str(config.rig.imperfections), "with configured imperfections")
        world += " in MuJoCo" if physics == "mujoco" else ""
        comparison: AnyComparison = load_part(LIVE[config.system].comparison)(stack.rig_info["seed"], world)
        if not stack.start_page() and not stop.made:
            say(f"no live page: {stack.children.pop('page').error_output() or 'it did not start'}")
        _name_other_views(stack.bus)
        _operate(stack, comparison, stop, arguments.seconds)
        if physics == "mujoco":
            with suppress(CliError):  # the rig may have ended already
                say(f"deepest penetration in MuJoCo: {stack.rig_status()['penetration_m'] * 1e6:.1f} µm")
        _bring_to_rest(stack)
        if not arguments.no_record:
            _finish_recording(stack, advise=config.system == TWO_PALMS and not comparison.settled)
    print(comparison.summary())
    return 0 if comparison.settled else RIG_FAILED


def _name_other_views(bus: BusConfig) -> None:
    at = "" if bus.publish == PUBLISH else f" --address {bus.publish}"
    to = "" if bus.command == COMMAND else f" --address {bus.command}"
    say(f"  palmd top{at}")
    say(f"  PlotJuggler: ZeroMQ subscriber, MessagePack, {bus.publish}")
    say(f"  palmd ctl status{to}")


def _operate(stack: Stack, comparison: AnyComparison, stop: StopRequest, seconds: float) -> None:
    """Act as the operator, for `seconds` of motion or until a stop is requested."""
    operator = Operator()
    t_begin = time.monotonic()
    t_progress = -math.inf
    while not stop.made:
        for message in stack.subscriber.until(time.monotonic() + LOOK_S):
            comparison.take(message)
            operator.take(message.topic, message.fields)
        stack.check_alive("rig", "daemon")
        t = time.monotonic()
        started = comparison.t_started
        if started is None and t > t_begin + MOTION_START_S:
            raise CliError(
                RIG_FAILED, f"the palms did not start moving\n{stack.children['daemon'].error_output()}".strip()
            )
        if started is not None and t > started + seconds:
            return
        command = operator.decide(t)
        if command is not None and _is_done(stack.client, command) and command == "start":
            comparison.started(t)
        if started is not None and t >= t_progress + PROGRESS_S:
            t_progress = t
            if line := comparison.progress(t):
                say(line)


def _is_done(client: CommandClient, command: str) -> bool:
    """Give a command if the daemon's status still requires it; return whether it succeeded."""
    status = do(client, "status")
    if status["control"] not in ("", client.client) or not still_needed(command, status):
        return False
    reply = client.ask(command)
    if not reply["ok"]:
        say(str(reply.get("error")))
    elif command == "reset":
        say("reset")
    return bool(reply["ok"])


def _bring_to_rest(stack: Stack) -> None:
    """Stop the motion, then the daemon, before the rig ends; estimates meanwhile are not compared.

    The page is stopped first, so that it keeps showing the last state instead of missing data.
    """
    if "page" in stack.children:
        stack.children["page"].stop()
    with suppress(CliError):
        stack.client.ask("stop")
    stack.children["daemon"].stop()


def _finish_recording(stack: Stack, *, advise: bool) -> None:
    """Let the recorder receive the daemon's end and pack the recording; print its path.

    advise: print the command that estimates the outline from it.
    """
    recorder, paths = stack.children["recorder"], stack.recorded(RECORDED_S)
    for path in paths:
        say(f"recorded in {path}")
        if advise:
            say(f"estimate the outline from the whole run: palmd reconstruct {path} -o outline.svg")
    if recorder.status != 0 or not paths:
        say(f"not recorded: {recorder.error_output() or recorder.status}")
