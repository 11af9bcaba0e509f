"""The real daemon on the emulated rig, as processes connected by pseudo-terminals, with test operations.

Nothing waits for a fixed time or asserts one: every wait has a condition, and `GENEROUS_S` is the time-out on a slow
machine.
"""

import json
import signal
import socket
import subprocess
import sys
from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import msgpack
import yaml
import zmq
from waiting import PATIENCE_S as GENEROUS_S
from waiting import wait

from palmd.bus.command_client import CommandClient
from palmd.config.two_palms import Config
from palmd.harness.processes import Child
from palmd.harness.stack import Stack

_LOOK_S = 0.02
EVERYTHING = 1_000_000  # more messages than can be waiting

RATE_DEG_S = 80.0
LEAST_WORK = {"observer": {"primary": "quasistatic"}}  # nothing to compile or load, no helper processes
RESTING_RAD_S = 1e-3
TOGETHER_S = 0.3
PLAN = """\
name: lively
repeat: forever
segments:
  - {move: {phi1_deg: 45, phi2_deg: 90}, duration_s: 0.8}
  - {sine: {phi1_deg: 18, phi2_deg: 8}, frequency_hz: [0.5, 0.6], duration_s: 60}
"""


ROOT = Path(__file__).parents[2]


def run_study(*arguments, timeout_s):
    """Runs a study of the checkout to its end; returns status and output."""
    command = [sys.executable, "-m", "tools.studies", *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=timeout_s)


class Process(Child):
    """One palmd command as a process."""

    def __init__(self, arguments, folder, environment=None):
        super().__init__([*map(str, arguments)], folder, environment)

    @property
    def all_said(self):
        """Its standard error so far."""
        return self._err.read_text(encoding="utf-8", errors="replace")

    @property
    def alive(self):
        return self.status is None

    def first_line(self, patience_s=GENEROUS_S, *more):
        """The first line of its standard output."""
        line = super().first_line(patience_s, *more)
        assert line is not None, f"no output; it ended with {self.status}: {self.all_said}"
        return line

    def end(self, number=signal.SIGTERM, within_s=GENEROUS_S):
        """Sends a signal; returns the exit status."""
        self.send(number)
        return self.wait(within_s)

    def wait(self, within_s=GENEROUS_S):
        """The exit status, after it ends by itself."""
        return self._process.wait(within_s)

    def stop(self, *_patience_s):
        """Ends it in any case."""
        self._process.kill()
        self._process.wait()


class LoneRig(Process):
    """The emulated rig without a daemon; `found` is its JSON line, `config` a configuration with its ports."""

    def __init__(self, folder, settings, *arguments):
        """`settings` of the rig and of the configuration, without ports."""
        rig, self.config = folder / "rig.yaml", folder / "palmd.yaml"
        rig.write_text(yaml.safe_dump(with_ports(settings, {"pad1": "a", "pad2": "b", "arm": "c"})))
        super().__init__(["rig", rig, *arguments], folder)
        self.found = json.loads(self.first_line())
        self.bus = {"publish": f"ipc://{folder}/publish", "command": f"ipc://{folder}/command"}
        self.config.write_text(yaml.safe_dump(with_ports(settings, self.found) | {"bus": self.bus}))


def with_ports(settings, ports):
    """The settings with the ports of pad1, pad2 and arm."""
    pads = {f"palm{i}": settings.get("pads", {}) | {"port": ports[f"pad{i}"]} for i in (1, 2)}
    return settings | {"pads": pads, "arm": settings.get("arm", {}) | {"port": ports["arm"]}}


def palmd(*arguments, timeout_s=100.0):
    """Runs a palmd command to its end."""
    return subprocess.run(
        [sys.executable, "-P", "-m", "palmd", *map(str, arguments)],
        capture_output=True, text=True, timeout=timeout_s, check=False, stdin=subprocess.DEVNULL,
    )  # fmt: skip


class Client(CommandClient):
    """A client of a command socket that sends one map at a time."""

    def __init__(self, address):
        super().__init__(address, GENEROUS_S)
        self.socket = self._socket

    def reply(self):
        """The next answer to any request."""
        assert self.socket.poll(GENEROUS_S * 1e3), "no answer"
        return msgpack.unpackb(self.socket.recv_multipart()[-1])

    def ask(self, command, **args):
        """The answer `{id, ok, error?, result?}`."""
        return super().ask(command, args)

    def do(self, command, **args):
        """The result of a command; fails if it is refused."""
        reply = self.ask(command, **args)
        assert reply["ok"], f"{command}: {reply['error']}"
        return reply.get("result")


