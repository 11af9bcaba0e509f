"""Forty more mistakes of use: comparing, bundling, exporting, logs, configurations, plans; a line each."""

from __future__ import annotations

from pathlib import Path

import pytest
from mistakes import PORTS, Mistake, check_answer

HEAD = (
    '{"palmd_log":1,"rig":{"gravity_m_s2":9.81,"hinge":{"mode":"fixed"},'
    '"pad":{"length_m":0.05,"noise_m":1e-4,"resolution_m":1e-4},"force_scale_std":0.05}}\n'
)

MISTAKES = {
    "compare with a run that is not there": Mistake(
        "compare nowhere.mcap t.tum",
        1,
        "nowhere.mcap: no such file; `palmd runs FOLDER` lists the recordings in a folder",
    ),
    "compare a folder": Mistake(
        "compare runs",
        1,
        "runs: is a folder; name a file",
        {"runs/a.txt": "x\n"},
    ),
    "compare one track alone": Mistake(
        "compare t.tum",
        1,
        "t.tum: 1 poses; 30 are needed",
        {"t.tum": "0 0 0 0 0 0 0 1\n"},
    ),
    "a track with other columns": Mistake(
        "compare t.csv --reference t.csv",
        1,
        "t.csv:1: the column t_s is missing; required columns: t_s,object_x_mm,object_y_mm,object_angle_deg",
        {"t.csv": "time,x,y\n1,2,3\n"},
    ),
    "a pose of seven columns": Mistake(
        "compare t.tum t.tum",
        1,
        "t.tum:1: 7 columns; a line is time x y z qx qy qz qw",
        {"t.tum": "0 0 0 0 0 0 0\n"},
    ),
    "a figure in a text format": Mistake(
        "compare t.tum --figure f.doc",
        1,
        "f.doc: use the suffix .svg, .png, .pdf for a figure",
        {"t.tum": "0 0 0 0 0 0 0 1\n"},
    ),
    "a comparison over its input": Mistake(
        "compare t.tum -o t.tum",
        1,
        "t.tum: is an input; write to another file",
        {"t.tum": "0 0 0 0 0 0 0 1\n"},
    ),
    "a result without a trajectory": Mistake(
        "compare r.json r.json",
        1,
        "r.json: is not a result of palmd reconstruct: it has no trajectory",
        {"r.json": "[]\n"},
    ),
    "a bundle of a text": Mistake(
        "bundle notes.txt",
        1,
        "notes.txt: is neither a recording (.mcap) nor an event log (.jsonl)",
        {"notes.txt": "hello\n"},
    ),
    "a bundle of a folder": Mistake(
        "bundle runs",
        1,
        "runs: is a folder; `palmd runs FOLDER` lists the runs in one",
        {"runs/a.txt": "x\n"},
    ),
    "a bundle of nothing": Mistake(
        "bundle nowhere.mcap",
        1,
        "nowhere.mcap: no such file; `palmd runs FOLDER` lists the runs in one",
    ),
    "a bundle into a folder that is not there": Mistake(
        "bundle run.jsonl -o nowhere/b.zip",
        1,
        "nowhere/b.zip: cannot be written: No such file or directory",
        {"run.jsonl": HEAD},
    ),
    "an export without a place": Mistake(
        "export run.mcap",
        2,
        "palmd export: error: the following arguments are required: -o/--output",
    ),
    "an export of a text": Mistake(
        "export notes.txt -o x.svg",
        1,
        "notes.txt: is not an MCAP file",
        {"notes.txt": "hello\n"},
    ),
    "an export of half a result": Mistake(
        "export bad.json -o x.svg",
        1,
        "bad.json:1:2: not JSON: Expecting property name enclosed in double quotes",
        {"bad.json": "{"},
    ),
    "an export in a form of pictures": Mistake(
        "export run.mcap -o x.svg --as pdf",
        2,
        "palmd export: error: argument --as: there is no 'pdf'; did you mean 'dxf'?",
    ),
    "a report of a folder": Mistake(
        "report runs",
        1,
        "runs: is a folder; name a recording in it: `palmd runs FOLDER` lists them",
        {"runs/a.txt": "x\n"},
    ),
    "a report into a folder that is not there": Mistake(
        "report run.mcap -o nowhere/r.html",
        1,
        "nowhere/r.html: cannot be written: there is no folder nowhere",
    ),
    "why at a word": Mistake(
        "why run.mcap --at soon",
        2,
        "palmd why: error: argument --at: must be a time in the run in s, 0 or more, not soon",
    ),
    "why of a text": Mistake(
        "why notes.txt",
        1,
        "notes.txt: is not an MCAP file",
        {"notes.txt": "hello\n"},
    ),
    "runs of a file": Mistake(
        "runs notes.txt",
        1,
        "notes.txt: is a file; name its folder",
        {"notes.txt": "hello\n"},
    ),
    "runs of a folder that is not there": Mistake(
        "runs nowhere",
        1,
        "nowhere: no such folder: no run has been recorded into it; `palmd demo` records one into runs/",
    ),
    "runs since a word": Mistake(
        "runs --since yesterday",
        2,
        "palmd runs: error: argument --since: 'yesterday' is not a date; write one as 2026-11-23",
    ),
    "runs since a month that there is not": Mistake(
        "runs --since 2026-13-01",
        2,
        "palmd runs: error: argument --since: '2026-13-01' is not a date; write one as 2026-11-23",
    ),
    "a note to a run that is not there": Mistake(
        "runs runs --note 2026 text",
        1,
        "2026: there is no such run in runs",
        {"runs/a.txt": "x\n"},
    ),
    "a replay at no speed": Mistake(
        "replay run.mcap --speed 0",
        2,
        "palmd replay: error: argument --speed: must be more than 0, got 0",
    ),
    "a recovery of a text": Mistake(
        "runs recover notes.txt",
        1,
        "notes.txt: is not an MCAP file",
        {"notes.txt": "hello\n"},
    ),
    "an empty log": Mistake(
        "estimate run.jsonl -o x.jsonl",
        1,
        "run.jsonl:1: the file is empty; an event log begins with its palmd_log line",
        {"run.jsonl": ""},
    ),
    "a log of a third pad": Mistake(
        "estimate run.jsonl -o x.jsonl",
        1,
        "run.jsonl:2: pad must be 1 or 2, got 3",
        {"run.jsonl": HEAD + '{"t":2,"pad":3,"s_m":0.02}\n'},
    ),
    "a log of an arc without its length": Mistake(
        "estimate run.jsonl -o x.jsonl",
        1,
        "run.jsonl:1: palm1_length_m is missing",
        {"run.jsonl": '{"palmd_log":1,"rig":{"hinge":{"mode":"arc"}}}\n'},
    ),
    "a table for a log": Mistake(
        "reconstruct t.csv -o x.json",
        1,
        "t.csv:1: not JSON: Expecting value",
        {"t.csv": "t,x\n1,2\n"},
    ),
    "a log over itself": Mistake(
        "estimate run.jsonl -o run.jsonl",
        1,
        "run.jsonl:1: the log holds no events",
        {"run.jsonl": HEAD},
    ),
    "a list for a configuration": Mistake(
        "check my.yaml",
        1,
        "my.yaml:1:1: must be a block of keys and values; got a list",
        {"my.yaml": "- a\n"},
    ),
    "a decimal comma": Mistake(
        "check my.yaml",
        1,
        "my.yaml:3:23: rig: a comma begins another entry; for 9,81 write 9.81",
        {"my.yaml": PORTS + "rig: {gravity_m_s2: 9,81}\n"},
    ),
    "not a number at all": Mistake(
        "check my.yaml",
        1,
        "my.yaml:3:21: rig.gravity_m_s2: must be a finite number; got .nan",
        {"my.yaml": PORTS + "rig: {gravity_m_s2: .nan}\n"},
    ),
    "a rate below zero": Mistake(
        "check my.yaml",
        1,
        "my.yaml:3:17: loop.rate_hz: must be at least 10; got -100",
        {"my.yaml": PORTS + "loop: {rate_hz: -100}\n"},
    ),
    "a system that there is not": Mistake(
        "check my.yaml",
        1,
        "my.yaml:1:15: rig.system: there is no system 'three'; the systems are pivot, three_palms, and "
        "two palms without this key",
        {"my.yaml": "rig: {system: three}\n" + PORTS},
    ),
    "a zero beyond the pad": Mistake(
        "check my.yaml",
        1,
        "my.yaml:1:39: pads.palm1.zero_mm: count 0 would be 280 mm from the hinge, but the pad "
        "ends at 55.5 mm (length_mm)",
        {"my.yaml": PORTS.replace("/dev/a", "/dev/a, zero_mm: 280")},
    ),
    "a file for the folder of runs": Mistake(
        "check my.yaml",
        1,
        "my.yaml:3:21: record.directory: {here}/notes.txt is no folder: nothing could be recorded",
        {"my.yaml": PORTS + "record: {directory: notes.txt}\n", "notes.txt": "x\n"},
    ),
    "a plan without segments": Mistake(
        "check p.yaml",
        1,
        "p.yaml:2:11: segments: must have at least 1 entries; got 0",
        {"p.yaml": "name: p\nsegments: []\n"},
    ),
    "a hold of negative time": Mistake(
        "check p.yaml",
        1,
        "p.yaml:3:14: segments.0.hold_s: must be more than 0; got -1",
        {"p.yaml": "name: p\nsegments:\n  - {hold_s: -1}\n"},
    ),
    "a sine of no frequency": Mistake(
        "check p.yaml",
        1,
        "p.yaml:3:41: segments.0.frequency_hz: must be more than 0; got 0",
        {"p.yaml": "name: p\nsegments:\n  - {sine: {phi1_deg: 5}, frequency_hz: 0, duration_s: 2}\n"},
    ),
    "a coverage in per cent in a plan": Mistake(
        "check p.yaml",
        1,
        "p.yaml:3:26: segments.0.explore.coverage: must be at most 1; got 95",
        {"p.yaml": "name: p\nsegments:\n  - {explore: {coverage: 95}}\n"},
    ),
    "a plan run no times": Mistake(
        "check p.yaml",
        1,
        "p.yaml:2:9: repeat: must be a whole number from 1 to 10000, or forever; got 0",
        {"p.yaml": "name: p\nrepeat: 0\nsegments:\n  - {hold_s: 1}\n"},
    ),
    "two systems at once": Mistake(
        "demo --system pivot --rig tabletop",
        2,
        "palmd demo: error: argument --rig: not allowed with argument --system",
    ),
    "a demo of no time": Mistake(
        "demo --seconds 0",
        2,
        "palmd demo: error: argument --seconds: must be more than 0, got 0",
    ),
    "a port that there is not": Mistake(
        "view --port 80000",
        2,
        "palmd view: error: argument --port: must be 0 to 65535, got 80000",
    ),
    "a configuration to view that is not there": Mistake(
        "view --config nowhere.yaml",
        1,
        "nowhere.yaml: no addresses can be read from it: No such file or directory",
    ),
    "an address with an impossible port": Mistake(
        "ctl status --address tcp://127.0.0.1:99999",
        1,
        "tcp://127.0.0.1:99999: not an address (a port is 1 to 65535)",
    ),
    "an address without a port": Mistake(
        "ctl status --address tcp://127.0.0.1",
        1,
        "tcp://127.0.0.1: not an address (Invalid argument); one looks like tcp://127.0.0.1:9872",
    ),
    "a key that is not there": Mistake(
        "ctl status --key nowhere",
        1,
        "nowhere: no such file; palmd keys new makes one",
    ),
    "a shell that there is not": Mistake(
        "install completion tcsh",
        2,
        "palmd install completion: error: argument shell: there is no 'tcsh'; choose from bash, zsh, man",
    ),
    "an init over a file": Mistake(
        "init notes.txt",
        1,
        "notes.txt exists: name another file, or give --force",
        {"notes.txt": "x\n"},
    ),
    "pads without a radius": Mistake(
        "calibrate pads my.yaml",
        2,
        "palmd calibrate pads: error: the following arguments are required: --radius-mm",
        {"my.yaml": PORTS},
    ),
    "a port of a touch device that is not there": Mistake(
        "doctor --port /dev/nothing --arm-conformance",
        3,
        "arm: no such port /dev/nothing: check the plug and the configured name",
    ),
}


def test_there_are_forty() -> None:
    assert len(MISTAKES) >= 40


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_told_in_one_line(name: str, tmp_path: Path, monkeypatch, capsys) -> None:
    assert "\n" not in MISTAKES[name].told
    check_answer(MISTAKES[name], tmp_path, monkeypatch, capsys)
