"""A calibration with a cylinder between the palms: a running daemon moves it by a plan while the pads are recorded."""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from palmd.bus.command_client import CommandClient
from palmd.bus.link import add_key, credentials
from palmd.bus.subscriber import Subscriber
from palmd.calibration.cylinder import CylinderError, turning_plan
from palmd.calibration.files import add_config, add_output, document, plain, result_folder, store
from palmd.config.addresses import from_here
from palmd.config.pads import PadConfig
from palmd.config.two_palms import Config
from palmd.console.arguments import positive
from palmd.console.configured import configured
from palmd.console.errors import RIG_FAILED, CliError, as_cli_error
from palmd.events import Event
from palmd.harness.operator import LEASE_S, PlanRun, Status, can_move, why
from palmd.harness.processes import StopRequest
from palmd.messages import events_of
from palmd.motion.check import motion_limits
from palmd.quantities import CONTACT, EVENTS
from palmd.system.mechanism import PALMS

Result = TypeVar("Result")

FIRST_TOUCH_S = 30.0
"""Longest wait until the cylinder lies on both palms."""
TAKE_OUT_S = 60.0
"""Longest wait until a cylinder that is to be exchanged is removed."""
TOUCHED_S = 1.0
"""How long both pads must be touched without interruption before anything moves."""

_LOOK_S = 0.25
MAX_RADIUS_MM = 1000.0


def add_arguments(parser: argparse.ArgumentParser, written: str) -> None:
    """The configuration, the cylinder's radius, the folder for the file `written`, and the key."""
    add_config(parser, "the running daemon's configuration, palmd.yaml")
    add_radius(parser)
    add_output(parser, written)
    add_key(parser)
    parser.set_defaults(resumes=None)  # of `PlanRun`; a guided capture sets it


def add_radius(parser: argparse.ArgumentParser) -> None:
    """The cylinder's radius."""
    parser.add_argument("--radius-mm", type=positive(MAX_RADIUS_MM), required=True, metavar="R", help="of the cylinder")


def recorded_events(
    arguments: argparse.Namespace, config: Config, plan: Mapping[str, Any], *, cylinder: str = "the cylinder"
) -> list[Event]:
    """The observer's events while the daemon runs the plan; `cylinder` is the name in the prompt.

    Nothing moves before both pads are touched. CliError if there is no daemon, it refuses, the plan does not end
    normally, or the daemon detects swapped pads.
    """
    key = credentials(arguments)
    command, publish = from_here(config.bus.command), from_here(config.bus.publish)
    with (
        StopRequest() as stop,
        CommandClient(command, key=key, lease_s=LEASE_S) as client,
        Subscriber(publish, topics=(CONTACT.name, EVENTS.name), key=key) as subscriber,
    ):
        can_move(client)
        wait_for_touch(subscriber, publish, stop, cylinder)
        events: list[Event] = []

        def listen(t_end: float) -> None:
            for message in subscriber.until(t_end):
                if message.topic == EVENTS.name:
                    events.extend(events_of(message.fields))

        operation = PlanRun(
            client, listen, lambda _status, seconds: f"ended after {seconds:.0f} s", resumes=arguments.resumes
        )
        status = operation.run(plan, stop, progress_line)
        if stop.made:
            raise CliError(RIG_FAILED, f"stopped after {operation.seconds:.0f} s: nothing is stored")
        if "pads-swapped" in status["faults"]:
            raise CliError(
                RIG_FAILED,
                "the pressures change in the wrong direction as the V is tipped: the pads are swapped; exchange"
                f" {' and '.join(f'pads.palm{palm}.port' for palm in PALMS)}, restart the daemon, and calibrate"
                " again",
            )
        return events


def turn_and_measure(
    arguments: argparse.Namespace,
    measure: Callable[[Sequence[Event], tuple[PadConfig, ...], float, Sequence[float]], Result],
) -> tuple[Config, Path, Result]:
    """The configuration, the folder for the result, and what `measure` returns for a cylinder that the palms turn.

    `measure` is called with the events, the pads, the radius (m) and the configured curvatures (1/m). CliError if the
    input is wrong, before anything has moved, or if the rig fails.
    """
    config = configured(arguments.config)
    radius_m = arguments.radius_mm * 1e-3
    with as_cli_error(CylinderError):
        plan = turning_plan(radius_m, motion_limits(config))
    folder = result_folder(arguments)
    events = recorded_events(arguments, config, plan)
    with as_cli_error(CylinderError, status=RIG_FAILED):
        return config, folder, measure(events, config.pads.each(), radius_m, config.rig.curvatures_per_m)


