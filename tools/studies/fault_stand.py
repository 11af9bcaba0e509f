"""Test stand of rig, daemon, recorder and page as processes, on which faults are injected and reactions measured."""

from __future__ import annotations

import contextlib
import os
import resource
import signal
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

from palmd.bus.subscriber import Message
from palmd.config.two_palms import Config
from palmd.console.errors import RIG_FAILED, CliError
from palmd.harness.operator import Operator
from palmd.harness.stack import START_S, Stack, not_started
from palmd.record import RunError
from palmd.record.run import read_run
from tools.studies.fault_reaction import Reaction, ReactionWatch, TrueMotion, complete
from tools.studies.fault_rows import (
    Act,
    FaultRow,
    FullDisk,
    Kill,
    Pause,
    Process,
    RowFault,
    TakenAddress,
    WallClockStep,
)
from tools.studies.fault_why import ask, asked_at

PATIENCE_S = 40.0  # longest time until the palms move again
WATCHED_LEAST_S, WATCHED_MOST_S = 1.0, 10.0  # duration of watching a reaction
AFTERWARDS_S = 0.5  # watched on after the reaction is complete
LOOK_S = 0.02  # polling period
CLOCKS_AGREE_S = 1.0
BRISK_RAD_S = 0.4
"""Rate that a palm must have when a cause occurs, so that there is a motion to stop (rad/s)."""

STEPPED_CLOCK = """\
import os, time
_time, _mark = time.time, {mark!r}
time.time = lambda: _time() + ({seconds!r} if os.path.exists(_mark) else 0.0)
"""
"""For the interpreter's `sitecustomize`: steps the wall clock of one process as soon as the mark file exists."""


