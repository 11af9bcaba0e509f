"""palmd on its own rig PC: Debian 12 with its real-time kernel, real drivers of real ports, plugs and power."""

import time

import pytest
import rigpc
from ftdi import BREAK, FRAMING, OVERRUN, PARITY
from machine import ADAPTERS
from rigpc import CONFIG, NAMES, PALMD, RUNS

PADS = tuple(ADAPTERS)


def _property(pc, device, name):
    """A udev property of a device."""
    return pc.ask(f"udevadm info -q property --property={name} --value /dev/{device}")


def test_the_machine_is_a_debian_12_with_a_real_time_kernel(pc, image):
    assert "PREEMPT_RT" in pc.ask("uname -v")
    assert pc.ask(f"{PALMD} --version").split()[-1] == image.version
    assert pc.ask(f"ls {CONFIG} /etc/palmd/plans/rock.yaml")
    drivers = pc.ask("cat /proc/devices")
    assert "ttyUSB" in drivers
    assert "ttyACM" in drivers


def test_ready_at_boot_after_its_ports(pc):
    pc.ready()
    entered = int(pc.show("palmd", "ActiveEnterTimestampMonotonic"))
    for name in (*PADS, "arm"):
        initialised = int(_property(pc, f"palmd-{name}", "USEC_INITIALIZED"))
        assert initialised < entered
    assert pc.show("palmd", "NRestarts") == "0"
    heard = pc.hear()
    assert heard["palm/state"]["state"] == "ready"
    assert heard["palm/loop"]["pad1_packets"] > 0
    assert heard["palm/loop"]["arm_acks"] > 0


def test_pads_are_named_by_serial_number_in_any_order_of_plugging(pc):
    def named():
        return {pad: _property(pc, f"palmd-{pad}", "ID_SERIAL_SHORT") for pad in PADS}

    assert named() == ADAPTERS
    before = pc.ask("readlink /dev/palmd-pad1")
    for pad in PADS:
        pc.machine.unplug(pad)
    pc.until(lambda: not pc.run("ls /dev/ttyUSB*", check=False).said.startswith("/dev"), "both unplugged")
    for pad in reversed(PADS):
        pc.machine.plug(pad)
        pc.until(lambda pad=pad: pc.run(f"test -e /dev/palmd-{pad}", check=False).status == 0, f"{pad} is back")
    assert named() == ADAPTERS
    assert pc.ask("readlink /dev/palmd-pad1") != before  # the kernel has numbered them in reverse order
    pc.ready()


def test_pads_can_be_named_by_path(pc):
    rules = pc.ask(f"cat {NAMES}")
    paths = {pad: _property(pc, f"palmd-{pad}", "ID_PATH") for pad in PADS}
    assert len(set(paths.values())) == len(PADS)
    by_path = "".join(
        f'SUBSYSTEM=="tty", ENV{{ID_PATH}}=="{path}", SYMLINK+="palmd-{pad}-there"\n' for pad, path in paths.items()
    )
    pc.put(NAMES, rules + "\n" + by_path)
    pc.ask("udevadm control --reload && udevadm trigger --action=add --subsystem-match=tty && udevadm settle")
    for pad in PADS:
        assert pc.ask(f"readlink /dev/palmd-{pad}-there") == pc.ask(f"readlink /dev/palmd-{pad}")
    pc.put(NAMES, rules + "\n")


def test_latency_timers_are_set_at_boot_and_after_plugging_in(pc):
    said = pc.ask("cat /sys/bus/usb-serial/devices/ttyUSB*/latency_timer")
    assert said.split() == ["1", "1"]


def test_no_other_process_can_open_a_port(pc):
    for name in (*PADS, "arm"):
        tried = pc.run(f"runuser -u palmd -- head -c 1 /dev/palmd-{name}", check=False)
        assert tried.status != 0
        assert "Device or resource busy" in tried.said


def _errors(pc, end):
    """Errors that the daemon has counted on a line: breaks, framing errors, parity errors, overruns."""
    loop = pc.hear()["palm/loop"]
    return [loop[f"{end}_port_{what}"] for what in ("breaks", "framing_errors", "parity_errors", "overruns")]


def test_a_break_on_the_uart_is_counted(pc):
    before = _errors(pc, "arm")
    for _ in range(3):
        pc.machine.monitor("chardev-send-break", id="arm")
        time.sleep(0.5)
    pc.until(lambda: _errors(pc, "arm") == [before[0] + 3, *before[1:]], "three breaks more")


