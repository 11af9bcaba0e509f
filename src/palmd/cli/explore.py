"""Makes a running daemon explore the whole outline of the object on the palms, and shows the progress.

If the arm is not armed, it is armed first and stopped at the end. After Ctrl-C the palms are held,
then the arm is stopped.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping
from typing import Any

from palmd.bus.addresses import add_config, command_address, publish_address
from palmd.bus.command_client import CommandClient
from palmd.bus.link import COMMAND, PUBLISH, add_key, credentials
from palmd.bus.subscriber import Subscriber
from palmd.config.plans import MAX_DURATION_S, ExploreGoal
from palmd.console.arguments import positive
from palmd.harness.operator import LEASE_S, PlanRun, why
from palmd.harness.processes import StopRequest

PLAN = "explore"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add, default = parser.add_argument, ExploreGoal()
    add("--coverage", type=_share, default=default.coverage, metavar="SHARE",
        help="share of the reachable normals at which it ends (default: %(default)s)")  # fmt: skip
    add("--band-mm", type=positive(10.0), metavar="MM",
        help="also require that the outline's standard deviation is below this at all of them")  # fmt: skip
    add("--seconds", type=positive(MAX_DURATION_S), default=default.time_limit_s, metavar="S",
        help="time limit in s (default: %(default)g)")  # fmt: skip
    add("--address", help=f"the daemon's command socket (default: as configured, {COMMAND})")
    add("--listen", metavar="ADDRESS", help=f"the daemon's publisher (default: as configured, {PUBLISH})")
    add_config(parser)
    add_key(parser)


def run(arguments: argparse.Namespace) -> int:
    """Explore to the end; CliError if the daemon refuses or does not answer, or the rig fails."""
    goal = ExploreGoal(coverage=arguments.coverage, band_mm=arguments.band_mm, time_limit_s=arguments.seconds)
    key = credentials(arguments)
    with (
        StopRequest() as stop,
        CommandClient(command_address(arguments.address, arguments.config), key=key, lease_s=LEASE_S) as client,
        Subscriber(publish_address(arguments.listen, arguments.config), topics=("palm/shape",), key=key) as subscriber,
    ):
        band = _Band(subscriber)
        operation = PlanRun(client, band.listen, lambda status, seconds: concluded(status, seconds, band.sd_m))
        plan = {"name": PLAN, "segments": [{"explore": goal.model_dump(exclude_none=True)}]}
        status = operation.run(plan, stop, lambda status, seconds: progress(status, seconds, band.sd_m))
        print(concluded(status, operation.seconds, band.sd_m))
    return 0


class _Band:
    """Receives outlines; `sd_m` is the largest standard deviation of the last one."""

    def __init__(self, subscriber: Subscriber) -> None:
        self.sd_m = math.nan
        self._subscriber = subscriber

    def listen(self, t_end: float) -> None:
        """Listen until t_end (s, monotonic clock)."""
        for message in self._subscriber.until(t_end):
            self.sd_m = max(message.fields["h_sd_m"])


def progress(status: Mapping[str, Any], seconds: float, band_m: float) -> str:
    """One line of progress."""
    explored = status.get("explored") or {}
    share = explored.get("coverage")
    parts = [f"{seconds:5.0f} s  {status['state']:8}", f"touched {_percent(share)}", f"largest sd {_mm(band_m)}"]
    if status["state"] == "hold":
        parts.append(f"{why(status)} (palmd ctl start continues)")
    elif explored.get("reason"):
        parts.append(explored["reason"])
    return "  ".join(parts)


def concluded(status: Mapping[str, Any], seconds: float, band_m: float) -> str:
    """One line on the result and the reason for the end."""
    explored = status.get("explored") or {}
    text = (
        f"explored {_percent(explored.get('coverage'))} of the {_percent(explored.get('reachable'))} of the outline "
        f"that can be reached in {seconds:.0f} s, largest sd {_mm(band_m)}"
    )
    return f"{text}: {explored['reason']}" if explored.get("reason") else text


def _percent(share: float | None) -> str:
    return "nothing yet" if share is None else f"{share:.0%}"


def _mm(band_m: float) -> str:
    return "not known" if math.isnan(band_m) else f"{band_m * 1e3:.3f} mm"


def _share(text: str) -> float:
    """Argument type: a share of 1; the error text says so for a percentage."""
    try:
        return positive(1.0)(text)
    except argparse.ArgumentTypeError as error:
        hint = "; did you mean a share of 1, such as 0.95?" if 1.0 < float(text) <= 100.0 else ""
        raise argparse.ArgumentTypeError(f"{error}{hint}") from None
