"""Publishes a recorded run again, message by message, for the live page and other subscribers.

With --check nothing is published: the recorded events are processed by the same observer again, and its estimates are
compared bit by bit with the recorded ones; the commands and states are checked against the lifecycle's rules.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from palmd.bus.link import PUBLISH
from palmd.config.addresses import LocalAddress
from palmd.console.arguments import positive
from palmd.console.errors import BAD_INPUT, as_cli_error
from palmd.console.notes import print_notes
from palmd.console.progress import Progress
from palmd.harness.processes import StopRequest
from palmd.harness.rules import RulesReport, check_run
from palmd.payload import FRAMES
from palmd.record.mcapfile import RawMessage
from palmd.record.player import SETTLE_S, RecordedPublisher, RepublishError, pause, play
from palmd.record.recheck import Difference, Recheck
from palmd.record.run import AnyRun, RunError, read_any_run

MAX_BROKEN_SHOWN = 10


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add = parser.add_argument
    add("run", type=Path, metavar="RUN", help="a recorded run (.mcap)")
    add("--speed", type=positive(), default=1.0, metavar="X", help="factor of the recorded speed (default: 1)")
    add("--publish", type=_address, default=PUBLISH, metavar="ADDRESS",
        help="address to publish at (default: %(default)s)")  # fmt: skip
    add("--frames", type=int, choices=FRAMES, default=3,
        help="frames of each message; 2 omits the time (default: 3)")  # fmt: skip
    either = parser.add_mutually_exclusive_group()
    either.add_argument("--loop", action="store_true", help="restart at the end, until Ctrl-C")
    either.add_argument(
        "--check", action="store_true",
        help="compare with the observer's present estimates, and check the lifecycle's rules",
    )  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Publish or check the run; return 1 if a check finds a difference. CliError for an invalid run."""
    with as_cli_error(RunError, RepublishError):
        recording = read_any_run(arguments.run)
        print_notes(recording.notes)
        if arguments.check:
            return _check(recording)
        _publish(recording, arguments.publish, arguments.speed, arguments.frames, loop=arguments.loop)
    return 0


def _publish(recording: AnyRun, address: str, speed: float, frames: int, *, loop: bool) -> None:
    total = recording.layout.count
    publisher = RecordedPublisher(address, frames)

    def send(message: RawMessage) -> None:
        publisher.announce(recording.path, speed)
        publisher.send(message)

    try:
        with StopRequest() as stop:
            pause(time.monotonic() + SETTLE_S, lambda: stop.made)
            while not stop.made:
                with Progress("replay", total, "messages") as progress:
                    play(recording.messages(), speed, send, lambda: stop.made, progress.at)
                if not loop:
                    break
    finally:
        publisher.close()


def _check(recording: AnyRun) -> int:
    recheck = Recheck(recording)
    total = recording.survey()[recording.topics.events.name].count
    elsewhere = recheck.environment_differences()
    for line in elsewhere:
        print(f"{recording.path}: recorded with {line}: the last bits may differ", file=sys.stderr)
    ticks = agree = 0
    found: list[Difference] = []
    with Progress("check", total, "ticks") as progress:
        for tick in recheck.ticks():
            ticks += 1
            agree += not tick.differences
            found += tick.differences
            progress.at(tick.number)
    kept = check_run(recording)
    print("\n".join(_comparison_lines(recording.path, total, ticks, agree, found) + _rule_lines(kept)))
    return BAD_INPUT if found or kept.broken else 0


def _rule_lines(kept: RulesReport) -> list[str]:
    """Result of the check of the lifecycle's rules, as text lines."""
    what = f"{kept.states} states and {kept.entries} entries of the log"
    if not kept.broken:
        return [f"the lifecycle's rules hold in {what}"]
    lines = [f"the lifecycle's rules are broken {len(kept.broken)} times in {what}"]
    return lines + [f"at {broken}" for broken in kept.broken[:MAX_BROKEN_SHOWN]]


def _comparison_lines(path: Path, total: int, ticks: int, agree: int, found: list[Difference]) -> list[str]:
    """Result of the comparison, as text lines."""
    lines = [f"{path}: {agree} of {ticks} ticks agree to the last bit"]
    if ticks < total:
        lines[0] += f"; {total - ticks} more could not be compared: messages between them are missing"
    if found:
        first = found[0]
        lines.append(f"first difference in tick {first.number}: {first.name} was {first.recorded!r}, is {first.now!r}")
    finite = [each for each in found if math.isfinite(each.sigmas)]
    if finite:
        most = max(finite, key=lambda each: each.sigmas)
        lines.append(f"largest difference in tick {most.number}: {most.name} by {most.sigmas:.2g} sd")
    return lines


def _address(text: str) -> str:
    try:
        address: str = TypeAdapter(LocalAddress).validate_python(text)
    except ValidationError as error:
        raise argparse.ArgumentTypeError(error.errors()[0]["msg"].removeprefix("Value error, ")) from None
    return address
