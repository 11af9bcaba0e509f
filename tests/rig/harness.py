"""The real daemon on the emulated rig, as processes joined by pseudo-terminals, and what a test needs of both.

Nothing here sleeps for a fixed time or asserts one: whoever waits names a condition, and `GENEROUS_S` is only
how long a slow machine may take until it holds.
"""

import contextlib
import json
import signal
import socket
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import msgpack
import yaml
import zmq

from palmd.bus.command_client import CommandClient
from palmd.harness.processes import Child

GENEROUS_S = 20.0
_LOOK_S = 0.02

RATE_DEG_S = 80.0
RESTING_RAD_S = 1e-3
PLAN = """\
name: lively
repeat: forever
segments:
  - {move: {phi1_deg: 45, phi2_deg: 90}, duration_s: 0.8}
  - {sine: {phi1_deg: 18, phi2_deg: 8}, frequency_hz: [0.5, 0.6], duration_s: 60}
"""


class Process(Child):
    """One palmd command; what it says is kept in `folder`. It cannot outlive us."""

    def __init__(self, folder, *arguments):
        number = len(list(folder.glob("*.err")))
        super().__init__([*map(str, arguments)], folder, label=f"{arguments[0]}{number}")

    @property
    def said(self):
        """Its standard error up to now."""
        return self._err.read_text(encoding="utf-8", errors="replace")

    @property
    def alive(self):
        return self.status is None

    def first_line(self):
        """The first line of its standard output."""
        line = super().first_line(GENEROUS_S)
        assert line is not None, f"it says nothing; it ended with {self.status}: {self.said}"
        return line

    def end(self, number=signal.SIGTERM, within_s=GENEROUS_S):
        """Send a signal, and return the exit status."""
        self.send(number)
        return self._process.wait(within_s)

    def wait(self, within_s=GENEROUS_S):
        """The exit status, once it ends by itself."""
        return self._process.wait(within_s)

    def kill(self):
        """Whatever it does, it is gone."""
        self._process.kill()
        self._process.wait()


class Client(CommandClient):
    """Asks a command socket, one map at a time."""

    def __init__(self, address):
        super().__init__(address, GENEROUS_S)
        self.socket = self._socket

    def reply(self):
        """The next answer, whomever it is for."""
        assert self.socket.poll(GENEROUS_S * 1e3), "no answer"
        return msgpack.unpackb(self.socket.recv_multipart()[-1])

    def ask(self, command, **args):
        """The answer `{id, ok, error?, result?}`."""
        return super().ask(command, args)

    def do(self, command, **args):
        """The result of a command that must not be refused."""
        reply = self.ask(command, **args)
        assert reply["ok"], f"{command}: {reply['error']}"
        return reply.get("result")


@dataclass
class Heard:
    """What has been heard since the last `Listener.forget`: the last message of each topic, and what passed by."""

    latest: dict = field(default_factory=dict)
    counts: Counter = field(default_factory=Counter)
    states: list = field(default_factory=list)
    faults: dict = field(default_factory=dict)  # severity by code
    since: dict = field(default_factory=dict)  # by code: the tick (s) that told it first

    @property
    def state(self):
        return self.latest.get("palm/state", {}).get("state")

    @property
    def active(self):
        """The codes of the faults that stand."""
        return set(self.latest.get("palm/state", {}).get("faults", ()))

    @property
    def ticks(self):
        return self.counts["palm/estimate"]


class Listener:
    """Subscribes to everything; `heard` is up to date whenever a condition is asked."""

    def __init__(self, address):
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.SUB)
        self._socket.linger = 0
        self._socket.rcvhwm = 0
        self._socket.connect(address)
        self._socket.subscribe(b"palm/")
        self.heard = Heard()

    def forget(self):
        """Begin anew, but for what the last messages said."""
        self.drain()
        self.heard = Heard(latest=self.heard.latest)

    def frames(self, wait_s):
        """The next message as it came, None if there is none in time."""
        return self._socket.recv_multipart() if self._socket.poll(wait_s * 1e3) else None

    def drain(self, wait_s=0.0):
        """Take in what has come."""
        while (frames := self.frames(wait_s)) is not None:
            self._take(frames[0].decode(), msgpack.unpackb(frames[1]))
            wait_s = 0.0

    def _take(self, topic, fields):
        heard = self.heard
        heard.latest[topic] = fields
        heard.counts[topic] += 1
        if topic == "palm/state":
            heard.faults |= zip(fields["faults"], fields["severities"], strict=True)
            heard.since = dict.fromkeys(fields["faults"], fields["mono_ns"] * 1e-9) | heard.since
            if heard.states[-1:] != [fields["state"]]:
                heard.states.append(fields["state"])

    def close(self):
        self._context.destroy(linger=0)


