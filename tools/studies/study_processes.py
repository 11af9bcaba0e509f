"""Rig, daemon, recorder and live page as processes, with a simulated operator: common to studies that inject faults."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

from palmd.bus.subscriber import Message
from palmd.config.two_palms import Config
from palmd.console.errors import RIG_FAILED, CliError
from palmd.harness.operator import Operator
from palmd.harness.stack import Stack
from palmd.jsonvalues import or_none
from palmd.rig.fault_injection import PortName

PATIENCE_S = 40.0  # longest time to a requested state
LOOK_S = 0.02  # polling period
WORKER = "palmd.daemon.worker_main"


@dataclass(frozen=True, slots=True)
class InjectedFault:
    """A fault injected into the emulated rig, for `for_s` seconds; infinite: until it is cleared."""

    name: str
    port: PortName | None = None
    strength: float | None = None
    for_s: float = math.inf


class StudyProcesses(Stack):
    """A context manager that starts and ends the processes; `take` gets every message."""

    def __init__(self, folder: Path, config: Config, seed: int, runs: Path) -> None:
        """`folder`: for configurations and the processes' output; `runs`: for recordings; `seed`: of the rig."""
        super().__init__(folder, config, runs)
        self._seed = seed
        self._operator = Operator()

    def __enter__(self) -> Self:
        """Start the processes; raises CliError if one does not start."""
        try:
            self.start_rig("--seed", str(self._seed))
            self.start(record=True)
            self.start_page()
        except BaseException:
            self.__exit__(None, None, None)
            raise
        return self

    def take(self, message: Message) -> None:
        """Process one message of daemon or rig."""
        self._operator.take(message.topic, message.fields)

    def listen(self, t_end: float) -> None:
        """Take all messages until `t_end` (s)."""
        for message in self.subscriber.until(t_end):
            self.take(message)

    def operate(self, t: float) -> None:
        """Give the command that a simulated operator gives at `t` (s), if any."""
        command = self._operator.decide(t)
        if command is not None:
            self.client.ask(command)

    def wait(
        self, holds: Callable[[], bool], otherwise: str, patience_s: float = PATIENCE_S, *, operate: bool = False
    ) -> None:
        """Listen, and `operate` if requested, until `holds()`; raises CliError with `otherwise` after `patience_s`."""
        t_end = time.monotonic() + patience_s
        while not holds():
            t = time.monotonic()
            if t > t_end:
                text = self.children["daemon"].error_output()
                raise CliError(RIG_FAILED, f"{otherwise}: {self._operator.state.get('state', '')}\n{text}".strip())
            self.listen(t + LOOK_S)
            if operate:
                self.operate(t)

    def inject(self, fault: InjectedFault) -> dict[str, Any]:
        """Inject a fault into the rig and return its answer; raises CliError if it refuses."""
        return self.ask_rig("inject", **asdict(fault) | {"for_s": or_none(fault.for_s)})

    def helpers(self) -> Iterator[tuple[str, int]]:
        """The modules that the daemon's helper processes run, with their process ids."""
        daemon = self.children["daemon"].number
        with suppress(OSError):
            for number in Path(f"/proc/{daemon}/task/{daemon}/children").read_text(encoding="ascii").split():
                words = Path(f"/proc/{number}/cmdline").read_bytes().decode(errors="replace").split("\0")
                if WORKER in words:
                    yield words[words.index(WORKER) + 1], int(number)
