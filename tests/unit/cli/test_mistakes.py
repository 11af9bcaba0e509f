"""Common mistakes, each with its exact message: one line a fault, where it is, what to do.

Messages about a file's contents are tested with its reader.

The usage line that argparse prints above its message is left out here. `{here}` is the working folder.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from palmd import cli

PORTS = "pads: {palm1: {port: /dev/a}, palm2: {port: /dev/b}}\narm: {port: /dev/c}\n"
FIRST = "name: p\nsegments:\n  - {move: {phi1_deg: 45, phi2_deg: 90}, duration_s: 2.0}\n"
HEAD = (
    '{"palmd_log":1,"rig":{"gravity_m_s2":9.81,"hinge":{"mode":"fixed"},'
    '"pad":{"length_m":0.05,"noise_m":1e-4,"resolution_m":1e-4},"force_scale_std":0.05}}\n'
)

# fmt: off
MISTAKES = (
    ("rnu my.yaml", 2, "palmd: error: argument COMMAND: there is no 'rnu'; did you mean 'run'?"),
    ("ctl strat", 2, "palmd ctl: error: argument COMMAND: there is no 'strat'; did you mean 'start'?"),
    ("run", 2, "palmd run: error: the following arguments are required: CONFIG"),
    ("calibrate pad my.yaml", 2, "palmd calibrate pad: error: the following arguments are required: --pad"),
    ("calibrate pad my.yaml --pad 3", 2,
     "palmd calibrate pad: error: argument --pad: there is no '3'; choose from 1, 2"),
    ("ctl jog", 2, "ctl jog: by how much? give --phi1-deg, --phi2-deg or both, such as --phi1-deg 1"),
    ("ctl jog --phi1-deg 400", 2, "palmd ctl jog: error: argument --phi1-deg: must be -90 to 90, got 400"),
    ("ctl jog --phi1-deg one", 2, "palmd ctl jog: error: argument --phi1-deg: must be a number, got 'one'"),
    ("rig --seed x", 2, "palmd demo rig: error: argument --seed: must be a whole number, got 'x'"),
    ("ctl explore --coverage 95", 2,
     "palmd ctl explore: error: argument --coverage: must be more than 0 and at most 1, got 95; did you mean a "
     "share of 1, such as 0.95?"),
    ("ctl explore --seconds nan", 2,
     "palmd ctl explore: error: argument --seconds: must be more than 0 and at most 3600, got nan"),
    ("ctl explore --band-mm -1", 2,
     "palmd ctl explore: error: argument --band-mm: must be more than 0 and at most 10, got -1"),
    ("estimate run.jsonl -o out.jsonl --observer kalman", 2,
     "palmd estimate: error: argument --observer: there is no observer 'kalman'; choose from shape, extended, "
     "quasistatic"),
    ("estimate run.jsonl", 2, "palmd estimate: error: the following arguments are required: -o/--output"),
    ("rig --inject explode", 1,
     "unknown fault 'explode'; known: drop, garble, mute, unplug, late, burst, misbaud, touch, break, estop, "
     "power_off, manual, block, freeze, jump, saturate, lift, swap, overload, overheat, undervoltage, brownout, "
     "overflow"),
    ("rig --seed -1", 1, "--seed must not be negative, got -1"),
    ("rig nowhere.yaml", 1, "nowhere.yaml:1:1: no such file"),
    ("rig my.yaml", 1, "my.yaml:3:6: arm: kind adept needs hinge: arc, but rig.hinge is fixed",
     {"my.yaml": "rig: {hinge: fixed}\n" + PORTS}),
    ("rig --ports notes.txt/new", 1, "--ports: notes.txt/new: Not a directory", {"notes.txt": "hello\n"}),
    ("rig --ports notes.txt", 1, "--ports: notes.txt is not a folder", {"notes.txt": "hello\n"}),
    ("top --once --address localhost:9872", 1,
     "localhost:9872: not an address (Invalid argument); one looks like tcp://127.0.0.1:9872"),
    ("ctl status --address tcp://127.0.0.1:1", 3,
     "no answer from tcp://127.0.0.1:1 within 2 s: is a palmd running there, and does it have keys (then give "
     "--key)?"),
    ("jog my.yaml", 1,
     "jog needs a terminal for its keys; without one use palmd ctl jog --phi1-deg 1", {"my.yaml": PORTS}),
    ("run nowhere.yaml", 1, "nowhere.yaml:1:1: no such file"),
    ("run p.yaml", 1,
     "p.yaml:1:1: this is a motion plan; expected a configuration, which may name it (plan: FILE)", {"p.yaml": FIRST}),
    ("check my.yaml", 1,
     "my.yaml:1:38: pads.palm2: port /dev/a is already used by palm1", {"my.yaml": PORTS.replace("/dev/b", "/dev/a")}),
    ("check my.yaml", 1,
     "my.yaml:3:24: rig.palm1_length_mm: 0.12 mm is implausible: 20 to 1000 mm is usual; did you mean 120 mm?",
     {"my.yaml": PORTS + "rig: {palm1_length_mm: 0.12}\n"}),
    ("reconstruct run.jsonl -o r.json", 1,
     'run.jsonl:1: the first line must be the header {"palmd_log":1,"rig":{…}}', {"run.jsonl": '{"t":1}\n'}),
    ("export run.mcap -o run.xls", 1,
     "run.xls: the name does not determine the format; add --as log|csv|mcap-json|rrd|lerobot|svg|dxf|points"),
    ("check o.csv", 1, "o.csv:1: the header must be x_mm,y_mm, got x,y", {"o.csv": "x,y\n"}),
    ("compare nowhere.mcap t.tum", 1,
     "nowhere.mcap: no such file; `palmd runs FOLDER` lists the recordings in a folder"),
    ("compare t.csv --reference t.csv", 1,
     "t.csv:1: the column t_s is missing; required columns: t_s,object_x_mm,object_y_mm,object_angle_deg",
     {"t.csv": "time,x,y\n1,2,3\n"}),
    ("compare t.tum --figure f.doc", 1,
     "f.doc: use the suffix .svg, .png, .pdf for a figure", {"t.tum": "0 0 0 0 0 0 0 1\n"}),
    ("compare t.tum -o t.tum", 1, "t.tum: is an input; write to another file", {"t.tum": "0 0 0 0 0 0 0 1\n"}),
    ("bundle notes.txt", 1,
     "notes.txt: is neither a recording (.mcap) nor an event log (.jsonl)", {"notes.txt": "hello\n"}),
    ("bundle nowhere.mcap", 1, "nowhere.mcap: no such file; `palmd runs FOLDER` lists the runs in one"),
    ("bundle run.jsonl -o nowhere/b.zip", 1,
     "nowhere/b.zip: cannot be written: No such file or directory", {"run.jsonl": HEAD}),
    ("export run.mcap", 2, "palmd export: error: the following arguments are required: -o/--output"),
    ("export bad.json -o x.svg", 1,
     "bad.json:1:2: not JSON: Expecting property name enclosed in double quotes", {"bad.json": "{"}),
    ("export run.mcap -o x.svg --as pdf", 2,
     "palmd export: error: argument --as: there is no 'pdf'; did you mean 'dxf'?"),
    ("why run.mcap --at soon", 2,
     "palmd why: error: argument --at: must be a time in the run in s, 0 or more, not soon"),
    ("runs notes.txt", 1, "notes.txt: is a file; name its folder", {"notes.txt": "hello\n"}),
    ("runs nowhere", 1,
     "nowhere: no such folder: no run has been recorded into it; `palmd demo` records one into runs/"),
    ("runs --since yesterday", 2,
     "palmd runs: error: argument --since: 'yesterday' is not a date; write one as 2026-11-23"),
    ("runs runs --note 2026 text", 1, "2026: there is no such run in runs", {"runs/a.txt": "x\n"}),
    ("replay run.mcap --speed 0", 2, "palmd replay: error: argument --speed: must be more than 0, got 0"),
    ("estimate run.jsonl -o x.jsonl", 1,
     "run.jsonl:2: pad must be 1 or 2, got 3", {"run.jsonl": HEAD + '{"t":2,"pad":3,"s_m":0.02}\n'}),
    ("estimate run.jsonl -o run.jsonl", 1, "run.jsonl:1: the log holds no events", {"run.jsonl": HEAD}),
    ("check my.yaml", 1,
     "my.yaml:3:23: rig: a comma begins another entry; for 9,81 write 9.81",
     {"my.yaml": PORTS + "rig: {gravity_m_s2: 9,81}\n"}),
    ("check my.yaml", 1,
     "my.yaml:3:17: loop.rate_hz: must be at least 10; got -100", {"my.yaml": PORTS + "loop: {rate_hz: -100}\n"}),
    ("check my.yaml", 1,
     "my.yaml:1:15: rig.system: there is no system 'three'; the systems are pivot, three_palms, and two palms "
     "without this key",
     {"my.yaml": "rig: {system: three}\n" + PORTS}),
    ("check p.yaml", 1,
     "p.yaml:3:41: segments.0.frequency_hz: must be more than 0; got 0",
     {"p.yaml": "name: p\nsegments:\n  - {sine: {phi1_deg: 5}, frequency_hz: 0, duration_s: 2}\n"}),
    ("check p.yaml", 1,
     "p.yaml:3:26: segments.0.explore.coverage: must be at most 1; got 95",
     {"p.yaml": "name: p\nsegments:\n  - {explore: {coverage: 95}}\n"}),
    ("demo --system pivot --rig tabletop", 2, "palmd demo: error: argument --rig: not allowed with argument --system"),
    ("demo --seconds 0", 2, "palmd demo: error: argument --seconds: must be more than 0, got 0"),
    ("view --port 80000", 2, "palmd view: error: argument --port: must be 0 to 65535, got 80000"),
    ("view --config nowhere.yaml", 1, "nowhere.yaml: no addresses can be read from it: No such file or directory"),
    ("ctl status --address tcp://127.0.0.1:99999", 1, "tcp://127.0.0.1:99999: not an address (a port is 1 to 65535)"),
    ("ctl status --address tcp://127.0.0.1", 1,
     "tcp://127.0.0.1: not an address (Invalid argument); one looks like tcp://127.0.0.1:9872"),
    ("ctl status --key nowhere", 1, "nowhere: no such file; palmd keys new makes one"),
    ("install completion tcsh", 2,
     "palmd install completion: error: argument shell: there is no 'tcsh'; choose from bash, zsh, man"),
    ("init notes.txt", 1, "notes.txt exists: name another file, or give --force", {"notes.txt": "x\n"}),
    ("doctor arm nowhere.yaml", 1, "nowhere.yaml:1:1: no such file"),
    ("doctor --arm-conformance --yes", 2,
     "palmd doctor --arm-conformance: palmd doctor arm tests the actuator; the conformance suites run in a checkout:"
     " python -m tools.conformance arm PORT"),
)
"""The command line, its exit status, its message, and the files in the folder."""
# fmt: on


@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda mistake: mistake[0])
def test_a_mistake_is_reported_in_one_line(mistake, tmp_path: Path, monkeypatch, capsys) -> None:
    typed, status, message, *others = mistake
    files: dict[str, str] = others[0] if others else {}
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("palmd.daemon.realtime.prepare", lambda *_: [])
    for path, text in files.items():
        Path(path).parent.mkdir(exist_ok=True)
        Path(path).write_text(text)
    try:
        ended = cli.main(typed.split())
    except SystemExit as caught:
        ended = caught.code
    captured = capsys.readouterr()
    said = re.sub(r"\Ausage: .*?^(?=palmd.*: error: )", "", captured.err, flags=re.DOTALL | re.MULTILINE)
    assert said == message.replace("{here}", str(tmp_path)) + "\n"
    assert (ended, captured.out) == (status, "")
    assert {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file()} == set(files)


FAR = "name: far\nrepeat: forever\nsegments:\n  - {move: {phi1_deg: 75, phi2_deg: 90}, duration_s: 0.8}\n"
BAD_FILES = {
    "ten-megabytes": ("# all the same\n" * 700_000, "1:1:"),
    "two mistakes": (PORTS + 'arm2: 1\nloop: {rate_hz: "100"}\n', "4:17:"),
    "binary": ("\0\1\2", "1:1:"),
    "plan-outside-limits": (PORTS + "plan: far.yaml\nlimits: {phi1_deg: [20, 70]}\n", "far.yaml:4:"),
}


@pytest.mark.parametrize("command", ["run", "check"])
@pytest.mark.parametrize("name", BAD_FILES)
def test_a_bad_file_is_reported_with_its_place_and_nothing_starts(tmp_path, capsys, command, name) -> None:
    text, place = BAD_FILES[name]
    config, plan = tmp_path / "palmd.yaml", tmp_path / "far.yaml"
    config.write_text(text)
    plan.write_text(FAR)
    files = [config, plan] if command == "check" and name == "plan-outside-limits" else [config]
    assert cli.main([command, *map(str, files)]) == 1
    out, err = capsys.readouterr()
    path = plan if place.startswith("far") else config
    assert out == ""
    assert f"{path}:{place.removeprefix('far.yaml:')}" in err
    assert all(line.startswith(f"{path}:") for line in err.splitlines())
    assert len(err) < 1000
