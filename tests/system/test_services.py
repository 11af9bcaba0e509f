"""palmd's units under a real systemd: readiness, restarts without motion, stops, rights."""

import re
import shutil
import time
from pathlib import Path

import pytest
from services import CONFIG, PALMD, RUNS, UNITS

from palmd.daemon.realtime import PRIORITY

pytestmark = pytest.mark.system

OLD = Path(__file__).parents[1] / "data/0.2"
STOP_S = 2.0
EXPOSURE_MOST = 2.0
FIFO, HELPER = (f"SCHED_FIFO|SCHED_RESET_ON_FORK {priority}" for priority in (PRIORITY, PRIORITY - 1))


@pytest.mark.parametrize("unit", UNITS)
def test_units_have_little_exposure(services, unit):
    said = services.machine.run("systemd-analyze", "security", "--no-pager", f"{unit}.service")
    assert float(re.search(r"exposure level for .*: ([\d.]+)", said)[1]) <= EXPOSURE_MOST


def test_a_second_install_keeps_changed_files(services):
    said = services.machine.run(PALMD, "install")
    assert "kept     /etc/palmd/palmd.yaml" in said
    assert "kept     /etc/udev/rules.d/71-palmd-names.rules" in said
    assert "/run/palmd-rig/pad1" in services.machine.path("/etc/palmd/palmd.yaml").read_text()


def test_ready_means_that_ports_are_open_and_the_controller_has_answered(services):
    services.systemctl("mask", "--runtime", "palmd-rig")
    try:
        services.systemctl("start", "--no-block", "palmd")
        services.hear(lambda: services.ticks > 100, "ticks without a rig")
        assert services.heard["palm/state"]["state"] == "idle"
        assert services.show("palmd", "ActiveState", "NRestarts") == ["activating", "0"]
        assert "idle, arm-port, pad1-port, pad2-port" in services.show("palmd", "StatusText")
    finally:
        services.systemctl("unmask", "--runtime", "palmd-rig")
    services.systemctl("start", "palmd-rig")
    services.until(lambda: services.state("palmd") == "active", "active")
    services.hear(lambda: services.heard["palm/state"]["state"] == "ready", "ready")
    assert services.commanded() == (0, 0, 0)


def test_companion_units_start_and_stop_with_the_daemon(services):
    services.started()
    services.until(lambda: [services.state(unit) for unit in UNITS] == ["active"] * 4, "all active")
    began, listening = (int(services.show(unit, "ActiveEnterTimestampMonotonic")) for unit in ("palmd", "palmd-record"))
    assert listening < began
    companions = ("palmd-record", "palmd-view")
    for unit in companions:
        services.kill("SIGKILL", unit)
    services.until(
        lambda: all(services.show(unit, "ActiveState", "NRestarts") == ["active", "1"] for unit in companions), "both"
    )
    assert services.show("palmd", "ActiveState", "NRestarts") == ["active", "0"]
    services.systemctl("stop", "palmd")
    expected = ["inactive", "inactive", "inactive", "active"]
    services.until(lambda: [services.state(unit) for unit in UNITS] == expected, "the companions' end")
    assert services.show("palmd-record", "Result") == "success"
    runs = list(services.machine.path(RUNS).glob("*.mcap"))
    assert services.machine.run("stat", "--format=%U %a", *(f"{RUNS}/{run.name}" for run in runs)).split() == [
        "palmd",
        "640",
    ] * len(runs)
    newest = max(runs, key=lambda run: run.stat().st_mtime)
    said = services.machine.run(PALMD, "runs", "recover", f"{RUNS}/{newest.name}", "-o", "/run/whole.mcap")
    assert "messages" in said


