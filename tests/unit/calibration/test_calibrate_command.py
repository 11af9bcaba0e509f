"""`palmd calibrate pad`: what it stores and prints, and its messages when it cannot measure."""

import os
import sys
import tty
from dataclasses import replace

import pytest
import terminals
import yaml

import palmd.calibration
from palmd.calibration import pad
from palmd.calibration.pad_characteristic import characterise
from palmd.cli import main
from palmd.config.any_config import config_hash
from palmd.config.pads import VersaPadConfig
from palmd.console.extras import install_line
from palmd.console.shipped import shipped
from palmd.devices.port import Port
from palmd.devices.versapad import encode_packet
from palmd.rig.pads import PadOptions
from palmd.yamlfile import load_config
from tools.rolled_marble import rolled

CONFIG = "pads: {{palm1: {{port: {port}{more}}}, palm2: {{port: /dev/none2}}}}\narm: {{port: /dev/none3}}\n"


@pytest.fixture
def configured(tmp_path):
    """Write a configuration whose first pad has this port and further keys."""

    def write(port="/dev/none1", more=""):
        path = tmp_path / "palmd.yaml"
        path.write_text(CONFIG.format(port=port, more=more))
        return path

    return write


@pytest.fixture
def line():
    with terminals.line() as ends:
        yield ends


def marble(monkeypatch, change=lambda packets: packets, batches=None, made_for=None, **options):
    """Emulate the pad: no port and no waiting."""

    def listen(number, config, seconds):
        packets, counters = rolled(made_for or config, 1, seconds, PadOptions(**options))
        counters.batches = counters.batches if batches is None else batches
        return change(packets), counters.as_dict()

    monkeypatch.setattr(pad, "_listen", listen)


def on_first_wait(monkeypatch, act):
    """Act once the port is open; opening it discards earlier bytes."""

    class Waiter(pad.PortWaiter):
        acted = False

        def wait(self, t_deadline):
            if not self.acted:
                self.acted = True
                act()
            return super().wait(t_deadline)

    monkeypatch.setattr(pad, "PortWaiter", Waiter)


def calibrate(config, *more, pad=1):
    return main(["calibrate", "pad", str(config), "--pad", str(pad), *map(str, more)])


def refused(config, status, capsys, *more):
    """The one line of its error message."""
    assert calibrate(config, *more) == status
    out, err = capsys.readouterr()
    assert out == ""
    assert not list(config.parent.glob("**/pad*"))
    return err.splitlines()[-1]


def test_result_and_figure_are_stored_beside_the_configuration(configured, monkeypatch, capsys):
    marble(monkeypatch, noise_m=2e-4)
    config = configured()
    assert calibrate(config) == 0
    result = yaml.safe_load((config.parent / "calibration/pad1.yaml").read_text())
    assert (result["palmd_pad_characteristic"], result["pad"]) == (1, 1)
    noise_mm = result["configuration"]["noise_mm"]
    assert noise_mm == pytest.approx(0.2, rel=0.1)
    assert noise_mm == round(result["found"]["x"]["noise_mm"], 3)
    assert result["found"]["interval_mean_ms"] == pytest.approx(10.0, rel=0.1)
    assert [band["packet_times"] for band in result["found"]["bands"]] == [1, 2, 3]
    assert result["found"]["dead_band_n"] == pytest.approx(0.04, abs=0.021)
    assert (config.parent / "calibration/pad1.svg").read_text().startswith("<?xml")
    assert sorted(path.name for path in (config.parent / "calibration").iterdir()) == ["pad1.svg", "pad1.yaml"]
    out, err = capsys.readouterr()
    assert out.startswith("pad1: ")
    assert f"{config}: write in pads.palm1: noise_mm: {noise_mm}\n" in out
    assert err == ""
    before = load_config(config).pads.palm1
    configured(more=f", noise_mm: {noise_mm}")
    after = load_config(config).pads.palm1
    assert config_hash(after) == result["settings_sha256"] != config_hash(before)
    assert main(["check", str(config)]) == 0


def test_the_configured_axis_and_the_output_folder_are_used(configured, monkeypatch, tmp_path):
    marble(monkeypatch, noise_m=3e-4)
    config = configured(more=", axis: y")
    assert calibrate(config, "-o", tmp_path / "a/b") == 0
    result = yaml.safe_load((tmp_path / "a/b/pad1.yaml").read_text())
    assert result["configuration"]["noise_mm"] == round(result["found"]["y"]["noise_mm"], 3)
    assert result["found"]["y"]["noise_mm"] == pytest.approx(0.3, rel=0.1)


def test_noise_below_the_rounding_gives_a_valid_setting():
    config = VersaPadConfig(port="p")
    packets, counters = rolled(config, 1, 20.0)
    found = characterise(packets, counters.as_dict(), config)
    for noise, noise_sd, message in (
        (0.0, 0.004, 0.004),
        (0.002, 0.004, 0.004),
        (0.0, 0.0, 0.001),
        (0.1234, 0.004, 0.123),
    ):
        hidden = replace(found, x=replace(found.x, noise_mm=noise, noise_sd_mm=noise_sd))
        assert pad.noise_mm(hidden, config) == message
        assert VersaPadConfig(port="p", noise_mm=message).noise_mm == message