def store_result(
    path: Path,
    header: Mapping[str, Any],
    arguments: argparse.Namespace,
    config: Config,
    proposed: Mapping[str, Mapping[str, Any]],
    found: Mapping[str, Any],
) -> None:
    """Write the result and print the settings to write into the configuration, by palm.

    `header` begins the file. The hash is that of the whole section `pads` with the proposed settings.
    """
    updated = {palm: getattr(config.pads, palm).model_copy(update=new) for palm, new in proposed.items()}
    settings = {palm: dict(new) for palm, new in proposed.items()}
    store(path, document(header, config.pads.model_copy(update=updated), settings, plain(dict(found))))
    for palm, new in settings.items():
        text = ", ".join(f"{key}: {value}" for key, value in new.items())
        print(f"{arguments.config}: write in pads.{palm}: {text}")


def progress_line(status: Status, seconds: float) -> str:
    """One line of progress."""
    hint = f"  {why(status)} (palmd ctl start goes on)" if status["state"] == "hold" else ""
    return f"{seconds:5.0f} s  {status['state']:8}  {status['progress']:4.0%}{hint}"


def wait_until_removed(arguments: argparse.Namespace, config: Config, cylinder: str) -> None:
    """Wait until nothing has touched the pads for a while; CliError if the cylinder stays or no messages arrive."""
    print(f"take {cylinder} out", file=sys.stderr, flush=True)
    publish = from_here(config.bus.publish)
    with StopRequest() as stop, Subscriber(publish, topics=(CONTACT.name,), key=credentials(arguments)) as subscriber:
        contacts = _wait_for_contacts(subscriber, stop, (False, False), TAKE_OUT_S)
    if contacts is None:
        return
    if stop.made:
        raise CliError(RIG_FAILED, "stopped between the cylinders: nothing is stored")
    if not contacts:
        raise CliError(RIG_FAILED, _no_messages(publish))
    raise CliError(RIG_FAILED, f"{cylinder} was not taken out within {TAKE_OUT_S:.0f} s: nothing is stored")


def wait_for_touch(subscriber: Subscriber, address: str, stop: StopRequest, cylinder: str) -> None:
    """Ask for `cylinder`, and wait until both pads have been touched for a while; CliError if they are not."""
    print(f"lay {cylinder} between the palms, across both pads", file=sys.stderr, flush=True)
    contacts = _wait_for_contacts(subscriber, stop, (True, True), FIRST_TOUCH_S)
    if contacts is None:
        return
    if stop.made:
        raise CliError(RIG_FAILED, "stopped before anything moved")
    if not contacts:
        raise CliError(RIG_FAILED, _no_messages(address))
    raise CliError(
        RIG_FAILED, f"{_missing_contacts(contacts, cylinder)} within {FIRST_TOUCH_S:.0f} s: nothing has been moved"
    )


def _wait_for_contacts(
    subscriber: Subscriber, stop: StopRequest, wanted: tuple[bool, bool], seconds: float
) -> tuple[bool, ...] | None:
    """None once the pads have been touched as `wanted` for `TOUCHED_S`; the last contacts if the time is over or a stop
    is requested, empty if no message arrived."""
    t_end, t_since = time.monotonic() + seconds, math.inf
    touched: tuple[bool, ...] = ()
    while time.monotonic() < t_end and not stop.made:
        for message in subscriber.until(min(time.monotonic() + _LOOK_S, t_end)):
            if message.topic == CONTACT.name:
                touched = (bool(message.fields["touch1"]), bool(message.fields["touch2"]))
                t_since = min(t_since, message.t_recv) if touched == wanted else math.inf
                if message.t_recv >= t_since + TOUCHED_S:
                    return None
    return touched


def _no_messages(address: str) -> str:
    return f"no messages from {address}: is a palmd running there?"


def _missing_contacts(touched: tuple[bool, ...], cylinder: str) -> str:
    if any(touched):
        touched_palm, other_palm = PALMS if touched[0] else PALMS[::-1]
        return f"{cylinder} touches palm {touched_palm} but not palm {other_palm}"
    return "nothing has touched the pads"
