"""`palmd doctor --touch`: strokes show which pad is which, which axis matters and its sign."""

import os
import threading
import time

import pytest
import terminals

from palmd.cli import main
from palmd.config.pads import VersaPadConfig
from palmd.config.two_palms import PadsConfig
from palmd.console.errors import CliError
from palmd.devices.versapad import encode_packet
from palmd.doctor import touch
from palmd.doctor.touch import FingerStroke, changes

PADS = PadsConfig(palm1=VersaPadConfig(port="one"), palm2=VersaPadConfig(port="two", axis="y", sign=-1))


def stroke(heard_on, x, y=0):
    steps = range(20)
    return FingerStroke(heard_on, tuple(x * k // 19 for k in steps), tuple(y * k // 19 for k in steps))


def suggestions(*strokes):
    return [line.partition("  #")[0].strip() for line in changes(strokes, PADS)]


def test_pads_as_configured():
    assert suggestions(stroke(1, 300, 20), stroke(2, 10, -300)) == []


def test_swapped_pads_are_reported_with_the_ports_to_write():
    assert suggestions(stroke(2, 300), stroke(1, 0, -300)) == ["pads.palm1: port: two", "pads.palm2: port: one"]


def test_mirrored_and_turned_pads():
    assert suggestions(stroke(1, -300), stroke(2, 0, 300)) == ["pads.palm1: sign: -1", "pads.palm2: sign: 1"]
    assert suggestions(stroke(1, 0, 300), stroke(2, -300)) == ["pads.palm1: axis: y", "pads.palm2: axis: x"]


@pytest.mark.parametrize("strokes", [(stroke(1, 300), stroke(1, 300)), (stroke(1, 200, 180), stroke(2, 0, -300)),
                                     (stroke(1, 0), stroke(2, 0, -300))])  # fmt: skip
def test_ambiguous_strokes_are_an_error(strokes):
    with pytest.raises(CliError):
        suggestions(*strokes)


@pytest.fixture
def rig(tmp_path):
    """Two pads on pseudo-terminals; their far ends and the configuration."""
    with terminals.line() as (far1, port1), terminals.line() as (far2, port2):
        path = tmp_path / "palmd.yaml"
        path.write_text(f"pads: {{palm1: {{port: {port1}}}, palm2: {{port: {port2}}}}}\narm: {{port: /dev/none}}\n")
        yield {1: far1, 2: far2}, path


def slide(master, counts):
    for k in range(30):
        os.write(master, encode_packet(counts * k // 29, 0, 50))
        time.sleep(0.01)


def test_strokes_by_hand_identify_both_pads(monkeypatch, capsys, rig):
    masters, path = rig
    asked = [threading.Event(), threading.Event()]

    def hand():
        for event, palm, counts in zip(asked, (2, 1), (250, -250), strict=True):
            event.wait(10.0)
            slide(masters[palm], counts)

    listened = touch._stroke

    def listen(palm, listeners):
        asked[palm - 1].set()
        return listened(palm, listeners)

    monkeypatch.setattr(touch, "_stroke", listen)
    thread = threading.Thread(target=hand)
    thread.start()
    assert main(["doctor", str(path), "--touch"]) == 1
    thread.join()
    lines = [line.partition("  #")[0].strip() for line in capsys.readouterr().out.splitlines()]
    assert [line.split(":")[1].strip() for line in lines if line.startswith("pads.palm")] == ["port", "port", "sign"]


def test_without_any_touch_the_check_ends(monkeypatch, capsys, rig):
    monkeypatch.setattr(touch, "TOUCH_WITHIN_S", 0.2)
    assert main(["doctor", str(rig[1]), "--touch"]) == 3
    assert "no stroke within" in capsys.readouterr().err
