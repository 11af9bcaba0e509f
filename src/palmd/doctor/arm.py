"""The arm link's conformance on a real port: each check with what was seen, or with what was sent and expected."""

from __future__ import annotations

import sys
import time
from typing import TypeVar

from palmd.console.errors import BAD_INPUT, RIG_FAILED, CliError
from palmd.daemon import realtime
from palmd.devices.armconformance import CHECKS, REACH_M, REPORT, CheckResult, examine
from palmd.devices.armconformance_talk import Script, Talk, TalkAnswer, TalkRequest
from palmd.devices.armlink import Line, LineReader, Stop, encode_command
from palmd.devices.port import Port, PortWaiter

_T = TypeVar("_T")
_WORDS = {"passed": "pass", "failed": "FAIL", "not run": "----"}
_QUESTION = (
    f"The next checks make the arm track; one that keeps the contract moves less than {REACH_M * 1e3:g} mm. One that\n"
    "does not may leap by one cycle of its greatest speed. Is the arm free, nobody within reach, and a hand on the\n"
    "emergency stop? Then type yes: "
)


class ArmLine:
    """The port with the controller behind it."""

    def __init__(self, path: str, baud: int) -> None:
        """Opens it; CliError when it cannot be opened."""
        self._port = Port("arm", path, baud)
        if not self._port.poll_open(time.monotonic()):
            raise CliError(RIG_FAILED, str(self._port.error))
        self._reader = LineReader(baud)
        self._waiter = PortWaiter([self._port])

    def play(self, script: Script[_T]) -> _T:
        """What the script ends with; CliError when the port is lost on the way."""
        try:
            say = next(script)
            while True:
                say = script.send(self._heard(say))
        except StopIteration as end:
            value: _T = end.value
            return value

    def _heard(self, say: TalkRequest) -> TalkAnswer:
        lines: list[Line] = []
        raw = self._listen(lines, say.t_send, 0)
        t_sent = time.monotonic()
        self._port.write(say.data)
        raw += self._listen(lines, t_sent + say.listen_s, say.enough)
        return TalkAnswer(lines, raw, t_sent, time.monotonic())

    def _listen(self, lines: list[Line], t_end: float, enough: int) -> bytes:
        """Adds the lines that come until t_end (s), or until there are enough; returns all the bytes."""
        raw = b""
        while time.monotonic() < t_end and not 0 < enough <= len(lines):
            self._waiter.wait(t_end)
            data = self._port.read()
            if not self._port.is_open:
                raise CliError(RIG_FAILED, str(self._port.error))
            raw += data
            lines += self._reader.feed(data, time.monotonic())
        return raw

    def stop(self, talk: Talk) -> None:
        """Asks for a planned stop, in case that anything still moves."""
        self._port.write(encode_command(Stop(talk.next_ss())))

    def close(self) -> None:
        """Lets go of the port."""
        self._port.close()


def examine_arm(path: str, baud: int, sure: bool) -> int:
    """Makes every check that is allowed, prints each; returns the exit status, CliError when nobody answers.

    sure: what makes the arm track needs no question.
    """
    line, talk = ArmLine(path, baud), Talk(baud)
    results: list[CheckResult] = []
    realtime.prepare()  # as punctual as this user may be: what is missing only makes a check less sure
    try:
        for check in CHECKS:
            if check.tracks and not sure:
                sure = _confirmed()
                if not sure:
                    break
            results.append(line.play(examine(check, talk)))
            print(told(results[-1]), flush=True)
            if check is REPORT and results[-1].outcome != "passed":
                raise CliError(RIG_FAILED, f"{path}: no use going on: {results[-1].seen}")
    finally:
        line.stop(talk)
        line.close()
    return _summary(path, results)


def told(result: CheckResult) -> str:
    """A result in words: one line, more if it failed."""
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
        print("what makes the arm track was left out: give --yes, or answer yes", file=sys.stderr)
    return RIG_FAILED if counts["failed"] else BAD_INPUT if left else 0


def _confirmed() -> bool:
    if not sys.stdin.isatty():
        return False
    try:
        return input(_QUESTION).strip().lower() == "yes"
    except EOFError:
        return False
