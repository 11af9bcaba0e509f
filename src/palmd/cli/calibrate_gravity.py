"""Finds gravity in the plane and the error of the arm's yaw, with a ball or a cylinder that you let roll down the palms.

Needs a running daemon. It arms the arm if that has not been done, and then stops it in the end; the palms go to one
slope after the other, and stand there while you let it roll.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from palmd.cli.bus import COMMAND, PUBLISH, Client, Subscriber, add_key, credentials
from palmd.cli.calibrated_linkage import arm_base, changed, found, lines, palm_base_in_arm
from palmd.cli.calibration_file import plain, provenance, writable, write
from palmd.cli.configured import configured
from palmd.cli.errors import BAD_INPUT, RIG_FAILED, CliError
from palmd.cli.operation import Operation, why
from palmd.cli.processes import StopRequest
from palmd.cli.progress import Progress
from palmd.config import Config, LimitsConfig, PadConfig, config_hash
from palmd.events import Event, PadSample
from palmd.messages import EVENTS, INFO, events_of
from palmd.study.rolling_fit import (
    INERTIA,
    LEAST_PER_PALM,
    Acceleration,
    GravityFit,
    RollerKind,
    TooFewRollsError,
    accelerate,
    find_rolls,
    fit_gravity,
    causes,
    slope,
)

FORMAT = 1
LOOK_S = 0.25
PATIENCE_S = 60.0
"""How long nothing may roll, or the palms may be on their way."""
SETTLED_S = 0.3
INTRODUCTION_S = 3.0

_SHALLOW_DEG, _STEEPER_DEG = 8.0, 18.0
_OPENING_DEG = 110.0
_MOST_PHI12_DEG = 169.0  # leaves room for a yaw that is wrong
_MARGIN_DEG = 1.0
_LEAST_STEEPER_DEG = 6.0
_UPRIGHT_M_S2 = 9.84
_SCATTER_MOST = 2.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The calibration's arguments."""
    add = parser.add_argument
    add("config", type=Path, metavar="CONFIG", help="the configuration that the daemon runs with, palmd.yaml")
    add("--roller", choices=INERTIA, default="ball", help="what rolls; a cylinder must be full (default: %(default)s)")
    add("--rolls", type=_rolls, default=40, metavar="N",
        help="on each steep slope, a third of it on each shallow one (default: %(default)s)")  # fmt: skip
    add("--clear", type=_clear, default=3.0, metavar="S",
        help="both pads must be free for so long before the palms move (default: %(default)g)")  # fmt: skip
    add("--address", help=f"the daemon's command socket (default: as configured, {COMMAND})")
    add("--listen", metavar="ADDRESS", help=f"where it publishes (default: as configured, {PUBLISH})")
    add("-o", "--output", type=Path, metavar="FOLDER",
        help="for gravity.yaml, which is overwritten (default: calibration/ beside CONFIG)")  # fmt: skip
    add_key(parser)


@dataclass(frozen=True, slots=True)
class Slope:
    """Where the palms stand while it rolls on one of them."""

    pad: Literal[1, 2]
    phi1_deg: float
    phi2_deg: float
    rolls: int

    def __str__(self) -> str:
        falls = self.phi1_deg if self.pad == 1 else 180.0 - self.phi1_deg - self.phi2_deg
        return f"palm {self.pad}, {falls:.0f}°"


