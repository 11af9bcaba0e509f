"""`palmd record capture` before it reaches a rig, and its bundle. With an emulated rig: tests/rig/test_capture.py."""

import io
from pathlib import Path

import pytest

from palmd.cli import main
from palmd.cli.capture import Guide
from palmd.cli.capture_bundle import Bundle, with_pads
from palmd.config.two_palms import Config
from palmd.console.errors import CliError
from palmd.record.calipers import Measured, read_table
from palmd.yamlfile import load_config

ROOT = Path(__file__).parents[3]
TABLETOP, EXPLORE, LIVELY = (
    ROOT / "config" / name for name in ("tabletop.yaml", "plans/explore.yaml", "plans/lively.yaml")
)
STONE = Measured("stone", "runs/1-stone.mcap", "stone.jpg", 44.0, 36.0, 0.05)


def test_a_plan_without_an_end_is_refused_before_the_capture(tmp_path, capsys):
    assert main(["capture", str(TABLETOP), "--plan", str(LIVELY), "-o", str(tmp_path / "new")]) == 1
    assert "repeats forever" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_existing_files_are_not_overwritten(tmp_path, capsys):
    (tmp_path / "mine").write_text("mine")
    assert main(["capture", str(TABLETOP), "-o", str(tmp_path)]) == 1
    assert "is not empty" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


def test_a_bundle_loads_again_with_its_calibration_and_plan(tmp_path):
    bundle = Bundle.new(tmp_path / "bundle")
    run = tmp_path / "20261129.mcap"
    run.write_bytes(b"run")
    assert bundle.take_run(run, "1-stone") == STONE.run
    config = with_pads(load_config(TABLETOP), {"palm1": {"zero_mm": 2.6, "scale_sd": 0.002}})
    bundle.begin(config, EXPLORE, emulated=False)
    bundle.add(STONE)
    loaded: Config = load_config(bundle.folder / "palmd.yaml")
    assert (loaded.pads.palm1.zero_mm, loaded.pads.palm1.scale_sd, loaded.pads.palm2.zero_mm) == (2.6, 0.002, 2.5)
    assert (loaded.plan, loaded.record.directory) == (bundle.folder / "plan.yaml", bundle.folder / "runs")
    assert loaded.plan.read_text() == EXPLORE.read_text()
    (row,) = read_table(bundle.folder)
    assert (row.name, row.run, row.photo, row.largest_mm) == ("stone", STONE.run, "stone.jpg", 44.0)
    assert bundle.pack() == tmp_path / "bundle.zip"
    assert main(["check", str(loaded.plan), str(bundle.folder / "palmd.yaml")]) == 0


def guide(monkeypatch, tmp_path, *lines):
    monkeypatch.setattr("sys.stdin", io.StringIO("".join(f"{line}\n" for line in lines)))
    return Guide(None, load_config(TABLETOP), EXPLORE, Bundle.new(tmp_path / "bundle"), None)


def failing(times):
    left = [times]

    def step():
        left[0] -= 1
        if left[0] >= 0:
            raise CliError(3, "pad 1 is silent")
        return "done"

    return step


def test_a_failed_step_says_what_to_do_and_is_repeated(monkeypatch, tmp_path, capsys):
    assert guide(monkeypatch, tmp_path, "", "yes")._retry(failing(2), "wipe the pads") == "done"
    said = capsys.readouterr().err
    assert said.count("Failed: pad 1 is silent\nWhat to do: wipe the pads.") == 2
    with pytest.raises(CliError, match="silent"):
        guide(monkeypatch, tmp_path / "other", "no")._retry(failing(1), "wipe the pads")


class Stack:
    """Records which rigs and daemons are started; `measured` takes the cylinders in turn."""

    path, rig_info = TABLETOP, {"control": "c"}

    def __init__(self):
        self.started, self.on_palms, self.client = [], None, self

    def start_rig(self, *arguments):
        self.started.append("rig")
        self.on_palms = [each.partition("=")[2] for each in arguments if each.startswith("--cylinder")]

    def configure(self, *_):
        pass

    def begin_daemon(self):
        self.started.append("daemon")

    def wait_for_daemon(self):
        return True

    def ask(self, _command):
        return {"result": {"state": "ready"}}

    def ask_rig(self, command):
        assert command == "new_object"
        self.on_palms.append(self.on_palms.pop(0))