def test_stop_brings_the_arm_to_rest_in_time(services):
    services.started()
    services.moving()
    begun = time.monotonic()
    services.systemctl("kill", "--kill-whom=main", "--signal=SIGTERM", "palmd")
    services.until(lambda: services.state("palmd") == "inactive", "the end")
    ended = int(services.show("palmd", "ExecMainExitTimestampMonotonic")) * 1e-6
    assert ended - begun < STOP_S
    assert services.show("palmd", "Result", "ExecMainStatus", "NRestarts") == ["success", "0", "0"]
    assert services.rig()["arm_state"] == "R"


def test_a_hanging_daemon_is_restarted_without_commands_to_the_arm(services):
    services.started()
    hung = services.main()
    services.kill("SIGSTOP")
    services.until(lambda: services.show("palmd", "NRestarts") == "1", "the watchdog")
    services.forget()
    services.hear(lambda: services.heard["palm/state"]["state"] == "ready", "ready again")
    services.until(lambda: services.state("palmd") == "active", "active again")
    assert services.main() != hung
    services.hear(lambda: services.ticks > 100, "a second of ticks")
    assert services.commanded() == (0, 0, 0)
    said = "\n".join(text for _, text in services.journal("palmd"))
    assert 'loop.py", line' in said.partition("Fatal Python error")[2]


def test_after_a_crash_in_motion_nothing_moves_the_arm(services):
    services.started()
    services.moving()
    services.kill("SIGKILL")
    services.until(lambda: services.show("palmd", "NRestarts") == "1", "the restart")
    before = services.commanded()
    assert services.rig()["arm_state"] == "F"
    services.forget()
    services.hear(lambda: services.heard["palm/state"]["state"] != "idle", "a state")
    services.until(lambda: services.state("palmd") == "active", "active again")
    services.hear(lambda: services.ticks > 100, "a second of ticks")
    assert services.commanded() == before
    assert "arm-fault" in services.heard["palm/state"]["faults"]
    assert services.show("palmd-record", "ActiveState", "NRestarts") == ["active", "0"]


def test_an_invalid_configuration_is_reported_without_restarts(services):
    config = services.machine.path("/etc/palmd/palmd.yaml")
    right = config.read_text()
    config.write_text(right.replace("rate_hz: 100", "rate_hz: quick"))
    try:
        services.machine.run("systemctl", "start", "palmd", check=False)
        assert services.show("palmd", "ActiveState", "ExecMainStatus", "NRestarts") == ["failed", "1", "0"]
    finally:
        config.write_text(right)
    assert any("palmd.yaml:" in text and "rate_hz" in text for _, text in services.journal("palmd"))


def test_a_restarting_rig_causes_no_restart_and_no_motion(services):
    services.started()
    services.systemctl("stop", "palmd-rig")
    services.hear(lambda: services.heard["palm/state"]["state"] == "idle", "idle")
    services.systemctl("start", "palmd-rig")
    services.hear(lambda: services.heard["palm/state"]["state"] == "ready", "ready again")
    assert services.show("palmd", "ActiveState", "NRestarts") == ["active", "0"]
    assert services.commanded() == (0, 0, 0)


def test_a_plan_in_a_hidden_home_folder_is_sent_by_content(services):
    services.started()
    plan = Path.home() / "of-a-user.yaml"
    inside = services.machine.path(str(plan))
    inside.parent.mkdir(parents=True, exist_ok=True)
    inside.write_text("name: of a user\nsegments:\n  - {hold_s: 1.0}\n")
    assert services.machine.run(PALMD, "ctl", "plan", str(plan)).strip() == "state ready, plan of a user"


