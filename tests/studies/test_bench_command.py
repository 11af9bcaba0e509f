"""The table of studies, and what the study montecarlo prints, writes, refuses and leaves."""

import importlib
import json
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest

from palmd.console.extras import install_line
from tools.studies import bench_montecarlo, montecarlo, runs
from tools.studies.commands import STUDIES, loaded, main
from tools.studies.scoring import MonteCarloRow


def usage(*argv):
    with pytest.raises(SystemExit) as caught:
        main([*argv])
    return caught.value.code


@pytest.mark.parametrize("name", STUDIES)
def test_every_study_has_its_module_and_help(name, capsys):
    assert callable(loaded(name).run)
    assert usage(name, "--help") == 0
    assert capsys.readouterr().out.startswith(f"usage: python -m tools.studies {name}")


def test_help_names_every_study(capsys):
    assert usage("--help") == 0
    shown = capsys.readouterr().out
    assert all(f"  {name} " in shown for name in STUDIES)


def test_a_missing_optional_package_is_named_with_the_line_that_installs_it(monkeypatch, capsys):
    def not_there(_name):
        raise ModuleNotFoundError(name="filterpy")

    monkeypatch.setattr(importlib, "import_module", not_there)
    assert main(["field"]) == 1
    told = f"the study field needs filterpy, which is not installed: {install_line('filterpy', 'studies')}\n"
    assert capsys.readouterr().err == told


def test_a_missing_module_of_ours_is_a_defect(monkeypatch):
    monkeypatch.delitem(sys.modules, "tools.studies.bench_sbc", raising=False)
    monkeypatch.setitem(sys.modules, "tools.studies.sbc", None)
    with pytest.raises(ModuleNotFoundError):
        main(["sbc"])


