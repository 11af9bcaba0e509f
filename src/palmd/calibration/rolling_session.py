"""What a daemon and a person do together for gravity: to one slope after the other, and there the roller rolls."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from palmd.bus.command_client import CommandClient
from palmd.bus.subscriber import Subscriber
from palmd.calibration.rolling_fit import LEAST_PER_PALM, Acceleration, accelerate, causes, find_rolls
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
"""How long nothing may roll, or the palms may be on their way."""
SETTLED_S = 0.3
INTRODUCTION_S = 3.0
TOUR_S = 600.0

_SHALLOW_DEG, _STEEPER_DEG = 8.0, 18.0
_OPENING_DEG = 110.0
_MOST_PHI12_DEG = 169.0  # leaves room for a yaw that is wrong
_MARGIN_DEG = 1.0
_LEAST_STEEPER_DEG = 6.0


@dataclass(frozen=True, slots=True)
class Slope:
    """Where the palms stand while it rolls on one of them."""

    pad: int
    angles_deg: tuple[float, float]
    rolls: int

    def __str__(self) -> str:
        falls = self.angles_deg[0] if self.pad == PALMS[0] else 180.0 - sum(self.angles_deg)
        return f"palm {self.pad}, {falls:.0f}°"


def slopes_within(limits: LimitsConfig, rolls: int) -> Iterator[Slope]:
    """A gentle and a steep slope of each palm, by the first one's angle; CliError where the limits leave no room."""
    (low1, high1), (low2, high2) = limits.angles_deg
    low1, high1, low2, high2 = low1 + _MARGIN_DEG, high1 - _MARGIN_DEG, low2 + _MARGIN_DEG, high2 - _MARGIN_DEG
    opening = min(max(_OPENING_DEG, low2), high2)
    gentle1 = max(_SHALLOW_DEG, low1)
    steep1 = min(gentle1 + _STEEPER_DEG, high1, _MOST_PHI12_DEG - opening)
    gentle2 = min(_MOST_PHI12_DEG - opening, high1)  # palm 1's angle where palm 2 is gentle
    steep2 = max(gentle2 - _STEEPER_DEG, low1)
    if min(steep1 - gentle1, gentle2 - steep2) < _LEAST_STEEPER_DEG or low2 > high2:
        raise CliError(
            BAD_INPUT,
            f"limits: they leave no two slopes {_LEAST_STEEPER_DEG:g}° apart on each palm,"
            f" at {JOINTS[OPENING]} {opening:g}°: widen",
        )
    few = max(rolls // 3, LEAST_PER_PALM)
    first, second = PALMS
    yield Slope(first, (gentle1, opening), few)
    yield Slope(first, (steep1, opening), rolls)
    yield Slope(second, (steep2, opening), rolls)
    yield Slope(second, (gentle2, opening), few)


class RollingSession:
    """The rolls on one slope after the other; each method raises CliError when it cannot be done."""

    def __init__(
        self, config: Config, client: CommandClient, subscriber: Subscriber, stop: StopRequest, clear_s: float
    ) -> None:
        self.rolls: list[Acceleration] = []
        self.too_short = self.rough = 0
        self.over = False
        self._armed = False
        self._config, self._client, self._subscriber = config, client, subscriber
        self._stop, self._clear_s = stop, clear_s

    def begin(self, slopes: Sequence[Slope]) -> None:
        """Arm, once the daemon has been heard and has nothing against the whole tour; CliError where it has."""
        self._introduce()
        can_move(self._client)
        self._load(*slopes)
        if self._status()["state"] == "ready":
            do(self._client, "arm")
            self._armed = True

    def end(self) -> None:
        """Leave the palms standing, and the arm as it was found; after Ctrl-C or a failure it is stopped."""
        leave(self._client, armed=self._armed, over=self.over)

    def _introduce(self) -> None:
        """CliError unless the daemon runs with our configuration: the angles that it tells rest on its own."""
        t_end = time.monotonic() + INTRODUCTION_S
        for message in self._subscriber.until(t_end):
            if message.topic == INFO.name:
                if message.fields["config_hash"] != config_hash(self._config):
                    raise CliError(
                        BAD_INPUT, "gravity: the daemon runs with another configuration: restart it with this one"
                    )
                return
        raise CliError(RIG_FAILED, "gravity: the daemon says nothing of itself: is --listen where it publishes?")

    def roll_on(self, where: Slope) -> None:
        """Go there and take in as many good rolls as are wanted; after a fault that is mended it goes on from there."""
        good: list[Acceleration] = []
        with Progress(str(where), where.rolls, "rolls") as progress:
            while len(good) < where.rolls:
                self._wait_until_commanded()
                if self._go(where):
                    good += self._stand(where, len(good), progress)
        self.rolls += good

    def _stand(self, where: Slope, had: int, progress: Progress) -> list[Acceleration]:
        """The good rolls besides those that we had, until they are enough or the arm is commanded no longer."""
        _tell(f"{where}: lay the roller at the upper end of palm {where.pad} and let go, {where.rolls - had} times")
        pad = self._config.pads.of(where.pad)
        events: list[Event] = []
        good: list[Acceleration] = []
        too_short = rough = 0
        t_good = time.monotonic()
        while had + len(good) < where.rolls and self._status()["state"] == "tracking":
            events += self._events()
            rolls, too_short = find_rolls(events)
            each = [accelerate(roll, reading_sd(pad)) for roll in rolls if roll.pad == where.pad]
            before, good = len(good), [roll for roll in each if roll is not None]
            rough = len(each) - len(good)
            if len(good) > before:
                t_good = time.monotonic()
            self._refuse_to_wait(t_good, _nothing(where, had + len(good), too_short, rough))
            progress.at(had + len(good))
        self.too_short += too_short
        self.rough += rough
        return good

    def _load(self, first: Slope, *others: Slope) -> None:
        """A way to a slope, or to several one after the other, so slow that only its poses can be refused."""
        segments = [
            {
                "move": {f"{joint}_deg": angle for joint, angle in zip(JOINTS, each.angles_deg, strict=True)},
                "duration_s": duration_s,
            }
            for each, duration_s in ((first, 1.0), *((each, TOUR_S) for each in others))
        ]
        load(self._client, {"name": "gravity", "segments": segments})

    def _wait_until_commanded(self) -> None:
        """Nothing to wait for unless a fault has stopped the arm, which a person can mend."""
        told = False
        t_begin = time.monotonic()
        while not _commanded(status := self._status()):
            if not told:
                _tell(f"{why(status)}; when that is mended: palmd ctl reset, palmd ctl arm")
                told = True
            self._refuse_to_wait(t_begin, why(status))
            self._events()

    def _go(self, where: Slope) -> bool:
        """Bring the palms there once nothing touches them; whether they have arrived, and not been stopped."""
        self._load(where)
        _tell(f"{where}: take the roller off and keep clear, the palms will move")
        t_free = t_begin = time.monotonic()
        while time.monotonic() < t_free + self._clear_s:
            if any(isinstance(event, PadSample) for event in self._events()):
                t_free = time.monotonic()
            self._refuse_to_wait(t_begin, "something touches the pads: take it off")
        if not _commanded(self._status()):
            return False
        do(self._client, "start")
        t_begin = time.monotonic()
        while _commanded(status := self._status()):
            if status["state"] == "tracking" and status["over"]:
                for _ in self._subscriber.until(time.monotonic() + SETTLED_S):
                    pass
                return True
            self._events()
            self._refuse_to_wait(t_begin, f"the palms do not arrive; {why(status)}")
        return False

    def _refuse_to_wait(self, t_begin: float, text: str) -> None:
        if time.monotonic() > t_begin + PATIENCE_S:
            raise CliError(RIG_FAILED, f"gravity: {text}")

    def _status(self) -> dict[str, Any]:
        if self._stop.made:
            raise CliError(RIG_FAILED, "gravity: given up")
        return do(self._client, "status")

    def _events(self) -> list[Event]:
        messages = self._subscriber.until(time.monotonic() + LOOK_S)
        return [event for each in messages if each.topic == EVENTS.name for event in events_of(each.fields)]


def reading_sd(pad: PadConfig) -> float:
    """One sigma of a position (m), rounding included."""
    return math.hypot(pad.noise_mm, 1.0 / (pad.counts_per_mm * math.sqrt(12.0))) * 1e-3


def _commanded(status: Mapping[str, Any]) -> bool:
    return status["state"] in ("tracking", "hold")


def _nothing(where: Slope, good: int, too_short: int, rough: int) -> str:
    out = causes(too_short, rough, 0)
    said = ", ".join(f"{count} were {cause}" for cause, count in out.items()) or "nothing touches its pad"
    return (
        f"{where}: nothing rolls: {good} good rolls of {where.rolls} wanted, and no more within"
        f" {PATIENCE_S:.0f} s; {said}"
    )


def _tell(text: str) -> None:
    print(f"gravity: {text}", file=sys.stderr, flush=True)