def test_its_rights_are_sufficient_and_minimal(services):
    services.started()
    pid = services.main()
    threads = services.machine.run("chrt", "--all-tasks", "--pid", pid)
    policies = re.findall(r"policy: (\S+)\n.*priority: (\d+)", threads)
    assert " ".join(policies[0]) == FIFO
    status = services.machine.path(f"/proc/{pid}/status").read_text()
    fields = dict(line.split(":\t", 1) for line in status.splitlines())
    assert {int(fields[name], 16) for name in ("CapInh", "CapPrm", "CapEff", "CapBnd", "CapAmb")} == {0}
    limit = services.machine.path(f"/proc/{pid}/limits").read_text()
    if re.search(r"Max locked memory +unlimited", limit):  # a container's manager may not grant it
        assert int(fields["VmLck"].split()[0]) > 10_000
    granted = re.search(rf"Max realtime priority +{PRIORITY - 1} ", limit) is not None  # nor this
    threads_of_python = {HELPER} if granted else set()
    assert {" ".join(each) for each in policies[1:]} == {"SCHED_OTHER 0"} | threads_of_python
    services.hear(lambda: "palm/loop" in services.heard, "palm/loop")
    assert services.heard["palm/loop"]["backend"] == "c"
    assert not {"vm-backend", "recorder-failed", "recorder-silent"} & set(services.heard["palm/state"]["faults"])
    assert not [text for _, text in services.journal("palmd") if "virtual machine" in text]


def test_log_lines_have_priorities(services):
    services.started()
    services.systemctl("stop", "palmd")
    lines = services.journal("palmd")
    assert (6, "idle -> ready") in lines
    assert any(priority == 4 and text.startswith("fault ") for priority, text in lines)
    assert not any(text.startswith("<") for _, text in lines)


def test_an_upgrade_from_0_2_keeps_configuration_keys_and_runs(services):
    """Units, configuration and recording of 0.2 are put in place; then the present palmd is installed over them."""
    machine = services.machine
    ours = machine.path("/etc/palmd"), machine.path("/usr/local/lib/systemd/system")
    kept = [machine.path(f"/run/kept-{number}") for number in range(len(ours))]
    for folder, aside in zip(ours, kept, strict=True):
        shutil.copytree(folder, aside)
    try:
        shutil.copytree(OLD / "root/usr", machine.path("/usr"), dirs_exist_ok=True)
        shutil.copytree(OLD / "root/etc/palmd", ours[0], dirs_exist_ok=True)
        config = machine.path(CONFIG)
        mine = config.read_text().replace("/dev/palmd-", "/run/palmd-rig/")
        mine = mine.replace('9873"}', '9873", keys: keys}').replace("rock.yaml", "lively.yaml")
        config.write_text(mine)
        run = machine.path(f"{RUNS}/2026-11-23T06-00-00Z.mcap")
        shutil.copy(OLD / "run.mcap", run)
        machine.run(PALMD, "keys", "new", "server", "-d", "/etc/palmd/keys")
        machine.run(PALMD, "keys", "new", "client", "desk", "--role", "operate", "-d", "/etc/palmd/keys")
        machine.run("chown", "-R", "palmd", "/etc/palmd/keys")
        keys = {path.name: path.read_bytes() for path in machine.path("/etc/palmd/keys").rglob("*") if path.is_file()}
        said = machine.run(PALMD, "install")
        assert f"kept     {CONFIG}" in said
        assert config.read_text() == mine
        assert run.read_bytes() == (OLD / "run.mcap").read_bytes()
        assert {p.name: p.read_bytes() for p in machine.path("/etc/palmd/keys").rglob("*") if p.is_file()} == keys
        services.systemctl("start", "palmd")
        services.until(lambda: services.state("palmd") == "active", "today's daemon with the configuration of 0.2")
        desk = ("--key", "/etc/palmd/keys/desk.key_secret")
        assert "ready" in machine.run(PALMD, "ctl", "status", "--address", "tcp://127.0.0.1:9873", *desk)
        assert "2026-11-23T06-00-00Z" in machine.run(PALMD, "runs", RUNS)
    finally:
        services.systemctl("stop", *UNITS)
        for folder, aside in zip(ours, kept, strict=True):
            shutil.rmtree(folder)
            shutil.copytree(aside, folder)
        services.systemctl("daemon-reload")
