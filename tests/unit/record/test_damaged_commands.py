"""Every command that reads a run, on damaged recordings: it ends, reads intact chunks, reports missing data."""

import math
import random

import damaged
import pytest
from campaign import nightly

from palmd.cli import main
from palmd.record import RunError
from palmd.record.run import read_any_run

READ = 0.95  # share of the messages in intact chunks
SEEDS = [0, *nightly(*range(1, 200))]
FORMS = {"log": "log.jsonl", "csv": "csv", "mcap-json": "json.mcap", "svg": "drawing.svg", "dxf": "drawing.dxf"}


def commands(run, out):
    """The commands by name."""
    exports = {f"export {form}": ["export", run, "-o", out / name, "--as", form] for form, name in FORMS.items()}
    return exports | {
        "points": ["export", run, "-o", out / "points.csv", "--as", "points"],
        "runs": ["runs", run.parent, "--json"],
        "compare": ["runs", run.parent, "--compare", run.stem, "whole"],
        "report": ["report", run, "-o", out / "report.html"],
        "why": ["why", run],
        "replay": ["replay", run, "--check"],
        "estimate": ["estimate", run, "-o", out / "estimate.jsonl"],
        "reconstruct": ["reconstruct", run, "-o", out / "result.json"],
        "recognise": ["recognise", run, out / "library"],
        "recover": ["recover", run, "-o", out / "saved.mcap"],
        "bundle": ["bundle", run, "-o", out / "bundle.zip"],
    }


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path = tmp_path_factory.mktemp("whole") / "whole.mcap"
    damaged.pack(path)
    return path


def laid_out(tmp_path, changed, data):
    """A folder of runs, a damaged one and an intact one; and a folder for results, with a library of outlines."""
    folder, out = tmp_path / "runs", tmp_path / "out"
    folder.mkdir()
    (out / "library").mkdir(parents=True)
    run = folder / "run.mcap"
    run.write_bytes(changed)
    (folder / "whole.mcap").write_bytes(data)
    angles = [math.tau * k / 90 for k in range(90)]
    points = "".join(f"{22 * math.cos(a):.4f},{18 * math.sin(a):.4f}\n" for a in angles)
    (out / "library" / "oval.csv").write_text(f"x_mm,y_mm\n{points}")
    return run, out


def each_command(run, out, capsys):
    """Name, status and errors of each command: it ends, gives a reason, and leaves the recording unchanged."""
    before = run.read_bytes()
    for name, words in commands(run, out).items():
        status = main([str(word) for word in words])
        said = capsys.readouterr()
        assert status in (0, 1), (name, status)
        assert "Traceback" not in said.err, name
        assert status == 0 or "run.mcap" in said.err, f"{name}: {said.err}"
        assert len(said.err.splitlines()) < 12, (name, said.err)
        assert run.read_bytes() == before, f"{name} has changed the recording"
        yield name, status, said


@pytest.mark.parametrize("seed", SEEDS)
def test_every_command_handles_a_damaged_recording(whole, tmp_path, capsys, seed):
    data = whole.read_bytes()
    changed, kept = damaged.damage(data, random.Random(seed))
    run, out = laid_out(tmp_path, changed, data)
    parts = damaged.chunks(data)
    everything, intact = set().union(*(m for *_, m in parts)), damaged.intact_messages(parts, kept)
    for name, status, said in each_command(run, out, capsys):
        if name == "export csv" and status == 0:
            rows = sum(len(file.read_text().splitlines()) - 1 for file in (out / "csv").iterdir())
            assert rows >= READ * len(intact)
            assert rows == len(everything) or said.err.strip(), f"{len(everything) - rows} lost without a message"
    try:
        read = sum(1 for _ in read_any_run(run).messages())
    except RunError:
        read = 0
    assert read >= READ * len(intact)
    if (out / "saved.mcap").exists():
        saved = read_any_run(out / "saved.mcap")
        assert saved.complete
        assert saved.layout.count == read


# of the nightly ones "text" and "empty" are like "zero", the others like random damage
@pytest.mark.parametrize("kind", ["header", "zero", *nightly("empty", "text", "duplicate", "footer")])
def test_every_command_handles_further_damage(whole, tmp_path, capsys, kind):
    data = whole.read_bytes()
    begin, end, _ = damaged.chunks(data)[5]
    changed = {
        "duplicate": data[:end] + data[begin:],
        "header": bytes(64) + data[64:],
        "footer": data[:-20],
        "empty": b"",
        "text": b"no recording\n" * 1000,
        "zero": bytes(len(data)),
    }[kind]
    run, out = laid_out(tmp_path, changed, data)
    for _ in each_command(run, out, capsys):
        pass