def test_a_repeated_calibration_of_the_emulated_rig_begins_with_the_first_cylinder(monkeypatch, tmp_path):
    stack, seen = Stack(), []
    config = load_config(TABLETOP)
    mine = Guide(stack, config, EXPLORE, Bundle.new(tmp_path / "bundle"), 0)
    stack.start_rig("--cylinder=24,150", "--cylinder=15,60")

    def measure(arguments, exchange):
        seen.append(stack.on_palms[0])
        exchange(config, "the first")
        seen.append(stack.on_palms[0])
        if len(seen) == 2:
            raise CliError(3, "the second one slipped")
        arguments.output.mkdir()
        (arguments.output / "standoff.yaml").write_text("configuration: {palm1: {zero_mm: 2.7}}")

    monkeypatch.setattr("palmd.calibration.standoff.measure", measure)
    mine.calibrate()
    assert seen == ["24,150", "15,60"] * 2
    assert stack.started == ["rig", "daemon", "rig", "daemon"]


def test_calipers_are_asked_for_and_an_implausible_answer_is_asked_again(monkeypatch, tmp_path, capsys):
    answers = ("44", "54", "36.5", "unknown", "")
    row = guide(monkeypatch, tmp_path, *answers)._measured("stone", "runs/1-stone.mcap")
    assert (row.largest_mm, row.smallest_mm, row.photo) == (44.0, 36.5, "stone.jpg")
    assert row.mass_g != row.mass_g
    assert "a number from 1 to 44" in capsys.readouterr().err


@pytest.mark.parametrize("similar", ["40", "60"])
def test_cylinders_that_cannot_calibrate_are_asked_again(monkeypatch, tmp_path, capsys, similar):
    one = guide(monkeypatch, tmp_path, "4", "48", similar, "30")
    assert one._ask("First", "", one._diameter()) == 48.0
    assert "the palms can turn" in capsys.readouterr().err
    assert one._ask("Second", "", one._diameter(48.0)) == 30.0
    assert "at most 36.9 or at least 62.4" in capsys.readouterr().err


def interrupted(folder, *runs):
    """A bundle whose capture ended after these recordings, with the first one measured."""
    bundle = Bundle.new(folder)
    bundle.begin(load_config(TABLETOP), EXPLORE, emulated=False)
    for run in runs:
        (folder / "runs" / f"{run}.mcap").write_bytes(b"run")
    bundle.add(STONE)
    return folder


def test_a_resumed_capture_asks_for_what_was_not_measured(monkeypatch, tmp_path, capsys):
    folder = interrupted(tmp_path / "bundle", "10-knob", "1-stone")
    monkeypatch.setattr("sys.stdin", io.StringIO("30\n28\n90.5\n\n"))
    assert main(["record", "capture", "--resume", str(folder), "--objects", "10"]) == 0
    assert capsys.readouterr().out.strip() == str(folder)
    rows = read_table(folder)
    assert [(row.name, row.run) for row in rows] == [("stone", STONE.run), ("knob", "runs/10-knob.mcap")]
    assert (rows[1].largest_mm, rows[1].smallest_mm, rows[1].mass_g, rows[1].photo) == (30.0, 28.0, 90.5, "knob.jpg")


def test_a_capture_that_ends_among_the_questions_says_how_it_goes_on(monkeypatch, tmp_path, capsys):
    folder = interrupted(tmp_path / "bundle", "1-stone", "2-knob")
    monkeypatch.setattr("sys.stdin", io.StringIO("30\n"))
    assert main(["record", "capture", "--resume", str(folder)]) == 1
    assert f"palmd record capture --resume {folder}" in capsys.readouterr().err
    assert [row.name for row in read_table(folder)] == ["stone"]


def test_what_cannot_be_resumed_is_refused(tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    assert main(["record", "capture", "--resume", str(tmp_path / "empty")]) == 1
    assert "not calibrated" in capsys.readouterr().err
    (tmp_path / "empty" / "palmd.yaml").write_text(TABLETOP.read_text())  # some rig's folder
    assert main(["record", "capture", "--resume", str(tmp_path / "empty")]) == 1
    assert "runs" in capsys.readouterr().err
    folder = interrupted(tmp_path / "bundle", "1-stone")
    assert main(["record", "capture", str(TABLETOP), "--resume", str(folder)]) == 2
    (folder / "truth.csv").write_text("name\nstone\n")
    assert main(["record", "capture", "--resume", str(folder)]) == 1
    assert "truth.csv:2: column run is missing" in capsys.readouterr().err


def test_a_bundle_without_a_caliper_table_cannot_be_compared(tmp_path, capsys):
    (tmp_path / "runs").mkdir()
    assert main(["reconstruct", str(tmp_path), "-o", str(tmp_path / "r.json")]) == 1
    assert "truth.csv" in capsys.readouterr().err
