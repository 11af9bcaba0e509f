"""Processes of a soak as in a demo, acts on them, and their messages."""

from __future__ import annotations

import json
import shutil
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgpack
import zmq
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect
from websockets.typing import Origin

from palmd.bus.subscriber import Message, Subscriber
from palmd.config.two_palms import Config
from palmd.console.errors import RIG_FAILED, CliError
from palmd.console.shipped import shipped
from palmd.harness.stack import ANSWER_S
from palmd.view.http_guard import SOCKET
from tools.studies.soak_fault_injection import Act, OperatorCommand, Visitor
from tools.studies.soak_findings import SoakWatch
from tools.studies.study_processes import LOOK_S, InjectedFault, StudyProcesses

STOPPED_S = 2.0  # longest time to a stop
RECORDED_S = 1800.0  # longest time to pack the recording of an hour
SAMPLE_S = 5.0  # period of sampling the processes
FALLEN_S = 5.0  # from a fall of the object to its exchange
QUIET_S = 2.5  # idle time at the end, two periods of palm/loop
PLANS = ("plans/lively.yaml", "plans/explore.yaml")
"""The first plan, and the one that alternates with it."""

HELPERS = {"palmd.daemon.smoothing": "smoother", "palmd.daemon.explorer_process": "planner"}
MALFORMED = b"\xc1 no command"
ASKED_EVERY_S = 0.05  # longest wait for more answers


