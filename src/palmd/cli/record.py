"""Records what a daemon publishes: one MCAP file per run, in the configuration's record.directory.

It listens until SIGTERM or SIGINT, with or without a daemon, and begins a file with the daemon's first message.
Finished runs are packed into compressed chunks. Standard output reports when it listens, and each run's path at the
end.
"""

from __future__ import annotations

import argparse
import contextlib
import logging
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

from palmd.console.errors import RIG_FAILED, as_cli_error
from palmd.console.progress import Progress
from palmd.daemon.systemd import Notifier
from palmd.harness.processes import StopRequest, start_beside
from palmd.keys import KeysError, client_credentials, own_credentials
from palmd.record import RunError
from palmd.record.mcapread import is_packed
from palmd.record.recorder import RecorderLockedError, only_recorder, record
from palmd.record.recording import ClosedFile
from palmd.record.runfile import pack
from palmd.yamlfile import ConfigError, load_any_config

log = logging.getLogger(__name__)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("config", type=Path, metavar="CONFIG", help="the daemon's configuration, palmd.yaml")
    parser.add_argument(
        "--key", type=Path, metavar="FILE",
        help="secret key with role operate, for a daemon with keys (default: the daemon's own, from its bus.keys)",
    )  # fmt: skip
    parser.add_argument("--truth", metavar="ADDRESS", help="address at which an emulated rig publishes its truth")


def run(arguments: argparse.Namespace) -> int:
    """Record; CliError if the configuration or an address is invalid."""
    with as_cli_error(ConfigError, KeysError):
        config = load_any_config(arguments.config)
        keys = config.bus.keys
        key = client_credentials(arguments.key) if arguments.key else None if keys is None else own_credentials(keys)
    truth = () if arguments.truth is None else (arguments.truth,)
    notifier = Notifier()

    def ready() -> None:
        print(f"listening to {config.bus.publish}", flush=True)
        notifier.ready()

    with (
        StopRequest() as stop,
        as_cli_error(RecorderLockedError, status=RIG_FAILED),
        only_recorder(config.record.directory, config.bus.publish),
    ):
        packing = _Packing()
        record(config, truth, ready, lambda: stop.made, lambda ended: packing.take(ended, in_time=not stop.made), key)
        packing.finish()
    return 0


class _Packing:
    """Packs finished runs: in a separate process during the recording, or at its end."""

    def __init__(self) -> None:
        self._ended: list[tuple[ClosedFile, subprocess.Popen[bytes] | None]] = []

    def take(self, ended: ClosedFile, *, in_time: bool) -> None:
        """Register a finished run; pack it now if it is complete and the recording continues."""
        beside = start_beside(["runs", "recover", str(ended.path)]) if in_time and ended.whole else None
        self._ended.append((ended, beside))

    def finish(self) -> None:
        """Pack the remaining runs. A run that cannot be packed is left unchanged; try `palmd runs recover` on it."""
        for ended, beside in self._ended:
            if beside is not None:
                beside.wait()
            try:
                if not is_packed(ended.path):
                    with _terminal() as stream, Progress("packing", max(ended.messages, 1), "messages", stream) as bar:
                        pack(ended.path, ended.path, bar.at)
            except (OSError, RunError) as error:
                log.warning("%s is not packed: %s", ended.path, error)
            print(ended.path)


@contextlib.contextmanager
def _terminal() -> Iterator[TextIO]:
    """Standard error, or /dev/null if another command has the terminal now."""
    with contextlib.ExitStack() as stack:
        try:
            ours = os.tcgetpgrp(sys.stderr.fileno()) == os.getpgrp()
        except OSError:
            ours = False
        yield sys.stderr if ours else stack.enter_context(Path(os.devnull).open("w", encoding="utf-8"))
