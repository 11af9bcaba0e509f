"""An emulated rig, the daemon and the live page together, in closed loop on an object that palmd knows nothing about.

The rig is as far off from its configuration as calibration leaves one, drawn by the seed (`--perfect`: not at all). The
palms explore until the outline is complete, and then stand. Progress goes to standard error, and in the end one
line that compares the estimate with the rig's truth to standard output. Without --seconds it runs until Ctrl-C.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
import time
from contextlib import ExitStack, suppress
from pathlib import Path

from palmd.bus.command_client import CommandClient
from palmd.bus.link import COMMAND, PUBLISH
from palmd.cli.browser import open_page
from palmd.cli.build import made_ready
from palmd.config.any_config import AnyConfig, BusConfig
from palmd.console.errors import BAD_INPUT, RIG_FAILED, CliError
from palmd.console.extras import require
from palmd.console.shipped import shipped
from palmd.harness.comparison import AnyComparison
from palmd.harness.operator import Operator, do, still_needed
from palmd.harness.processes import StopRequest
from palmd.harness.stack import Stack
from palmd.rig.app import add_object_arguments
from palmd.rig.imperfections import perfect
from palmd.rig.plant import Physics
from palmd.systems import LIVE, SYSTEMS, TWO_PALMS, load_part
from palmd.yamlfile import ConfigError, load_any_config

MOTION_START_S = 30.0
LOOK_S = 0.1
PROGRESS_S = 1.0
RECORDED_S = 300.0  # to pack the recording of many hours
RUNS = Path("runs")
RIGS = {"adept": "demo.yaml", "tabletop": "tabletop.yaml"}
DEMOS = {"cradle": "cradle.yaml"} | {name: live.demo for name, live in LIVE.items() if name != TWO_PALMS}
_WORLDS = {"none": "perfect", "calibrated": "off as calibration leaves one"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument("--seconds", type=_duration, default=math.inf, metavar="N", help="how long to run")
    parser.add_argument("--no-browser", action="store_true", help="serve the live page, but open no browser")
    parser.add_argument("--seed", type=int, help="which object and noise; default: a random one, printed")
    add_object_arguments(parser)
    parser.add_argument("--no-record", action="store_true", help=f"keep no recording; else it goes to {RUNS}/ here")
    parser.add_argument("--perfect", action="store_true", help="a rig that is exactly as configured, which is known")
    which = parser.add_mutually_exclusive_group()
    others = "; ".join(f"{name}: {SYSTEMS[name].words}" for name in LIVE if name != TWO_PALMS)
    which.add_argument("--system", choices=DEMOS, help="cradle: two concave palms; " + others)
    which.add_argument("--rig", choices=RIGS, default="adept", help="an arm and VersaPads, or strips and servos")
    which.add_argument("--config", type=Path, help="rig and plan; default: as shipped")


def run(arguments: argparse.Namespace) -> int:
    """Runs to the end asked for and leaves nothing behind; 3 when no estimate ever settled.

    Raises CliError when the rig or the daemon fail.
    """
    try:
        config = load_any_config(arguments.config or shipped(DEMOS.get(arguments.system, RIGS[arguments.rig])))
    except ConfigError as error:
        raise CliError(BAD_INPUT, str(error)) from None
    if arguments.perfect:
        config = perfect(config)
    physics = arguments.physics
    if physics == "mujoco":
        require("--physics mujoco", "mujoco", "mujoco")
    made_ready(config, _tell)
    asked = [] if arguments.seed is None else ["--seed", str(arguments.seed)]
    asked += [] if arguments.kind is None else ["--kind", arguments.kind]
    with StopRequest() as stop, tempfile.TemporaryDirectory(prefix="palmd-demo-") as name, ExitStack() as leaving:

        def show(page: str) -> None:
            _tell(f"  {page}")
            if not arguments.no_browser:
                open_page(page)

        stack = Stack(Path(name), config, RUNS.absolute(), give_up=lambda: stop.made, notify=_tell, show=show)
        leaving.enter_context(stack)
        if not stack.start_rig("--sockets", "--physics", physics, *asked):
            return 0  # the end was asked for before anything began
        _introduce(stack.rig_info["seed"], config.system)
        if not stack.start(record=not arguments.no_record, page=True):
            return 0
        comparison = _comparison(config, stack.rig_info["seed"], physics)
        if not stack.start_page() and not stop.made:
            _tell(f"no live page: {stack.children.pop('page').error_output() or 'it did not start'}")
        _name_other_views(stack.bus)
        _operate(stack, comparison, stop, arguments.seconds)
        if physics == "mujoco":
            with suppress(CliError):  # it may have ended first
                _tell(f"deepest penetration in MuJoCo: {stack.rig_status()['penetration_m'] * 1e6:.1f} µm")
        _bring_to_rest(stack)
        if not arguments.no_record:
            _finish_recording(stack)
    print(comparison.summary())
    return 0 if comparison.settled else RIG_FAILED


def _comparison(config: AnyConfig, seed: int, physics: Physics) -> AnyComparison:
    world = _WORLDS.get(str(config.rig.imperfections), "off as configured")
    world += " in MuJoCo" if physics == "mujoco" else ""
    comparison: AnyComparison = load_part(LIVE[config.system].comparison)(seed, world)
    return comparison


def _introduce(seed: int, system: str) -> None:
    _tell(LIVE[system].shows)
    _tell(f"Seed {seed}; the object is unknown to the daemon. Look at it with:")


def _name_other_views(bus: BusConfig) -> None:
    at = "" if bus.publish == PUBLISH else f" --address {bus.publish}"
    to = "" if bus.command == COMMAND else f" --address {bus.command}"
    _tell(f"  palmd top{at}")
    _tell(f"  PlotJuggler: ZeroMQ subscriber, MessagePack, {bus.publish}")
    _tell(f"  palmd ctl status{to}")


def _operate(stack: Stack, comparison: AnyComparison, stop: StopRequest, seconds: float) -> None:
    """Does what an operator does, for so many seconds of motion or until the end is asked for."""
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
                RIG_FAILED, f"the palms were not brought to move\n{stack.children['daemon'].error_output()}".strip()
            )
        if started is not None and t > started + seconds:
            return
        command = operator.decide(t)
        if command is not None and _is_done(stack.client, command) and command == "start":
            comparison.started(t)
        if started is not None and t >= t_progress + PROGRESS_S:
            t_progress = t
            if line := comparison.progress(t):
                _tell(line)


def _is_done(client: CommandClient, command: str) -> bool:
    """Give a command that the bus has called for, if the daemon still does."""
    status = do(client, "status")
    if status["control"] not in ("", client.client) or not still_needed(command, status):
        return False
    reply = client.ask(command)
    if not reply["ok"]:
        _tell(str(reply.get("error")))
    elif command == "reset":
        _tell("reset")
    return bool(reply["ok"])


def _bring_to_rest(stack: Stack) -> None:
    """A planned stop, then the daemon's end before the rig's; what it estimates meanwhile is not compared.

    The page ends before all that: it shows what has come of it, and not that nothing comes any more.
    """
    if "page" in stack.children:
        stack.children["page"].stop()
    with suppress(CliError):
        stack.client.ask("stop")
    stack.children["daemon"].stop()


def _finish_recording(stack: Stack) -> None:
    """Let the recorder hear the daemon's end and pack what it has; says where that is."""
    recorder, paths = stack.children["recorder"], stack.recorded(RECORDED_S)
    for path in paths:
        _tell(f"recorded in {path}")
    if recorder.status != 0 or not paths:
        _tell(f"not recorded: {recorder.error_output() or recorder.status}")


def _tell(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _duration(text: str) -> float:
    seconds = float(text)
    if not seconds > 0.0:
        raise argparse.ArgumentTypeError(f"must be more than 0, got {text}")
    return seconds
