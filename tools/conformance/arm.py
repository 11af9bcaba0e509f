"""Runs the arm link's conformance checks on a real port and prints the results."""

from __future__ import annotations

import sys

from palmd.console.errors import BAD_INPUT, RIG_FAILED, CliError, as_cli_error
from palmd.daemon import realtime
from palmd.devices.port import PortUnavailableError
from palmd.doctor.arm import confirmed
from tools.conformance.arm_checks import CHECKS, MAX_EXCURSION_M, REPORT, CheckResult, examine
from tools.conformance.arm_line import ArmLine
from tools.conformance.arm_talk import Talk

_WORDS = {"passed": "pass", "failed": "FAIL", "not run": "----"}
_QUESTION = (
    f"The next checks make the arm track. It moves less than {MAX_EXCURSION_M * 1e3:g} mm if its controller is right,\n"
    "otherwise up to one cycle at its maximum speed. If the arm is free, nobody is within reach, and a hand is on the\n"
    "emergency stop, type yes: "
)


def examine_arm(path: str, baud: int, sure: bool) -> int:
    """Run all permitted checks and print the results; return the exit status. CliError if the port fails.

    sure: run the checks that make the arm track without asking.
    """
    realtime.prepare()  # where it is not permitted, checks may have to be repeated
    with as_cli_error(PortUnavailableError, status=RIG_FAILED), ArmLine(path, baud) as line:
        return _summary(path, _examined(path, line, Talk(baud), sure))


def _examined(path: str, line: ArmLine, talk: Talk, sure: bool) -> list[CheckResult]:
    results: list[CheckResult] = []
    try:
        for check in CHECKS:
            if check.tracks and not sure:
                sure = confirmed(_QUESTION)
                if not sure:
                    break
            results.append(line.play(examine(check, talk)))
            print(as_text(results[-1]), flush=True)
            if check is REPORT and results[-1].outcome != "passed":
                raise CliError(RIG_FAILED, f"{path}: the other checks cannot run: {results[-1].seen}")
    finally:
        line.stop(talk)
    return results


def as_text(result: CheckResult) -> str:
    """A result as text: two lines, more if it failed."""
    text = f"{result.number:2} {_WORDS[result.outcome]}  {result.clause}"
    if result.outcome == "failed":
        rows = {"sent": result.sent, "expected": result.expected, "seen": result.seen}
        return text + "".join(f"\n         {what:9} {value}" for what, value in rows.items())
    return f"{text}\n         {result.seen}"


def _summary(path: str, results: list[CheckResult]) -> int:
    counts = {outcome: sum(result.outcome == outcome for result in results) for outcome in _WORDS}
    left = len(CHECKS) - len(results)
    text = f"{counts['passed']} of {len(CHECKS)} checks passed, {counts['failed']} failed"
    not_run = counts["not run"] + left
    print(f"{path}: {text}" + (f", {not_run} not run" if not_run else ""))
    if left:
        print("checks that make the arm track were skipped: give --yes, or answer yes", file=sys.stderr)
    return RIG_FAILED if counts["failed"] else BAD_INPUT if left else 0
