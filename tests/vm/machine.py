"""A rig PC in QEMU: its power, plugs and monitor from outside, and commands run inside by Debian's guest agent.

Pads are USB serial adapters (an FTDI chip with the guest's ftdi_sio driver), the arm is the 8250 UART ttyS1. QEMU opens
the emulated rig's pseudo-terminals as serial ports, so that baud rates are passed on. The guest runs on this machine's
processor if possible (KVM). Otherwise it is interpreted, and its time is counted in instructions, 10⁹ a second, so that
it appears to have a fast processor.
"""

from __future__ import annotations

import base64
import contextlib
import json
import os
import shlex
import signal
import socket
import subprocess
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ftdi import Adapter

BOOT_S = 400.0  # interpreted processors are slow
ADAPTERS = {"pad1": "PALM0001", "pad2": "PALM0002"}  # serial numbers
_CHUNK = 1 << 16
_ON_THE_COMMAND_LINE = "root=/dev/vda rw quiet console=ttyS0 mitigations=off"
_INTERPRETED = (
    *("-accel", "tcg,tb-size=1024", "-cpu", "Nehalem"),
    *("-icount", "shift=0,sleep=on"),  # a nanosecond per instruction
    *("-append", f"{_ON_THE_COMMAND_LINE} guest_clock_spins"),
)
_VIRTUALISED = ("-accel", "kvm", "-cpu", "host", "-append", _ON_THE_COMMAND_LINE)


def virtualised() -> bool:
    """Whether this processor can run the guest itself; a paravirtual /dev/kvm (kvm_pvm) cannot run its kernel."""
    by_hardware = any(Path("/sys/module", name).exists() for name in ("kvm_intel", "kvm_amd"))
    return by_hardware and os.access("/dev/kvm", os.R_OK | os.W_OK)


class GuestError(Exception):
    """The output of a failed command inside."""


@dataclass(frozen=True, slots=True)
class Done:
    """A command that was run inside."""

    status: int
    said: str
    """Both outputs."""


class _JsonLines:
    """JSON requests and answers on a socket, one per line, as used by QEMU's monitor and the guest's agent."""

    def __init__(self, path: Path) -> None:
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.connect(str(path))
        self._rest = b""

    def close(self) -> None:
        self._socket.close()

    def send(self, request: Mapping[str, Any]) -> None:
        self._socket.sendall(json.dumps(request).encode() + b"\n")

    def receive(self, t_end: float) -> dict[str, Any]:
        """The next line; raises TimeoutError."""
        while b"\n" not in self._rest:
            self._socket.settimeout(max(1e-3, t_end - time.monotonic()))
            data = self._socket.recv(_CHUNK)
            if not data:
                raise ConnectionError("the far end has hung up")
            self._rest += data
        line, _, self._rest = self._rest.partition(b"\n")
        answer: dict[str, Any] = json.loads(line.lstrip(b"\xff"))
        return answer

    def ask(self, command: str, seconds: float, **arguments: Any) -> Any:
        """The result of a request; raises GuestError for a refusal, TimeoutError."""
        self.send({"execute": command} | ({"arguments": arguments} if arguments else {}))
        t_end = time.monotonic() + seconds
        while True:
            answer = self.receive(t_end)
            if "error" in answer:
                raise GuestError(f"{command}: {answer['error']['desc']}")
            if "return" in answer:
                return answer["return"]


