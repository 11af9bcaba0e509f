"""Power cuts during recording: how much is lost, and whether the machine comes back to the same state.

At ten instants of a recording the disk is copied, mounted with its journal replayed, and the recording recovered. Data
given to QEMU count as written, as on a disk without a volatile cache. At the end the power is really cut, and the
machine is started again.
"""

import json
import random
import shutil
import subprocess
import time
from pathlib import Path

import rigpc
from rigpc import PALMD, PYTHON, RUNS

from palmd import cli
from palmd.quantities import CONTACT
from palmd.record.mcapread import read_messages

LOST_MOST_S = 0.1
TIMES = 10

LAST = """
import sys
from pathlib import Path
from palmd.record.mcapread import read_messages
print(max(m.fields["mono_ns"] for m in read_messages(Path(sys.argv[1])) if m.topic == "palm/contact"))
"""


def _mounted(disk, run, folder):
    """The recording on a disk after a power cut, copied from there."""
    raw = folder / "raw"
    subprocess.run(["qemu-img", "convert", "-O", "raw", str(disk), str(raw)], check=True)
    (folder / "mnt").mkdir()
    taken = folder / "run.mcap"
    here = folder / "mnt"
    words = f"mount -o loop {raw} {here} && cp {here}{run} {taken}"
    subprocess.run(["unshare", "--mount", "bash", "-ec", words], check=True)
    raw.unlink()
    return taken


def _last_ns(run):
    """The monotonic time of the last tick in a recording."""
    return max(each.fields["mono_ns"] for each in read_messages(run) if each.topic == CONTACT.name)


def _recording(pc):
    """The recording in progress, once it has content."""
    run = pc.until(lambda: pc.run(f"ls -t {RUNS}/*.mcap | head -1", check=False).said.strip(), "a recording")
    size = int(pc.ask(f"stat -c %s {run}"))
    pc.until(lambda: int(pc.ask(f"stat -c %s {run}")) > size, "growth")
    return run


def test_power_cuts_lose_little_of_a_recording(pc, rig, tmp_path, capsys):
    pc.ready()
    run = _recording(pc)
    chance = random.Random(23)
    lost_ms = []
    for number in range(TIMES):
        time.sleep(chance.uniform(2.0, 8.0))
        folder = tmp_path / str(number)
        folder.mkdir()
        with pc.machine.standing_still():
            cut_ns = rig.status()["guest_ns"]
            disk = Path(shutil.copy(pc.machine.disk, folder / "disk.qcow2"))
        taken = _mounted(disk, run, folder)
        disk.unlink()
        assert cli.main(["runs", "recover", str(taken)]) == 0
        lost_ms.append((cut_ns - _last_ns(taken)) * 1e-6)
        with capsys.disabled():
            print(json.dumps({"cut": number + 1, "lost_ms": round(lost_ms[-1], 1), "said": capsys.readouterr().out}))
    assert max(lost_ms) <= LOST_MOST_S * 1e3, lost_ms


def test_the_machine_comes_back_after_a_power_cut(image, rig, installed, tmp_path):
    disk = rigpc.overlay(installed, tmp_path / "disk.qcow2")
    with rigpc.powered(image, disk, rig, tmp_path / "first") as pc:
        pc.ready()
        run = _recording(pc)
        pc.machine.cut_power()
        cut_ns = rig.status()["guest_ns"]
    with rigpc.powered(image, disk, rig, tmp_path / "second") as pc:
        pc.ready()
        said = pc.ask(f"{PALMD} recover {run}", seconds=rigpc.START_S)
        assert "messages" in said
        assert pc.ask(f"stat -c '%U %a' {run}") == "palmd 640"
        pc.put("/run/last.py", LAST)
        last_ns = int(pc.ask(f"{PYTHON} /run/last.py {run}", seconds=rigpc.START_S))
    assert cut_ns - last_ns <= LOST_MOST_S * 1e9
