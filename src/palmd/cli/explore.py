"""Has a running daemon find the whole outline of what lies on the palms, and tells how far it has come.

Arms the arm if that has not been done, and then stops it in the end. After Ctrl-C the palms are held,
then the arm is stopped.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Mapping
from typing import Any

from palmd.cli.bus import COMMAND, PUBLISH, Client, Subscriber, add_key, credentials
from palmd.cli.errors import RIG_FAILED, CliError
from palmd.cli.operation import LOOK_S, Operation, why
from palmd.cli.processes import StopRequest
from palmd.config import MAX_DURATION_S, ExploreGoal

PLAN = "explore"
PROGRESS_S = 1.0
HELD_S = 30.0  # that a hold may last: until then somebody may put the object back and start again


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    add, default = parser.add_argument, ExploreGoal()
    add("--coverage", type=_share, default=default.coverage, metavar="SHARE",
        help="of the normals that can be reached, after which it is enough (default: %(default)s)")  # fmt: skip
    add("--band-mm", type=_band, metavar="MM", help="go on until the outline's sd is below this on all of them too")
    add("--seconds", type=_seconds, default=default.time_limit_s, metavar="S", help="at most (default: %(default)g)")
    add("--address", default=COMMAND, help="the daemon's command socket (default: %(default)s)")
    add("--listen", default=PUBLISH, metavar="ADDRESS", help="where it publishes (default: %(default)s)")
    add_key(parser)


def run(arguments: argparse.Namespace) -> int:
    """Explores to the end; CliError when the daemon refuses, does not answer, or the rig fails meanwhile."""
    goal = ExploreGoal(coverage=arguments.coverage, band_mm=arguments.band_mm, time_limit_s=arguments.seconds)
    key = credentials(arguments)
    with (
        StopRequest() as stop,
        Client(arguments.address, key=key) as client,
        Subscriber(arguments.listen, topics=("palm/shape",), key=key) as subscriber,
    ):
        operation = _Operation(client, subscriber)
        operation.begin(goal)
        try:
            status = operation.watch(stop)
        finally:
            operation.end()
        print(concluded(status, operation.seconds, operation.band_m))
    return 0


class _Operation:
    """One exploration, as a person at `palmd ctl` would do it; `band_m` is the largest sd of the last outline heard."""

    def __init__(self, client: Client, subscriber: Subscriber) -> None:
        self.band_m = math.nan
        self.seconds = 0.0
        self._operation, self._subscriber = Operation(client), subscriber
        self._over = False

    def begin(self, goal: ExploreGoal) -> None:
        """Hand the plan over, arm and start; CliError with the daemon's own words when it refuses."""
        self._operation.load({"name": PLAN, "segments": [{"explore": goal.model_dump(exclude_none=True)}]})
        self._operation.arm()
        try:
            self._operation.do("start")
        except CliError:
            self.end()
            raise

    def watch(self, stop: StopRequest) -> Mapping[str, Any]:
        """The status when it is over; CliError when somebody or a fault has ended it, or it stays held."""
        begun = time.monotonic()
        t_progress = t_going = begun
        while True:
            for message in self._subscriber.until(time.monotonic() + LOOK_S):
                self.band_m = max(message.fields["h_sd_m"])
            status, t = self._operation.do("status"), time.monotonic()
            self.seconds = t - begun
            if status["state"] not in ("tracking", "hold"):
                raise CliError(RIG_FAILED, f"{concluded(status, self.seconds, self.band_m)}; {why(status)}")
            if status["state"] == "tracking" and status["over"]:
                self._over = True
                return status
            if stop.made:
                return status
            if status["state"] == "tracking":
                t_going = t
            if t > t_going + HELD_S:
                raise CliError(RIG_FAILED, f"held for {HELD_S:g} s, so given up; {why(status)}")
            if t >= t_progress:
                t_progress = t + PROGRESS_S
                print(progress(status, self.seconds, self.band_m), file=sys.stderr, flush=True)

    def end(self) -> None:
        """Leave the palms standing, and the arm as it was found; after Ctrl-C or a failure it is stopped."""
        self._operation.leave(over=self._over)


def progress(status: Mapping[str, Any], seconds: float, band_m: float) -> str:
    """One line on how it stands."""
    explored = status.get("explored") or {}
    share = explored.get("coverage")
    parts = [f"{seconds:5.0f} s  {status['state']:8}", f"touched {_percent(share)}", f"largest sd {_mm(band_m)}"]
    if status["state"] == "hold":
        parts.append(f"{why(status)} (palmd ctl start goes on)")
    elif explored.get("reason"):
        parts.append(explored["reason"])
    return "  ".join(parts)


def concluded(status: Mapping[str, Any], seconds: float, band_m: float) -> str:
    """How far it has come, and why it ended."""
    explored = status.get("explored") or {}
    told = (
        f"explored {_percent(explored.get('coverage'))} of the {_percent(explored.get('reachable'))} of the outline "
        f"that can be reached in {seconds:.0f} s, largest sd {_mm(band_m)}"
    )
    return f"{told}: {explored['reason']}" if explored.get("reason") else told


def _percent(share: float | None) -> str:
    return "nothing yet" if share is None else f"{share:.0%}"


def _mm(band_m: float) -> str:
    return "not known" if math.isnan(band_m) else f"{band_m * 1e3:.3f} mm"


def _share(text: str) -> float:
    return _within(text, 1.0)


def _band(text: str) -> float:
    return _within(text, 10.0)


def _seconds(text: str) -> float:
    return _within(text, MAX_DURATION_S)


def _within(text: str, most: float) -> float:
    value = float(text)
    if not 0.0 < value <= most:
        raise argparse.ArgumentTypeError(f"must be more than 0 and at most {most:g}, got {text}")
    return value
