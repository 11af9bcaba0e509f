"""The harness of studies: execution in threads, processes or a cluster, row files, resuming, the table, the goals."""

import contextlib
import importlib
import json
import math
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import connection
from pathlib import Path

import numpy as np
import pytest
from toy_study import KINDS, ToyRow, asked, draw, study

from palmd.console.errors import BAD_INPUT, CliError
from palmd.console.extras import install_line
from tools.studies import cells, harness, runs
from tools.studies.commands import FORMER, STUDIES, loaded, main

A_DAY_S = 86_400.0
ENVIRONMENT = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}


@pytest.fixture
def threads(monkeypatch):
    monkeypatch.setattr(runs, "local", lambda _jobs: ThreadPoolExecutor(8))


def lines(path):
    return [json.loads(line) for line in path.read_text().splitlines()]


# -------------------------------------------------------------------------------------------- the command line


def usage(*argv):
    with pytest.raises(SystemExit) as caught:
        main([*argv])
    return caught.value.code


@pytest.mark.parametrize("name", STUDIES)
def test_every_study_has_its_module_and_help(name, capsys):
    module = loaded(name)
    assert callable(module.STUDY.conduct if hasattr(module, "STUDY") else module.conduct)
    assert usage(name, "--help") == 0
    shown = capsys.readouterr().out
    assert shown.startswith(f"usage: python -m tools.studies {name}")
    assert "columns" in shown.lower() or name == "simulate"


@pytest.mark.parametrize("former", FORMER)
def test_a_former_name_works_with_a_note(former, capsys):
    assert former not in STUDIES
    assert usage(former, "--help") == 0
    shown = capsys.readouterr()
    assert shown.out.startswith(f"usage: python -m tools.studies {FORMER[former]}")
    assert FORMER[former] in shown.err


def test_help_names_every_study(capsys):
    assert usage("--help") == 0
    shown = capsys.readouterr().out
    assert all(f"  {name} " in shown for name in STUDIES)


def test_a_missing_optional_package_is_named_with_its_install_command(monkeypatch, capsys):
    def not_there(_name):
        raise ModuleNotFoundError(name="matplotlib")

    monkeypatch.setattr(importlib, "import_module", not_there)
    assert main(["montecarlo"]) == BAD_INPUT
    assert install_line("matplotlib", "studies") in capsys.readouterr().err


def test_a_missing_module_of_the_project_is_an_error(monkeypatch):
    monkeypatch.delitem(sys.modules, "tools.studies.sbc", raising=False)
    monkeypatch.setitem(sys.modules, "tools.studies.uniformity", None)
    with pytest.raises(ModuleNotFoundError):
        main(["sbc"])


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        ((), "NAME"),
        (("dance",), "dance"),
        (("montecarlo", "--runs", "0"), "0 is less than 1"),
        (("montecarlo", "--runs", "x"), "must be a whole number, got 'x'"),
        (("montecarlo", "--seed", "-1"), "-1 is negative"),
        (("montecarlo", "--seconds", "0.1"), "must be 0.5 s or more, got 0.1"),
        (("montecarlo", "--seconds", "nan"), "must be 0.5 s or more, got nan"),
        (("montecarlo", "--kind", "strange"), "there is no 'strange'"),
        (("montecarlo", "--jobs", "2", "--scheduler", "tcp://127.0.0.1:1"), "not allowed with"),
    ],
)
def test_usage_errors(argv, said, capsys):
    assert usage(*argv) == 2
    assert said in capsys.readouterr().err


# ------------------------------------------------------------------------------------------ rows, table, goals


def test_rows_are_in_order_and_an_exception_makes_an_error_row(threads, tmp_path, capsys):
    path = tmp_path / "new" / "toy.jsonl"
    assert study().conduct(asked("--runs", 3, "--seed", 11, "-o", path)) == 0
    assert [(row["kind"], row["seed"]) for row in lines(path)] == [(kind, s) for kind in KINDS for s in (11, 12, 13)]
    assert [row["value"] for row in lines(path)] == [11.0, None, 13.0] * 2
    out = capsys.readouterr().out.splitlines()
    assert out[0] == "seeds 11–13"
    assert [line.split() for line in out[1:4]] == [
        ["runs", "errors", "large", "median"], ["flat", "3", "1", "2", "12"], ["bent", "3", "1", "2", "12"],
    ]  # fmt: skip
    assert out[4:6] == ["flat 12: ValueError: no ground", "bent 12: ValueError: no ground"]
    assert out[-1] == f"written: {path}"


