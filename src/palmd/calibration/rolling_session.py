"""The session of the gravity calibration: the daemon moves to one slope after the other, where a person rolls."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from palmd.bus.command_client import CommandClient
from palmd.bus.subscriber import Subscriber
from palmd.calibration.rolling_fit import MIN_ROLLS_PER_PALM, Acceleration, accelerate, causes, find_rolls
from palmd.config.any_config import config_hash
from palmd.config.pads import PadConfig
from palmd.config.two_palms import Config, LimitsConfig
from palmd.console.errors import BAD_INPUT, RIG_FAILED, CliError
from palmd.console.progress import Progress
from palmd.events import Event, PadSample
from palmd.harness.operator import can_move, do, leave, load, why
from palmd.harness.processes import StopRequest
from palmd.messages import events_of
from palmd.quantities import EVENTS, INFO
from palmd.system.mechanism import JOINTS, OPENING, PALMS

LOOK_S = 0.25
PATIENCE_S = 60.0
"""Longest time without a roll, or for the palms to arrive."""
SETTLED_S = 0.3
INTRODUCTION_S = 3.0
TOUR_S = 600.0

_SHALLOW_DEG, _STEEPER_DEG = 8.0, 18.0
_OPENING_DEG = 110.0
_MAX_PHI12_DEG = 169.0  # leaves room for an error of the yaw
_MARGIN_DEG = 1.0
_MIN_STEEPER_DEG = 6.0


@dataclass(frozen=True, slots=True)
class Slope:
    """The palms' pose while the roller rolls on one of them."""

    pad: int
    angles_deg: tuple[float, float]
    rolls: int

    def __str__(self) -> str:
        slope = self.angles_deg[0] if self.pad == PALMS[0] else 180.0 - sum(self.angles_deg)
        return f"palm {self.pad}, {slope:.0f}°"


