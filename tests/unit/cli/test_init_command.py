"""`palmd init`: every rig that it offers becomes a configuration that loads."""

import io
import itertools
from pathlib import Path

import pytest

from palmd.cli import main
from palmd.yamlfile import load_config

TAXELS = Path(__file__).parents[3] / "config/taxels"


def init(monkeypatch, path, lines, *arguments):
    monkeypatch.setattr("sys.stdin", io.StringIO("".join(f"{line}\n" for line in lines)))
    return main(["init", str(path), *arguments])


def lines(pads, arm, tilt="90", vibrate=""):
    of_pads = {
        "evdev": ["20", "y", "-40", "80"],
        "strip": ["3", "73.5"],
        "taxels": ["text", "20", "4", "3.5", "2.2", "2"],
    }.get(pads, [])
    return [pads, "/dev/a", "/dev/b", *of_pads, arm, "/dev/c", "100", "110", tilt, vibrate]


@pytest.mark.parametrize(
    ("pads", "arm"),
    list(itertools.product(("versapad", "strip", "evdev", "taxels"), ("adept", "dynamixel", "feetech"))),
)
def test_every_rig_loads(monkeypatch, tmp_path, pads, arm):
    assert init(monkeypatch, tmp_path / "new/my.yaml", lines(pads, arm)) == 0
    config = load_config(tmp_path / "new/my.yaml")
    assert {pad.kind for pad in config.pads.each()} == {pads}
    assert (config.arm.kind, config.rig.hinge) == (arm, "arc" if arm == "adept" else "fixed")
    assert [pad.port for pad in config.pads.each()] == ["/dev/a", "/dev/b"]
    assert config.plan.is_file()
    assert config.rig.palm_lengths_mm == (100.0, 110.0)
    if arm == "adept":
        assert config.rig.base_mm == (100.0, 0.0)
    if pads == "strip":
        strip = config.pads.palm1
        assert (strip.zero_mm, strip.length_mm, strip.counts_per_mm) == (3.0, 76.5, 222.9)
    if pads == "evdev":
        device = config.pads.palm1
        assert (device.counts_per_mm, device.pressure) == (20.0, True)
        assert (device.zero_mm, device.length_mm) == (-40.0, 80.0)
    if pads == "taxels":
        array = config.pads.palm1
        assert (array.protocol, array.rows, array.columns, array.pitch_mm) == ("text", 20, 4, 3.5)
        assert (array.zero_mm, array.length_mm, array.contact_width_mm) == (2.0, 70.25, 2.2)


@pytest.mark.parametrize(
    ("answers", "size"),
    [
        (["tsf85", "7", "", "", ""], (7, 4)),
        (["tsf85", "", "", "", ""], (14, 4)),
        (["st0001", "20", "", "", ""], (20, 3)),
    ],
)
def test_an_array_has_the_columns_of_its_protocol(monkeypatch, tmp_path, answers, size):
    typed = ["taxels", "/dev/a", "/dev/b", *answers, "feetech", "/dev/c", "100", "100", "", ""]
    assert init(monkeypatch, tmp_path / "my.yaml", typed) == 0
    array = load_config(tmp_path / "my.yaml").pads.palm2
    assert (array.rows, array.columns) == size


@pytest.mark.parametrize("protocol", ["tsf85", "st0001", "text"])
def test_an_array_on_enter_is_the_shipped_one(monkeypatch, tmp_path, protocol):
    typed = ["taxels", "/dev/a", "/dev/b", protocol, *[""] * 20]
    assert init(monkeypatch, tmp_path / "my.yaml", typed) == 0
    mine, shipped = (load_config(path).pads.palm1 for path in (tmp_path / "my.yaml", TAXELS / f"{protocol}.yaml"))
    for key in ("rows", "columns", "pitch_mm", "contact_width_mm", "zero_mm"):
        assert getattr(mine, key) == getattr(shipped, key), key


