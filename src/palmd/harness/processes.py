"""Other palmd commands as child processes, which are asked to end when this one ends."""

from __future__ import annotations

import ctypes
import os
import signal
import stat
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import FrameType
from typing import Any, Self

from palmd.bus.link import KEY_VARIABLE
from palmd.console.parent import PARENT_VARIABLE

_C = ctypes.CDLL(None)
_PR_SET_PDEATHSIG = 1
_STOPPING_S = 5.0
_LOOK_S = 0.02


def _die_with_parent() -> None:
    _C.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def start_beside(arguments: list[str]) -> subprocess.Popen[bytes]:
    """Start another command that is asked to end when this process ends, and may take its time; raises OSError.

    It shares standard error unless that is a pipe, whose reader waits for this process alone. It takes 1 ms even if
    this process is large, because nothing of ours runs between fork and exec.
    """
    return subprocess.Popen(
        [sys.executable, "-P", "-m", "palmd", *arguments],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL if stat.S_ISFIFO(os.fstat(sys.stderr.fileno()).st_mode) else None,
        env=os.environ | {PARENT_VARIABLE: str(os.getpid())},
        process_group=0,
    )


class Child:
    """One command, with its output and temporary files in `folder`; a terminal's Ctrl-C does not reach it.

    Its daemon has no keys, so it gets none either.
    """

    def __init__(self, arguments: list[str], folder: Path, environment: Mapping[str, str] | None = None) -> None:
        """`arguments` begin with the command's name, also used for its files; `environment` is added to ours."""
        self.name = arguments[0]
        self._out, self._err = folder / f"{self.name}.out", folder / f"{self.name}.err"
        with self._out.open("wb") as out, self._err.open("wb") as err:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "palmd", *arguments],
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                env={name: value for name, value in os.environ.items() if name != KEY_VARIABLE}
                | {"TMPDIR": str(folder)}
                | dict(environment or {}),
                start_new_session=True,
                preexec_fn=_die_with_parent,
            )

    @property
    def number(self) -> int:
        """The process id."""
        return self._process.pid

    @property
    def status(self) -> int | None:
        """The exit status, None while it runs; negative for a signal."""
        return self._process.poll()

    def error_output(self) -> str:
        """The last lines of its standard error, without log levels below a warning."""
        lines = self._err.read_text(encoding="utf-8", errors="replace").splitlines()
        return "\n".join([line for line in lines if not line.startswith(("INFO ", "DEBUG "))][-20:])

    def first_line(self, timeout_s: float, give_up: Callable[[], bool] = lambda: False) -> str | None:
        """The first line of its standard output; None if it ends without one, at a time-out, or if `give_up()`."""
        t_end = time.monotonic() + timeout_s
        while True:
            ended = self.status is not None
            line, end, _ = self._out.read_text(encoding="utf-8").partition("\n")
            if end:
                return line
            if ended or give_up() or time.monotonic() > t_end:
                return None
            time.sleep(_LOOK_S)

    def lines(self) -> list[str]:
        """The lines of its standard output."""
        return self._out.read_text(encoding="utf-8").splitlines()

    def send(self, number: signal.Signals) -> None:
        """Send it a signal."""
        self._process.send_signal(number)

    def stop(self, timeout_s: float = _STOPPING_S) -> None:
        """Ask it to end, and kill it after `timeout_s`."""
        self._process.terminate()
        try:
            self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


class StopRequest:
    """Context in which SIGINT and SIGTERM only set `made`."""

    def __init__(self) -> None:
        self.made = False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Self:
        self._before = {number: signal.signal(number, self._ask) for number in (signal.SIGINT, signal.SIGTERM)}
        return self

    def _ask(self, _signal: int, _frame: FrameType | None) -> None:
        self.made = True

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
