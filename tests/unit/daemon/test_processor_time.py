"""Which process used the processor: read from files as Linux writes them."""

import pytest

from palmd.daemon.diagnostics import LoopDiagnostics
from palmd.daemon.processor_time import ProcessorTime

STAT = "cpu  3836670 2336114 392554 856445 10455 0 17397 {} 0 0\ncpu0 1 2 3\n"


@pytest.fixture
def proc(tmp_path):
    def written(waited_ns, kept_ticks):
        (tmp_path / "self").mkdir(exist_ok=True)
        (tmp_path / "self/schedstat").write_text(f"9000000000 {waited_ns} 12\n")
        (tmp_path / "stat").write_text(STAT.format(kept_ticks))
        return tmp_path

    return written


def test_the_time_lost_since_the_last_query_is_reported(proc):
    account = ProcessorTime(proc(5_000_000_000, 100))
    assert account.lost() == ""
    proc(5_021_400_000, 100)
    assert account.lost() == "it waited for a processor while other programs ran for 21 ms"
    proc(5_031_400_000, 103)
    assert account.lost().endswith("for 10 ms and this virtual machine's host withheld its processors for 30 ms")
    proc(9_000_000_000, 500)
    account.forget()
    assert account.lost() == ""


def test_a_system_without_these_files_is_no_error(tmp_path):
    (tmp_path / "stat").write_text("cpu 1 2\n")
    assert ProcessorTime(tmp_path).lost() == ""


def test_the_fault_names_the_process_that_used_the_processor():
    loop = LoopDiagnostics()
    loop.overran(1.0, 0.023, "this virtual machine's host withheld its processors for 30 ms")
    assert loop.evidence("loop-overrun").endswith(
        "23 ms after its deadline; in the second before, this virtual machine's host withheld its processors for 30 ms"
    )