class Bench:
    """A rig, and a daemon on its ports; `folder` holds configuration, plan and output.

    The configured ports are links of steady names, as udev makes them; a rig that is started anew gets them.
    """

    def __init__(self, folder, seed=3, record=False, **changes):
        """`changes` go into the daemon's configuration and not into the rig's; `record` has it start its recorder."""
        self.folder = folder
        self.config = folder / "palmd.yaml"
        self.ports = {name: folder / name for name in ("pad1", "pad2", "arm")}
        self._seed, self._stalls = seed, 0
        self._closing = []
        (folder / "lively.yaml").write_text(PLAN)
        try:
            self.start_rig()
            self.start_daemon(record, **changes)
        except BaseException:
            self.close()
            raise

    def _settings(self):
        pad1, pad2, arm = ({"port": str(self.ports[name])} for name in ("pad1", "pad2", "arm"))
        limits = {"phi1_deg": [20, 70], "phi2_deg": [75, 105], "rate_deg_s": RATE_DEG_S}
        return {"pads": {"palm1": pad1, "palm2": pad2}, "arm": arm, "limits": limits, "plan": "lively.yaml"}

    def start_rig(self):
        """The emulated rig, and the links to its ports."""
        config = self.folder / "rig.yaml"
        config.write_text(yaml.safe_dump(self._settings()))
        self.rig = self._closes(Process(self.folder, "rig", config, "--seed", self._seed), Process.kill)
        found = json.loads(self.rig.first_line())
        for name, link in self.ports.items():
            link.unlink(missing_ok=True)
            link.symlink_to(found[name])
        self._truth, self._rig_folder = found["truth"], Path(found["arm"]).parent
        self.hand = self._closes(Client(found["control"]), Client.close)

    def start_daemon(self, record=False, **changes):
        """The daemon, with sockets of its own, and its recorder if that is wanted."""
        publish, self.command = (f"tcp://127.0.0.1:{port}" for port in free_ports(2))
        settings = self._settings() | {"bus": {"publish": publish, "command": self.command}}
        self.config.write_text(yaml.safe_dump(merged(settings, changes)))
        quietly = () if record else ("--no-record",)
        self.daemon = self._closes(Process(self.folder, "run", self.config, *quietly), Process.kill)
        self.client = self._closes(Client(self.command), Client.close)
        self.stranger = self._closes(Client(self.command), Client.close)
        self.listener = self._closes(Listener(publish), Listener.close)

    def _closes(self, thing, how):
        self._closing.append((how, thing))
        return thing

    def close(self):
        """Everything ends; the rig tidies up if it can."""
        if hasattr(self, "hand") and self.rig.alive:
            assert self.rig.end() == 0
            assert not self._rig_folder.exists()
        while self._closing:
            how, thing = self._closing.pop()
            how(thing)

    # what the daemon says

    @property
    def heard(self):
        return self.listener.heard

    @property
    def motion(self):
        return self.heard.latest["palm/motion"]

    def forget(self):
        """From here on anew."""
        self._stalls = self.status()["stalls"]
        self.listener.forget()

    def until(self, condition, what):
        """Listen until `condition(heard)` is true; the daemon must live."""

        def look():
            self.listener.drain(_LOOK_S)
            assert self.daemon.alive, f"the daemon ended: {self.daemon.said}"
            return self.heard.state is not None and condition(self.heard)

        def story():
            heard = self.heard
            rig = self.hand.ask("status") if self.rig.alive else "gone"
            return (
                f"{what}; state {heard.state}, faults {heard.active}, passed: {heard.states}, {heard.faults}\n"
                f"rig: {rig}\n{self.daemon.said[-3000:]}"
            )

        return wait(look, story, pause_s=0.0)

    def until_state(self, *states):
        self.until(lambda heard: heard.state in states, f"state {states}")

    def until_faults(self, *codes):
        """Until all of these have stood, at once or one after the other."""
        self.until(lambda heard: heard.faults.keys() >= set(codes), f"faults {codes}")

    def until_gone(self, *codes):
        """Until none of these stands."""
        self.until(lambda heard: not heard.active & set(codes), f"the end of {codes}")

    def ticks(self, count):
        """Let the daemon do so many ticks more: it lives and publishes."""
        end = self.heard.ticks + count
        self.until(lambda heard: heard.ticks >= end, f"{count} ticks more")

    # what an operator does

    def ready(self):
        """From wherever it is to `ready`."""
        self.until(lambda _: True, "the first message")
        if self.heard.state == "fault":
            wait(lambda: self.client.ask("reset")["ok"], "a reset", pause_s=0.1)
        elif self.heard.state in ("tracking", "hold"):
            self.client.do("stop")
        self.until(lambda heard: heard.state == "ready" and self.motion["arm_state"] == "R", "all ready")

    def run_plan(self):
        """The palms follow the plan, and both feel the object; nothing to do if that is so."""
        self.until(lambda _: True, "the first message")
        if self.heard.state != "tracking" or self.motion["segment"] < 0:
            self._begin()
        self.until(lambda _: self._felt(), "the object")
        self.moving()

    def moving(self):
        """The palms turn, by what the arm reports, in state tracking."""
        start = self.motion["phi1_rad"]
        self.until(
            lambda heard: (
                self._forgiven() or (heard.state == "tracking" and abs(self.motion["phi1_rad"] - start) > 0.02)
            ),
            "the palms moving",
        )

    def _forgiven(self):
        """Begin again after a hold or a fault for which the rig's own stall is to blame; returns nothing."""
        if self.heard.state in ("hold", "fault") and self._felt() and self.stalled():
            self._begin()

    def _begin(self):
        self.ready()
        self.client.ask("arm")
        self.client.ask("start")

    def _felt(self):
        return all(self.heard.latest["palm/contact"][f"touch{i}"] for i in (1, 2))

    # what the rig says

    def status(self):
        """What it has counted."""
        return self.hand.do("status")

    def until_rig(self, condition, what):
        """Until what the rig has counted is so; returns it."""
        return wait(lambda: (status := self.status()) and condition(status) and status, what)

    def stalled(self):
        """Whether a slow machine has kept the rig from its work since the last `forget`, as if it were silent."""
        return self.status()["stalls"] > self._stalls

    def truth(self):
        """What is really there now."""
        with zmq.Context() as context, context.socket(zmq.SUB) as socket:
            socket.linger = 0
            socket.connect(self._truth)
            socket.subscribe(b"rig/truth")
            assert socket.poll(GENEROUS_S * 1e3), "no truth"
            return msgpack.unpackb(socket.recv_multipart()[1])

    def at_rest(self):
        """Wait until the palms really stand; returns the truth."""
        return wait(
            lambda: (
                (truth := self.truth())
                and abs(truth["omega1_rad_s"]) + abs(truth["omega2_rad_s"]) < RESTING_RAD_S
                and truth
            ),
            "the palms at rest",
        )

    def judge(self):
        """What must hold whatever happens: the arm was only sent what is allowed, and nothing came unforeseen."""
        status = self.status()
        assert status["setpoints_outside_limits"] == 0
        assert status["largest_rate_deg_s"] <= RATE_DEG_S * 1.02
        assert status.get("refused_610", 0) == 0
        assert "Traceback" not in self.daemon.said
        assert not {"tick-error", "estimate-not-finite", "limits-violated"} & self.heard.faults.keys()
        return status


def merged(settings, changes):
    """Nested maps, the changes laid over the settings."""
    return settings | {
        key: merged(settings[key], value) if isinstance(value, dict) and key in settings else value
        for key, value in changes.items()
    }


def wait(look, what, pause_s=_LOOK_S, patience_s=GENEROUS_S):
    """What `look` returns, once it is true."""
    deadline = time.monotonic() + patience_s
    while not (found := look()):
        if time.monotonic() > deadline:
            raise AssertionError(f"waited in vain for {what() if callable(what) else what}")
        time.sleep(pause_s)
    return found


def free_ports(count):
    """Numbers of TCP ports that nobody has."""
    with contextlib.ExitStack() as stack:
        sockets = [stack.enter_context(socket.socket()) for _ in range(count)]
        for each in sockets:
            each.bind(("127.0.0.1", 0))
        return [each.getsockname()[1] for each in sockets]
