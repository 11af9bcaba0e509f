"""Turns the palms while an arrow key is held: left and right palm 1, up and down palm 2.

The terminal's key repeat is the dead-man's switch: when it stops, the palms stop. Needs a running daemon.
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
from palmd.bus.jogging import JOG_EVERY_S, JOG_STEP_DEG
from palmd.bus.link import COMMAND, PUBLISH
from palmd.bus.subscriber import Subscriber
from palmd.config.two_palms import LimitsConfig
from palmd.console.configured import configured, default_path
from palmd.console.errors import BAD_INPUT, RIG_FAILED, CliError
from palmd.console.keys import pressed, unbuffered
from palmd.system.mechanism import JOINTS, PALMS

HELD_S = 0.12
"""Time (s) after its last repeat for which a key counts as held; terminals repeat about 30 times a second."""

SILENCE_S = 2.0

STEPS = {b"\x1b[C": (1, 0), b"\x1b[D": (-1, 0), b"\x1b[A": (0, 1), b"\x1b[B": (0, -1),
         b"\x1bOC": (1, 0), b"\x1bOD": (-1, 0), b"\x1bOA": (0, 1), b"\x1bOB": (0, -1)}  # fmt: skip
"""Escape sequences of the arrow keys, and the directions in which they turn the joints."""

REQUESTS = {b"a": "arm", b"s": "stop"}
ARROWS = dict(zip(PALMS, ("← →", "↑ ↓"), strict=True))
HELP = (
    f"arrows: {', '.join(f'{keys} palm {palm}' for palm, keys in ARROWS.items())}, only while held"
    "    a: arm   s: stop   q: end"
)


@dataclass(slots=True)
class DeadMansSwitch:
    """Dead-man's switch: which arrow key is held, by the time of its last repeat. Pure."""

    arrow: tuple[int, int] = (0, 0)
    t_last: float = -math.inf

    def pressed(self, data: bytes, t: float) -> list[str]:
        """Process the bytes received by `t` (s); return other requests: `arm`, `stop` or `end`."""
        requests = []
        while data:
            key = next((key for key in STEPS if data.startswith(key)), data[:1])
            data = data[len(key) :]
            if key in STEPS:
                self.arrow, self.t_last = STEPS[key], t
                continue
            self.t_last = -math.inf  # any other key releases the arrow
            if key in b"qQ\x03\x04":
                requests.append("end")
            elif key.lower() in REQUESTS:
                requests.append(REQUESTS[key.lower()])
        return requests

    def step(self, t: float) -> dict[str, float] | None:
        """Return the step to send at `t` (s), None if no arrow is held."""
        if t - self.t_last > HELD_S:
            return None
        return {f"phi{i}_deg": JOG_STEP_DEG * direction for i, direction in enumerate(self.arrow, 1)}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("config", nargs="?", type=Path, metavar="CONFIG",
                        help="the daemon's configuration, for its limits and addresses")  # fmt: skip
    parser.add_argument("--address", help=f"the daemon's command socket (default: as configured, {COMMAND})")
    parser.add_argument("--publish", help=f"the daemon's publisher (default: as configured, {PUBLISH})")


def run(arguments: argparse.Namespace) -> int:
    """Run until q; CliError without a terminal or a daemon. An arm armed here is stopped at the end."""
    config = configured(default_path(arguments.config))
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise CliError(
            BAD_INPUT, f"jog needs a terminal for its keys; without one use palmd ctl jog --{JOINTS[0]}-deg 1"
        )
    command, publish = arguments.address or config.bus.command, arguments.publish or config.bus.publish
    with CommandClient(command) as client, Subscriber(publish, topics=("palm/motion", "palm/state")) as subscriber:
        client.ask("status")
        print(HELP)
        with unbuffered(sys.stdin.fileno()) as keys:
            _Jogging(client, subscriber, config.limits).until_end(keys)
    return 0


class _Jogging:
    """One session at the keyboard."""

    def __init__(self, client: CommandClient, subscriber: Subscriber, limits: LimitsConfig) -> None:
        self._client, self._subscriber, self._limits = client, subscriber, limits
        self._switch = DeadMansSwitch()
        self._latest: dict[str, dict[str, Any]] = {}
        self._t_heard = time.monotonic()
        self._armed = False
        self._error = ""

    def until_end(self, keys: int) -> None:
        """Run until q is pressed; an arm armed here is stopped in any case."""
        try:
            while not self._turn(keys):
                pass
        finally:
            print()
            if self._armed:
                print(f"stop: {self._send('stop')}")

    def _turn(self, keys: int) -> bool:
        t_next = time.monotonic() + JOG_EVERY_S
        requests = self._switch.pressed(pressed(keys), time.monotonic())
        for each in requests:
            if each == "end":
                return True
            self._error = self._send(each)
            self._armed = each == "arm" and not self._error
        step = self._switch.step(time.monotonic())
        if step is not None:
            self._error = self._send("jog", step)
        for message in self._subscriber.until(t_next):
            self._latest[message.topic], self._t_heard = message.fields, time.monotonic()
        if time.monotonic() - self._t_heard > SILENCE_S:
            raise CliError(RIG_FAILED, f"nothing from the daemon for {SILENCE_S:g} s: check palmd ctl status")
        motion, state = (self._latest.get(topic, {}) for topic in ("palm/motion", "palm/state"))
        columns = shutil.get_terminal_size().columns
        text = line(motion, state, self._limits, self._error, columns)
        sys.stdout.write(f"\r{text}\x1b[K")
        sys.stdout.flush()
        return False

    def _send(self, command: str, args: dict[str, float] | None = None) -> str:
        """Send a command; return the error text, empty if it was accepted."""
        reply = self._client.ask(command, args)
        return "" if reply["ok"] else str(reply.get("error"))


def line(motion: dict[str, Any], state: dict[str, Any], limits: LimitsConfig, error: str, columns: int) -> str:
    """Angles, state and faults in one terminal row; with limits, unless the last command was refused."""
    parts = []
    for joint, bounds in zip(JOINTS, limits.angles_deg, strict=True):
        angle = motion.get(f"{joint}_rad", math.nan)
        shown = f"{math.degrees(angle):.1f}" if math.isfinite(angle) else "–"
        parts.append(f"{joint} {shown:>5}°" + ("" if error else f" ({bounds[0]:g} to {bounds[1]:g})"))
    words = [str(state.get("state", "")), *([error] if error else []), *state.get("faults", ())]
    text = "  ".join([*parts, *words])
    return text if len(text) < columns else text[: max(columns - 2, 0)] + "…"
