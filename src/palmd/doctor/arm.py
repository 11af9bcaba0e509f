"""Tests the arm or the servos: state, limits, latency, and after confirmation a motion of 1° and back.

Uses the daemon's own driver; the daemon must not run. Servos get the settings that `palmd run` would write.
The full check of a controller's protocol is `python -m tools.conformance` in a checkout.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from palmd.config.arms import ArmConfig
from palmd.config.two_palms import Config
from palmd.console.configured import INSTALLED, configured, default_path
from palmd.console.errors import BAD_INPUT, RIG_FAILED, CliError, as_cli_error
from palmd.daemon import realtime
from palmd.daemon.poses import make_poses
from palmd.devices.actuator import FOLLOWING, ArmPose, ArmReport, ArmState
from palmd.devices.armlistener import ArmListener
from palmd.devices.port import PortUnavailableError
from palmd.doctor.finding import Finding
from palmd.events import Joints
from palmd.motion.check import motion_limits
from palmd.motion.kinematics import PoseError

LINKED_WITHIN_S = 3.0
LISTEN_S = 1.0
SLOW_S = 0.030
"""Median latency (s) of an answer above which an adapter delays it: a controller answers within a cycle of 16 ms."""

TURN_RAD, TURN_S = math.radians(1.0), 1.0
STOPPED_WITHIN_S = 2.0
_INACCURACY = 0.2  # of the turn, at its end and back at the start, beside the rounding of goals
_AFTER_S = 0.2  # how long the last set-point is held
_QUESTION = (
    f"The next test turns palm 1, and palm 2 with it, by {math.degrees(TURN_RAD):g}° and back, and stops. If the\n"
    "palms are free, nobody is within reach, and a hand is on the emergency stop, type yes: "
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("config", nargs="?", type=Path, metavar="CONFIG",
                        help=f"the rig's configuration (default: {INSTALLED}, else the shipped one)")  # fmt: skip
    parser.add_argument("--yes", action="store_true", help="allow the motion without asking")


def run(arguments: argparse.Namespace) -> int:
    """Print a line for each result; 0 if all are good, 1 without permission to move, 3 if the rig failed."""
    config = configured(default_path(arguments.config))
    realtime.prepare()
    with as_cli_error(PortUnavailableError, status=RIG_FAILED), ArmListener(config.arm) as arm:
        results = [_linked(arm, config.arm, LINKED_WITHIN_S)]
        print(results[-1].line(), flush=True)
        if results[-1].verdict != "ok":
            return RIG_FAILED
        sure = arguments.yes or confirmed(_QUESTION)
        if sure:
            results.append(_motion(arm, config))
            print(results[-1].line())
    if not sure:
        print("the motion was skipped: give --yes, or answer yes", file=sys.stderr)
        return BAD_INPUT
    return 0 if results[-1].verdict == "ok" else RIG_FAILED


def confirmed(question: str) -> bool:
    """Whether the user at the terminal types yes; False without a terminal."""
    if not sys.stdin.isatty():
        return False
    try:
        return input(question).strip().lower() == "yes"
    except EOFError:
        return False


def answers(config: ArmConfig) -> Finding:
    """Check that the controller answers and is ready; nothing moves."""
    try:
        with ArmListener(config) as arm:
            return _linked(arm, config, LISTEN_S)
    except PortUnavailableError as error:
        return Finding("arm answers", "missing", str(error))


def _linked(arm: ArmListener, config: ArmConfig, patience_s: float) -> Finding:
    """State, limits and latency of a controller that answers within `patience_s`."""
    what, driver = "arm answers", arm.driver
    _listen(arm, patience_s, lambda: driver.linked(time.monotonic()))
    if not driver.linked(time.monotonic()) or driver.state is None:
        fix = "check supply, cable and arm.baud; start the controller's program (tools/adept/README.md)"
        return Finding(what, "missing", driver.refusal or f"no answer at {config.baud} bit/s", fix)
    _listen(arm, LISTEN_S)
    latency_s = statistics.median(arm.latencies_s)
    box = driver.reach
    text = f"state {driver.state} ({driver.state.name}), answers after {latency_s * 1e3:.1f} ms"
    if box is not None:
        text += (
            f", workspace {box.x_min_m * 1e3:.0f} to {box.x_max_m * 1e3:.0f} by {box.y_min_m * 1e3:.0f} to"
            f" {box.y_max_m * 1e3:.0f} mm, {box.v_max_m_s:.2g} m/s, {box.a_max_m_s2:.2g} m/s²"
        )
    if driver.state is not ArmState.READY:
        return Finding(what, "missing", f"{text}, {driver.error}".rstrip(", "), "bring it to READY")
    if latency_s > SLOW_S:
        return Finding(what, "missing", text, "sudo palmd install sets the adapter's latency timer to 1 ms")
    return Finding(what, "ok", text)


def _motion(arm: ArmListener, config: Config) -> Finding:
    """Turn palm 1 and back, and stop."""
    driver, poses = arm.driver, make_poses(config)
    if driver.pose is None:
        raise CliError(RIG_FAILED, "the arm has not reported its pose")
    with as_cli_error(PoseError, status=RIG_FAILED, before="the reported pose is not this rig's: "):
        start = poses.angles(driver.pose)
        twist = poses.twist(driver.pose, start)
        turn = _turn_inside(config, arm, start)
    driver.request_tracking()
    reports: list[ArmReport] = []
    try:
        _listen(arm, LISTEN_S, lambda: driver.tracking or driver.refusal is not None)
        if not driver.tracking:
            return Finding("arm moves", "missing", driver.refusal or "tracking does not begin")
        t_start = time.monotonic()

        def target(t: float) -> ArmPose:
            share = math.sin(math.pi * min((t - t_start) / TURN_S, 1.0)) ** 2
            return poses.pose((start[0] + turn * share, *start[1:]), twist)

        while time.monotonic() < t_start + TURN_S + _AFTER_S and driver.tracking:
            reports += arm.read(target)
    finally:
        driver.request_stop()
        _listen(arm, STOPPED_WITHIN_S, lambda: driver.state is ArmState.READY and not driver.busy)
    ended = next((each.state for each in reports if each.state not in FOLLOWING), None)
    if ended is not None or len(reports) < 2:
        return Finding("arm moves", "missing", f"tracking ended: {driver.error or ended or 'no reports'}")
    t_s = np.array([each.t_sample - t_start for each in reports])
    turned = np.array([poses.angles(each.pose)[0] - start[0] for each in reports]) / turn
    delay_s = float(t_s @ turned / turned.sum()) - TURN_S / 2  # of the mean time, weighted by the turn
    text = f"palm 1 turned {math.degrees(turned.max() * turn):+.2f}°, {delay_s * 1e3:.0f} ms after the set-points"
    back = f"it is {math.degrees(abs(turned[-1] * turn)):.2f}° from its start"
    allowed = _INACCURACY + 2.0 * config.arm.goal_rounding_rad / TURN_RAD
    good = abs(turned.max() - 1.0) < allowed and abs(turned[-1]) < allowed
    return Finding("arm moves", "ok" if good else "missing", f"{text}, {back}")


def _turn_inside(config: Config, arm: ArmListener, start: Joints) -> float:
    """The turn of palm 1 (rad) that stays within all limits. CliError if there is none."""
    poses, reach = make_poses(config), arm.driver.reach
    limits = dataclasses.replace(motion_limits(config), workspace=poses.workspace(reach) if reach else None)
    problems: list[str] = []
    for turn in (TURN_RAD, -TURN_RAD):
        problems = limits.violations((start[0] + turn, *start[1:])) or limits.violations(start)
        if not problems:
            return turn
    raise CliError(RIG_FAILED, f"the palms cannot be turned by {math.degrees(TURN_RAD):g}°: {'; '.join(problems)}")


def _listen(arm: ArmListener, seconds: float, done: Callable[[], bool] = lambda: False) -> None:
    t_end = time.monotonic() + seconds
    while time.monotonic() < t_end and not done():
        arm.read()
