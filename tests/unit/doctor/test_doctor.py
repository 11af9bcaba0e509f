"""`palmd doctor`: each missing prerequisite is found, with the command that fixes it."""

import os
import socket
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest
import terminals
from shut import shut

from palmd.cli import main
from palmd.config.arms import AdeptConfig
from palmd.config.pads import VersaPadConfig
from palmd.console import configured
from palmd.console.shipped import shipped
from palmd.daemon import realtime
from palmd.daemon.bus import Bus
from palmd.daemon.commands import Reply
from palmd.devices.versapad import encode_packet
from palmd.doctor import machine, ports
from palmd.doctor.arm import answers
from palmd.doctor.findings import bus, daemon, findings, plan
from palmd.model import compiled
from palmd.quantities import RIG
from palmd.yamlfile import load_config

CONFIG = """\
pads: {{palm1: {{port: {folder}/pad1}}, palm2: {{port: {folder}/pad2}}}}
arm: {{port: {folder}/arm}}
bus: {{publish: "ipc://{folder}/publish", command: "ipc://{folder}/command"}}
"""


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "palmd.yaml"
    path.write_text(CONFIG.format(folder=tmp_path))
    return path


@contextmanager
def terminal(link):
    """A pseudo-terminal under a fixed name; the descriptor of its far end."""
    with terminals.line() as (far, port):
        link.symlink_to(port)
        try:
            yield far
        finally:
            link.unlink()


def found(path):
    return {finding.what: finding for finding in findings(path)}


