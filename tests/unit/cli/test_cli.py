"""The command line as a whole: its table, exit statuses, start-up time, log lines, the progress bar."""

import importlib
import importlib.metadata
import io
import json
import logging
import os
import subprocess
import sys

import pytest

import palmd
from palmd import cli
from palmd.cli.table import COMMANDS, RENAMED, SHORT, load_module, subcommands
from palmd.console.errors import CliError
from palmd.console.extras import install_line
from palmd.console.progress import Progress, working
from palmd.logformat import JournalFormatter, is_journal


def usage(*argv):
    with pytest.raises(SystemExit) as caught:
        cli.main(argv)
    return caught.value.code


def test_version_and_help(capsys):
    assert usage("--version") == 0
    assert capsys.readouterr().out == f"palmd {palmd.__version__}\n"
    assert usage("--help") == 0
    output = capsys.readouterr().out
    assert all(f"  {name} " in output for name in subcommands())


def test_without_a_command_help_is_printed(capsys):
    assert usage() == 2
    output = capsys.readouterr().err
    assert all(f"  {name} " in output for name in subcommands())


@pytest.mark.parametrize("encoding", ["ascii", "cp437"])
def test_help_on_any_terminal(encoding):
    command = [sys.executable, "-m", "palmd", "--help"]
    environment = os.environ | {"PYTHONIOENCODING": encoding}
    done = subprocess.run(command, env=environment, capture_output=True, check=True)
    assert done.stderr == b""
    assert "see: palmd COMMAND --help" in " ".join(done.stdout.decode(encoding).split())


def test_errors_on_any_terminal(tmp_path):
    plan = tmp_path / "plan.yaml"
    plan.write_text("name: x\nsegments: [{move: {phi1_deg: 200}, duration_s: 1.0}]\n")
    command = [sys.executable, "-m", "palmd", "check", str(plan)]
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    done = subprocess.run(command, env=environment, capture_output=True, check=False)
    assert b"phi1 reaches 200?, the limit is 150?" in done.stderr


def test_data_on_standard_output_are_utf_8_on_any_terminal(tmp_path):
    program = (
        "import pathlib; from palmd.cli import logs, main; main(['keys', 'list'])\n"
        "with logs.open_output(logs.STDOUT, pathlib.Path('x')) as stream: stream.write('µ…')"
    )
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    done = subprocess.run(
        [sys.executable, "-c", program], env=environment, cwd=tmp_path, capture_output=True, check=True
    )
    assert done.stdout.decode("utf-8").endswith("µ…")


@pytest.mark.parametrize("command", COMMANDS, ids=lambda each: each.name)
def test_every_command_has_its_module_and_help(command, capsys):
    assert command.module is None or callable(load_module(command).run)
    assert usage(*command.name.split(), "--help") == 0
    assert capsys.readouterr().out.startswith(f"usage: palmd {command.name} ")


@pytest.mark.parametrize("old", RENAMED)
def test_a_former_spelling_works_and_names_the_new_one(old, capsys):
    assert usage(*old.split(), "--help") == 0
    shown = capsys.readouterr()
    assert shown.out.startswith(f"usage: palmd {RENAMED[old]} ")
    assert shown.err == f"palmd {old} is now: palmd {RENAMED[old]}\n"


@pytest.mark.parametrize(
    ("argv", "place"),
    [
        (("bench",), "python -m tools.studies NAME"),
        (("bench", "montecarlo", "--runs", "3"), "python -m tools.studies montecarlo"),
        (("outlook",), "docs/theory/outlook.md"),
        (("observability", "--states", "5"), "docs/theory/paper.md"),
        (("report", "paper", "-o", "x"), "python -m tools.studies paper"),
    ],
)
def test_a_command_that_became_a_study_names_the_study(argv, place, capsys):
    assert cli.main(argv) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert error.endswith(f"{place}\n")


@pytest.mark.parametrize(("short", "full"), SHORT.items())
def test_a_short_name_works_and_is_not_listed(short, full, capsys):
    assert usage(short, "--help") == 0
    shown = capsys.readouterr()
    assert shown.out.startswith(f"usage: palmd {full} ")
    assert shown.err == ""
    assert short not in subcommands()


def test_few_commands_are_listed():
    assert len(subcommands()) <= 22
    assert all(len(each.help) <= 100 for each in COMMANDS)