def run(arguments: argparse.Namespace) -> int:
    """Writes nothing before all is measured; CliError when the daemon refuses, or the rolls say too little."""
    config = configured(arguments.config)
    folder = writable(arguments.output or arguments.config.parent / "calibration")
    key = credentials(arguments)
    command, publish = arguments.address or config.bus.command, arguments.listen or config.bus.publish
    slopes = list(slopes_within(config.limits, arguments.rolls))
    with (
        StopRequest() as stop,
        Client(command, key=key) as client,
        Subscriber(publish, topics=(EVENTS.name, INFO.name), key=key) as subscriber,
    ):
        client.ask("status")
        session = _Session(config, Operation(client), subscriber, stop, arguments.clear)
        session.begin(slopes[0])
        try:
            for each in slopes:
                session.roll_on(each)
            session.over = True
        finally:
            session.operation.leave(over=session.over)
    try:
        fit = fit_gravity(session.rolls, arguments.roller)
    except TooFewRollsError as error:
        raise CliError(RIG_FAILED, f"gravity: {error}") from None
    print(table(fit, arguments.roller, session.too_short, session.rough))
    for remark in remarks(fit, arguments.roller):
        print(remark, file=sys.stderr)
    result = folder / "gravity.yaml"
    write(result, document(fit, arguments.roller, config))
    print(f"written: {result}")
    print(f"{arguments.config}: write in these sections:\n{lines(called_for(fit, config))}")
    return 0