def test_line_errors_reported_by_an_adapter_are_counted(pc):
    """QEMU's adapter reports no errors; an external one with the same serial number replaces it."""
    pc.machine.unplug("pad1")
    pc.until(lambda: "pad1-port" in pc.status(), "the fault")
    before = _errors(pc, "pad1")
    adapter = pc.machine.plug_chip("pad1")
    pc.ready()
    assert adapter.latency_ms == 1
    wanted = {BREAK: 2, FRAMING: 3, PARITY: 5, OVERRUN: 7}
    for error, count in wanted.items():
        adapter.mark(error, count)
    pc.until(lambda: adapter.marked == sum(wanted.values()), "all marked bytes")
    assert [now - then for now, then in zip(_errors(pc, "pad1"), before, strict=True)] == list(wanted.values())
    adapter.close()
    pc.machine.monitor("device_del", id="chip")
    pc.until(lambda: "pad1-port" in pc.status(), "the fault again")
    pc.machine.plug("pad1")
    pc.ready()


def test_an_adapter_may_be_unplugged_and_plugged_in_again(pc):
    pc.ready()
    for pad in PADS:
        losses = pc.hear()["palm/loop"][f"{pad}_port_losses"]
        pc.machine.unplug(pad)
        pc.until(lambda pad=pad: f"{pad}-port" in pc.status(), f"{pad}'s fault")
        assert f"no such port /dev/palmd-{pad}" in pc.journal()
        pc.machine.plug(pad)
        pc.ready()
        heard = pc.hear()["palm/loop"]
        assert heard[f"{pad}_port_losses"] == losses + 1
    assert pc.show("palmd", "NRestarts") == "0"


@pytest.mark.parametrize("step", ["+1 hour", "-1 hour"])
def test_a_clock_step_of_an_hour_causes_no_fault_and_no_restart(pc, step):
    pc.ready()
    before = pc.hear()
    pc.ask(f"date -s '{step}'")
    after = pc.hear()
    assert after["palm/state"]["state"] == "ready"
    wall, mono = (
        after["palm/loop"][name] * unit - before["palm/loop"][name] * unit
        for name, unit in (("timestamp", 1.0), ("mono_ns", 1e-9))
    )
    assert abs(abs(wall - mono) - 3600.0) < 1.0
    assert not set(after["palm/state"]["faults"]) - set(before["palm/state"]["faults"])
    assert pc.show("palmd", "NRestarts") == pc.show("palmd-record", "NRestarts") == "0"
    assert pc.show("palmd-record", "ActiveState") == "active"


def test_a_full_disk_is_reported_and_the_recording_is_recoverable(pc):
    pc.ready()
    pc.ask("fallocate -l $(($(df --output=avail -B1 / | tail -1) - (1 << 20))) /filler || true")
    pc.run("dd if=/dev/zero of=/filler2 bs=64k", check=False)
    pc.until(lambda: "recorder-failed" in pc.status(), "the fault")
    assert pc.status().startswith("ready")
    assert "the disk is full" in pc.journal("palmd-record")
    full = pc.ask(f"ls -t {RUNS}/*.mcap | head -1")
    pc.ask("rm /filler /filler2")
    pc.until(lambda: "recorder-failed" not in pc.status(), "its end")
    newest = pc.until(lambda: (new := pc.ask(f"ls -t {RUNS}/*.mcap | head -1")) != full and new, "another file")
    assert "messages" in pc.ask(f"{PALMD} recover {full} -o /var/tmp/full.mcap")
    assert newest
    assert pc.show("palmd-record", "NRestarts") == "0"


def test_upgrade_to_the_next_version_and_back(pc, image):
    kept = [NAMES, CONFIG, "/etc/palmd/plans/rock.yaml"]
    before = pc.ask(f"sha256sum {' '.join(kept)}")
    for version in (image.next_version, image.version):
        said = pc.install(version)
        assert "kept     /etc/palmd/palmd.yaml" in said
        pc.ask("systemctl restart --no-block palmd")
        pc.ready()
        assert pc.hear()["palm/info"]["version"] == version
        assert pc.ask(f"sha256sum {' '.join(kept)}") == before
    assert f"zero_mm: {rigpc.CALIBRATED_ZERO_MM}" in pc.ask(f"cat {CONFIG}")


def test_the_daemon_recovers_after_suspend(pc):
    pc.ready()
    pc.ask("systemctl suspend")
    pc.until(lambda: pc.machine.monitor("query-status")["status"] == "suspended", "suspended")
    time.sleep(5.0)
    pc.machine.monitor("system_wakeup")
    pc.machine.until_up()
    pc.ready()
    assert pc.hear()["palm/state"]["state"] == "ready"
    assert pc.show("palmd-record", "ActiveState") == "active"


def test_installation_from_scratch_on_the_machine_itself(image, rig, tmp_path):
    """Venv, wheels, and `palmd install` with its compiler, which `installed` does outside. Takes hours."""
    with rigpc.powered(image, rigpc.overlay(image.base, tmp_path / "disk.qcow2"), rig, tmp_path) as pc:
        said = pc.install(image.version)
        assert "written  /usr/local/lib/systemd/system/palmd.service" in said
        assert "virtual machine" not in said  # every observer was compiled
        assert "ttyACM" in pc.ask("cat /proc/devices")  # known before boot and before one was plugged in
