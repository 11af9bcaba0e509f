"""Rig, daemon, recorder and page as processes, and the hand that provokes faults on them and looks at what comes."""

from __future__ import annotations

import json
import os
import resource
import signal
import time
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from palmd.bus.client import Client, Subscriber
from palmd.cli.demo import as_yaml, free_addresses
from palmd.config import BusConfig, Config
from palmd.console.errors import RIG_FAILED, CliError
from palmd.harness.panel import Panel
from palmd.harness.processes import Child
from palmd.lab.fault_reaction import Reaction, Turning, Watch, complete
from palmd.lab.fault_rows import Act, ClockStep, FullDisk, Kill, Pause, Process, Row, TakenAddress, Trick
from palmd.record.mcapfile import RunError
from palmd.record.run import read_run

START_S = 240.0  # compiling the observers on a slow machine
PATIENCE_S = 40.0  # until the palms move again
WATCHED_LEAST_S, WATCHED_MOST_S = 1.0, 10.0
AFTERWARDS_S = 0.5  # looked on after all has come
ANSWER_S = 5.0
LOOK_S = 0.02
CLOCKS_AGREE_S = 1.0
BRISK_RAD_S = 0.4
"""How fast a palm must turn when a cause comes, or there would be nothing to stop."""

STEPPED_CLOCK = """\
import os, time
_time, _mark = time.time, {mark!r}
time.time = lambda: _time() + ({seconds!r} if os.path.exists(_mark) else 0.0)
"""
"""For the interpreter's `sitecustomize`: the wall clock of one process, set as soon as the mark is there."""


