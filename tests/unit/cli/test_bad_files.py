"""Files that people get wrong: `palmd run` and `palmd check` say where, in one line each, and nothing is begun."""

import pytest

from palmd.cli import main

PORTS = "pads: {palm1: {port: /dev/none1}, palm2: {port: /dev/none2}}\narm: {port: /dev/none3}\n"
BAD_FILES = {
    "tabs": (PORTS + "limits:\n\trate_deg_s: 90\n", "4:1:"),
    "empty": ("", "1:1:"),
    "ten-megabytes": ("# all the same\n" * 700_000, "1:1:"),
    "nan": (PORTS + "limits: {rate_deg_s: .nan}\n", "3:22:"),
    "text-for-a-number": (PORTS + 'arm2: 1\nloop: {rate_hz: "100"}\n', "4:17:"),
    "binary": ("\0\1\2", "1:1:"),
    "plan-outside-limits": (PORTS + "plan: far.yaml\nlimits: {phi1_deg: [20, 70]}\n", "far.yaml:4:"),
}
FAR = """\
name: far
repeat: forever
segments:
  - {move: {phi1_deg: 75, phi2_deg: 90}, duration_s: 0.8}
"""


@pytest.mark.parametrize("command", ["run", "check"])
@pytest.mark.parametrize("name", BAD_FILES)
def test_a_bad_file_is_told_with_its_place(tmp_path, capsys, command, name):
    text, place = BAD_FILES[name]
    config, plan = tmp_path / "palmd.yaml", tmp_path / "far.yaml"
    config.write_text(text)
    plan.write_text(FAR)
    files = [config, plan] if command == "check" and name == "plan-outside-limits" else [config]
    assert main([command, *map(str, files)]) == 1
    out, err = capsys.readouterr()
    path = plan if place.startswith("far") else config
    assert out == ""
    assert f"{path}:{place.removeprefix('far.yaml:')}" in err
    assert all(line.startswith(f"{path}:") for line in err.splitlines())
    assert len(err) < 1000
