"""Serves the live page of a running daemon, or of a replayed run, to browsers on this machine.

The first line of standard output is its address. With the token in it, a browser may give commands like any other
client of the daemon's command socket; without it the page only watches. Ends with Ctrl-C.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import os
import secrets
import signal
from pathlib import Path

from palmd.bus.addresses import INSTALLED, add_config, command_address, publish_address
from palmd.bus.link import COMMAND, PUBLISH, add_key, credentials
from palmd.console.arguments import whole_between
from palmd.console.notes import open_page
from palmd.daemon.lifecycle import TRANSITIONS, State, Trigger
from palmd.view.server import Settings, serve_page

PORT = 8787
TRIGGERS = {
    "arm": Trigger.ARMED,
    "start": Trigger.START,
    "hold": Trigger.HOLD,
    "stop": Trigger.STOP,
    "reset": Trigger.CLEARED,
}
"""The page's buttons and their triggers."""

FORMS = {
    "jog": (State.TRACKING, State.HOLD),
    "plan": (State.READY, State.TRACKING, State.HOLD),
    "alive": tuple(State),
    "new_object": (State.READY, State.TRACKING, State.HOLD),
    "note": tuple(State),
}
"""The page's other commands, which change no state, and the states in which they apply."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("--address", help=f"the daemon's publisher (default: as configured, {PUBLISH})")
    parser.add_argument("--command", help=f"the daemon's command socket (default: as configured, {COMMAND})")
    add_config(parser)
    add_key(parser)
    parser.add_argument(
        "--truth", default="", metavar="ADDRESS", help="address at which an emulated rig publishes its truth"
    )
    parser.add_argument(
        "--runs", type=Path, metavar="FOLDER", help="folder of the recordings (default: the configuration's)"
    )
    parser.add_argument("--port", type=whole_between(0, 65535), default=PORT,
                        help="port of the page; 0: any free port (default: %(default)s)")  # fmt: skip
    parser.add_argument("--no-browser", action="store_true", help="do not open a browser")


def run(arguments: argparse.Namespace) -> int:
    """Serve until the end is requested; CliError for an invalid address or an unavailable port."""
    settings = Settings(
        publish=publish_address(arguments.address, arguments.config),
        command=command_address(arguments.command, arguments.config),
        truth=arguments.truth,
        port=arguments.port,
        token=secrets.token_urlsafe(16),
        allowed=allowed(),
        key=credentials(arguments),
        runs=arguments.runs,
        config=arguments.config or (INSTALLED if os.access(INSTALLED, os.R_OK) else None),
    )
    asyncio.run(_serve(settings, browser=not arguments.no_browser))
    return 0


def allowed() -> dict[str, list[str]]:
    """Return the states in which each of the page's commands applies, from the daemon's table."""
    buttons = {
        command: [str(state) for state, trigger in TRANSITIONS if trigger is triggered]
        for command, triggered in TRIGGERS.items()
    }
    return buttons | {command: [str(state) for state in states] for command, states in FORMS.items()}


async def _serve(settings: Settings, browser: bool) -> None:
    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)

    def ready(url: str) -> None:
        with contextlib.suppress(BrokenPipeError):
            print(url, flush=True)
        if browser:
            open_page(url)

    await serve_page(settings, ready, stop)
