"""Checks of a rig's servos: findings for `palmd doctor`, and the conformance checks."""

from __future__ import annotations

import sys
from collections.abc import Iterator

from palmd.config.arms import DynamixelConfig, FeetechConfig
from palmd.console.errors import BAD_INPUT, RIG_FAILED, as_cli_error
from palmd.devices.actuator import make_actuator
from palmd.devices.port import PortUnavailableError
from palmd.devices.servoconformance import CHECKS, STEP_COUNTS, ServoResult, ServoTalk, examine
from palmd.devices.servohost import ServoHost
from palmd.doctor.arm import confirmed
from palmd.doctor.finding import Finding

READ_ONLY_CHECKS = CHECKS[:7]
"""Checks that `palmd doctor` runs without options; they change nothing."""

_QUESTION = (
    f"The next checks turn the torque on; the last moves each palm by up to {STEP_COUNTS * 360 / 4096:.0f}°. If the\n"
    "palms are free, nobody is within reach, and a hand is on the supply's switch, type yes: "
)


def findings(arm: DynamixelConfig | FeetechConfig) -> Iterator[Finding]:
    """Yield one finding for each check of each servo."""
    try:
        with _talk(arm) as talk:
            for result in examine(talk, READ_ONLY_CHECKS):
                yield Finding(_name(result), "ok" if result.outcome == "passed" else "missing", result.seen, result.fix)
    except PortUnavailableError as error:
        yield Finding("servos", "missing", str(error))


def examine_servos(arm: DynamixelConfig | FeetechConfig, sure: bool) -> int:
    """Run all permitted checks and print the results; return the exit status. CliError if the port cannot be opened.

    sure: run the checks that turn the torque on without asking.
    """
    results: list[ServoResult] = []
    moving = False
    with as_cli_error(PortUnavailableError, status=RIG_FAILED), _talk(arm) as talk:
        still = [check for check in CHECKS if not check.moves]
        results += _printed(examine(talk, still))
        if not any(result.outcome == "failed" for result in results):
            moving = sure or confirmed(_QUESTION)
        if moving:
            results += _printed(examine(talk, [check for check in CHECKS if check.moves]))
    failed = sum(result.outcome == "failed" for result in results)
    print(f"{arm.port}: {len(results) - failed} of {len(results)} checks passed, {failed} failed")
    if not moving and not failed:
        print("checks that turn the torque on were skipped: give --yes, or answer yes", file=sys.stderr)
    return RIG_FAILED if failed else 0 if moving else BAD_INPUT


def _talk(arm: DynamixelConfig | FeetechConfig) -> ServoTalk:
    host = make_actuator(arm)
    assert isinstance(host, ServoHost)
    return ServoTalk(arm.port, arm.baud, host.axes)


def _printed(results: Iterator[ServoResult]) -> list[ServoResult]:
    made = []
    for result in results:
        word = "pass" if result.outcome == "passed" else "FAIL"
        fix = f"\n         fix       {result.fix}" if result.fix else ""
        print(f"{result.number:2} {word}  {_name(result)}: {result.clause}\n         {result.seen}{fix}", flush=True)
        made.append(result)
    return made


def _name(result: ServoResult) -> str:
    return f"servo {result.servo}" if result.servo else "servos"