@pytest.mark.parametrize("argv", [["--help"], ["ctl", "status", "--help"]])
def test_quick_commands_do_not_load_heavy_libraries(argv):
    program = (
        "import sys; from palmd.cli import main\n"
        f"try: main({argv!r})\n"
        "except SystemExit: pass\n"
        "sys.exit(bool({'numpy', 'casadi', 'pydantic', 'yaml'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", program], capture_output=True, check=False).returncode == 0


class Ending:
    """A command that ends in a given way."""

    def __init__(self, end):
        self._end = end

    def add_arguments(self, _parser):
        pass

    def run(self, _arguments):
        if isinstance(self._end, int):
            return self._end
        raise self._end


@pytest.mark.parametrize(
    ("end", "status", "error"),
    [
        (0, 0, ""),
        (3, 3, ""),
        (CliError(1, "file:3: wrong"), 1, "file:3: wrong\n"),
        (CliError(3, "no rig"), 3, "no rig\n"),
        (KeyboardInterrupt(), 130, ""),
    ],
)
def test_the_exit_status_is_that_of_the_command(end, status, error, monkeypatch, capsys):
    monkeypatch.setattr(importlib, "import_module", lambda _: Ending(end))
    assert cli.main(["check"]) == status
    assert capsys.readouterr().err == error


def test_check_reports_all_errors_at_once(tmp_path, capsys):
    good, bad = tmp_path / "good.yaml", tmp_path / "bad.yaml"
    good.write_text("name: x\nsegments: [{hold_s: 1.0}]\n")
    bad.write_text("name: x\nnmae: y\nsegments: [{hold_s: -1.0}]\n")
    assert cli.main(["check", str(good)]) == 0
    assert capsys.readouterr().out == f"{good}: good\n"
    assert cli.main(["check", str(bad), str(tmp_path / "none.yaml")]) == 1
    err = capsys.readouterr().err.splitlines()
    assert len(err) == 3
    assert sum(line.startswith(f"{bad}:") for line in err) == 2