class Stand:
    """See the module; enter it to have the processes, leave it and they are gone.

    `usable` is False once the palms could not be brought to move again.
    """

    def __init__(self, folder: Path, config: Config, seed: int) -> None:
        """`folder` takes configurations, output and recordings; `config` has the plan that is run."""
        self._folder, self._config, self._seed = folder, config, seed
        self.usable = True
        self._count = 0
        self._stack = ExitStack()
        self._lives: dict[str, ExitStack] = {}
        self._children: dict[Process, Child] = {}

    def __enter__(self) -> Self:
        """Raises CliError when a process does not start."""
        try:
            path = self._written("rig.yaml", as_yaml(self._config, self._config.bus, _NO_PORTS))
            rig = self._begin("rig", str(path), "--seed", str(self._seed))
            self._told: dict[str, Any] = json.loads(rig.started(START_S))
            self._hand = self._stack.enter_context(Client(self._told["control"], ANSWER_S))
            self._start_daemon(Watch())
            self._start_recorder()
            self._start_page()
        except BaseException:
            self.__exit__(None, None, None)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        for life in self._lives.values():
            life.close()
        self._stack.close()

    # ---- the processes -----------------------------------------------------------------------------------

    def _written(self, name: str, text: str) -> Path:
        path = self._folder / name
        path.write_text(text, encoding="utf-8")
        return path

    def _begin(self, *arguments: str, stack: ExitStack | None = None, **environment: str) -> Child:
        self._count += 1
        folder = self._folder / str(self._count)
        folder.mkdir()
        child = Child(list(arguments), folder, environment)
        (stack or self._stack).callback(child.stop)
        return child

    def _life(self, name: str) -> ExitStack:
        """A new life for one of them; the one before ends."""
        if name in self._lives:
            self._lives.pop(name).close()
        return self._lives.setdefault(name, ExitStack())

    def _start_daemon(self, watch: Watch, **environment: str) -> None:
        """`watch` takes what is heard until the daemon speaks."""
        stack = self._life("daemon")
        if "daemon" not in self._children:
            self._bus: BusConfig = free_addresses(self._config.bus)
            runs = self._folder / "runs"
            self._path = self._written("palmd.yaml", as_yaml(self._config, self._bus, self._told, runs))
        self._children["daemon"] = self._begin("run", str(self._path), "--no-record", stack=stack, **environment)
        self._heard = stack.enter_context(Subscriber(self._bus.publish, self._told["truth"], topics=("palm/", "rig/")))
        self._client = stack.enter_context(Client(self._bus.command, ANSWER_S))
        self._panel = Panel()
        self._state: dict[str, Any] = {}
        self._motion: dict[str, Any] = {}
        t_end = time.monotonic() + START_S
        while not self._state:
            self._listen(watch, LOOK_S)
            if self._children["daemon"].status is not None or time.monotonic() > t_end:
                raise CliError(RIG_FAILED, self._children["daemon"].said() or "palmd run did not start")

    def _start_recorder(self) -> None:
        self._children["recorder"] = self._begin("record", str(self._path), stack=self._life("recorder"))
        self._children["recorder"].started(START_S)

    def _start_page(self) -> None:
        where = ("--address", self._bus.publish, "--command", self._bus.command, "--truth", self._told["truth"])
        page = self._begin("view", "--no-browser", "--port", "0", *where, stack=self._life("page"))
        self._children["page"] = page
        page.started(START_S)

    # ---- what an operator does ---------------------------------------------------------------------------

    def bring_to_motion(self) -> None:
        """Arm, start, go on or reset as it needs, until the palms turn briskly; raises CliError."""
        watch = Watch()
        t_end = time.monotonic() + PATIENCE_S
        while not self._brisk(watch):
            self._listen(watch, LOOK_S)
            t = time.monotonic()
            if t > t_end:
                said = self._children["daemon"].said()
                raise CliError(RIG_FAILED, f"the palms were not brought to move: {self._state}\n{said}")
            command = self._panel.decide(self._state, self._motion, t)
            if command is not None:
                self._client.ask(command)

    def _brisk(self, watch: Watch) -> bool:
        last: Turning | None = watch.turning[-1] if watch.turning else None
        follows = self._state.get("state") == "tracking" and self._motion.get("segment", -1) > 0
        grave = {"hold", "stop"} & set(self._state.get("severities", ()))
        return last is not None and follows and not grave and max(map(abs, last.omega)) > BRISK_RAD_S

    def _listen(self, watch: Watch, seconds: float) -> None:
        for message in self._heard.until(time.monotonic() + seconds):
            if message.topic == "palm/state":
                self._state = message.fields
                self._panel.see(message.fields)
            elif message.topic == "palm/motion":
                self._motion = message.fields
            watch.take(message.topic, message.fields)

    # ---- a row -------------------------------------------------------------------------------------------

    def provoke(self, row: Row) -> Reaction:
        """From brisk motion: the cause, what comes of it, its end, and the palms moving again; raises CliError."""
        if isinstance(row.act, ClockStep):
            self._start_daemon(Watch(), PYTHONPATH=self._stepped_clock(row.act))
        self.bring_to_motion()
        before, kept = self._rig_status(), self._recorder()
        watch = Watch()
        wrong: list[str] = []
        self._listen(watch, LOOK_S)
        t_cause = self._do(row.act, watch, wrong)
        reaction = self._watch(row, watch, t_cause)
        wrong += self._set_points(before, reaction)
        wrong += self._undo(row.act)
        self._listen(Watch(), AFTERWARDS_S)  # a line that was late has bytes of then to deliver
        try:
            self.bring_to_motion()
        except CliError as error:
            self.usable = False
            wrong.append(str(error).splitlines()[0])
        wrong += _lost(kept) if _concerns_recording(row.act) else []
        starved = self._rig_status()["stalls"] > before["stalls"]
        return watch.reaction(row, t_cause, wrong, starved=starved)

    def _watch(self, row: Row, watch: Watch, t_cause: float) -> Reaction:
        """Look on until all that the row promises has come, and a little longer."""
        t_begin = time.monotonic()
        t_done = t_begin + WATCHED_MOST_S
        while time.monotonic() < t_done:
            self._listen(watch, LOOK_S)
            reaction = watch.reaction(row, t_cause)
            if t_done == t_begin + WATCHED_MOST_S and complete(row, reaction):
                t_done = max(t_begin + WATCHED_LEAST_S, time.monotonic() + AFTERWARDS_S)
        return watch.reaction(row, t_cause)

    def _do(self, act: Act, watch: Watch, wrong: list[str]) -> float:
        """Bring the cause about; returns its time (s, monotonic clock)."""
        t = time.monotonic()
        match act:
            case Trick():
                fields = {"name": act.name, "port": act.port, "strength": act.strength, "for_s": act.for_s}
                t = float(self._ask_hand("mischief", fields)["t_on_s"])
            case Pause():
                self._children[act.process].send(signal.SIGSTOP)
                time.sleep(act.seconds)
                self._children[act.process].send(signal.SIGCONT)
            case Kill():
                self._children[act.process].send(signal.SIGKILL)
                if act.process == "daemon":
                    self._listen(watch, WATCHED_LEAST_S)
                    self._start_daemon(watch)
            case FullDisk():
                self._limit_recorder(Path(self._recorder()["path"]).stat().st_size)
            case TakenAddress():
                wrong += self._refused_beside()
            case ClockStep():
                self._mark.touch()
        return t

    def _undo(self, act: Act) -> list[str]:
        """End the cause, and start again what is gone; what went wrong with that."""
        match act:
            case Trick() if act.for_s is None:
                self._ask_hand("calm", {"name": act.name, "port": act.port})
            case Kill(process="daemon"):
                self._client.ask("reset")  # the controller's fault, which the new daemon found
            case Kill(process="recorder"):
                self._start_recorder()
            case Kill(process="page"):
                self._start_page()
            case Pause(process="recorder"):
                return self._gone("recorder-silent")
            case FullDisk():
                self._limit_recorder(resource.RLIM_INFINITY)
                return self._gone("recorder-failed")
            case ClockStep():
                jumped = self._state["timestamp"] - time.time()
                self._start_daemon(Watch())
                return [] if abs(jumped - act.seconds) < CLOCKS_AGREE_S else ["the daemon's clock was not set"]
        return []

    def _refused_beside(self) -> list[str]:
        """What is wrong with a second daemon's end, which must say why."""
        child = self._begin("run", str(self._path), "--no-record")
        t_end = time.monotonic() + START_S
        while child.status is None and time.monotonic() < t_end:
            time.sleep(LOOK_S)
        if child.status == RIG_FAILED and f"{self._bus.publish} is in use" in child.said():
            return []
        return [f"the second daemon ended with {child.status}: {child.said()}"]

    def _gone(self, code: str) -> list[str]:
        t_end = time.monotonic() + PATIENCE_S
        while code in self._state["faults"]:
            if time.monotonic() > t_end:
                return [f"{code} does not go away"]
            self._listen(Watch(), LOOK_S)
        return []

    def _limit_recorder(self, size_bytes: int) -> None:
        number = self._children["recorder"].number
        _, hard = resource.prlimit(number, resource.RLIMIT_FSIZE)
        resource.prlimit(number, resource.RLIMIT_FSIZE, (size_bytes, hard))

    def _stepped_clock(self, act: ClockStep) -> str:
        """A PYTHONPATH in which the interpreter finds `STEPPED_CLOCK` first."""
        folder = self._folder / "clock"
        folder.mkdir(exist_ok=True)
        self._mark = folder / "stepped"
        self._mark.unlink(missing_ok=True)
        text = STEPPED_CLOCK.format(mark=str(self._mark), seconds=act.seconds)
        (folder / "sitecustomize.py").write_text(text, encoding="utf-8")
        return os.pathsep.join(filter(None, [str(folder), os.environ.get("PYTHONPATH", "")]))

    # ---- what the others say -----------------------------------------------------------------------------

    def _ask_hand(self, command: str, fields: dict[str, Any]) -> dict[str, Any]:
        reply = self._hand.ask(command, fields)
        if not reply["ok"]:
            raise CliError(RIG_FAILED, f"the emulated rig refuses {command}: {reply.get('error')}")
        return reply["result"] or {}

    def _rig_status(self) -> dict[str, Any]:
        return self._ask_hand("status", {})

    def _recorder(self) -> dict[str, Any]:
        """What the recorder last told the daemon, once it has a file."""
        t_end = time.monotonic() + PATIENCE_S
        while time.monotonic() < t_end:
            result = self._client.ask("status").get("result") or {}
            told: dict[str, Any] = result.get("recorder") or {}
            if "path" in told:
                return told
            time.sleep(LOOK_S)
        raise CliError(RIG_FAILED, f"the recorder does not record\n{self._children['recorder'].said()}")

    def _set_points(self, before: dict[str, Any], reaction: Reaction) -> list[str]:
        """What is wrong with those that the rig has heard: outside the limits, or taken by an arm that must stand."""
        now = self._rig_status()
        wrong = []
        if now["setpoints_outside_limits"] > before["setpoints_outside_limits"]:
            wrong.append("set-points outside the limits")
        if reaction.state in ("ready", "fault"):
            time.sleep(AFTERWARDS_S)
            if self._rig_status()["accepted"] > now["accepted"]:
                wrong.append("set-points to an arm that must stand")
        return wrong


_NO_PORTS = {name: name for name in ("pad1", "pad2", "arm")}


def _concerns_recording(act: Act) -> bool:
    return isinstance(act, FullDisk) or (isinstance(act, Kill | Pause) and act.process in ("daemon", "recorder"))


def _lost(told: dict[str, Any]) -> list[str]:
    """What is missing of the messages that the recorder had told of, or between those of the file."""
    try:
        survey = read_run(Path(told["path"])).survey()
    except RunError as error:
        return [str(error)]
    count = sum(found.count for found in survey.values())
    missing = sum(found.missing for found in survey.values())
    wrong = [f"{told['messages'] - count:.0f} recorded messages are lost"] if count < told["messages"] else []
    return wrong + ([f"{missing} messages are missing in the recording"] if missing else [])