@dataclass
class Heard:
    """Messages since the last `Bench.forget`: the last one of each topic, and what occurred in between."""

    latest: dict = field(default_factory=dict)
    counts: Counter = field(default_factory=Counter)
    states: list = field(default_factory=list)
    faults: dict = field(default_factory=dict)  # severity by code
    since: dict = field(default_factory=dict)  # by code: the first tick that reported it

    @property
    def state(self):
        return self.latest.get("palm/state", {}).get("state")

    @property
    def active(self):
        """Codes of the active faults."""
        return set(self.latest.get("palm/state", {}).get("faults", ()))

    @property
    def ticks(self):
        return self.counts["palm/estimate"]

    def take(self, topic, fields):
        self.latest[topic] = fields
        self.counts[topic] += 1
        if topic == "palm/state":
            self.faults |= zip(fields["faults"], fields["severities"], strict=True)
            self.since = dict.fromkeys(fields["faults"], fields["mono_ns"] * 1e-9) | self.since
            if self.states[-1:] != [fields["state"]]:
                self.states.append(fields["state"])


class Bench(Stack):
    """A rig, and a daemon on its ports; `folder` holds configuration, plan and output.

    The configured ports are links with fixed names, as udev makes them; a restarted rig gets the same ones.
    """

    child = Process
    topics = ("palm/",)

    def __init__(self, folder, seed=3, record=False, **changes):
        """`changes` apply to the daemon's configuration, not to the rig's; `record` starts the recorder."""
        self.folder, self.heard = folder, Heard()
        self.ports = {name: folder / "ports" / name for name in ("pad1", "pad2", "arm")}
        self._seed, self._stalls = seed, 0
        pad1, pad2, arm = ({"port": str(port)} for port in self.ports.values())
        pad1["newtons_per_count"] = pad2["newtons_per_count"] = 0.04  # no object of these tests saturates them
        limits = {"phi1_deg": [20, 70], "phi2_deg": [75, 105], "rate_deg_s": RATE_DEG_S}
        self._settings = {"pads": {"palm1": pad1, "palm2": pad2}, "arm": arm, "limits": limits, "plan": "lively.yaml"}
        (folder / "lively.yaml").write_text(PLAN)
        super().__init__(folder, Config.model_validate(self._settings))
        try:
            self.start_rig()
            self.start_daemon(record, **changes)
        except BaseException:
            self.close()
            raise

    def start_rig(self):
        super().start_rig("--seed", self._seed, "--ports", self.folder / "ports")

    def start_daemon(self, record=False, **changes):
        """Starts the daemon with its own sockets, and its recorder if requested."""
        publish, command = (f"tcp://127.0.0.1:{port}" for port in free_ports(2))
        settings = self._settings | {"bus": {"publish": publish, "command": command}}
        self.configure(Config.model_validate(merged(settings, changes)))
        self.begin_daemon(record)
        life = self._exit_stacks["daemon"]
        self.client, self.stranger = (life.enter_context(Client(self.bus.command)) for _ in range(2))
        self.heard = Heard()

    def close(self):
        """Ends all processes; the rig cleans up if it can."""
        rig = self.children.get("rig")
        status = rig.end() if rig and rig.alive else 0
        self.__exit__(None, None, None)
        assert status == 0

    @property
    def daemon(self):
        return self.children["daemon"]

    @property
    def rig(self):
        return self.children["rig"]

    # messages of the daemon

    @property
    def motion(self):
        return self.heard.latest["palm/motion"]

    def forget(self):
        """Forgets all messages so far."""
        self._stalls = self.rig_status()["stalls"]
        self.drain()
        self.heard = Heard(latest=self.heard.latest)

    def drain(self, wait_s=0.0):
        """Takes the waiting messages; if there are none, waits for the first one within wait_s."""
        for topic, payload, *_ in self.subscriber.frames(EVERYTHING, wait_s):
            self.heard.take(topic.decode(), msgpack.unpackb(payload))

    def until(self, condition, what):
        """Receives until `condition(heard)` is true; fails if the daemon ends."""

        def look():
            self.drain(_LOOK_S)
            assert self.daemon.alive, f"the daemon ended: {self.daemon.all_said}"
            return self.heard.state is not None and condition(self.heard)

        def story():
            heard = self.heard
            rig = self.rig_status() if self.rig.alive else "gone"
            return (
                f"{what}; state {heard.state}, faults {heard.active}, passed: {heard.states}, {heard.faults}\n"
                f"rig: {rig}\n{self.daemon.all_said[-3000:]}"
            )

        return wait(look, story, pause_s=0.0)

    def until_state(self, *states):
        self.until(lambda heard: heard.state in states, f"state {states}")

    def until_faults(self, *codes):
        """Waits until all of these have been active, not necessarily at once."""
        self.until(lambda heard: heard.faults.keys() >= set(codes), f"faults {codes}")

    def until_gone(self, *codes):
        """Waits until none of these is active."""
        self.until(lambda heard: not heard.active & set(codes), f"the end of {codes}")

    def ticks(self, count):
        """Waits for so many further ticks, which are published."""
        end = self.heard.ticks + count
        self.until(lambda heard: heard.ticks >= end, f"{count} ticks more")

    # actions of an operator

    def ready(self):
        """Brings the daemon from any state to `ready`."""
        self.until(lambda _: True, "the first message")
        if self.heard.state == "fault" or "arm-fault" in self.heard.active:  # an unplugged port leaves the latter
            wait(lambda: self.client.ask("reset")["ok"], "a reset", pause_s=0.1)
        elif self.heard.state in ("tracking", "hold"):
            self.client.do("stop")
        self.until(lambda heard: heard.state == "ready" and self.motion["arm_state"] == "R", "all ready")

    def run_plan(self):
        """Runs the plan until both palms touch the object; does nothing if that is so."""
        self.until(lambda _: True, "the first message")
        if self.heard.state != "tracking" or self.motion["segment"] < 0:
            self._begin()
        self.until(lambda _: self._touches(), "the object")
        self.moving()

    def moving(self):
        """Waits until the palms turn, by the arm's reports, in state tracking."""
        start = self.motion["phi1_rad"]
        self.until(
            lambda heard: (
                self.restart_motion() or (heard.state == "tracking" and abs(self.motion["phi1_rad"] - start) > 0.02)
            ),
            "the palms moving",
        )

    def restart_motion(self):
        """Resumes after a hold or a fault caused by a stall of the rig itself; returns nothing."""
        if self.heard.state in ("hold", "fault") and self._touches() and self.stalled():
            self._begin()

    def _begin(self):
        self.ready()
        self.client.ask("arm")
        self.client.ask("start")

    def _touches(self):
        return all(self.heard.latest["palm/contact"][f"touch{i}"] for i in (1, 2))

    # status of the rig

    def until_rig(self, condition, what):
        """Waits for a condition on the rig's counters; returns them."""
        return wait(lambda: (status := self.rig_status()) and condition(status) and status, what)

    def stalled(self):
        """Whether a slow machine has delayed the rig since the last `forget`, as if it were silent.

        Or its lines: pads that fall silent together have one cause, the kernel's thread for pseudo-terminals.
        """
        silent = [self.heard.since[f"pad{i}-silent"] for i in (1, 2) if f"pad{i}-silent" in self.heard.since]
        together = len(silent) == 2 and abs(silent[0] - silent[1]) < TOGETHER_S
        return together or self.rig_status()["stalls"] > self._stalls

    def truth(self):
        """The present truth."""
        with zmq.Context() as context, context.socket(zmq.SUB) as socket:
            socket.linger = 0
            socket.connect(self.rig_info["truth"])
            socket.subscribe(b"rig/truth")
            assert socket.poll(GENEROUS_S * 1e3), "no truth"
            return msgpack.unpackb(socket.recv_multipart()[1])

    def at_rest(self):
        """Waits until the palms truly stand; returns the truth."""
        return wait(
            lambda: (
                (truth := self.truth())
                and abs(truth["omega1_rad_s"]) + abs(truth["omega2_rad_s"]) < RESTING_RAD_S
                and truth
            ),
            "the palms at rest",
        )

    def judge(self):
        """Checks what must always hold: only allowed set-points were sent, and no unexpected fault came."""
        status = self.rig_status()
        assert status["setpoints_outside_limits"] == 0, status
        assert status["largest_rate_deg_s"] <= RATE_DEG_S * 1.02, status
        assert status.get("refused_610", 0) == 0
        assert "Traceback" not in self.daemon.all_said
        assert not {"tick-error", "estimate-not-finite", "limits-violated"} & self.heard.faults.keys()
        return status


def merged(settings, changes):
    """Nested maps, with the changes applied to the settings."""
    return settings | {
        key: merged(settings[key], value) if isinstance(value, dict) and key in settings else value
        for key, value in changes.items()
    }


def free_ports(count):
    """Numbers of unused TCP ports."""
    with ExitStack() as stack:
        sockets = [stack.enter_context(socket.socket()) for _ in range(count)]
        for each in sockets:
            each.bind(("127.0.0.1", 0))
        return [each.getsockname()[1] for each in sockets]
