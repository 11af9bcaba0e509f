"""Commands of README and docs that need a daemon work as documented: each block is run in the order of its page.

`tests/unit/test_documentation_runs.py` runs the others. Blocks that are not run state the reason above them.
"""

import re

import docreader
import pytest
import rig_recording
from harness import Bench, wait

from palmd.bus.command_client import CommandClient

pytestmark = pytest.mark.rig

LIMITS = {"phi1_deg": [6, 150], "phi2_deg": [35, 155], "rate_deg_s": 120}
ENDS_A_MOTION = re.compile(r"palmd ctl (?:hold|stop)|rig\.command\(.hold")
SHORTER = {"time_limit_s=60.0": "time_limit_s=3.0"}


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    bench = Bench(tmp_path_factory.mktemp("bench"), limits=LIMITS)
    yield bench
    bench.close()


@pytest.mark.parametrize("page", docreader.pages(with_a_daemon=True))
def test_blocks_of(page, bench, tmp_path):
    (tmp_path / "lively.yaml").write_bytes((bench.folder / "lively.yaml").read_bytes())
    reader = docreader.Reader(tmp_path, rig_recording.path(), bench.path)
    words = SHORTER | {"tcp://127.0.0.1:43731": bench.rig_info["truth"]}
    for block in docreader.blocks_of(page, with_a_daemon=True):
        if "palmd run" in block.text and bench.daemon.alive:
            assert bench.daemon.end() == 0
        elif "palmd run" not in block.text:
            prepared(bench, moving=ENDS_A_MOTION.search(block.text) is not None)
        reader.run(block, (bench.bus.publish, bench.bus.command), lambda: until_ready(bench.bus.command), words)


def prepared(bench, moving):
    """A daemon whose palms move, so that they can be held or stopped; else a ready one without an operator."""
    if not bench.daemon.alive:
        bench.start_daemon(limits=LIMITS)
    bench.ready()
    if moving:
        bench.client.do("arm", take=True)
        bench.client.do("start")
        bench.moving()
    else:
        bench.until(lambda heard: not heard.latest["palm/state"]["control"], "nobody's control")


def until_ready(command):
    """Waits for the daemon that the page has started."""
    with CommandClient(command, docreader.PATIENCE_S) as client:
        wait(lambda: client.ask("status")["result"]["state"] == "ready", "state ready")
