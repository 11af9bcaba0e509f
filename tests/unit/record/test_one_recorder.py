"""One recorder for each daemon, and the gap that the successor of a killed recorder reports."""

import os
import subprocess
import sys
import textwrap
from pathlib import Path

import msgpack
import pytest

from palmd.daemon.journal import Journal
from palmd.daemon.recorder_process import RESTART_S, RecorderProcess
from palmd.daemon.recorder_watch import RecorderWatch
from palmd.record.mcapread import read_layout
from palmd.record.recorder import RecorderLockedError, only_recorder
from palmd.record.recording import Recording
from palmd.rig.world import default_config

BUS = "tcp://127.0.0.1:9872"


def holder(folder):
    """Another process that holds the lock."""
    code = textwrap.dedent(
        f"""
        import sys
        from pathlib import Path
        from palmd.record.recorder import only_recorder
        with only_recorder(Path({str(folder)!r}), {BUS!r}):
            print("has it", flush=True)
            sys.stdin.read()
        """
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "has it\n"
    return process


def test_a_second_recorder_is_refused_until_the_first_has_been_killed(tmp_path):
    first = holder(tmp_path)
    with pytest.raises(RecorderLockedError, match=f"process {first.pid} "), only_recorder(tmp_path, BUS):
        pass
    with only_recorder(tmp_path, "tcp://127.0.0.1:9999"):  # of another daemon
        pass
    first.kill()
    first.communicate()
    with only_recorder(tmp_path, BUS):
        pass


def test_without_a_lock_file_it_records_nevertheless():
    with only_recorder(Path("/proc/no/such/folder"), BUS):
        pass


def recording(folder, ended=lambda _: None):
    config = default_config()
    return Recording(
        config.model_copy(update={"record": config.record.model_copy(update={"directory": folder})}), ended
    )


def said(number, t):
    fields = {"seq": number, "timestamp": t, "mono_ns": round(t * 1e9), "v": 1}
    return [b"palm/estimate", msgpack.packb(fields), b""]


@pytest.mark.parametrize(("after_s", "first", "marked"), [(2.5, 300, True), (2.5, 0, False), (100.0, 300, False)])
def test_the_next_recording_names_its_predecessor_and_the_gap(tmp_path, after_s, first, marked):
    """Only if it is of the same start of the daemon and soon afterwards."""
    killed = recording(tmp_path)
    killed.take(said(0, 1000.0), 1000.0)
    killed.flush(1000.0)
    before = killed.path
    os.utime(before, (1000.0, 1000.0))
    ended = []
    after = recording(tmp_path, ended.append)
    after.take(said(first, 1000.0 + after_s), 1000.0 + after_s)
    after.finish()
    metadata = read_layout(ended[0].path).preface.metadata["palmd"]
    assert metadata["continues"] == (before.name if marked else "")
    assert float(metadata["gap_s"]) == pytest.approx(after_s if marked else 0.0, abs=1e-3)


def test_a_completed_recording_has_no_successor(tmp_path):
    ended = []
    for first in (0, 300):
        one = recording(tmp_path, ended.append)
        one.take(said(first, 1000.0 + first), 1000.0 + first)
        one.finish()
    assert [read_layout(each.path).preface.metadata["palmd"]["continues"] for each in ended] == ["", ""]


def test_the_daemons_log_reports_the_gap_between_two_recorders():
    journal = Journal()
    watch = RecorderWatch(journal)
    status = {"bytes": 1.0, "messages": 5.0, "lost": 0.0}
    for t, process in ((1.0, 11), (2.0, 11), (4.5, 12), (5.5, 12)):
        watch.update({**status, "process": process}, t)
    watch.update(status, 6.0)  # a recorder that does not send its process
    (entry,) = journal.entries
    assert (entry.kind, entry.name, entry.lasted_s) == ("recorder", "gap", 2.5)


class Ended:
    def __init__(self, status):
        self.status = status

    def poll(self):
        return self.status


def test_a_killed_recorder_is_restarted_and_one_that_has_ended_is_not():
    starts = []
    statuses = iter([-9, -9, 3])

    def start():
        starts.append(len(starts))
        return Ended(next(statuses))

    process = RecorderProcess(start)
    for tick in range(100):
        process.tend(0.25 * tick)
    assert len(starts) == 3
    assert RESTART_S > 0.25