def test_kinds_have_a_column_each_and_one_together():
    rows = [ToyRow(kind, seed, 1.0, value=float(seed)) for kind in KINDS for seed in (1, 2)]
    across = study(across=True, whole="all").tabled(rows).splitlines()
    assert across[0].split() == ["flat", "bent", "all"]
    assert across[1].split() == ["runs", "2", "2", "4"]
    assert [task.kind for task in draw(asked("--kind", "bent", "--runs", 2))] == ["bent", "bent"]


def test_a_missed_goal_is_reported_and_sets_the_exit_status(threads, capsys):
    assert study().conduct(asked("--runs", 1, "--seed", 30, output=None)) == BAD_INPUT
    assert "goal missed: no value is above 20" in capsys.readouterr().out


def test_a_study_with_a_figure_draws_it(threads, tmp_path, capsys):
    panels = [("value", lambda row: row.value, 1.0, (2.0,), False), ("nothing", lambda _: math.nan, 1.0, (), True)]
    assert study(panels=panels).conduct(asked("-o", tmp_path)) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["runs.jsonl", "toy.png", "toy.svg"]
    first = (tmp_path / "toy.svg").read_bytes()
    assert study(panels=panels).conduct(asked("-o", tmp_path)) == 0
    assert (tmp_path / "toy.svg").read_bytes() == first
    assert capsys.readouterr().out.splitlines()[-1].count("toy") == 2


def test_quantiles():
    random = np.random.default_rng(0).normal(size=37)
    for q in (0.0, 0.5, 0.9, 0.95, 1.0):
        assert cells.quantile(random, q) == pytest.approx(np.quantile(random, q))
    assert cells.quantile([1.0, math.inf], 0.5) == math.inf


def test_cells_count_missing_values_as_configured():
    rows = [ToyRow("flat", 0, 1.0, value=each) for each in (3.0, 4.0, math.nan)]
    value = ToyRow.value.__get__
    assert cells.quantiles(value, 10.0)(rows) == "35"
    assert cells.quantiles(value, 1.0, (0.5, 1.0), worst=True)(rows) == "4 / ∞"
    assert cells.rms(value)(rows) == "3.54"
    assert cells.mean(value, ".1f")(rows) == "3.5"
    assert cells.most(value)([]) == cells.quantiles(value)([]) == cells.rms(value)([]) == cells.NOTHING
    assert cells.count_of(lambda row: row.value > 3.0)(rows) == "1 of 3"
    assert cells.among(lambda row: row.value > 3.0, cells.runs)(rows) == "1"


def test_numbers_are_formatted_for_the_table():
    assert harness.numbers([5, 3, 4, 9, 11, 12, 4]) == "3–5, 9, 11–12"


# ------------------------------------------------------------------------------------------------ interrupted


def test_an_interrupted_study_keeps_finished_rows(threads, tmp_path, monkeypatch, capsys):
    def interrupted(_executor, work, _failed, tasks):
        for task in reversed(tasks[:3]):
            yield work(task)
        raise KeyboardInterrupt

    monkeypatch.setattr(runs, "finished", interrupted)
    path = tmp_path / "toy.jsonl"
    assert study().conduct(asked("--kind", "bent", "--runs", 50, "-o", path)) == 130
    assert [row["seed"] for row in lines(path)] == [0, 1, 2]
    assert "interrupted: 3 of 50 runs are finished\n" in capsys.readouterr().err


def test_each_row_is_on_disk_as_soon_as_its_run_ends(threads, tmp_path, monkeypatch):
    path, counts = tmp_path / "toy.jsonl", []

    def watched(_executor, work, _failed, tasks):
        for task in tasks:
            yield work(task)
            counts.append(path.read_text().count("\n"))

    monkeypatch.setattr(runs, "finished", watched)
    assert study().conduct(asked("--kind", "bent", "--runs", 3, "-o", path)) == 0
    assert counts == [1, 2, 3]
    assert study(resumes=True).conduct(asked("--kind", "bent", "--runs", 5, "-o", path)) == 0
    assert counts == [1, 2, 3, 4, 5]


