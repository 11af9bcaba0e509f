"""Turns the palms for as long as an arrow key is held: left and right palm 1, up and down palm 2.

The terminal's key repeat is the dead-man's handle: when it stops, the palms do. Needs a running daemon.
"""

from __future__ import annotations

import argparse
import math
import shutil
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from palmd.bus.command_client import CommandClient
from palmd.bus.link import COMMAND, PUBLISH
from palmd.bus.subscriber import Subscriber
from palmd.config.two_palms import LimitsConfig
from palmd.console.configured import configured, usual
from palmd.console.errors import BAD_INPUT, RIG_FAILED, CliError
from palmd.console.keys import pressed, unbuffered
from palmd.system.mechanism import JOINTS, PALMS

EVERY_S = 0.05
STEP_DEG = 0.4
"""8 degrees a second: the palms keep up."""

HELD_S = 0.12
"""A key counts as held for so long after its last repeat; terminals repeat some 30 times a second."""

SILENCE_S = 2.0

STEPS = {b"\x1b[C": (1, 0), b"\x1b[D": (-1, 0), b"\x1b[A": (0, 1), b"\x1b[B": (0, -1),
         b"\x1bOC": (1, 0), b"\x1bOD": (-1, 0), b"\x1bOA": (0, 1), b"\x1bOB": (0, -1)}  # fmt: skip
"""What terminals send for the arrows, and how they turn the joints."""

ASKS = {b"a": "arm", b"s": "stop"}
ARROWS = dict(zip(PALMS, ("← →", "↑ ↓"), strict=True))
HELP = (
    f"arrows: {', '.join(f'{keys} palm {palm}' for palm, keys in ARROWS.items())}, only while held"
    "    a: arm   s: stop   q: end"
)


@dataclass(slots=True)
class Handle:
    """The dead-man's handle: which arrow is held, by the time of its last repeat. Pure."""

    arrow: tuple[int, int] = (0, 0)
    t_last: float = -math.inf

    def pressed(self, data: bytes, t: float) -> list[str]:
        """Take what the terminal sent by `t` (s); returns what else was asked for: `arm`, `stop` or `end`."""
        asked = []
        while data:
            key = next((key for key in STEPS if data.startswith(key)), data[:1])
            data = data[len(key) :]
            if key in STEPS:
                self.arrow, self.t_last = STEPS[key], t
                continue
            self.t_last = -math.inf  # any other key lets go
            if key in b"qQ\x03\x04":
                asked.append("end")
            elif key.lower() in ASKS:
                asked.append(ASKS[key.lower()])
        return asked

    def step(self, t: float) -> dict[str, float] | None:
        """The step to send at `t` (s), None when nothing is held."""
        if t - self.t_last > HELD_S:
            return None
        return {f"phi{i}_deg": STEP_DEG * way for i, way in enumerate(self.arrow, 1)}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument("config", nargs="?", type=Path, metavar="CONFIG",
                        help="the daemon's configuration, for its limits and addresses")  # fmt: skip
    parser.add_argument("--address", help=f"the daemon's command socket (default: as configured, {COMMAND})")
    parser.add_argument("--publish", help=f"where the daemon publishes (default: as configured, {PUBLISH})")


def run(arguments: argparse.Namespace) -> int:
    """Runs until q; CliError without a terminal or a daemon. Stops what it has armed."""
    config = configured(usual(arguments.config))
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise CliError(BAD_INPUT, f"jog needs a terminal, for its keys; elsewhere: palmd ctl jog --{JOINTS[0]}-deg 1")
    command, publish = arguments.address or config.bus.command, arguments.publish or config.bus.publish
    with CommandClient(command) as client, Subscriber(publish, topics=("palm/motion", "palm/state")) as subscriber:
        client.ask("status")
        print(HELP)
        with unbuffered(sys.stdin.fileno()) as keys:
            _Jogging(client, subscriber, config.limits).until_end(keys)
    return 0


class _Jogging:
    """One sitting at the keys."""

    def __init__(self, client: CommandClient, subscriber: Subscriber, limits: LimitsConfig) -> None:
        self._client, self._subscriber, self._limits = client, subscriber, limits
        self._handle = Handle()
        self._latest: dict[str, dict[str, Any]] = {}
        self._t_heard = time.monotonic()
        self._armed = False
        self._said = ""

    def until_end(self, keys: int) -> None:
        """Until q is pressed; what was armed here is stopped in any case."""
        try:
            while not self._turn(keys):
                pass
        finally:
            print()
            if self._armed:
                print(f"stop: {self._asked('stop')}")

    def _turn(self, keys: int) -> bool:
        t_next = time.monotonic() + EVERY_S
        asked = self._handle.pressed(pressed(keys), time.monotonic())
        for each in asked:
            if each == "end":
                return True
            self._said = self._asked(each)
            self._armed = each == "arm" and not self._said
        step = self._handle.step(time.monotonic())
        if step is not None:
            self._said = self._asked("jog", step)
        for message in self._subscriber.until(t_next):
            self._latest[message.topic], self._t_heard = message.fields, time.monotonic()
        if time.monotonic() - self._t_heard > SILENCE_S:
            raise CliError(RIG_FAILED, f"nothing from the daemon for {SILENCE_S:g} s: see palmd ctl status")
        motion, state = (self._latest.get(topic, {}) for topic in ("palm/motion", "palm/state"))
        columns = shutil.get_terminal_size().columns
        text = line(motion, state, self._limits, self._said, columns)
        sys.stdout.write(f"\r{text}\x1b[K")
        sys.stdout.flush()
        return False

    def _asked(self, command: str, args: dict[str, float] | None = None) -> str:
        """What speaks against it, empty if it was granted."""
        reply = self._client.ask(command, args)
        return "" if reply["ok"] else str(reply.get("error"))


def line(motion: dict[str, Any], state: dict[str, Any], limits: LimitsConfig, said: str, columns: int) -> str:
    """Angles, state and faults in one row of the terminal; the limits too, unless the last wish was refused."""
    parts = []
    for joint, bounds in zip(JOINTS, limits.angles_deg, strict=True):
        angle = motion.get(f"{joint}_rad", math.nan)
        shown = f"{math.degrees(angle):.1f}" if math.isfinite(angle) else "–"
        parts.append(f"{joint} {shown:>5}°" + ("" if said else f" ({bounds[0]:g} to {bounds[1]:g})"))
    words = [str(state.get("state", "")), *([said] if said else []), *state.get("faults", ())]
    text = "  ".join([*parts, *words])
    return text if len(text) < columns else text[: max(columns - 2, 0)] + "…"