class Machine:
    """One power-on of the rig PC, from `disk` (qcow2, written to) with the installation medium in its drive."""

    def __init__(self, disk: Path, kernel: Path, initrd: Path, medium: Path, ports: Path, folder: Path) -> None:
        """`ports` holds the far ends `pad1`, `pad2` and `arm`; sockets and the console's log go to `folder`."""
        self.folder = folder
        self.disk, self._ports = disk, ports
        self._monitor_at, self._agent_at, self.chip_at = folder / "monitor", folder / "agent", folder / "chip"
        for path in (self._monitor_at, self._agent_at, self.chip_at):
            path.unlink(missing_ok=True)
        words: list[object] = [
            *("qemu-system-x86_64", "-machine", "pc", "-m", "2048"),
            *(_VIRTUALISED if virtualised() else _INTERPRETED),
            *("-nodefaults", "-no-user-config", "-display", "none", "-rtc", "base=utc"),
            *("-kernel", kernel, "-initrd", initrd),
            *("-drive", f"file={disk},if=virtio,format=qcow2,cache=writeback"),
            *("-drive", f"file={medium},if=virtio,format=raw,readonly=on"),
            *("-chardev", f"file,id=console,path={folder / 'console.log'},append=on", "-serial", "chardev:console"),
            *("-chardev", f"serial,id=arm,path={ports / 'arm'}", "-serial", "chardev:arm"),
            *("-qmp", f"unix:{self._monitor_at},server=on,wait=off"),
            *("-device", "virtio-serial-pci"),
            *("-chardev", f"socket,id=agent,path={self._agent_at},server=on,wait=off"),
            *("-device", "virtserialport,chardev=agent,name=org.qemu.guest_agent.0"),
            *("-chardev", f"socket,id=clock,path={ports / 'clock'}"),
            *("-device", "virtserialport,chardev=clock,name=clock"),
            *("-device", "qemu-xhci,id=usb"),
        ]
        for pad in ADAPTERS:
            words += ["-chardev", f"serial,id={pad},path={ports / pad}"]
            words += ["-device", json.dumps(_adapter(pad))]
        self._process = subprocess.Popen(
            ["nice", "-n", "15", *map(str, words)], stdin=subprocess.DEVNULL, stderr=(folder / "qemu.log").open("ab")
        )
        self._monitor: _JsonLines | None = None
        self._agent: _JsonLines | None = None
        self._asked = 0

    # power

    @property
    def on(self) -> bool:
        """Whether it has power."""
        return self._process.poll() is None

    def cut_power(self) -> None:
        """Cuts the power at once: unwritten data of the guest are lost."""
        self._process.send_signal(signal.SIGKILL)
        self._process.wait()
        for link in (self._monitor, self._agent):
            if link is not None:
                link.close()

    @contextlib.contextmanager
    def standing_still(self) -> Iterator[None]:
        """Stops the guest's time, with all its written data on the disk, as just before a power cut."""
        self.monitor("stop")
        try:
            yield
        finally:
            self.monitor("cont")

    def shut_down(self) -> None:
        """Shuts the guest down in order."""
        with contextlib.suppress(GuestError, TimeoutError, ConnectionError, OSError):
            self.run("sync; systemctl poweroff --no-block", seconds=60.0, check=False)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout=180.0)
        self.cut_power()

    def monitor(self, command: str, **arguments: Any) -> Any:
        """Sends a command to QEMU; returns its answer. Raises GuestError."""
        if self._monitor is None:
            self._monitor = _JsonLines(self._monitor_at)
            self._monitor.receive(time.monotonic() + 30.0)  # its greeting
            self._monitor.ask("qmp_capabilities", 30.0)
        return self._monitor.ask(command, 30.0, **arguments)

    def console(self) -> str:
        """Output of the kernel and of the first process."""
        return (self.folder / "console.log").read_text(errors="replace")

    # plugs

    def unplug(self, pad: str) -> None:
        """Unplugs an adapter; its data are lost meanwhile."""
        self.monitor("device_del", id=pad)

    def plug_chip(self, pad: str) -> Adapter:
        """Replaces an adapter by one of the same serial number whose bytes can be marked as damaged."""
        address = {"type": "unix", "data": {"path": str(self.chip_at)}}
        socket_there = {"addr": address, "server": True, "wait": False}  # QEMU removes it with the device
        self.monitor("chardev-add", id="chip", backend={"type": "socket", "data": socket_there})
        self.monitor("device_add", driver="usb-redir", id="chip", chardev="chip", bus="usb.0", port="3")
        return Adapter(self.chip_at, self._ports / pad, ADAPTERS[pad])

    def plug(self, pad: str) -> None:
        """Plugs the adapter in again."""
        far_end = os.open(self._ports / pad, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        with contextlib.suppress(BlockingIOError):  # discards data from the time it was out
            while os.read(far_end, _CHUNK):
                pass
        os.close(far_end)
        self.monitor("device_add", **_adapter(pad))

    # inside

    def until_up(self) -> None:
        """Waits for the agent; raises TimeoutError with the console's last lines."""
        t_end = time.monotonic() + BOOT_S
        while time.monotonic() < t_end:
            if not self.on:
                raise GuestError(f"QEMU has ended: {(self.folder / 'qemu.log').read_text()[-2000:]}")
            try:
                self._synchronised()
            except (TimeoutError, OSError):
                continue
            return
        raise TimeoutError(f"no agent within {BOOT_S:g} s: {self.console()[-3000:]}")

    def _synchronised(self) -> None:
        """Synchronises with the agent, so that its next answer belongs to our request."""
        if self._agent is not None:
            self._agent.close()
        self._agent = _JsonLines(self._agent_at)
        self._asked += 1
        self._agent.send({"execute": "guest-sync", "arguments": {"id": self._asked}})
        t_end = time.monotonic() + 5.0
        while self._agent.receive(t_end).get("return") != self._asked:
            pass

    def run(self, command: str, *, seconds: float = 120.0, check: bool = True, text: str = "") -> Done:
        """Runs a shell command inside as root, `text` on its standard input; raises GuestError, TimeoutError."""
        assert self._agent is not None, "until_up() first"
        begun = self._agent.ask(
            "guest-exec",
            60.0,
            path="/bin/bash",
            arg=["-c", f"exec 2>&1\n{command}"],
            env=["PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin", "LANG=C.UTF-8", "HOME=/root"],
            **{"capture-output": True, "input-data": base64.b64encode(text.encode()).decode()},
        )
        t_end, pause_s = time.monotonic() + seconds, 0.05
        while not (now := self._agent.ask("guest-exec-status", 60.0, pid=begun["pid"]))["exited"]:
            if time.monotonic() > t_end:
                raise TimeoutError(f"not within {seconds:g} s: {command}")
            time.sleep(pause_s)
            pause_s = min(1.0, 1.5 * pause_s)
        done = Done(now.get("exitcode", -now.get("signal", 0)), _decoded(now))
        if check and done.status != 0:
            raise GuestError(f"{command}\nended with status {done.status}: {done.said[-4000:]}")
        return done

    def ask(self, command: str, *, seconds: float = 120.0) -> str:
        """Output of a command that must succeed, without the last line end."""
        return self.run(command, seconds=seconds).said.rstrip("\n")

    def put(self, path: str, text: str) -> None:
        """Writes a file inside."""
        self.run(f"mkdir -p $(dirname {shlex.quote(path)}) && cat >{shlex.quote(path)}", text=text)


def _adapter(pad: str) -> dict[str, str]:
    return {
        "driver": "usb-serial",
        "id": pad,
        "chardev": pad,
        "serial": ADAPTERS[pad],
        "bus": "usb.0",
        "port": pad.removeprefix("pad"),
    }


def _decoded(status: Mapping[str, Any]) -> str:
    return base64.b64decode(status.get("out-data", "")).decode(errors="replace")