def test_a_trackpad_on_enter_covers_the_palm(monkeypatch, tmp_path):
    assert init(monkeypatch, tmp_path / "my.yaml", ["evdev", "/dev/a", "/dev/b", *[""] * 20]) == 0
    config = load_config(tmp_path / "my.yaml")
    assert config.pads.palm1.length_mm == config.rig.palm1_length_mm


def test_impossible_numbers_of_rows_are_asked_again(monkeypatch, tmp_path, capsys):
    typed = ["taxels", "/dev/a", "/dev/b", "tsf85", "8", "14", "", "", "", "feetech", "/dev/c", "", "", "", ""]
    assert init(monkeypatch, tmp_path / "my.yaml", typed) == 0
    assert "it must be one of 7, 14" in capsys.readouterr().err


def test_enter_accepts_the_default(monkeypatch, tmp_path):
    assert init(monkeypatch, tmp_path / "my.yaml", [""] * 20) == 0
    config = load_config(tmp_path / "my.yaml")
    assert (config.pads.palm1.kind, config.arm.kind) == ("strip", "dynamixel")
    assert config.rig.gravity_m_s2 == 9.81


@pytest.mark.parametrize(
    ("pads", "arm", "answer", "relation"),
    [
        ("strip", "dynamixel", "", "independent"),
        ("strip", "feetech", "", "independent"),
        ("strip", "dynamixel", "no", "none"),
        ("versapad", "adept", "", "none"),
        ("versapad", "adept", "yes", "independent"),
    ],
)
def test_the_kit_vibrates_and_other_rigs_on_request(monkeypatch, tmp_path, pads, arm, answer, relation):
    assert init(monkeypatch, tmp_path / "my.yaml", lines(pads, arm, vibrate=answer)) == 0
    assert load_config(tmp_path / "my.yaml").rig.vibration.relation == relation


def test_a_tilted_table_has_less_gravity(monkeypatch, tmp_path):
    init(monkeypatch, tmp_path / "my.yaml", lines("strip", "dynamixel", tilt="30"))
    assert load_config(tmp_path / "my.yaml").rig.gravity_m_s2 == pytest.approx(4.905)


def test_a_bad_answer_is_asked_again_with_the_reason(monkeypatch, tmp_path, capsys):
    answers = ["pads", "s", "/dev/a", "/dev/b", "", "", "d", "/dev/c", "", "", "steep", "200", "45", ""]
    assert init(monkeypatch, tmp_path / "my.yaml", answers) == 0
    said = capsys.readouterr().err
    assert "it must be one of versapad, strip, evdev" in said
    assert said.count("it must be a number from 1 to 90") == 2


def test_an_existing_file_is_not_overwritten(monkeypatch, tmp_path, capsys):
    path = tmp_path / "my.yaml"
    path.write_text("mine")
    assert init(monkeypatch, path, [""] * 20) == 1
    assert "exists" in capsys.readouterr().err
    assert path.read_text() == "mine"
    assert init(monkeypatch, path, [""] * 20, "--force") == 0


def test_one_port_for_two_pads_is_refused(monkeypatch, tmp_path, capsys):
    answers = lines("strip", "dynamixel")
    answers[2] = answers[1]
    assert init(monkeypatch, tmp_path / "my.yaml", answers) == 1
    assert "is already used by palm1" in capsys.readouterr().err


def test_it_ends_when_its_input_ends(monkeypatch, tmp_path, capsys):
    assert init(monkeypatch, tmp_path / "my.yaml", []) == 1
    assert "no answer" in capsys.readouterr().err
    assert not (tmp_path / "my.yaml").exists()


def test_touch_devices_keep_their_own_units_and_come_with_a_warning(monkeypatch, tmp_path, capsys):
    answers = ["evdev", "/dev/a", "/dev/b", "", "yes", "", "", "d", "/dev/c", "", "", "90", ""]
    assert init(monkeypatch, tmp_path / "my.yaml", answers) == 0
    assert "counts_per_mm" not in (tmp_path / "my.yaml").read_text()
    assert "does not sense plastic" in capsys.readouterr().err
