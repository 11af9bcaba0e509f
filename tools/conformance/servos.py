"""Runs the servos' conformance checks on a real bus and prints the results."""

from __future__ import annotations

import sys
from collections.abc import Iterator

from palmd.config.arms import DynamixelConfig, FeetechConfig
from palmd.console.errors import BAD_INPUT, RIG_FAILED, as_cli_error
from palmd.devices.port import PortUnavailableError
from palmd.doctor.arm import confirmed
from palmd.doctor.servos import open_talk
from tools.conformance.servo_checks import CHECKS, STEP_COUNTS, ServoResult, examine

_QUESTION = (
    f"The next checks turn the torque on; the last moves each palm by up to {STEP_COUNTS * 360 / 4096:.0f}°. If the\n"
    "palms are free, nobody is within reach, and a hand is on the supply's switch, type yes: "
)


def examine_servos(arm: DynamixelConfig | FeetechConfig, sure: bool) -> int:
    """Run all permitted checks and print the results; return the exit status. CliError if the port cannot be opened.

    sure: run the checks that turn the torque on without asking.
    """
    results: list[ServoResult] = []
    moving = False
    with as_cli_error(PortUnavailableError, status=RIG_FAILED), open_talk(arm) as talk:
        results += _printed(examine(talk, [check for check in CHECKS if not check.moves]))
        if not any(result.outcome == "failed" for result in results):
            moving = sure or confirmed(_QUESTION)
        if moving:
            results += _printed(examine(talk, [check for check in CHECKS if check.moves]))
    failed = sum(result.outcome == "failed" for result in results)
    print(f"{arm.port}: {len(results) - failed} of {len(results)} checks passed, {failed} failed")
    if not moving and not failed:
        print("checks that turn the torque on were skipped: give --yes, or answer yes", file=sys.stderr)
    return RIG_FAILED if failed else 0 if moving else BAD_INPUT


def _printed(results: Iterator[ServoResult]) -> list[ServoResult]:
    made = []
    for result in results:
        word = "pass" if result.outcome == "passed" else "FAIL"
        fix = f"\n         fix       {result.fix}" if result.fix else ""
        name = f"servo {result.servo}" if result.servo else "servos"
        print(f"{result.number:2} {word}  {name}: {result.clause}\n         {result.seen}{fix}", flush=True)
        made.append(result)
    return made
