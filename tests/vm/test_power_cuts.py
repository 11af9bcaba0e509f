"""The power goes while a run is recorded: how much of it is lost, and that the machine comes back to the same."""

import json

import pytest
import rigpc
from rigpc import PALMD, PYTHON, RUNS

LOST_MOST_S = 0.1
TIMES = 10

# Inside: the monotonic time (ns) of the last estimate in a recording.
LAST = """
import sys
from pathlib import Path
from palmd.record.mcapfile import read_messages
print(max(m.fields["mono_ns"] for m in read_messages(Path(sys.argv[1])) if m.topic == "palm/contact"))
"""


@pytest.fixture(scope="module")
def disk(installed, tmp_path_factory):
    return rigpc.overlay(installed[0], tmp_path_factory.mktemp("cut") / "disk.qcow2")


@pytest.mark.parametrize("number", range(TIMES))
def test_power_cut(image, rig, disk, tmp_path, number):
    with rigpc.powered(image, disk, rig, tmp_path) as pc:
        pc.ready()
        pc.put("/root/last.py", LAST)
        run = pc.until(lambda: pc.run(f"ls -t {RUNS}/*.mcap | head -1", check=False).said.strip(), "a recording")
        size = int(pc.ask(f"stat -c %s {run}"))
        pc.until(lambda: int(pc.ask(f"stat -c %s {run}")) > size, "growth")
        pc.machine.cut_power()
        cut_ns = rig.status()["guest_ns"]
    with rigpc.powered(image, disk, rig, tmp_path / "again") as pc:
        pc.ready()
        said = pc.ask(f"{PALMD} recover {run} -o /root/whole.mcap")
        last_ns = int(pc.ask(f"{PYTHON} /root/last.py /root/whole.mcap"))
        pc.close()
    lost_s = (cut_ns - last_ns) * 1e-9
    print(json.dumps({"cut": number + 1, "lost_ms": round(lost_s * 1e3), "said": said}))
    assert "messages" in said
    assert lost_s <= LOST_MOST_S