@pytest.mark.parametrize(
    ("argv", "told"),
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
def test_usage_errors(argv, told, capsys):
    assert usage(*argv) == 2
    assert told in capsys.readouterr().err


# --------------------------------------------------------------------------------------------- montecarlo


def quick(task):
    """A run that takes no time: the later seeds are finished first, one raises."""
    time.sleep(0.02 * (4 - task.seed % 4))
    if task.seed == 12:
        return montecarlo.failed(task, ValueError("no ground"))
    return MonteCarloRow(task.kind, task.seed, converged=True, e_h_m=1e-5 * task.seed, max_error_m=1e-4, h_bound_m=1e-5)


@pytest.fixture
def undrawn(monkeypatch):
    """A figure takes seconds, and is told of by one test."""
    monkeypatch.setattr(bench_montecarlo, "drawing", lambda _: None)


@pytest.fixture
def quickly(monkeypatch):
    @contextmanager
    def threads(_jobs):
        with ThreadPoolExecutor(8) as executor:
            yield executor

    monkeypatch.setattr(runs, "local", threads)
    monkeypatch.setattr(montecarlo, "run", quick)


def written(folder):
    return [json.loads(line) for line in (folder / bench_montecarlo.ROWS).read_text().splitlines()]


def test_table_rows_and_figure(quickly, tmp_path, capsys):
    folder = tmp_path / "new" / "folder"
    assert main(["montecarlo", "--runs", "4", "--seed", "10", "-o", str(folder)]) == 0
    out, err = capsys.readouterr()
    kinds = ("nominal", "friction", "rig", "odd")
    assert [(row["kind"], row["seed"]) for row in written(folder)] == [(k, s) for k in kinds for s in (10, 11, 12, 13)]
    assert out.splitlines()[0].split() == list(kinds)
    assert "odd 12: ValueError: no ground" in out
    assert f"written: {folder / 'runs.jsonl'}, {folder / 'montecarlo.svg'}, {folder / 'montecarlo.png'}" in out
    assert sorted(path.name for path in folder.iterdir()) == ["montecarlo.png", "montecarlo.svg", "runs.jsonl"]
    assert err == ""


def test_one_kind_and_how(quickly, undrawn, tmp_path, monkeypatch):
    seen = []

    def noted(task):
        seen.append(task)
        return quick(task)

    monkeypatch.setattr(montecarlo, "run", noted)
    arguments = ["--kind", "rig", "--runs", "2", "--seconds", "3", "--no-causal", "-o", str(tmp_path)]
    assert main(["montecarlo", *arguments]) == 0
    assert {(task.kind, task.seed, task.seconds, task.causal) for task in seen} == {
        ("rig", 0, 3.0, False),
        ("rig", 1, 3.0, False),
    }


def test_without_matplotlib_there_is_no_figure_and_one_line_says_so(quickly, tmp_path, monkeypatch, capsys):
    for name in [name for name in sys.modules if name.partition(".")[0] == "matplotlib"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.delitem(sys.modules, "tools.studies.montecarlo_figure", raising=False)
    monkeypatch.delattr("tools.studies.montecarlo_figure", raising=False)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert main(["montecarlo", "--kind", "odd", "--runs", "2", "-o", str(tmp_path)]) == 0
    out, err = capsys.readouterr()
    assert err == f"no figure: matplotlib is not installed: {install_line('matplotlib', 'report')}\n"
    assert out.splitlines()[-1] == f"written: {tmp_path / 'runs.jsonl'}"
    assert len(written(tmp_path)) == 2


def test_an_interruption_leaves_what_is_finished(quickly, undrawn, tmp_path, monkeypatch, capsys):
    def interrupted(_executor, work, _failed, tasks):
        for task in reversed(tasks[:3]):
            yield work(task)
        raise KeyboardInterrupt

    monkeypatch.setattr(runs, "finished", interrupted)
    assert main(["montecarlo", "--kind", "odd", "--runs", "50", "-o", str(tmp_path)]) == 130
    out, err = capsys.readouterr()
    assert [row["seed"] for row in written(tmp_path)] == [0, 1, 2]
    assert out.splitlines()[1].split() == ["runs", "3"]
    assert "interrupted: 3 of 50 runs are finished\n" in err


def test_rows_are_on_disk_as_soon_as_they_are_finished(quickly, undrawn, tmp_path, monkeypatch):
    counts = []

    def watched(_executor, work, _failed, tasks):
        for task in tasks:
            yield work(task)
            counts.append(len(written(tmp_path)))

    monkeypatch.setattr(runs, "finished", watched)
    assert main(["montecarlo", "--kind", "odd", "--runs", "3", "-o", str(tmp_path)]) == 0
    assert counts == [1, 2, 3]


@pytest.mark.parametrize(("number", "send"), [(signal.SIGINT, os.killpg), (signal.SIGTERM, os.kill)])
def test_a_signal_ends_real_processes(number, send, tmp_path):
    """A terminal's Ctrl-C reaches all of them, a termination the first only."""
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
        out, err = process.communicate(timeout=120.0)
    assert process.returncode == 130
    assert "Traceback" not in err
    assert 2 <= before <= len(written(tmp_path)) <= before + 20  # as soon as can be, however slow the machine
    assert [row["error"] for row in written(tmp_path)] == [""] * len(written(tmp_path))
    assert f"runs {len(written(tmp_path))}" in " ".join(out.split())
    t_end = time.monotonic() + 60.0
    while any(Path(f"/proc/{child}").exists() for child in children):
        assert time.monotonic() < t_end
        time.sleep(0.05)


def test_a_cluster_is_used_when_its_address_is_given(undrawn, tmp_path, monkeypatch, capsys):
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(montecarlo, "run", quick)
    with distributed.LocalCluster(1, threads_per_worker=2, processes=False, dashboard_address=":0") as dask:
        arguments = ["--kind", "rig", "--runs", "3", "--scheduler", dask.scheduler_address, "-o", str(tmp_path)]
        assert main(["montecarlo", *arguments]) == 0
    assert [row["seed"] for row in written(tmp_path)] == [0, 1, 2]
    assert capsys.readouterr().out.splitlines()[1].split() == ["runs", "3"]


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nonsense://there"])
def test_a_scheduler_that_is_not_there_is_one_line_and_earlier_rows_stay(address, tmp_path, monkeypatch, capsys):
    pytest.importorskip("distributed")
    monkeypatch.setattr(runs, "CONNECT_S", 0.3)
    (tmp_path / "runs.jsonl").write_text("precious\n")
    assert main(["montecarlo", "--scheduler", address, "-o", str(tmp_path)]) == 1
    err = capsys.readouterr().err
    assert err.startswith(f"no Dask scheduler at {address}: ")
    assert err.count("\n") == 1
    assert (tmp_path / "runs.jsonl").read_text() == "precious\n"


def test_a_cluster_needs_dask(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert main(["montecarlo", "--scheduler", "tcp://127.0.0.1:1", "-o", str(tmp_path)]) == 1
    told = f"--scheduler needs Dask, which is not installed: {install_line('Dask', 'studies')}\n"
    assert capsys.readouterr().err == told


def test_a_folder_that_cannot_be_is_one_line(quickly, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main(["montecarlo", "-o", str(tmp_path / "file")]) == 1
    assert "cannot be written" in capsys.readouterr().err