def test_missing_ports_are_reported_and_all_other_checks_are_made(path, capsys):
    assert main(["doctor", str(path)]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert next(line for line in lines if "pad 1 port" in line).startswith("missing")
    assert "/dev/serial/by-id" in "".join(line for line in lines if "arm port" in line)
    assert [line.split()[0] for line in lines if "  python  " in line] == ["ok"]
    assert lines[lines.index("") - 1].split(", ")[1].endswith("missing")
    assert not any("talks" in line or "answers" in line for line in lines)


def test_a_bad_configuration_ends_the_list_with_its_place(path, capsys):
    path.write_text("pads: 3\n")
    assert main(["doctor", str(path)]) == 1
    [line] = [line for line in capsys.readouterr().out.splitlines() if "configuration" in line]
    assert line.startswith("missing")
    assert f"{path}:1:" in line
    assert f"palmd check {path}" in line


def test_the_exit_status_is_zero_only_if_every_check_passes(monkeypatch, path):
    from palmd.doctor import findings
    from palmd.doctor.finding import Finding

    for verdicts, status in ((("ok", "ok"), 0), (("ok", "missing"), 1), (("ok", "unknown"), 1)):
        made = [Finding("a", each, "b") for each in verdicts]
        monkeypatch.setattr(findings, "findings", lambda _path, made=made: iter(made))
        monkeypatch.setattr(findings, "latency_tree", list)
        assert main(["doctor", str(path)]) == status


# -- the machine -----------------------------------------------------------------------------------------------


def test_python():
    assert machine.python((3, 11, 0)).verdict == "ok"
    assert machine.python((3, 10, 12)).verdict == "missing"


def test_packages(monkeypatch):
    assert machine.packages().verdict == "ok"
    assert machine.packages("nobody-made-this").verdict == "unknown"
    needed = ["numpy>=1", "no-such-thing[x]>=2 ; python_version > '3'", "neither-this; extra == 'report'"]
    monkeypatch.setattr(machine.importlib.metadata, "requires", lambda _: needed)
    assert machine.packages().text == "no-such-thing"


def test_compiler(monkeypatch, tmp_path):
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert machine.compiler().verdict == "missing"
    (tmp_path / "gcc").touch(0o755)
    assert machine.compiler().verdict == "missing"
    assert "gcc" in machine.compiler().text
    monkeypatch.undo()
    assert machine.compiler().verdict == "ok"


def test_a_wheel_with_compiled_observers_needs_no_compiler(monkeypatch, tmp_path):
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("CACHE_DIRECTORY", str(tmp_path / "cache"))
    monkeypatch.setattr(compiled, "SHIPPED", tmp_path)
    (tmp_path / "shape-12.so").touch()
    (tmp_path / compiled.NEEDS).write_text("AVX9000")
    assert {machine.compiler().verdict, machine.observers().verdict} == {"missing"}
    (tmp_path / compiled.NEEDS).write_text("")
    assert {machine.compiler().verdict, machine.observers().verdict} == {"ok"}
    assert machine.observers().text == f"1 compiled in {tmp_path}"


def test_observers(monkeypatch, tmp_path):
    monkeypatch.setenv("CACHE_DIRECTORY", str(tmp_path / "cache"))
    assert machine.observers().fix == "palmd doctor build"
    (tmp_path / "cache").mkdir()
    (tmp_path / "cache/shape-12.so").touch()
    assert machine.observers().verdict == "ok"


@pytest.mark.parametrize("what", ["cache", "cache/deeper"])
def test_observers_in_an_unreadable_folder(monkeypatch, tmp_path, what):
    monkeypatch.setenv("CACHE_DIRECTORY", str(tmp_path / what))
    (tmp_path / "cache/deeper").mkdir(parents=True)
    with shut(tmp_path / "cache"):
        finding, user = machine.observers(), realtime.user()
    assert (finding.verdict, finding.text) == ("missing", f"{tmp_path / what}: Permission denied")
    assert finding.fix == f"set XDG_CACHE_HOME to a folder of {user}'s own, then run palmd doctor build"


def test_observers_without_a_home_folder(monkeypatch):
    for name in ("CACHE_DIRECTORY", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)

    def homeless():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", homeless)
    assert "has no home" in machine.observers().text


def test_an_implausible_value_is_reported(tmp_path, capsys):
    path = tmp_path / "palmd.yaml"
    ports = "pads: {palm1: {port: /dev/none1, zero_mm: 0.028}, palm2: {port: /dev/none2}}\narm: {port: /dev/none3}\n"
    path.write_text(ports)
    assert main(["doctor", str(path)]) == 1
    [line] = [line for line in capsys.readouterr().out.splitlines() if " configuration " in line]
    assert line.startswith("mismatch ")
    assert line.endswith(f"did you mean 28 mm?: palmd check {path}")


def test_an_unreadable_installed_configuration_is_reported(monkeypatch, tmp_path):
    folder = tmp_path / "etc"
    folder.mkdir()
    monkeypatch.setattr(configured, "INSTALLED", folder / "palmd.yaml")
    with shut(folder):
        assert configured.default_path(None) == folder / "palmd.yaml"
    assert configured.default_path(None) == shipped("palmd.yaml")


@pytest.mark.parametrize(("what", "limit"), [("real_time", "RTPRIO"), ("locked_memory", "MEMLOCK")])
def test_rights(monkeypatch, tmp_path, what, limit):
    (tmp_path / "self").mkdir()
    status = tmp_path / "self/status"
    monkeypatch.setattr(machine, "PROC", tmp_path)
    for effective, allowed, verdict in (("0", 0, "missing"), ("0", -1, "ok"), ("0000000000804000", 0, "ok")):
        status.write_text(f"Name:\tx\nCapEff:\t{effective}\n")
        asked = []
        monkeypatch.setattr(machine.resource, "getrlimit", lambda name, n=allowed, a=asked: a.append(name) or (n, n))
        finding = getattr(machine, what)()
        assert finding.verdict == verdict
        assert asked == [getattr(machine.resource, f"RLIMIT_{limit}")]
    assert "limits.d" not in finding.fix


def test_the_daemons_start_suggests_the_same_commands_as_doctor(monkeypatch):
    def forbidden(*_):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(realtime.os, "sched_setscheduler", forbidden)
    monkeypatch.setattr(realtime.resource, "getrlimit", lambda _: (0, 0))
    monkeypatch.setattr(realtime, "_may_lock", lambda: False)
    monkeypatch.setattr(machine, "_capable", lambda _: False)
    as_text = [realtime._prioritise(realtime.PRIORITY), realtime._lock_memory()]
    for text, finding in zip(as_text, (machine.real_time(), machine.locked_memory()), strict=True):
        command = finding.fix.split("; ")[0]
        assert "sudo tee -a /etc/security/limits.d/" in command
        assert text.endswith(command)


LOCKING = """
import ctypes, encodings.ascii, os, resource, sys  # Python's own files may be out of reach once rights are laid down
from palmd.doctor.machine import locked_memory
limit = int(sys.argv[1])
resource.setrlimit(resource.RLIMIT_MEMLOCK, (limit, limit))
if sys.argv[2] == "stripped":
    os.setresuid(65534, 65534, 65534)
locks = ctypes.CDLL(None).mlockall(3) == 0  # what is there and what comes, as the daemon asks for it
print(locked_memory().verdict, locked_memory().text, locks, sep="|")
"""


@pytest.mark.parametrize("rights", ["own", "stripped"])
@pytest.mark.parametrize("limit", [1_000_000, -1], ids=["limited", "unlimited"])
def test_locked_memory_agrees_with_the_kernel(limit, rights):
    """In a process of its own, which tries to lock all its memory."""
    if rights == "stripped" and os.geteuid() != 0:
        pytest.skip("only root has rights to lay down")
    command = [sys.executable, "-c", LOCKING, str(limit), rights]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if "not allowed to raise maximum limit" in done.stderr:
        pytest.skip("this user may not raise the limit")
    verdict, says, locks = done.stdout.strip().split("|")
    assert verdict == ("ok" if locks == "True" else "missing")
    assert says == ("no limit" if verdict == "ok" else "limited to 1.0 MB")
    if rights == "stripped":
        assert verdict == ("missing" if limit > 0 else "ok")


def test_runs(monkeypatch, tmp_path):
    monkeypatch.setattr(machine.shutil, "disk_usage", lambda _: SimpleNamespace(free=5e9))
    assert machine.runs(tmp_path / "a/b").verdict == "ok"
    monkeypatch.setattr(machine.shutil, "disk_usage", lambda _: SimpleNamespace(free=1e9))
    assert "1000 MB free" in machine.runs(tmp_path / "a/b").text
    (tmp_path / "file").touch()
    assert machine.runs(tmp_path / "file/b").verdict == "missing"
    finding = machine.runs(tmp_path / ("a" * 300))
    assert (finding.verdict, finding.text.endswith("File name too long")) == ("missing", True)


def test_units(monkeypatch, tmp_path):
    assert machine.units([tmp_path]).fix == "sudo palmd install"
    for name in machine.UNITS:
        (tmp_path / name).touch()
    monkeypatch.setattr(machine, "SYSTEMD_RUNS", tmp_path / "none")
    assert machine.units([tmp_path / "other", tmp_path]).verdict == "unknown"
    monkeypatch.setattr(machine, "SYSTEMD_RUNS", tmp_path)
    assert machine.units([tmp_path]).verdict == "ok"


# -- files and sockets -----------------------------------------------------------------------------------------


def test_plan(path, tmp_path):
    assert plan(load_config(path), path).verdict == "ok"
    path.write_text(path.read_text() + "plan: far.yaml\n")
    assert plan(load_config(path), path).verdict == "missing"
    (tmp_path / "far.yaml").write_text("name: far\nsegments: [{move: {phi1_deg: 175}, duration_s: 2}]\n")
    assert "far.yaml:2:" in plan(load_config(path), path).text
    (tmp_path / "far.yaml").write_text("name: near\nsegments: [{hold_s: 1}]\n")
    assert plan(load_config(path), path).verdict == "ok"


def test_a_bus_address_is_free_or_in_use(path):
    config = load_config(path)
    assert daemon(config) is None
    assert bus(config, None).verdict == "ok"
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        path.write_text(path.read_text().replace(f'"ipc://{path.parent}/publish"', f'"tcp://127.0.0.1:{port}"'))
        finding = bus(load_config(path), None)
    assert finding.verdict == "missing"
    assert f"sport = :{port}" in finding.fix


def test_a_running_daemon_is_asked_about_its_ports(path, tmp_path):
    off = ["pad 1's zero seems +0.30 ± 0.03 mm off: mend it"]
    status = {"state": "ready", "faults": ["pad1-port", "arm-link-lost"], "arm_state": "R"}
    server, over = Bus(f"ipc://{tmp_path}/publish", f"ipc://{tmp_path}/command"), threading.Event()

    def serve():
        while not over.wait(0.002):
            server.publish(RIG, {"contradictions": off}, 0.0, 0.0)
            for request in server.receive():
                server.reply(Reply(request, None, status))

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        with terminal(tmp_path / "pad1"), terminal(tmp_path / "pad2"), terminal(tmp_path / "arm"):
            seen = found(path)
    finally:
        over.set()
        thread.join()
        server.close()
    assert "state ready" in seen["bus"].text
    assert (seen["pad 1 talks"].verdict, seen["pad 2 talks"].verdict) == ("missing", "ok")
    assert "arm-link-lost" in seen["arm answers"].text
    rig = seen["rig's constants"]
    assert (rig.verdict, rig.text, rig.fix) == ("mismatch", "pad 1's zero seems +0.30 ± 0.03 mm off", "mend it")


# -- ports -----------------------------------------------------------------------------------------------------


def test_a_port_is_free_or_in_use_or_not_permitted(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    assert "not a serial port" in ports.port_finding("arm", str(tmp_path / "file")).text
    with socket.socket(socket.AF_UNIX) as line:
        line.bind(str(tmp_path / "socket"))
        assert ports.port_finding("arm", str(tmp_path / "socket")).verdict == "ok"
    with terminal(tmp_path / "arm"):
        assert ports.port_finding("arm", str(tmp_path / "arm")).verdict == "ok"
        monkeypatch.setattr(ports.os, "access", lambda *_: False)
        monkeypatch.setattr(ports, "_group", lambda _: "dialout")
        finding = ports.port_finding("arm", str(tmp_path / "arm"))
    assert finding.verdict == "missing"
    assert finding.fix.startswith(f"sudo usermod -aG dialout {realtime.user()},")


@pytest.mark.parametrize(("name", "verdict"), [("stranger", "missing"), ("palmd", "ok")])
def test_the_process_that_has_a_port_open_is_named(tmp_path, name, verdict):
    """A process with a known name has it open."""
    script = tmp_path / name
    script.write_text("import sys, time\nport = open(sys.argv[1], 'rb')\nprint(flush=True)\ntime.sleep(60)\n")
    with terminal(tmp_path / "arm"):
        command = [sys.executable, str(script), str(tmp_path / "arm")]
        with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
            process.stdout.readline()
            finding = ports.port_finding("arm", str(tmp_path / "arm"))
            process.kill()
    assert finding.verdict == verdict
    assert f"({process.pid})" in finding.text if verdict == "missing" else "in use by palmd" in finding.text


def test_latency_timers(tmp_path, monkeypatch):
    monkeypatch.setattr(ports, "USB_SERIAL", tmp_path)
    assert ports.latency("arm", "/dev/ttyUSB7").verdict == "ok"
    (tmp_path / "ttyUSB7").mkdir()
    for milliseconds, verdict in ((16, "missing"), (1, "ok")):
        (tmp_path / "ttyUSB7/latency_timer").write_text(f"{milliseconds}\n")
        assert ports.latency("arm", "/dev/ttyUSB7").verdict == verdict


@pytest.mark.parametrize(
    ("data", "verdict", "says"),
    [
        (encode_packet(10, 20, 30), "ok", "reports in"),
        (b"\x07\x55", "missing", "at 9600 baud"),
        (b"", "unknown", "no reports"),
    ],
)
def test_a_pad_that_sends_is_detected(tmp_path, path, data, verdict, says):
    over = threading.Event()
    with terminal(tmp_path / "pad1") as master:

        def speak():
            while not over.wait(0.05):
                os.write(master, data)

        thread = threading.Thread(target=speak)
        thread.start()
        finding = ports.pad_talks("pad 1", VersaPadConfig(port=str(tmp_path / "pad1")), path)
        over.set()
        thread.join()
    assert finding.verdict == verdict
    assert says in finding.text


def test_a_silent_arm_is_reported(tmp_path, path):
    with terminal(tmp_path / "arm"):
        t = time.monotonic()
        finding = answers(AdeptConfig(port=str(tmp_path / "arm")))
        assert time.monotonic() - t < 10.0
    assert finding.verdict == "missing"
    assert "tools/adept/README.md" in finding.fix


def test_equally_numbered_pseudo_terminals_of_containers_are_distinct_ports():
    def device(major: int, minor: int, of: int) -> os.stat_result:
        return os.stat_result((0, 0, of, 0, 0, 0, 0, 0, 0, 0), {"st_rdev": os.makedev(major, minor)})

    assert ports.same_port(device(136, 3, 24), device(136, 3, 24))
    assert not ports.same_port(device(136, 3, 77), device(136, 3, 24))
    assert not ports.same_port(device(136, 4, 24), device(136, 3, 24))
    assert ports.same_port(device(188, 0, 5), device(188, 0, 6)), "a USB port is one port wherever /dev is"


def test_the_process_that_holds_a_port_is_found(monkeypatch):
    with terminals.line() as (_, port):
        assert os.getpid() in [process for process, _ in ports.holders(port)]
        assert ports.holders("/dev/ttyNobody") == []
        monkeypatch.setattr(ports, "same_port", lambda *_: False)  # as if every port were a container's
        assert ports.holders(port) == []