@pytest.mark.nightly
@pytest.mark.parametrize(("number", "send"), [(signal.SIGINT, os.killpg), (signal.SIGTERM, os.kill)])
def test_a_signal_ends_all_processes(number, send, tmp_path):
    """Ctrl-C at a terminal reaches all of them, a termination signal only the first."""
    command = [sys.executable, "-m", "tools.studies", "montecarlo", "--kind", "nominal", "--runs", "500"]
    command += ["--seconds", "0.6", "--no-causal", "--jobs", "1", "-o", str(tmp_path)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, **pipes, text=True, process_group=0) as process:
        rows = tmp_path / "runs.jsonl"
        t_end = time.monotonic() + 180.0
        while time.monotonic() < t_end and not (rows.exists() and rows.read_text().count("\n") > 1):
            time.sleep(0.05)
        children = subprocess.run(
            ["ps", "-o", "pid=", "--ppid", str(process.pid)], capture_output=True, text=True, check=True
        ).stdout.split()
        before = rows.read_text().count("\n")
        send(process.pid, number)
        _, err = process.communicate(timeout=120.0)
    assert process.returncode == 130
    assert "Traceback" not in err
    assert 2 <= before <= len(lines(rows)) <= before + 20  # soon, however slow the machine
    assert [row["error"] for row in lines(rows)] == [""] * len(lines(rows))
    t_end = time.monotonic() + 60.0
    while any(Path(f"/proc/{child}").exists() for child in children):
        assert time.monotonic() < t_end
        time.sleep(0.05)


# ---------------------------------------------------------------------------------------------------- resumed


def resumed(path, *argv):
    return study(resumes=True).conduct(asked("--kind", "bent", "-o", path, *argv))


def test_a_study_is_resumed_and_files_are_merged(threads, tmp_path, monkeypatch):
    done = []
    finished = runs.finished

    def noted(executor, work, failed, tasks):
        done.extend(task.seed for task in tasks)
        return finished(executor, work, failed, tasks)

    monkeypatch.setattr(runs, "finished", noted)
    path, other = tmp_path / "a.jsonl", tmp_path / "b.jsonl"
    assert resumed(path, "--runs", 2, "--seed", 10) == resumed(path, "--runs", 4, "--seed", 10) == 0
    assert done == [10, 11, 12, 13]
    assert resumed(other, "--runs", 2, "--seed", 13) == 0
    path.write_text(path.read_text() + other.read_text())
    done.clear()
    assert resumed(path, "--runs", 4, "--seed", 10) == 0
    assert done == []
    assert [row["seed"] for row in lines(path)] == [10, 11, 12, 13, 14]


@pytest.mark.parametrize("text", ["{}\n", "no json\n", "[1]\n", '{"kind": "bent", "seed": 1}\n', b"\xff\xfe\x00"])
def test_other_files_are_rejected_and_unchanged(text, threads, tmp_path):
    path = tmp_path / "file.jsonl"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    before = path.read_bytes()
    with pytest.raises(CliError, match=r"is not a file of this study: line 1 is not a run"):
        resumed(path)
    assert path.read_bytes() == before
    (tmp_path / "folder").mkdir()
    with pytest.raises(CliError, match="cannot be read: Is a directory"):
        resumed(tmp_path / "folder")


def test_rows_of_another_duration_are_rejected(threads, tmp_path):
    path = tmp_path / "file.jsonl"
    assert resumed(path, "--runs", 1, "--seconds", 5) == 0
    with pytest.raises(CliError, match="has runs of 5 s, not 10 s"):
        resumed(path, "--seconds", 10)


def test_a_truncated_line_is_reported_with_its_number(threads, tmp_path):
    """A power failure leaves such a line."""
    path = tmp_path / "file.jsonl"
    assert resumed(path, "--runs", 2) == 0
    left = path.read_text()[:-20]
    path.write_text(left)
    with pytest.raises(CliError, match="line 2 is not a run; remove it"):
        resumed(path, "--runs", 3)
    assert path.read_text() == left


