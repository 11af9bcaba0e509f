"""palmd's services on a separate systemd, installed by `palmd install`, with the emulated rig."""

import json
import shutil
import sys
import time
from pathlib import Path

from boot import Machine, wait

from palmd.bus.command_client import CommandClient
from palmd.bus.subscriber import Subscriber
from palmd.harness.operator import Operator
from palmd.model.compiled import cache_directory

CHECKOUT = Path(__file__).parents[2]
PALMD = Path(sys.prefix) / "bin/palmd"
UNITS = ("palmd", "palmd-record", "palmd-view", "palmd-rig")
CACHE, RUNS, CONFIG = "/var/cache/palmd", "/var/lib/palmd", "/etc/palmd/palmd.yaml"
GENEROUS_S = 30.0
SEEDED = f"[Service]\nExecStart=\nExecStart={PALMD} rig --seed 3 --ports /run/palmd-rig {CONFIG}\n"


def _is_elsewhere(path):
    """Whether it is on another file system than /, which the overlay does not contain."""
    return path.stat().st_dev != Path("/").stat().st_dev


class Services:
    """The four units, and messages of daemon and rig."""

    def __init__(self, folder):
        self.machine = Machine(
            folder, sorted(filter(_is_elsewhere, {CHECKOUT, Path(sys.prefix), Path(sys.base_prefix)}))
        )
        try:
            self.installed = self._install()
            publish, command = (f"ipc://{self.machine.path(f'/run/palmd/{name}')}" for name in ("publish", "command"))
            self._subscriber = Subscriber(publish, topics=("palm/",))
            self._client = CommandClient(command, GENEROUS_S)
        except BaseException:
            self.machine.close()
            raise
        self._rig, self._rig_process = None, 0
        self.forget()

    def _install(self):
        """The output of `palmd install`; the kernels of this machine's cache are used."""
        cache = self.machine.path(CACHE)
        cache.mkdir(parents=True, exist_ok=True)
        for each in cache_directory().glob("*-*.*"):
            shutil.copy(each, cache)
        said = self.machine.run(PALMD, "install")
        config = self.machine.path(CONFIG)
        text = config.read_text().replace("/dev/palmd-", "/run/palmd-rig/").replace("rock.yaml", "lively.yaml")
        config.write_text(text)
        dropin = self.machine.path("/etc/systemd/system/palmd-rig.service.d")
        dropin.mkdir()
        (dropin / "seed.conf").write_text(SEEDED)
        self.systemctl("daemon-reload")
        self.systemctl("enable", *UNITS)
        return said

    def close(self):
        for link in (self._subscriber, self._client, self._rig):
            if link is not None:
                link.close()
        self.machine.close()

    # the service manager

    def systemctl(self, *words):
        return self.machine.run("systemctl", *words)

    def show(self, unit, *names):
        """Properties of a unit, in the given order."""
        said = self.systemctl("show", *(f"--property={name}" for name in names), unit)
        found = dict(line.split("=", 1) for line in said.splitlines())
        return found[names[0]] if len(names) == 1 else [found[name] for name in names]

    def state(self, unit):
        return self.show(unit, "ActiveState")

    def main(self, unit="palmd"):
        """The main process's number inside."""
        return int(self.show(unit, "MainPID"))

    def kill(self, signal, unit="palmd"):
        self.systemctl("kill", "--kill-whom=main", f"--signal={signal}", unit)

    def journal(self, unit):
        """Its messages: pairs of priority and text."""
        said = self.machine.run("journalctl", "--unit", unit, "--output", "json", "--no-pager")
        entries = [json.loads(line) for line in said.splitlines() if line.startswith("{")]
        return [(int(e["PRIORITY"]), e["MESSAGE"]) for e in entries if e.get("_COMM") == "palmd"]

    def until(self, condition, what):
        return wait(condition, lambda: f"{what}\n{self.systemctl_status()}", GENEROUS_S)

    def systemctl_status(self):
        return self.machine.run("systemctl", "status", "--no-pager", "--lines=20", *UNITS, check=False)

    def all_stopped(self):
        """The initial state of each test."""
        self.systemctl("stop", *UNITS)
        self.systemctl("reset-failed")
        self.forget()

    def started(self):
        """Starts all four; the daemon is ready for commands."""
        self.systemctl("start", "palmd")
        self.hear(lambda: self.heard["palm/state"]["state"] == "ready" and self.arm_letter() == "R", "ready")

    # daemon and rig

    def forget(self):
        """Forgets all messages so far."""
        for _ in self._subscriber.until(time.monotonic() + 0.05):
            pass
        self.heard = {}
        self.ticks = 0

    def hear(self, condition, what):
        """Receives until the condition is true; it may need messages that have not come yet."""

        def look():
            for message in self._subscriber.until(time.monotonic() + 0.1):
                self.heard[message.topic] = message.fields
                self.ticks += message.topic == "palm/estimate"
            try:
                return condition()
            except KeyError:
                return False

        self.until(look, what)

    def arm_letter(self):
        return self.heard["palm/motion"]["arm_state"]

    def moving(self):
        """Waits until the arm follows a plan; the operator retries after stops caused by a slow machine."""
        operator, start = Operator(), self.heard["palm/motion"]["phi1_rad"]

        def moves():
            for topic, fields in self.heard.items():
                operator.take(topic, fields)
            command = operator.decide(time.monotonic())
            if command is not None:
                self._client.ask(command)
            return operator.moves and abs(self.heard["palm/motion"]["phi1_rad"] - start) > 0.02

        self.hear(moves, "motion")

    def rig(self):
        """The rig's counters."""
        if self._rig is None or self._rig_process != self.main("palmd-rig"):
            if self._rig is not None:
                self._rig.close()
            self._rig_process = self.main("palmd-rig")
            reports = [text for _, text in self.journal("palmd-rig") if text.startswith("{")]
            with self.machine.network():
                self._rig = CommandClient(json.loads(reports[-1])["control"], GENEROUS_S)
        return self._rig.ask("status")["result"]

    def commanded(self):
        """Requests to the controller that may move the arm: starts of tracking, set-points, resets."""
        rig = self.rig()
        return rig["starts"], rig["setpoints"], rig["resets"]