class Stand(Stack):
    """See the module; a context manager that starts the processes and ends them.

    `usable` becomes False if the palms could not be brought to move again.
    """

    def __init__(self, folder: Path, config: Config, seed: int, runs: Path) -> None:
        """`folder`: for configurations and output; `runs`: for recordings; `config` has the plan to run."""
        super().__init__(folder, config, runs)
        self._seed = seed
        self._operator = Operator()
        self.usable = True

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

    def _restart_daemon(self, watch: ReactionWatch, **environment: str) -> None:
        """Start a daemon and wait for its first state; `watch` takes the messages until then."""
        self.begin_daemon(**environment)
        self._operator = Operator()
        if not self.wait_for_daemon(lambda message: self._take(watch, message)):
            raise not_started(self.children["daemon"])
        while not self._operator.state:
            self._listen(watch, LOOK_S)
            self.check_alive("daemon")

    # ---- what an operator does ---------------------------------------------------------------------------

    def bring_to_motion(self) -> None:
        """Arm, start, resume or reset as needed until the palms turn fast; raises CliError after `PATIENCE_S`."""
        watch = ReactionWatch()
        t_end = time.monotonic() + PATIENCE_S
        while not self._brisk(watch):
            self._listen(watch, LOOK_S)
            t = time.monotonic()
            if t > t_end:
                text = self.children["daemon"].error_output()
                raise CliError(RIG_FAILED, f"the palms did not start to move: {self._operator.state}\n{text}")
            command = self._operator.decide(t)
            if command is not None:
                self.client.ask(command)

    def _brisk(self, watch: ReactionWatch) -> bool:
        last: TrueMotion | None = watch.motions[-1] if watch.motions else None
        moves = self._operator.moves and self._operator.motion["segment"] > 0
        grave = {"hold", "stop"} & set(self._operator.state.get("severities", ()))
        return last is not None and moves and not grave and max(map(abs, last.omega)) > BRISK_RAD_S

    def _listen(self, watch: ReactionWatch, seconds: float) -> None:
        for message in self.subscriber.until(time.monotonic() + seconds):
            self._take(watch, message)

    def _take(self, watch: ReactionWatch, message: Message) -> None:
        self._operator.take(message.topic, message.fields)
        watch.take(message.topic, message.fields)

    # ---- a row -------------------------------------------------------------------------------------------

    def provoke(self, row: FaultRow) -> Reaction:
        """Inject a row's fault during fast motion, measure the reaction, undo the fault and resume; raises CliError."""
        if isinstance(row.act, WallClockStep):
            self._restart_daemon(ReactionWatch(), PYTHONPATH=self._stepped_clock(row.act))
        self.bring_to_motion()
        before, kept = self.rig_status(), self._recorder()
        watch = ReactionWatch()
        wrong: list[str] = []
        self._listen(watch, LOOK_S)
        t_cause = self._do(row.act, watch, wrong)
        reaction = self._watch(row, watch, t_cause)
        wrong += self._set_points(before, reaction)
        wrong += self._undo(row.act)
        self._listen(ReactionWatch(), AFTERWARDS_S)  # a delayed line still has old bytes to deliver
        try:
            self.bring_to_motion()
        except CliError as error:
            self.usable = False
            wrong.append(str(error).splitlines()[0])
        wrong += _lost(kept) if _concerns_recording(row.act) else []
        starved = self.rig_status()["stalls"] > before["stalls"]
        seen = replace(watch.reaction(row, t_cause, wrong, starved=starved), came_s=reaction.came_s)
        t_asked = asked_at(row, t_cause, seen.noticed_s, seen.came_s)
        return replace(seen, why=ask(row, Path(kept["path"]), t_cause, t_asked))

    def _watch(self, row: FaultRow, watch: ReactionWatch, t_cause: float) -> Reaction:
        """Watch until everything that the row expects has happened, and `AFTERWARDS_S` longer."""
        t_begin = time.monotonic()
        t_done = t_begin + WATCHED_MOST_S
        while time.monotonic() < t_done:
            self._listen(watch, LOOK_S)
            reaction = watch.reaction(row, t_cause)
            if t_done == t_begin + WATCHED_MOST_S and complete(row, reaction):
                t_done = max(t_begin + WATCHED_LEAST_S, time.monotonic() + AFTERWARDS_S)
        return watch.reaction(row, t_cause)

    def _do(self, act: Act, watch: ReactionWatch, wrong: list[str]) -> float:
        """Cause the fault; returns its time (s, monotonic clock)."""
        t = time.monotonic()
        match act:
            case RowFault():
                fields = {"name": act.name, "port": act.port, "strength": act.strength, "for_s": act.for_s}
                t = float(self.ask_rig("inject", **fields)["t_on_s"])
            case Pause():
                number = self._number(act.process)
                os.kill(number, signal.SIGSTOP)
                time.sleep(act.seconds)
                with contextlib.suppress(ProcessLookupError):  # the daemon may have ended it
                    os.kill(number, signal.SIGCONT)
            case Kill():
                os.kill(self._number(act.process), signal.SIGKILL)
                if act.process == "daemon":
                    self._listen(watch, WATCHED_LEAST_S)
                    self._restart_daemon(watch)
            case FullDisk():
                self._limit_recorder(Path(self._recorder()["path"]).stat().st_size)
            case TakenAddress():
                wrong += self._refused_beside()
            case WallClockStep():
                self._mark.touch()
        return t

    def _number(self, process: Process) -> int:
        """Process id of a child, or of the daemon's smoother."""
        if process in ("daemon", "recorder", "page"):
            return self.children[process].number
        daemon = self.children["daemon"].number
        for number in Path(f"/proc/{daemon}/task/{daemon}/children").read_text(encoding="ascii").split():
            if "palmd.daemon.smoothing" in Path(f"/proc/{number}/cmdline").read_text(encoding="utf-8"):
                return int(number)
        raise CliError(RIG_FAILED, "the daemon has no smoother")

    def _undo(self, act: Act) -> list[str]:
        """End the cause and restart ended processes; returns what went wrong."""
        match act:
            case RowFault() if act.for_s is None:
                self.ask_rig("clear", name=act.name, port=act.port)
            case Kill(process="daemon"):
                self.client.ask("reset")  # the controller's fault, which the new daemon found
            case Kill(process="recorder"):
                self.start_recorder()
            case Kill(process="page"):
                self.start_page()
            case Pause(process="recorder"):
                return self._gone("recorder-silent")
            case FullDisk():
                self._limit_recorder(resource.RLIM_INFINITY)
                return self._gone("recorder-failed")
            case WallClockStep():
                jumped = self._operator.state["timestamp"] - time.time()
                self._restart_daemon(ReactionWatch())
                return [] if abs(jumped - act.seconds) < CLOCKS_AGREE_S else ["the daemon's clock was not set"]
        return []

    def _refused_beside(self) -> list[str]:
        """Start a second daemon on the same addresses; returns a deviation unless it ends with the right message."""
        child = self.begin("second", "run", str(self.path), "--no-record")
        t_end = time.monotonic() + START_S
        while child.status is None and time.monotonic() < t_end:
            time.sleep(LOOK_S)
        if child.status == RIG_FAILED and f"{self.bus.publish} is in use" in child.error_output():
            return []
        return [f"the second daemon ended with {child.status}: {child.error_output()}"]

    def _gone(self, code: str) -> list[str]:
        t_end = time.monotonic() + PATIENCE_S
        while code in self._operator.state["faults"]:
            if time.monotonic() > t_end:
                return [f"{code} did not clear"]
            self._listen(ReactionWatch(), LOOK_S)
        return []

    def _limit_recorder(self, size_bytes: int) -> None:
        number = self.children["recorder"].number
        _, hard = resource.prlimit(number, resource.RLIMIT_FSIZE)
        resource.prlimit(number, resource.RLIMIT_FSIZE, (size_bytes, hard))

    def _stepped_clock(self, act: WallClockStep) -> str:
        """A PYTHONPATH with `STEPPED_CLOCK` as `sitecustomize`."""
        folder = self._folder / "clock"
        folder.mkdir(exist_ok=True)
        self._mark = folder / "stepped"
        self._mark.unlink(missing_ok=True)
        text = STEPPED_CLOCK.format(mark=str(self._mark), seconds=act.seconds)
        (folder / "sitecustomize.py").write_text(text, encoding="utf-8")
        return os.pathsep.join(filter(None, [str(folder), os.environ.get("PYTHONPATH", "")]))

    # ---- status of rig and recorder ----------------------------------------------------------------------

    def _recorder(self) -> dict[str, Any]:
        """The recorder's last report to the daemon, once it has a file."""
        t_end = time.monotonic() + PATIENCE_S
        while time.monotonic() < t_end:
            result = self.client.ask("status").get("result") or {}
            report: dict[str, Any] = result.get("recorder") or {}
            if "path" in report:
                return report
            time.sleep(LOOK_S)
        raise CliError(RIG_FAILED, f"the recorder does not record\n{self.children['recorder'].error_output()}")

    def _set_points(self, before: dict[str, Any], reaction: Reaction) -> list[str]:
        """Deviations of the set-points that the rig received: outside the limits, or sent to an arm that must rest."""
        now = self.rig_status()
        wrong = []
        if now["setpoints_outside_limits"] > before["setpoints_outside_limits"]:
            wrong.append("set-points outside the limits")
        taken = "accepted" if "accepted" in now else "setpoints"  # servos accept everything on the bus
        if reaction.state in ("ready", "fault"):
            time.sleep(AFTERWARDS_S)
            if self.rig_status()[taken] > now[taken]:
                wrong.append("set-points to an arm that must rest")
        return wrong


def _concerns_recording(act: Act) -> bool:
    return isinstance(act, FullDisk) or (isinstance(act, Kill | Pause) and act.process in ("daemon", "recorder"))


def _lost(report: dict[str, Any]) -> list[str]:
    """Messages that the recorder had reported and that its file lacks, and gaps in the file."""
    try:
        survey = read_run(Path(report["path"])).survey()
    except RunError as error:
        return [str(error)]
    count = sum(found.count for found in survey.values())
    missing = sum(found.missing for found in survey.values())
    wrong = [f"{report['messages'] - count:.0f} recorded messages are lost"] if count < report["messages"] else []
    return wrong + ([f"{missing} messages are missing in the recording"] if missing else [])
