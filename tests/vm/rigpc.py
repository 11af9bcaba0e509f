"""A rig PC with palmd, and the emulated rig at the far ends of its lines."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from image import CHECKOUT, Image
from machine import ADAPTERS, Machine

from palmd.bus.command_client import CommandClient

PALMD = "/opt/palmd/bin/palmd"
PYTHON = "/opt/palmd/bin/python"
CONFIG, NAMES = "/etc/palmd/palmd.yaml", "/etc/udev/rules.d/71-palmd-names.rules"
RUNS, HEARD, HEAR_AT = "/var/lib/palmd", "/run/heard.json", "/opt/hear.py"
CALIBRATED_ZERO_MM = 28.4
# The guest's processor executes 10⁹ instructions a second, a tenth of a rig PC's core: the cheapest observer at half
# the usual rate. All other settings are those of `palmd install`.
SLOWER = (("observer: {primary: shape}", "observer: {primary: quasistatic}"), ("rate_hz: 100", "rate_hz: 50"))
BY_SERIAL = "".join(
    f'SUBSYSTEM=="tty", ENV{{ID_SERIAL_SHORT}}=="{number}", SYMLINK+="palmd-{pad}", GROUP="palmd", MODE="0660"\n'
    for pad, number in ADAPTERS.items()
)
ARM_NAME = 'KERNEL=="ttyS1", SUBSYSTEM=="tty", SYMLINK+="palmd-arm", GROUP="palmd", MODE="0660"\n'
INSTALL_S, START_S = 3000.0, 300.0

# Inside: keeps the last message of each slow topic in a JSON file, because starting an interpreter there takes seconds.
HEAR = f"""
import json, os
from palmd.bus.link import PUBLISH
from palmd.bus.subscriber import Subscriber
heard = {{}}
with Subscriber(PUBLISH, topics=("palm/loop", "palm/state", "palm/info")) as subscriber:
    for message in subscriber.until(1e6):
        heard[message.topic] = message.fields
        with open("{HEARD}.part", "w") as file:
            json.dump(heard, file)
        os.replace("{HEARD}.part", "{HEARD}")
"""
HEAR_UNIT = f"[Service]\nExecStart={PYTHON} {HEAR_AT}\nRestart=always\n[Install]\nWantedBy=multi-user.target\n"


def configure(root: Path) -> None:
    """Writes a first configuration: the ports' names, a calibration, and a slower loop."""
    with (root / NAMES.lstrip("/")).open("a") as names:
        names.write("\n" + BY_SERIAL + ARM_NAME)
    path = root / CONFIG.lstrip("/")
    config = path.read_text()
    for shipped, ours in (*SLOWER, ("zero_mm: 28.0", f"zero_mm: {CALIBRATED_ZERO_MM}")):
        assert shipped in config, f"{path} has no {shipped}"
        config = config.replace(shipped, ours)
    path.write_text(config)
    (root / HEAR_AT.lstrip("/")).write_text(HEAR)
    units = root / "etc/systemd/system"
    (units / "hear.service").write_text(HEAR_UNIT)
    (units / "multi-user.target.wants/hear.service").symlink_to("/etc/systemd/system/hear.service")


class Rig:
    """The emulated rig on the time of the running machine; see `farside.py`."""

    def __init__(self, folder: Path) -> None:
        self.ports = folder
        self._process = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name("farside.py")), str(folder)],
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | {"PYTHONPATH": str(CHECKOUT / "src")},
        )
        assert self._process.stdout is not None
        self._control = CommandClient(json.loads(self._process.stdout.readline())["control"], 10.0)

    def status(self) -> dict:
        """The rig's counters, and `guest_ns`, the guest's monotonic clock."""
        return self._control.ask("status")["result"]

    def close(self) -> None:
        self._control.close()
        self._process.send_signal(signal.SIGTERM)
        self._process.wait(timeout=10.0)


class RigPC:
    """The machine, with an operator's actions."""

    def __init__(self, image: Image, disk: Path, rig: Rig, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.begun = time.monotonic()
        self.machine = Machine(disk, image.kernel, image.initrd, image.medium, rig.ports, folder)
        try:
            self.machine.until_up()
        except BaseException:
            self.machine.cut_power()
            raise
        self.boot_s = time.monotonic() - self.begun
        self.ask, self.run, self.put = self.machine.ask, self.machine.run, self.machine.put

    # palmd on it

    def install(self, version: str) -> str:
        """Installs from the medium, without a network; returns the output of `palmd install`."""
        self.ask("mkdir -p /media/wheels; mountpoint -q /media/wheels || mount -o ro /dev/vdb /media/wheels")
        self.ask("test -x /opt/palmd/bin/pip || python3 -m venv /opt/palmd", seconds=INSTALL_S)
        self.ask(
            f"/opt/palmd/bin/pip install -q --no-index --find-links /media/wheels palmd=={version}", seconds=INSTALL_S
        )
        return self.ask(f"{PALMD} install", seconds=INSTALL_S)

    def hear(self) -> dict:
        """The last messages of the slow topics, all later than this call."""
        now_ns = int(float(self.ask("cut -d' ' -f1 /proc/uptime")) * 1e9)

        def later():
            done = self.run(f"cat {HEARD}", check=False)
            heard = {} if done.status else json.loads(done.said)
            topics = ("palm/loop", "palm/state", "palm/info")
            return all(heard.get(topic, {}).get("mono_ns", 0) > now_ns for topic in topics) and heard

        return self.until(later, "all slow topics")

    def until(self, condition, what: str, seconds: float = START_S, pause_s: float = 1.0):
        """The first true value of `condition`."""
        t_end = time.monotonic() + seconds
        while not (value := condition()):
            assert time.monotonic() < t_end, f"not within {seconds:g} s: {what}\n{self.journal()}"
            time.sleep(pause_s)
        return value

    def journal(self, unit: str = "palmd", lines: int = 40) -> str:
        return self.run(f"journalctl -b -u {unit} -n {lines} --no-pager -o cat", check=False).said

    def show(self, unit: str, name: str) -> str:
        return self.ask(f"systemctl show --value -p {name} {unit}")

    def ready(self) -> None:
        """Waits until the daemon has reported READY with everything connected."""
        self.until(lambda: self.show("palmd", "ActiveState") == "active", "active")
        self.until(lambda: self.show("palmd", "StatusText").startswith("ready"), "ready")

    def status(self) -> str:
        return self.show("palmd", "StatusText")

    def close(self) -> None:
        self.machine.shut_down()


def overlay(base: Path, target: Path) -> Path:
    """A disk that starts as `base` and leaves it unchanged."""
    target.unlink(missing_ok=True)
    words = ["qemu-img", "create", "-q", "-f", "qcow2", "-F", "raw", "-b", str(base), str(target)]
    subprocess.run(words, check=True)
    return target


@contextlib.contextmanager
def powered(image: Image, disk: Path, rig: Rig, folder: Path):
    """A running machine that is switched off in any case."""
    pc = RigPC(image, disk, rig, folder)
    try:
        yield pc
    finally:
        if pc.machine.on:
            pc.machine.cut_power()
