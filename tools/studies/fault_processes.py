"""Processes on which the fault campaign injects its faults and measures the reactions."""

from __future__ import annotations

import math
import os
import resource
import signal
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from palmd.bus.subscriber import Message
from palmd.config.two_palms import Config
from palmd.console.errors import RIG_FAILED, CliError
from palmd.harness.operator import Operator
from palmd.harness.stack import START_S, not_started
from palmd.record import RunError
from palmd.record.run import read_run
from tools.studies.fault_reaction import Reaction, ReactionWatch, complete
from tools.studies.fault_rows import Act, FaultRow, FullDisk, Kill, Pause, Process, TakenAddress, WallClockStep
from tools.studies.root_cause import ask, asked_at
from tools.studies.study_processes import LOOK_S, PATIENCE_S, InjectedFault, StudyProcesses

WATCHED_LEAST_S, WATCHED_MOST_S = 1.0, 10.0  # duration of watching a reaction
AFTERWARDS_S = 0.5  # watched on after the reaction is complete
CLOCKS_AGREE_S = 1.0
BRISK_RAD_S = 0.4
"""Rate that a palm must have when a cause occurs, so that there is a motion to stop (rad/s)."""

STEPPED_CLOCK = """\
import os, time
_time, _mark = time.time, {mark!r}
time.time = lambda: _time() + ({seconds!r} if os.path.exists(_mark) else 0.0)
"""
"""For the interpreter's `sitecustomize`: steps the wall clock of one process as soon as the mark file exists."""


class FaultProcesses(StudyProcesses):
    """See the module. `usable` becomes False if the palms could not be brought to move again."""

    def __init__(self, folder: Path, config: Config, seed: int, runs: Path) -> None:
        """As for other studies; `config` has the plan to run."""
        super().__init__(folder, config, seed, runs)
        self._watch = ReactionWatch()
        self.usable = True

    def take(self, message: Message) -> None:
        """Process one message of daemon or rig."""
        super().take(message)
        self._watch.take(message.topic, message.fields)

    def _listen(self, seconds: float) -> None:
        self.listen(time.monotonic() + seconds)

    def _restart_daemon(self, **environment: str) -> None:
        """Start a daemon and wait for its first state."""
        self.begin_daemon(**environment)
        self._operator = Operator()
        if not self.wait_for_daemon(self.take):
            raise not_started(self.children["daemon"])
        while not self._operator.state:
            self._listen(LOOK_S)
            self.check_alive("daemon")

    def bring_to_motion(self) -> None:
        """Arm, start, resume or reset as needed until the palms turn fast; raises CliError after `PATIENCE_S`."""
        self._watch = ReactionWatch()
        self.wait(self._turns_fast, "the palms did not start to move", operate=True)

    def _turns_fast(self) -> bool:
        motions = self._watch.motions
        moves = self._operator.moves and self._operator.motion["segment"] > 0
        grave = {"hold", "stop"} & set(self._operator.state.get("severities", ()))
        return bool(motions) and moves and not grave and max(map(abs, motions[-1].omega)) > BRISK_RAD_S

    # ---- a row -------------------------------------------------------------------------------------------

    def provoke(self, row: FaultRow) -> Reaction:
        """Inject a row's fault during fast motion, measure the reaction, undo the fault and resume; raises CliError."""
        if isinstance(row.act, WallClockStep):
            self._restart_daemon(PYTHONPATH=self._stepped_clock(row.act))
        self.bring_to_motion()
        before, kept = self.rig_status(), self._recorder()
        watch = self._watch = ReactionWatch()
        wrong: list[str] = []
        self._listen(LOOK_S)
        t_cause = self._do(row.act, wrong)
        reaction = self._until_complete(row, t_cause)
        self._watch = ReactionWatch()
        wrong += self._set_points(before, reaction)
        wrong += self._undo(row.act)
        self._listen(AFTERWARDS_S)  # a delayed line still has old bytes to deliver
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

    def _until_complete(self, row: FaultRow, t_cause: float) -> Reaction:
        """Watch until everything that the row expects has happened, and `AFTERWARDS_S` longer."""
        t_begin = time.monotonic()
        t_done = t_begin + WATCHED_MOST_S
        while time.monotonic() < t_done:
            self._listen(LOOK_S)
            reaction = self._watch.reaction(row, t_cause)
            if t_done == t_begin + WATCHED_MOST_S and complete(row, reaction):
                t_done = max(t_begin + WATCHED_LEAST_S, time.monotonic() + AFTERWARDS_S)
        return self._watch.reaction(row, t_cause)

    def _do(self, act: Act, wrong: list[str]) -> float:
        """Cause the fault; returns its time (s, monotonic clock)."""
        t = time.monotonic()
        match act:
            case InjectedFault():
                t = float(self.inject(act)["t_on_s"])
            case Pause():
                number = self._number(act.process)
                os.kill(number, signal.SIGSTOP)
                time.sleep(act.seconds)
                with suppress(ProcessLookupError):  # the daemon may have ended it
                    os.kill(number, signal.SIGCONT)
            case Kill():
                os.kill(self._number(act.process), signal.SIGKILL)
                if act.process == "daemon":
                    self._listen(WATCHED_LEAST_S)
                    self._restart_daemon()
            case FullDisk():
                self._limit_recorder(Path(self._recorder()["path"]).stat().st_size)
            case TakenAddress():
                wrong += self._refused_beside()
            case WallClockStep():
                self._mark.touch()
        return t

    def _number(self, process: Process) -> int:
        """Process id of a child, or of the daemon's smoother."""
        if process != "smoother":
            return self.children[process].number
        for module, number in self.helpers():
            if module == "palmd.daemon.smoothing":
                return number
        raise CliError(RIG_FAILED, "the daemon has no smoother")

    def _undo(self, act: Act) -> list[str]:
        """End the cause and restart ended processes; returns what went wrong."""
        match act:
            case InjectedFault() if math.isinf(act.for_s):
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
                self._restart_daemon()
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
        try:
            self.wait(lambda: code not in self._operator.state["faults"], f"{code} did not clear")
        except CliError as error:
            return [str(error).splitlines()[0]]
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
