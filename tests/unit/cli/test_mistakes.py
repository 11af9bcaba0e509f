"""Forty mistakes that people make, each with the exact message that it gets: one line a fault, where it is, what to do.

What argparse prints above its message (the usage) is left out here. `{here}` is the folder in which all is done.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from mistakes import PORTS, Mistake, check_answer

FIRST = "name: p\nsegments:\n  - {move: {phi1_deg: 45, phi2_deg: 90}, duration_s: 2.0}\n"


MISTAKES = {
    # ---------------------------------------------------------------------------------------- what to type
    "a slip in a command's name": Mistake(
        "rnu my.yaml", 2, "palmd: error: argument COMMAND: there is no 'rnu'; did you mean 'run'?"
    ),
    "a slip in the name of one below": Mistake(
        "calibrate pda", 2, "palmd calibrate: error: argument NAME: there is no 'pda'; did you mean 'pad'?"
    ),
    "a slip in what the daemon shall do": Mistake(
        "ctl strat", 2, "palmd ctl: error: argument COMMAND: there is no 'strat'; did you mean 'start'?"
    ),
    "no configuration": Mistake("run", 2, "palmd run: error: the following arguments are required: CONFIG"),
    "which pad was not said": Mistake(
        "calibrate pad my.yaml", 2, "palmd calibrate pad: error: the following arguments are required: --pad"
    ),
    "a third pad": Mistake(
        "calibrate pad my.yaml --pad 3",
        2,
        "palmd calibrate pad: error: argument --pad: there is no '3'; choose from 1, 2",
    ),
    "a jog without angles": Mistake(
        "ctl jog", 2, "ctl jog: by how much? give --phi1-deg, --phi2-deg or both, such as --phi1-deg 1"
    ),
    "a jog right round": Mistake(
        "ctl jog --phi1-deg 400", 2, "palmd ctl jog: error: argument --phi1-deg: must be -90 to 90, got 400"
    ),
    "a word for a number": Mistake(
        "ctl jog --phi1-deg one", 2, "palmd ctl jog: error: argument --phi1-deg: must be a number, got 'one'"
    ),
    "a seed that is none": Mistake(
        "rig --seed x", 2, "palmd demo rig: error: argument --seed: must be a whole number, got 'x'"
    ),
    "per cent for a share": Mistake(
        "ctl explore --coverage 95",
        2,
        "palmd ctl explore: error: argument --coverage: must be more than 0 and at most 1, got 95; did you mean a "
        "share of 1, such as 0.95?",
    ),
    "an observer that does not exist": Mistake(
        "estimate run.jsonl -o out.jsonl --observer kalman",
        2,
        "palmd estimate: error: argument --observer: there is no observer 'kalman'; choose from shape, extended,"
        " quasistatic",
    ),
    "nowhere to write to": Mistake(
        "estimate run.jsonl", 2, "palmd estimate: error: the following arguments are required: -o/--output"
    ),
    "mischief that is not known": Mistake(
        "rig --mischief explode",
        1,
        "unknown fault 'explode'; known: drop, garble, mute, unplug, late, burst, misbaud, touch, break, estop,"
        " power_off, manual, block, freeze, jump, saturate,"
        " lift, swap, overload, overheat, undervoltage, brownout, overflow",
    ),
    "a file where a folder should be": Mistake(
        "rig --ports notes.txt", 1, "--ports: notes.txt is not a folder", {"notes.txt": "hello\n"}
    ),
    "an address without tcp://": Mistake(
        "top --once --address localhost:9872",
        1,
        "localhost:9872: not an address (Invalid argument); one looks like tcp://127.0.0.1:9872",
    ),
    "no daemon there": Mistake(
        "ctl status --address tcp://127.0.0.1:1",
        3,
        "no answer from tcp://127.0.0.1:1 within 2 s: is a palmd running there, and does it have keys (then give"
        " --key)?",
    ),
    "keys without a terminal": Mistake(
        "jog my.yaml",
        1,
        "jog needs a terminal for its keys; without one use palmd ctl jog --phi1-deg 1",
        {"my.yaml": PORTS},
    ),
    # --------------------------------------------------------------------------------------- configurations
    "a file that is not there": Mistake("run nowhere.yaml", 1, "nowhere.yaml:1:1: no such file"),
    "a plan for a configuration": Mistake(
        "run p.yaml",
        1,
        "p.yaml:1:1: this is a motion plan; expected a configuration, which may name it (plan: FILE)",
        {"p.yaml": FIRST},
    ),
    "an empty file": Mistake("check my.yaml", 1, "my.yaml:1:1: the file is empty", {"my.yaml": ""}),
    "a folder for a file": Mistake("check .", 1, ".:1:1: this is a folder, not a file"),
    "a key with a slip": Mistake(
        "check my.yaml", 1, "my.yaml:3:1: limts: unknown key; did you mean limits?", {"my.yaml": PORTS + "limts: {}\n"}
    ),
    "a key that is missing": Mistake(
        "check my.yaml", 1, "my.yaml:1:1: arm: is missing", {"my.yaml": PORTS.splitlines()[0] + "\n"}
    ),
    "a key twice": Mistake(
        "check my.yaml",
        1,
        "my.yaml:4:1: loop: this key is already in line 3",
        {"my.yaml": PORTS + "loop: {rate_hz: 100}\nloop: {rate_hz: 50}\n"},
    ),
    "a tab": Mistake(
        "check my.yaml",
        1,
        "my.yaml:4:1: a tab in the indentation: use spaces",
        {"my.yaml": PORTS + "limits:\n\trate_deg_s: 10\n"},
    ),
    "a number in quotes": Mistake(
        "check my.yaml",
        1,
        'my.yaml:3:17: loop.rate_hz: must be a number; got the text "100"; leave out the quotes',
        {"my.yaml": PORTS + 'loop: {rate_hz: "100"}\n'},
    ),
    "limits the wrong way round": Mistake(
        "check my.yaml",
        1,
        "my.yaml:3:20: limits.phi1_deg: must be [low, high] with -30 ≤ low < high ≤ 180; got [150, 6]",
        {"my.yaml": PORTS + "limits: {phi1_deg: [150, 6]}\n"},
    ),
    "one port for both pads": Mistake(
        "check my.yaml",
        1,
        "my.yaml:1:38: pads.palm2: port /dev/a is already used by palm1",
        {"my.yaml": PORTS.replace("/dev/b", "/dev/a")},
    ),
    "metres for millimetres": Mistake(
        "check my.yaml",
        1,
        "my.yaml:3:24: rig.palm1_length_mm: 0.12 mm is implausible: 20 to 1000 mm is usual; did you mean 120 mm?",
        {"my.yaml": PORTS + "rig: {palm1_length_mm: 0.12}\n"},
    ),
    "millimetres a count for counts a millimetre": Mistake(
        "check my.yaml",
        1,
        "my.yaml:1:45: pads.palm1.counts_per_mm: 0.127 counts/mm is implausible: 0.5 to 150 counts/mm is usual; did"
        " you mean 7.874 counts/mm?",
        {"my.yaml": PORTS.replace("/dev/a", "/dev/a, counts_per_mm: 0.127")},
    ),
    "a plan that does not exist": Mistake(
        "check my.yaml",
        1,
        "my.yaml:3:7: plan: {here}/plans/rok.yaml does not exist; did you mean {here}/plans/rock.yaml?",
        {"my.yaml": PORTS + "plan: plans/rok.yaml\n", "plans/rock.yaml": FIRST},
    ),
    "a bus for everybody, without keys": Mistake(
        "check my.yaml",
        1,
        "my.yaml:3:16: bus.publish: 0.0.0.0 can be reached from other machines, which needs CURVE keys, and none are"
        " configured; use tcp://127.0.0.1:PORT or ipc://PATH",
        {"my.yaml": PORTS + 'bus: {publish: "tcp://0.0.0.0:9872"}\n'},
    ),
    # ------------------------------------------------------------------------------------------------ plans
    "beyond the limits": Mistake(
        "check p.yaml",
        1,
        "p.yaml:4:5: segments.1: phi2 falls to 30°, the limit is 35°",
        {"p.yaml": FIRST + "  - {move: {phi2_deg: 30}, duration_s: 2.0}\n"},
    ),
    "too quick": Mistake(
        "check p.yaml",
        1,
        "p.yaml:4:5: segments.1: the acceleration of phi1 reaches 923.758°/s², the limit is 900°/s²; duration_s must be"
        " 0.26 or more",
        {"p.yaml": FIRST + "  - {move: {phi1_deg: 55}, duration_s: 0.25}\n"},
    ),
    "the wrong way": Mistake(
        "check p.yaml",
        1,
        "p.yaml:4:5: segments.1: phi1 turns at 20°/s and never reaches 30°: it starts at 45°",
        {"p.yaml": FIRST + "  - {rate: {phi1_deg_s: 20}, until: {phi1_deg: 30}}\n"},
    ),
    "a segment of no kind": Mistake(
        "check p.yaml",
        1,
        "p.yaml:4:5: segments.1: a segment needs exactly one of the keys move, rate, hold_s, sine, explore",
        {"p.yaml": FIRST + "  - {wait: 3}\n"},
    ),
    # ------------------------------------------------------------------------------------- logs and recordings
    "a recording that is not there": Mistake(
        "report none.mcap", 1, "none.mcap: no such file; `palmd runs FOLDER` lists the recordings in a folder"
    ),
    "a text for a recording": Mistake(
        "report notes.txt", 1, "notes.txt: is not an MCAP file", {"notes.txt": "hello\n"}
    ),
    "a log without its first line": Mistake(
        "reconstruct run.jsonl -o r.json",
        1,
        'run.jsonl:1: the first line must be the header {"palmd_log":1,"rig":{…}}',
        {"run.jsonl": '{"t":1}\n'},
    ),
    "a form of report that there is not": Mistake(
        "report run.mcap -o run.doc", 1, "run.doc: the suffix of a report must be .html or .pdf"
    ),
    "a form of export that there is not": Mistake(
        "export run.mcap -o run.xls",
        1,
        "run.xls: the name does not determine the format; add --as log|csv|mcap-json|rrd|lerobot|svg|dxf|points",
    ),
    "an outline with other columns": Mistake(
        "check o.csv", 1, "o.csv:1: the header must be x_mm,y_mm, got x,y", {"o.csv": "x,y\n"}
    ),
}


def test_there_are_forty() -> None:
    assert len(MISTAKES) >= 40


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_told(name: str, tmp_path: Path, monkeypatch, capsys) -> None:
    check_answer(MISTAKES[name], tmp_path, monkeypatch, capsys)