def test_a_file_that_cannot_be_written_is_a_one_line_error(threads, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(CliError, match="cannot be written"):
        study().conduct(asked("-o", tmp_path / "file" / "toy.jsonl"))


# -------------------------------------------------------------------------------------- processes and clusters


def failed(task, error):
    return f"{task}: {type(error).__name__}"


def test_processes_and_a_cluster_give_the_same_rows(tmp_path):
    distributed = pytest.importorskip("distributed")
    one, two = tmp_path / "one.jsonl", tmp_path / "two.jsonl"
    assert study().conduct(asked("--seed", 11, "--jobs", 2, "-o", one)) == 0
    with distributed.LocalCluster(1, threads_per_worker=2, processes=False, dashboard_address=":0") as dask:
        assert study().conduct(asked("--seed", 11, "--scheduler", dask.scheduler_address, "-o", two)) == 0
    assert one.read_text() == two.read_text()


def test_a_cluster_cancels_pending_runs_and_reports_failures():
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(1, threads_per_worker=1, processes=False, dashboard_address=":0") as dask:
        with runs.cluster(dask.scheduler_address) as executor:
            assert set(runs.finished(executor, math.sqrt, failed, [4.0, -1.0])) == {2.0, "-1.0: ValueError"}
            results = runs.finished(executor, time.sleep, failed, [0.0, *[0.3] * 100])
            assert next(results) is None
        t_end = time.monotonic() + 10.0  # a third of the time of all runs; the cancellation takes a moment
        while dask.scheduler.tasks and time.monotonic() < t_end:
            time.sleep(0.05)
        assert not dask.scheduler.tasks


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nonsense://there"])
def test_a_missing_scheduler_is_a_one_line_error_and_keeps_earlier_rows(address, tmp_path, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(runs, "CONNECT_S", 0.3)
    path = tmp_path / "toy.jsonl"
    path.write_text("precious\n")
    with pytest.raises(CliError, match="no Dask scheduler at"):
        study().conduct(asked("--scheduler", address, "-o", path))
    assert path.read_text() == "precious\n"


def test_a_cluster_needs_dask(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(CliError) as caught:
        study().conduct(asked("--scheduler", "tcp://127.0.0.1:1", output=None))
    assert str(caught.value) == f"--scheduler needs Dask, which is not installed: {install_line('Dask', 'studies')}"


def test_a_run_that_raises_or_kills_its_process_is_an_error_row():
    with runs.local(2) as executor:
        assert set(runs.finished(executor, math.sqrt, failed, [4.0, -1.0])) == {2.0, "-1.0: ValueError"}
    with runs.local(1) as executor:
        assert list(runs.finished(executor, os._exit, failed, [3])) == ["3: BrokenProcessPool"]


def test_a_worker_uses_one_thread_and_ignores_interruptions(monkeypatch):
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "3")
    with runs.local(1) as executor:
        assert executor.submit(signal.getsignal, signal.SIGINT).result() == signal.SIG_IGN
        assert executor.submit(os.getenv, "OPENBLAS_NUM_THREADS").result() == "1"
    program = "import sys; import tools.studies.runs; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], env=ENVIRONMENT, check=False).returncode == 0


def test_an_interruption_ends_runs_in_progress():
    """The runs would outlast this test's time limit unless they are ended."""
    workers = []
    try:
        with contextlib.suppress(KeyboardInterrupt), runs.local(2) as executor:
            next(runs.finished(executor, time.sleep, failed, [0.0, A_DAY_S, A_DAY_S, A_DAY_S]))
            workers += multiprocessing.active_children()
            raise KeyboardInterrupt
        assert len(workers) == 2
        for worker in workers:
            connection.wait(
                [worker.sentinel]
            )  # waits for its end; join() would race with the executor's own thread for the status
    finally:
        for worker in workers:
            worker.kill()


ORPHAN = """
import os, time
from tools.studies import runs

if __name__ == "__main__":
    with runs.local(1) as executor:
        print(executor.submit(os.getpid).result(), flush=True)
        time.sleep(60.0)
"""


def test_workers_end_with_their_parent(tmp_path):
    script = tmp_path / "orphan.py"
    script.write_text(ORPHAN)
    with subprocess.Popen([sys.executable, str(script)], env=ENVIRONMENT, stdout=subprocess.PIPE, text=True) as parent:
        worker = Path("/proc") / parent.stdout.readline().strip()
        assert worker.exists()
        parent.send_signal(signal.SIGKILL)
    t_end = time.monotonic() + 10.0
    while worker.exists():
        assert time.monotonic() < t_end
        time.sleep(0.05)