class SoakProcesses(StudyProcesses):
    """See the module. `finish` returns the recordings."""

    def __init__(self, folder: Path, config: Config, seed: int, runs: Path) -> None:
        """As for other studies."""
        super().__init__(folder, config, seed, runs)
        self.watch = SoakWatch()
        self.malformed = 0  # malformed commands sent
        self.unserved: list[str] = []  # visitors that were not served
        self._plans = [shipped(plan) for plan in PLANS]
        self._t_resume = 0.0  # until when the operator leaves another one's command alone; 0: not
        self._t_sampled = self._t_fallen = 0.0
        self._visitors: list[threading.Thread] = []
        self._lock = threading.Lock()
        self._over = threading.Event()

    def __exit__(self, *error: object) -> None:
        self._over.set()
        for visitor in self._visitors:
            visitor.join()
        super().__exit__(*error)

    # ---- operation ---------------------------------------------------------------------------------------

    def live(self, t_end: float) -> None:
        """Listen and operate the rig until t_end (s); raises CliError if a process ends."""
        while (t := time.monotonic()) < t_end:
            self.listen(min(t + LOOK_S, t_end))
            self.operate(t)

    def bring_to_motion(self) -> None:
        """Arm, start, resume or reset as needed until the plan runs; raises CliError after `PATIENCE_S`."""
        self._t_resume = 0.0
        self._operator.resume()
        self.wait(lambda: self._operator.moves, "the palms did not start to move", operate=True)

    def listen(self, t_end: float) -> None:
        """As for other studies; raises CliError if a process has ended."""
        super().listen(t_end)
        self.check_alive()

    def take(self, message: Message) -> None:
        """Process one message; with each `palm/loop`, look at the rig, and each `SAMPLE_S` at the processes."""
        super().take(message)
        self.watch.take(message)
        if message.topic != "palm/loop":
            return
        t = time.monotonic()
        self.watch.on_palms = self.rig_status()["on_palms"]
        if t - self._t_sampled >= SAMPLE_S:
            self._t_sampled = t
            numbers: dict[str, int] = {name: child.number for name, child in self.children.items()}
            numbers |= {HELPERS.get(module, module): number for module, number in self.helpers()}
            for name, number in numbers.items():
                sample = _sampled(number)
                if sample is not None:
                    rss_mb, descriptors, threads = sample
                    rss_mb = message.fields["rss_mb"] if name == "daemon" else rss_mb
                    self.watch.sample(name, t, rss_mb, descriptors, threads)

    def operate(self, t: float) -> None:
        """Act as the operator, except for a while after another operator's command."""
        if t < self._t_resume:
            return
        if self._t_resume:
            self._t_resume = 0.0
            self._operator.resume()
        if self.watch.on_palms:
            self._t_fallen = t
        elif t - self._t_fallen > FALLEN_S:
            self._t_fallen = t
            self.ask_rig("new_object")
        super().operate(t)

    # ---- acts --------------------------------------------------------------------------------------------

    def do(self, act: Act) -> None:
        """Perform an act, visits in a thread; raises CliError if the rig refuses."""
        match act:
            case InjectedFault():
                self.inject(act)
            case OperatorCommand(command="plan"):
                self._change_plan()
                self._t_resume = time.monotonic() + act.for_s
            case OperatorCommand():
                self.client.ask(act.command)
                self._t_resume = time.monotonic() + act.for_s
            case Visitor():
                visitor = threading.Thread(target=self._visit, args=(act,), name=act.who)
                visitor.start()
                self._visitors = [one for one in self._visitors if one.is_alive()] + [visitor]

    def _change_plan(self) -> None:
        """Stop and load the other plan; if a fault interferes the plan stays the same."""
        self.client.ask("stop")
        with suppress(CliError):
            self.wait(lambda: self.watch.state == "ready", "the palms did not stop", STOPPED_S)
            if self.client.ask("plan", {"path": str(self._plans[1]), "text": self._plans[1].read_text()})["ok"]:
                self._plans.reverse()

    def _visit(self, visit: Visitor) -> None:
        """Run one visitor, who must be served."""
        t_end = time.monotonic() + visit.for_s
        visits = {"listener": self._listen_in, "deaf": self._be_deaf, "page": self._open_page, "asker": self._ask_much}
        try:
            visits[visit.who](t_end)
        except (CliError, OSError, zmq.ZMQError, WebSocketException) as error:
            self.unserved.append(f"{visit.who}: {str(error)[:120]}")

    def _listen_in(self, t_end: float) -> None:
        with Subscriber(self.bus.publish, topics=("palm/",)) as subscriber:
            for _ in subscriber.until(t_end):
                if self._over.is_set():
                    break

    def _be_deaf(self, t_end: float) -> None:
        with zmq.Context() as context, context.socket(zmq.SUB) as socket:
            socket.setsockopt(zmq.RCVHWM, 1)
            socket.setsockopt(zmq.LINGER, 0)
            socket.connect(self.bus.publish)
            socket.subscribe(b"")
            self._over.wait(t_end - time.monotonic())

    def _open_page(self, t_end: float) -> None:
        address, _, token = self.page.partition("/#token=")
        socket = f"ws{address.removeprefix('http')}{SOCKET}"
        with connect(socket, origin=Origin(address), max_size=None, proxy=None) as page:
            page.send(json.dumps({"token": token}))
            page.recv(ANSWER_S)
            while time.monotonic() < t_end and not self._over.is_set():
                with suppress(TimeoutError):
                    page.recv(LOOK_S)

    def _ask_much(self, t_end: float) -> None:
        with zmq.Context() as context, context.socket(zmq.DEALER) as socket:
            socket.setsockopt(zmq.LINGER, round(ANSWER_S * 1e3))
            socket.connect(self.bus.command)
            while time.monotonic() < t_end and not self._over.is_set():
                socket.send(msgpack.packb({"id": 1, "cmd": "status"}))
                socket.send(MALFORMED)
                with self._lock:
                    self.malformed += 1
                if not socket.poll(round(ANSWER_S * 1e3)):
                    raise CliError(RIG_FAILED, "no answer to status")
                while socket.poll(round(ASKED_EVERY_S * 1e3)):
                    socket.recv_multipart()

    # ---- the end -----------------------------------------------------------------------------------------

    def come_to_rest(self) -> tuple[str, dict[str, Any]]:
        """Stop as an operator does; returns the final state, and the daemon's counters after `QUIET_S`."""
        for visitor in self._visitors:
            visitor.join()
        with suppress(CliError):  # the final state is judged
            self.bring_to_motion()
        self.client.ask("stop")
        with suppress(CliError):
            self.wait(lambda: self.watch.state == "ready", "the palms did not stop")
        end, t_quiet = self.watch.state, time.monotonic() + QUIET_S
        self.wait(lambda: self.watch.t_loop > t_quiet, "no palm/loop was received")
        return end, self.watch.loop

    def finish(self) -> list[Path]:
        """End the daemon, then the recorder; returns the recording's files in their order."""
        self.children["daemon"].stop()
        for message in self.subscriber.until(time.monotonic() + 1.0):
            self.watch.take(message)
        return self.recorded(RECORDED_S)

    def keep(self, folder: Path) -> None:
        """Copy the processes' error output to `folder`."""
        for path in self._folder.glob("*/*.err"):
            shutil.copy(path, folder)


def _sampled(number: int) -> tuple[float, int, int] | None:
    """Resident memory (MB), open descriptors and threads of a process; None if it has ended."""
    try:
        lines = Path(f"/proc/{number}/status").read_text(encoding="utf-8").splitlines()
        descriptors = len(list(Path(f"/proc/{number}/fd").iterdir()))
    except OSError:
        return None
    fields = dict(line.split(":", 1) for line in lines if ":" in line)
    if "VmRSS" not in fields:
        return None
    return int(fields["VmRSS"].split()[0]) * 1.024e-3, descriptors, int(fields["Threads"])