def test_check_reports_errors_as_json(tmp_path, capsys):
    good, bad = tmp_path / "good.yaml", tmp_path / "bad.yaml"
    good.write_text("name: x\nsegments: [{hold_s: 1.0}]\n")
    bad.write_text("name: x\nsegments: [{hold_s: -1.0}]\n")
    assert cli.main(["check", str(good), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"good": True, "problems": [], "notes": []}
    assert cli.main(["check", str(bad), "--json"]) == 1
    captured = capsys.readouterr()
    text = "segments.0.hold_s: must be more than 0; got -1.0"
    assert json.loads(captured.out)["problems"] == [{"file": str(bad), "line": 2, "column": 21, "text": text}]
    assert captured.err == ""
    (tmp_path / "o.json").write_text("{}")
    assert cli.main(["check", str(tmp_path / "o.json"), "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["problems"][0]["file"] == str(tmp_path / "o.json")


def test_check_draws_a_plan(tmp_path, capsys, monkeypatch):
    plan, picture = tmp_path / "plan.yaml", tmp_path / "out.svg"
    plan.write_text(
        "name: fast\nrepeat: 2\nsegments:\n  - {move: {phi1_deg: 45, phi2_deg: 90}, duration_s: 2.0}\n"
        "  - {move: {phi1_deg: 70}, duration_s: 0.5}\n"
    )
    assert cli.main(["check", str(plan), "--draw", str(picture)]) == 0
    rows = capsys.readouterr().out.splitlines()
    assert rows == [
        f"{plan}: good",
        f"{picture}: 3 s; nearest to its limit: phi12 = phi1 + phi2 135 to 160 of 0 to 172°",
    ]
    assert "<svg" in picture.read_text()
    first = picture.read_bytes()
    assert cli.main(["check", str(plan), "--draw", str(picture), "--json"]) == 0
    assert picture.read_bytes() == first
    capsys.readouterr()
    for argv, error in (
        ([str(plan), "--draw", "out.txt"], "out.txt: use the suffix .svg, .pdf, .png for a picture"),
        ([str(plan), str(plan), "--draw", str(picture)], "there are 2 plans and 0 configurations"),
        ([str(plan), "--draw", str(tmp_path / "none/out.svg")], "cannot be written: No such file or directory"),
    ):
        assert cli.main(["check", *argv]) == 1
        assert error in capsys.readouterr().err
    for module in ("palmd.report.plan_figure", "palmd.report.axes"):
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert cli.main(["check", str(plan), "--draw", str(picture)]) == 1
    assert f"--draw needs matplotlib, which is not installed: {install_line('matplotlib', 'report')}" in (
        capsys.readouterr().err
    )


# ------------------------------------------------------------------------------------------------ log lines


def test_log_lines_for_the_journal_carry_their_priority():
    formatter = JournalFormatter()
    levels = ((logging.CRITICAL, 2), (logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6), (logging.DEBUG, 7))
    for level, priority in levels:
        record = logging.LogRecord("x", level, "", 0, "one\n%s", ("two",), None)
        assert formatter.format(record) == f"<{priority}>one\n<{priority}>two"


def test_the_journal_is_recognised_by_its_stream(tmp_path):
    with (tmp_path / "stream").open("w") as stream:
        status = os.fstat(stream.fileno())
        environment = {"JOURNAL_STREAM": f"{status.st_dev}:{status.st_ino}"}
        assert is_journal(environment, stream.fileno())
        assert not is_journal({}, stream.fileno())
        with (tmp_path / "another").open("w") as another:
            assert not is_journal(environment, another.fileno())
    assert not is_journal(environment, 987_654)


# --------------------------------------------------------------------------------------------- progress bar


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_the_bar_shows_on_a_terminal_after_a_second(monkeypatch):
    now = [100.0]
    monkeypatch.setattr("palmd.console.progress.time.monotonic", lambda: now[0])
    terminal = Terminal()
    with Progress("work", 200, "ticks", terminal) as progress:
        for done, after in ((10, 0.0), (20, 0.9), (100, 1.1), (101, 1.15), (150, 1.3)):
            now[0] = 100.0 + after
            progress.at(done)
    shown = terminal.getvalue().split("\r")
    assert ["50 % of 200 ticks" in shown[1], "75 % of 200 ticks" in shown[2], len(shown)] == [True, True, 4]
    assert shown[-1] == "\x1b[K"


def test_the_bar_is_not_shown_otherwise(monkeypatch):
    now = [100.0]
    monkeypatch.setattr("palmd.console.progress.time.monotonic", lambda: now[0])
    for stream, after in ((Terminal(), 0.5), (io.StringIO(), 5.0)):
        with Progress("work", 200, "ticks", stream) as progress:
            now[0] = 100.0 + after
            progress.at(100)
        assert stream.getvalue() == ""
        now[0] = 100.0


@pytest.mark.parametrize(("encoding", "cells"), [("utf-8", "█" * 15 + "░" * 15), ("ascii", "#" * 15 + "." * 15)])
def test_the_bar_on_a_terminal_of_another_encoding(monkeypatch, encoding, cells):
    now = [100.0]
    monkeypatch.setattr("palmd.console.progress.time.monotonic", lambda: now[0])
    terminal = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
    terminal.isatty = lambda: True
    with Progress("work", 200, "ticks", terminal) as progress:
        now[0] = 102.0
        progress.at(100)
    assert cells in terminal.buffer.getvalue().decode(encoding)


def test_work_of_unknown_length_is_named_while_it_lasts():
    terminal = Terminal()
    with working("reading run.mcap", terminal) as say:
        assert terminal.getvalue() == "\rreading run.mcap ..."
        say("3 of 20 s")
        assert terminal.getvalue() == "\rreading run.mcap ...\r\x1b[K3 of 20 s ..."
    assert terminal.getvalue().endswith("\r\x1b[K")
    with working("reading run.mcap", pipe := io.StringIO()) as say:
        say("3 of 20 s")
    assert pipe.getvalue() == ""


# ---------------------------------------------------------------------------------------- optional packages


def test_a_missing_package_is_reported_with_the_command_that_installs_it(monkeypatch, tmp_path):
    def declared(_name):
        return ["numpy>=1.26", "matplotlib>=3.8; extra == 'report'", 'matplotlib>=3.8; extra == "studies"',
                "filterpy>=2.0; extra == 'studies'"]  # fmt: skip

    monkeypatch.setattr("importlib.metadata.requires", declared)
    monkeypatch.setattr(sys, "executable", str(tmp_path / ".venv/bin/python"))
    assert install_line("matplotlib", "report") == f"{tmp_path}/.venv/bin/python -m pip install 'matplotlib>=3.8'"
    monkeypatch.chdir(tmp_path)
    assert install_line("filterpy", "studies") == ".venv/bin/python -m pip install 'matplotlib>=3.8' 'filterpy>=2.0'"

    def none(_name):
        raise importlib.metadata.PackageNotFoundError

    monkeypatch.setattr("importlib.metadata.requires", none)  # palmd from its sources
    assert install_line("matplotlib", "report") == ".venv/bin/python -m pip install matplotlib"
