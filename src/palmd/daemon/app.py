"""`palmd run`: build all parts of the daemon, connect them and run the loop."""

from __future__ import annotations

import logging
import signal
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from subprocess import Popen
from types import FrameType
from typing import Any

from palmd.config.any_config import as_yaml, config_hash
from palmd.daemon import realtime
from palmd.daemon.async_log import start_async_log
from palmd.daemon.bus import Bus, BusError
from palmd.daemon.core import Core
from palmd.daemon.explorer_process import ExplorerProcess
from palmd.daemon.loop import Loop
from palmd.daemon.pad_units import with_reported_units
from palmd.daemon.plan_compiler import PlanCompiler
from palmd.daemon.planner import PlanFolder, read_plan
from palmd.daemon.processor_time import ProcessorTime
from palmd.daemon.recorder_process import RecorderProcess
from palmd.daemon.smoothing import BatchingProcess
from palmd.daemon.systemd import Notifier
from palmd.daemon.systems import live_system
from palmd.keys import KeysError, server_keys
from palmd.messages import Fields
from palmd.observer.observer import LiveObserver
from palmd.outlinefile import OutlineError, read_library
from palmd.topics import SYSTEM_TOPICS
from palmd.yamlfile import ConfigError, load_any_config

log = logging.getLogger(__name__)

OK, BAD_INPUT, RIG_FAILED = 0, 1, 3
RECORDER_START_S = 2.0
"""Longest buffering of messages until our recorder is ready: a replay needs all events from the first one."""
EXTERNAL_RECORDER_S = 0.5
"""The same for a recorder that was started separately: it is already listening and finds an open bus within 0.1 s."""


def run(config_path: Path, recorder: Callable[[], Popen[bytes]] | None = None) -> int:
    """Run the daemon until SIGTERM or SIGINT; returns the exit status. `recorder` starts a recorder beside it.

    0: the arm is at rest. 1: the configuration or its plan is invalid; the reason is on standard error. 3: an address
    is in use, or the arm did not confirm that it stopped.
    """
    with _Signals() as signals:
        try:
            return _start(config_path, signals, recorder)
        except _InterruptedError:
            return OK


def _start(config_path: Path, signals: _Signals, recorder: Callable[[], Popen[bytes]] | None) -> int:
    try:
        config = with_reported_units(load_any_config(config_path))
        system = live_system(config)
        plan = None if config.plan is None else read_plan(config.plan, system.limits, None)
        outlines = () if config.outlines is None else read_library(config.outlines)
        keys = None if config.bus.keys is None else server_keys(config.bus.keys)
    except ConfigError as error:
        print(error, file=sys.stderr)
        return BAD_INPUT
    except (OutlineError, KeysError) as error:
        print(f"{config_path}: {error}", file=sys.stderr)
        return BAD_INPUT
    with ExitStack() as stack:
        compiler = PlanCompiler()
        stack.callback(compiler.close)
        try:
            bus = Bus(config.bus.publish, config.bus.command, keys, frames=config.bus.frames, group=config.bus.group)
        except BusError as error:
            print(f"{config_path}: {error}", file=sys.stderr)
            return RIG_FAILED
        stack.callback(bus.close)
        stack.callback(start_async_log().close)
        recording = None if recorder is None else _start_recorder(recorder)
        notifier = Notifier()
        stack.callback(notifier.close)
        notifier.status("building the observer")
        estimator, smoother = system.observer(outlines, stack)
        notes = ["vm-backend"] if estimator.backend == "vm" else []
        estimator.warm_up()
        missing = realtime.prepare()
        for text in missing:
            log.warning("%s", text)
        notes += ["no-realtime"] if missing else []
        explorer, folder = system.explorer(stack), config_path.absolute().parent
        core = Core(config, estimator, compiler, plan, notes, folder, explorer, system, smoother)
        ports = core.ports()
        for port in ports.values():
            stack.callback(port.close)
        loop = Loop(
            core,
            ports,
            bus,
            notifier,
            rate_hz=config.loop.rate_hz,
            backend=estimator.backend,
            info=system.info(estimator.name, PlanFolder.of(config, folder).names()),
            info_topic=SYSTEM_TOPICS[config.system].info,
            config={"config_hash": config_hash(config), "yaml": as_yaml(config)},
            counters=lambda: _counters(smoother, estimator, explorer),
            processor=ProcessorTime(),
            tend=[each.tend for each in (compiler, smoother, explorer, recording) if each is not None],
        )
        if recording is not None:
            bus.buffer_until("recorder", RECORDER_START_S)
        else:
            bus.buffer_until("recorder", EXTERNAL_RECORDER_S, since_open=True)
        realtime.freeze_collector()
        signals.hand_over(loop.stop)
        return OK if loop.run() else RIG_FAILED


def _start_recorder(recorder: Callable[[], Popen[bytes]]) -> RecorderProcess | None:
    try:
        return RecorderProcess(recorder)
    except OSError as error:
        log.warning("cannot start the recorder, the run is not recorded: %s", error)
        return None


def _counters(
    smoother: BatchingProcess[Any] | None, estimator: LiveObserver, explorer: ExplorerProcess | None
) -> Fields:
    return {
        "smoother_improvements": estimator.improvements,
        "smoother_starts": smoother.starts if smoother else 0,
        "smoother_dropped": smoother.dropped if smoother else 0,
        "explorer_starts": explorer.starts if explorer else 0,
    }


class _InterruptedError(BaseException):
    """A signal asked to end before anything had been started."""


class _Signals:
    """Handler of SIGTERM and SIGINT: ends the loop once there is one, else the start-up."""

    def __init__(self) -> None:
        self._requested = False
        self._stop: Callable[[], None] | None = None
        self._before: dict[int, Any] = {}

    def __enter__(self) -> _Signals:
        self._before = {number: signal.signal(number, self._handle) for number in (signal.SIGTERM, signal.SIGINT)}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def hand_over(self, stop: Callable[[], None]) -> None:
        """From now on call `stop` on a signal; at once if one has come whose exception foreign code swallowed."""
        self._stop = stop
        if self._requested:
            stop()

    def _handle(self, _signal: int, _frame: FrameType | None) -> None:
        self._requested = True
        if self._stop is None:
            raise _InterruptedError
        self._stop()