def slopes_within(limits: LimitsConfig, rolls: int) -> Iterator[Slope]:
    """A gentle and a steep slope of each palm, in the order of phi1; CliError where the limits leave no room for them."""
    (low1, high1), (low2, high2) = limits.phi1_deg, limits.phi2_deg
    low1, high1, low2, high2 = low1 + _MARGIN_DEG, high1 - _MARGIN_DEG, low2 + _MARGIN_DEG, high2 - _MARGIN_DEG
    phi2 = min(max(_OPENING_DEG, low2), high2)
    gentle1 = max(_SHALLOW_DEG, low1)
    steep1 = min(gentle1 + _STEEPER_DEG, high1, _MOST_PHI12_DEG - phi2)
    gentle2 = min(_MOST_PHI12_DEG - phi2, high1)  # palm 1's angle where palm 2 is gentle
    steep2 = max(gentle2 - _STEEPER_DEG, low1)
    if min(steep1 - gentle1, gentle2 - steep2) < _LEAST_STEEPER_DEG or low2 > high2:
        raise CliError(
            BAD_INPUT,
            f"limits: they leave no two slopes {_LEAST_STEEPER_DEG:g}° apart on each palm at phi2 {phi2:g}°: widen them",
        )
    few = max(rolls // 3, LEAST_PER_PALM)
    yield Slope(1, gentle1, phi2, few)
    yield Slope(1, steep1, phi2, rolls)
    yield Slope(2, steep2, phi2, rolls)
    yield Slope(2, gentle2, phi2, few)


class _Session:
    """The rolls on one slope after the other."""

    def __init__(
        self, config: Config, operation: Operation, subscriber: Subscriber, stop: StopRequest, clear_s: float
    ) -> None:
        self.operation = operation
        self.rolls: list[Acceleration] = []
        self.too_short = self.rough = 0
        self.over = False
        self._config, self._subscriber, self._stop, self._clear_s = config, subscriber, stop, clear_s

    def begin(self, first: Slope) -> None:
        """Arm, once the daemon has been heard and has nothing against the first plan; CliError where it has."""
        self._introduce()
        self._load(first)
        self.operation.arm()

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
        """Go there, and take in as many good rolls as are wanted; CliError when that fails."""
        self._go(where)
        _tell(f"{where}: lay the roller at the upper end of palm {where.pad} and let go, {where.rolls} times")
        pad = self._config.pads.palm1 if where.pad == 1 else self._config.pads.palm2
        events: list[Event] = []
        good: list[Acceleration] = []
        t_good = time.monotonic()
        with Progress(str(where), where.rolls, "rolls") as progress:
            while len(good) < where.rolls:
                events += self._events()
                status = self._status()
                if status["state"] != "tracking":
                    raise CliError(RIG_FAILED, f"gravity: {why(status)}")
                rolls, short = find_rolls(events)
                each = [accelerate(roll, reading_sd(pad)) for roll in rolls if roll.pad == where.pad]
                before, good = len(good), [roll for roll in each if roll is not None]
                if len(good) > before:
                    t_good = time.monotonic()
                if time.monotonic() > t_good + PATIENCE_S:
                    raise CliError(RIG_FAILED, _nothing(where, len(good), short, len(each) - len(good)))
                progress.at(len(good))
        self.rolls += good
        self.too_short += short
        self.rough += len(each) - len(good)

    def _load(self, where: Slope) -> None:
        move = {"phi1_deg": where.phi1_deg, "phi2_deg": where.phi2_deg}
        self.operation.load({"name": "gravity", "segments": [{"move": move, "duration_s": 1.0}]})

    def _go(self, where: Slope) -> None:
        """Bring the palms there once nothing touches them; raises CliError when they do not arrive."""
        self._load(where)
        _tell(f"{where}: take the roller off and keep clear, the palms will move")
        t_free = t_begin = time.monotonic()
        while time.monotonic() < t_free + self._clear_s:
            if any(isinstance(event, PadSample) for event in self._events()):
                t_free = time.monotonic()
            status = self._status()
            if status["state"] not in ("tracking", "hold"):
                raise CliError(RIG_FAILED, f"gravity: {why(status)}")
            self._refuse_to_wait(t_begin, "something touches the pads: take it off")
        self.operation.do("start")
        t_begin = time.monotonic()
        while not ((status := self._status())["state"] == "tracking" and status["over"]):
            self._events()
            if status["state"] not in ("tracking", "hold"):
                raise CliError(RIG_FAILED, f"gravity: {why(status)}")
            self._refuse_to_wait(t_begin, f"the palms do not arrive; {why(status)}")
        for _ in self._subscriber.until(time.monotonic() + SETTLED_S):
            pass

    def _refuse_to_wait(self, t_begin: float, text: str) -> None:
        if time.monotonic() > t_begin + PATIENCE_S:
            raise CliError(RIG_FAILED, f"gravity: {text}")

    def _status(self) -> dict[str, Any]:
        if self._stop.made:
            raise CliError(RIG_FAILED, "gravity: given up")
        return self.operation.do("status")

    def _events(self) -> list[Event]:
        messages = self._subscriber.until(time.monotonic() + LOOK_S)
        return [event for each in messages if each.topic == EVENTS.name for event in events_of(each.fields)]


def table(fit: GravityFit, kind: RollerKind, too_short: int, rough: int) -> str:
    """The result in a few lines for a terminal."""
    out = causes(too_short, rough, fit.strange)
    said = ", ".join(f"{count} {cause}" for cause, count in out.items())
    rows = {
        "gravity": found(fit.g, fit.g_sd, "m/s² in the plane", 4),
        "yaw": f"wrong by {found(math.degrees(fit.delta), math.degrees(fit.delta_sd), '°', 3)}",
        "rolling": f"resistance {found(fit.resistance, fit.resistance_sd, '', 5)}",
    }
    head = f"gravity: {len(fit.used)} rolls of a {kind}" + (f"; left out: {said}" if said else "")
    return "\n".join([head, *(f"  {what:8} {text}" for what, text in rows.items()), *map(_row, by_slope(fit, kind))])


@dataclass(frozen=True, slots=True)
class OnSlope:
    """The rolls on one slope: mean acceleration, and by how much the fit misses it, with its one sigma (m/s²)."""

    pad: int
    slope_deg: float
    rolls: int
    mean_m_s2: float
    left_m_s2: float
    left_sd_m_s2: float


def by_slope(fit: GravityFit, kind: RollerKind) -> list[OnSlope]:
    """What the fit leaves of the rolls on each slope, gentle ones first."""
    groups: dict[tuple[int, float], list[Acceleration]] = {}
    for roll in fit.used:
        groups.setdefault((roll.pad, round(math.degrees(slope(roll.pad, roll.phi)), 1)), []).append(roll)
    rows = []
    for (pad, slope_deg), rolls in sorted(groups.items()):
        weights = [roll.a_sd**-2 for roll in rolls]
        mean = sum(w * roll.a for w, roll in zip(weights, rolls, strict=True)) / sum(weights)
        expected = fit.acceleration(rolls[0].phi, kind)
        rows.append(OnSlope(pad, slope_deg, len(rolls), mean, mean - expected, sum(weights) ** -0.5))
    return rows


def _row(row: OnSlope) -> str:
    left = found(row.left_m_s2, row.left_sd_m_s2, "m/s² left", 4)
    return f"  palm {row.pad} {row.slope_deg:6.1f}°  {row.rolls:3} rolls  {row.mean_m_s2:8.4f} m/s², {left}"


def remarks(fit: GravityFit, kind: RollerKind) -> list[str]:
    """What a person should look into."""
    said = []
    if fit.g - 3.0 * fit.g_sd > _UPRIGHT_M_S2:
        said.append(
            f"gravity: {fit.g:.3f} m/s² is more than there is: check the pads' counts_per_mm, and that it is a {kind}"
        )
    if fit.resistance < -3.0 * fit.resistance_sd:
        said.append("gravity: a resistance below zero: it was pushed, it slipped, or a pad's scale is bent")
    if fit.scatter > _SCATTER_MOST:
        said.append(f"gravity: the rolls scatter {fit.scatter:.1f} times as much as their readings: is it round and clean?")
    return said


def called_for(fit: GravityFit, config: Config) -> dict[str, dict[str, float]]:
    """What the configuration should say, by section: the yaw is turned about the palms' base, which stays."""
    yaw_deg = round(config.arm.base_yaw_deg + math.degrees(fit.delta), 4)
    return {
        "rig": {"gravity_m_s2": round(fit.g, 4)},
        "arm": {**arm_base(config, palm_base_in_arm(config), yaw_deg), "base_yaw_deg": yaw_deg},
    }


def document(fit: GravityFit, kind: RollerKind, config: Config) -> dict[str, Any]:
    """The stored result; `configuration` holds what it calls for, the hash is of sections rig and arm with it."""
    values = called_for(fit, config)
    numbers = {
        "gravity_m_s2": fit.g,
        "gravity_sd_m_s2": fit.g_sd,
        "yaw_error_deg": math.degrees(fit.delta),
        "yaw_error_sd_deg": math.degrees(fit.delta_sd),
        "rolling_resistance": fit.resistance,
        "rolling_resistance_sd": fit.resistance_sd,
        "scatter": fit.scatter,
    }
    return {
        "palmd_gravity_calibration": FORMAT,
        **provenance(changed(config, values["rig"], values["arm"])),
        "roller": kind,
        "configuration": values,
        "found": plain(numbers) | {"slopes": [plain(asdict(row)) for row in by_slope(fit, kind)]},
    }


def reading_sd(pad: PadConfig) -> float:
    """One sigma of a position (m), rounding included."""
    return math.hypot(pad.noise_mm, 1.0 / (pad.counts_per_mm * math.sqrt(12.0))) * 1e-3


def _nothing(where: Slope, good: int, too_short: int, rough: int) -> str:
    out = causes(too_short, rough, 0)
    said = ", ".join(f"{count} were {cause}" for cause, count in out.items()) or "nothing touches its pad"
    return (
        f"gravity: {where}: nothing rolls: {good} good rolls of {where.rolls} wanted, and no more within"
        f" {PATIENCE_S:.0f} s; {said}"
    )


def _tell(text: str) -> None:
    print(f"gravity: {text}", file=sys.stderr, flush=True)


def _rolls(text: str) -> int:
    value = int(text)
    if not LEAST_PER_PALM <= value <= 1000:
        raise argparse.ArgumentTypeError(f"must be {LEAST_PER_PALM} to 1000, got {text}")
    return value


def _clear(text: str) -> float:
    value = float(text)
    if not 0.2 <= value <= 30.0:
        raise argparse.ArgumentTypeError(f"must be 0.2 to 30 s, got {text}")
    return value