def test_a_pad_that_disagrees_with_its_configuration_causes_remarks(configured, monkeypatch, capsys):
    def coarse(packets):
        return [replace(each, x_counts=4 * round(each.x_counts / 4), batched=True) for each in packets]

    marble(monkeypatch, coarse, batches=100, made_for=VersaPadConfig(port="p"))
    assert calibrate(configured(more=", length_mm: 45")) == 0
    err = capsys.readouterr().err
    assert "reports are outside the pad: check zero_mm" in err
    assert "positions come in steps of 4 counts" in err
    assert "100 reads held several reports" in err


def test_without_matplotlib_the_result_is_stored_without_a_figure(configured, monkeypatch, capsys):
    marble(monkeypatch)
    monkeypatch.delitem(sys.modules, "palmd.calibration.pad_figure", raising=False)
    monkeypatch.delattr(palmd.calibration, "pad_figure", raising=False)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    config = configured()
    assert calibrate(config) == 0
    message = f"no figure: matplotlib is not installed: {install_line('matplotlib', 'report')}\n"
    assert capsys.readouterr().err == message
    assert [path.name for path in (config.parent / "calibration").iterdir()] == ["pad1.yaml"]


def test_a_failure_keeps_an_earlier_result(configured, monkeypatch, capsys):
    config = configured()
    stored = config.parent / "calibration/pad1.yaml"
    stored.parent.mkdir()
    stored.write_text("precious\n")
    assert calibrate(config) == 3
    marble(monkeypatch)
    assert calibrate(config, "--seconds", 2, "--pad", 2) == 0  # the other pad's
    assert stored.read_text() == "precious\n"


def test_a_port_held_by_another_process_is_reported(configured, line, capsys):
    holder = Port("daemon", line[1], 9600)
    assert holder.poll_open(0.0)
    message = refused(configured(line[1]), 3, capsys)
    holder.close()
    assert message.startswith(f"pad1: {line[1]} is held by another process: end it")


@pytest.mark.parametrize(
    ("heard", "seconds", "message"),
    [
        (encode_packet(0, 0, 0, in_use=False), 20, "no report within 0 s: nobody has touched the pad"),
        (b"\x15" * 10, 20, "10 bytes, but no report among them at 9600 baud: check pad and baud rate"),
        (encode_packet(0, 0, 50), 2, "too few reports (1 of at least 150): roll the marble for longer"),
    ],
    ids=["lift-off", "garbage", "few"],
)
def test_reports_that_are_not_of_a_rolled_marble_are_refused(
    configured, line, monkeypatch, capsys, heard, seconds, message
):
    monkeypatch.setattr(pad, "FIRST_TOUCH_S", 0.3)
    on_first_wait(monkeypatch, lambda: os.write(line[0], heard))
    assert refused(configured(line[1]), 3, capsys, "--seconds", seconds).startswith(f"pad1: {message}")


def test_a_lost_port_is_reported(configured, monkeypatch, capsys):
    master, slave = os.openpty()
    tty.setraw(slave)
    path = os.ttyname(slave)
    os.close(slave)
    on_first_wait(monkeypatch, lambda: os.close(master))
    assert f"pad1: {path} was lost" in refused(configured(path), 3, capsys)


def test_a_pad_that_does_not_answer_the_handshake_is_reported(configured, line, monkeypatch, capsys):
    monkeypatch.setattr(pad, "FIRST_TOUCH_S", 1.8)
    message = refused(configured(line[1], ", handshake: break"), 3, capsys)
    assert message.startswith("pad1: no identity within 1 s after the break")


def test_invalid_configurations_are_reported_with_their_place(configured, tmp_path, capsys):
    assert "no such file" in refused(tmp_path / "none.yaml", 1, capsys)
    for noise in ("0", "-0.1", "5.1", ".nan", "true", '"0.1"'):
        config = configured(more=f", noise_mm: {noise}")
        assert refused(config, 1, capsys).startswith(f"{config}:1:44: pads.palm1.noise_mm: must be ")
        assert main(["check", str(config)]) == 1
        assert capsys.readouterr().err.startswith(f"{config}:1:44: pads.palm1.noise_mm: must be ")


def test_a_folder_that_cannot_be_written_is_reported(configured, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert "cannot be written" in refused(configured(), 1, capsys, "-o", tmp_path / "file")


def test_gravity_calibration_refuses_curved_palms(capsys):
    assert main(["calibrate", "gravity", str(shipped("cradle.yaml"))]) == 1
    assert "supports flat palms only, and these are curved" in capsys.readouterr().err


def test_the_same_reports_give_the_same_figure(configured, monkeypatch):
    marble(monkeypatch)
    config = configured()
    figures = []
    for _ in range(2):
        assert calibrate(config, "--seconds", 3) == 0
        figures.append((config.parent / "calibration/pad1.svg").read_bytes())
    assert figures[0] == figures[1]


def test_the_obsolete_option_is_accepted_but_not_shown_in_help(tmp_path, capsys):
    assert main(["calibrate", "pad", "--characterise", str(tmp_path / "none.yaml"), "--pad", "1"]) == 1
    assert "none.yaml:1:1: no such file" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["calibrate", "pad", "--help"])
    assert "characterise" not in capsys.readouterr().out