def slopes_within(limits: LimitsConfig, rolls: int) -> Iterator[Slope]:
    """A gentle and a steep slope of each palm, by the first one's angle; CliError if the limits leave no room."""
    (low1, high1), (low2, high2) = limits.angles_deg
    low1, high1, low2, high2 = low1 + _MARGIN_DEG, high1 - _MARGIN_DEG, low2 + _MARGIN_DEG, high2 - _MARGIN_DEG
    opening = min(max(_OPENING_DEG, low2), high2)
    gentle1 = max(_SHALLOW_DEG, low1)
    steep1 = min(gentle1 + _STEEPER_DEG, high1, _MAX_PHI12_DEG - opening)
    gentle2 = min(_MAX_PHI12_DEG - opening, high1)  # palm 1's angle where palm 2 is gentle
    steep2 = max(gentle2 - _STEEPER_DEG, low1)
    if min(steep1 - gentle1, gentle2 - steep2) < _MIN_STEEPER_DEG or low2 > high2:
        raise CliError(
            BAD_INPUT,
            f"limits: they allow no two slopes {_MIN_STEEPER_DEG:g}° apart on each palm,"
            f" at {JOINTS[OPENING]} {opening:g}°: widen them",
        )
    few = max(rolls // 3, MIN_ROLLS_PER_PALM)
    first, second = PALMS
    yield Slope(first, (gentle1, opening), few)
    yield Slope(first, (steep1, opening), rolls)
    yield Slope(second, (steep2, opening), rolls)
    yield Slope(second, (gentle2, opening), few)


class RollingSession:
    """The rolls on one slope after the other; each method raises CliError if it cannot be completed."""

    def __init__(
        self, config: Config, client: CommandClient, subscriber: Subscriber, stop: StopRequest, clear_s: float
    ) -> None:
        self.rolls: list[Acceleration] = []
        self.too_short = self.not_smooth = 0
        self.is_complete = False
        self._armed = False
        self._config, self._client, self._subscriber = config, client, subscriber
        self._stop, self._clear_s = stop, clear_s

    def begin(self, slopes: Sequence[Slope]) -> None:
        """Check the daemon and the whole tour, and arm; CliError if the daemon refuses."""
        self._check_configuration()
        can_move(self._client)
        self._load(*slopes)
        if self._status()["state"] == "ready":
            do(self._client, "arm")
            self._armed = True

    def end(self) -> None:
        """Leave the palms standing, and the arm as it was found; after Ctrl-C or a failure the arm is stopped."""
        leave(self._client, armed=self._armed, over=self.is_complete)

    def _check_configuration(self) -> None:
        """CliError unless the daemon runs with the same configuration, which its angles are based on."""
        t_end = time.monotonic() + INTRODUCTION_S
        for message in self._subscriber.until(t_end):
            if message.topic == INFO.name:
                if message.fields["config_hash"] != config_hash(self._config):
                    raise CliError(
                        BAD_INPUT, "gravity: the daemon runs with another configuration: restart it with this one"
                    )
                return
        raise CliError(RIG_FAILED, "gravity: no information from the daemon: is --listen where it publishes?")

    def collect(self, where: Slope) -> None:
        """Move there and collect the required good rolls; resumes after a fault has been cleared."""
        good: list[Acceleration] = []
        with Progress(str(where), where.rolls, "rolls") as progress:
            while len(good) < where.rolls:
                self._wait_until_commanded()
                if self._move_to(where):
                    good += self._collect_rolls(where, len(good), progress)
        self.rolls += good

    def _collect_rolls(self, where: Slope, before_count: int, progress: Progress) -> list[Acceleration]:
        """The new good rolls, until there are enough or the arm is no longer controlled."""
        _print(
            f"{where}: place the roller at the upper end of palm {where.pad} and let go,"
            f" {where.rolls - before_count} times"
        )
        pad = self._config.pads.of(where.pad)
        events: list[Event] = []
        good: list[Acceleration] = []
        too_short = not_smooth = 0
        t_good = time.monotonic()
        while before_count + len(good) < where.rolls and self._status()["state"] == "tracking":
            events += self._events()
            rolls, too_short = find_rolls(events)
            each = [accelerate(roll, reading_sd(pad)) for roll in rolls if roll.pad == where.pad]
            before, good = len(good), [roll for roll in each if roll is not None]
            not_smooth = len(each) - len(good)
            if len(good) > before:
                t_good = time.monotonic()
            self._check_patience(t_good, _no_rolls_text(where, before_count + len(good), too_short, not_smooth))
            progress.at(before_count + len(good))
        self.too_short += too_short
        self.not_smooth += not_smooth
        return good

    def _load(self, first: Slope, *others: Slope) -> None:
        """Load a plan to one or several slopes, so slow that it can be refused for its poses only."""
        segments = [
            {
                "move": {f"{joint}_deg": angle for joint, angle in zip(JOINTS, each.angles_deg, strict=True)},
                "duration_s": duration_s,
            }
            for each, duration_s in ((first, 1.0), *((each, TOUR_S) for each in others))
        ]
        load(self._client, {"name": "gravity", "segments": segments})

    def _wait_until_commanded(self) -> None:
        """Wait until the arm is controlled; after a fault an operator must clear it."""
        is_announced = False
        t_begin = time.monotonic()
        while not _is_controlled(status := self._status()):
            if not is_announced:
                _print(f"{why(status)}; after clearing it: palmd ctl reset, palmd ctl arm")
                is_announced = True
            self._check_patience(t_begin, why(status))
            self._events()

    def _move_to(self, where: Slope) -> bool:
        """Move the palms there once nothing touches them; returns whether they have arrived without being stopped."""
        self._load(where)
        _print(f"{where}: take the roller off and keep clear, the palms will move")
        t_free = t_begin = time.monotonic()
        while time.monotonic() < t_free + self._clear_s:
            if any(isinstance(event, PadSample) for event in self._events()):
                t_free = time.monotonic()
            self._check_patience(t_begin, "something touches the pads: take it off")
        if not _is_controlled(self._status()):
            return False
        do(self._client, "start")
        t_begin = time.monotonic()
        while _is_controlled(status := self._status()):
            if status["state"] == "tracking" and status["over"]:
                for _ in self._subscriber.until(time.monotonic() + SETTLED_S):
                    pass
                return True
            self._events()
            self._check_patience(t_begin, f"the palms do not arrive; {why(status)}")
        return False

    def _check_patience(self, t_begin: float, text: str) -> None:
        if time.monotonic() > t_begin + PATIENCE_S:
            raise CliError(RIG_FAILED, f"gravity: {text}")

    def _status(self) -> dict[str, Any]:
        if self._stop.made:
            raise CliError(RIG_FAILED, "gravity: aborted")
        return do(self._client, "status")

    def _events(self) -> list[Event]:
        messages = self._subscriber.until(time.monotonic() + LOOK_S)
        return [event for each in messages if each.topic == EVENTS.name for event in events_of(each.fields)]


def reading_sd(pad: PadConfig) -> float:
    """1σ of a position (m), rounding included."""
    return math.hypot(pad.noise_mm, 1.0 / (pad.counts_per_mm * math.sqrt(12.0))) * 1e-3


def _is_controlled(status: Mapping[str, Any]) -> bool:
    return status["state"] in ("tracking", "hold")


def _no_rolls_text(where: Slope, good: int, too_short: int, not_smooth: int) -> str:
    counts = causes(too_short, not_smooth, 0)
    reasons = ", ".join(f"{count} were {cause}" for cause, count in counts.items()) or "nothing touches its pad"
    return f"{where}: {good} good rolls of {where.rolls} needed, and no more within {PATIENCE_S:.0f} s; {reasons}"


def _print(text: str) -> None:
    print(f"gravity: {text}", file=sys.stderr, flush=True)
