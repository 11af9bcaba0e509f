"""What `palmd install` puts where, and that the shipped units agree with the code."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from shut import shut

from palmd import cli
from palmd.cli import install
from palmd.cli.install import UNITS, adapted, hidden_parts, passing_parts
from palmd.console.errors import CliError
from palmd.console.shipped import shipped_service
from palmd.daemon.realtime import PRIORITY
from palmd.yamlfile import load_config

SYSTEM = Path("usr/local/lib/systemd/system")


def installed(root, *more):
    assert cli.main(["install", "--root", str(root), *more]) == 0
    return {path.relative_to(root): path for path in root.rglob("*") if path.is_file()}


def setting(unit, name):
    return re.findall(rf"^{name}=(.*)$", shipped_service(unit).read_text(), re.MULTILINE)


def test_files_are_installed_where_systemd_and_udev_expect_them(tmp_path):
    files = installed(tmp_path)
    assert {SYSTEM / unit for unit in UNITS} <= files.keys()
    assert Path("usr/local/lib/sysusers.d/palmd.conf") in files
    assert Path("etc/udev/rules.d/71-palmd-names.rules") in files
    assert {path.stat().st_mode & 0o777 for path in files.values()} == {0o644}


def test_the_installed_configuration_loads_and_records_where_the_service_may_write(tmp_path):
    config = load_config(installed(tmp_path)[Path("etc/palmd/palmd.yaml")])
    state = setting("palmd-record.service", "StateDirectory")
    assert [str(config.record.directory)] == [f"/var/lib/{name}" for name in state]
    assert config.plan is not None
    assert not config.autostart


def test_units_run_this_palmd_with_the_installed_configuration(tmp_path):
    text = installed(tmp_path)[SYSTEM / "palmd.service"].read_text()
    assert f"ExecStart={sys.prefix}/bin/palmd run --no-record /etc/palmd/palmd.yaml\n" in text
    assert "/opt/palmd" not in text or sys.prefix == "/opt/palmd"


def test_configuration_files_are_kept_and_all_others_replaced(tmp_path, capsys):
    files = installed(tmp_path)
    mine = [files[Path("etc/palmd/palmd.yaml")], files[Path("etc/udev/rules.d/71-palmd-names.rules")]]
    for path in (*mine, files[SYSTEM / "palmd.service"]):
        path.write_text("changed")
    capsys.readouterr()
    installed(tmp_path)
    assert all(path.read_text() == "changed" for path in mine)
    assert files[SYSTEM / "palmd.service"].read_text() != "changed"
    assert f"kept     {mine[0]}" in capsys.readouterr().out


def test_a_dry_run_writes_nothing_and_lists_every_file(tmp_path, capsys):
    assert installed(tmp_path / "dry", "--dry-run") == {}
    output = capsys.readouterr().out
    assert all(str(path) in output for path in installed(tmp_path / "wet"))


def test_an_unwritable_tree_is_a_one_line_error(tmp_path, capsys):
    (tmp_path / "usr").write_text("a file where a folder must be")
    assert cli.main(["install", "--root", str(tmp_path)]) == 1
    out, err = capsys.readouterr()
    assert len(err.splitlines()) == 1
    assert "palmd.service cannot be written" in err
    assert out == ""


def test_a_file_that_may_not_be_written_is_not_reported_as_written(tmp_path, capsys):
    (tmp_path / "tree").mkdir()
    with shut(tmp_path / "tree"):
        assert cli.main(["install", "--root", str(tmp_path / "tree")]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(f"{tmp_path / 'tree' / SYSTEM / UNITS[0]} may not be written: sudo ")


def test_a_step_that_the_next_boot_repeats_may_fail(capsys):
    install._follow(install.Step(["false"], vital=False), False)
    assert "next boot" in capsys.readouterr().out
    with pytest.raises(CliError, match="false failed with status 1"):
        install._follow(install.Step(["false"]), False)


def test_only_the_palmd_installation_of_a_home_folder_is_visible_to_the_service():
    unit = shipped_service("palmd.service").read_text()
    command = Path("/home/ada/palmd/.venv/bin/palmd")
    parts = [Path("/home/ada/palmd/.venv"), Path("/usr"), Path("/home/ada/palmd"), Path("/opt/python")]
    assert hidden_parts(parts) == [Path("/home/ada/palmd")]
    text = adapted(unit, command, hidden_parts(parts))
    assert "\nProtectHome=tmpfs\nBindReadOnlyPaths=/home/ada/palmd\n" in text
    assert "ProtectHome=yes" not in text
    assert f"ExecStart={command} run" in text


def test_a_palmd_among_temporary_files_is_visible_to_the_service_with_a_warning(tmp_path, capsys, monkeypatch):
    parts = [Path("/tmp/palmd/.venv"), Path("/tmp/palmd/src"), Path("/home/ada/python"), Path("/tmpfs/palmd")]
    assert hidden_parts(parts) == [Path("/home/ada/python"), *parts[:2]]
    assert passing_parts(parts) == parts[:2]
    monkeypatch.setattr(install, "_parts", lambda: parts)
    text = installed(tmp_path)[SYSTEM / "palmd.service"].read_text()
    assert "BindReadOnlyPaths=/home/ada/python /tmp/palmd/.venv /tmp/palmd/src\n" in text
    notes = [line for line in capsys.readouterr().out.splitlines() if line.startswith("note ")]
    assert [line.split()[1] for line in notes] == ["/tmp/palmd/.venv", "/tmp/palmd/src"]


def test_a_palmd_elsewhere_keeps_home_folders_hidden():
    text = adapted(shipped_service("palmd.service").read_text(), Path("/srv/palmd/bin/palmd"), [])
    assert "\nProtectHome=yes\n" in text
    assert "/opt/palmd" not in text


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="there is no systemd-analyze")
def test_systemd_analyze_verify_finds_nothing(tmp_path):
    files = installed(tmp_path)
    units = [str(files[SYSTEM / unit]) for unit in UNITS]
    done = subprocess.run(["systemd-analyze", "verify", *units], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_unit_and_code_agree():
    assert setting("palmd.service", "CPUSchedulingPriority") == [str(PRIORITY)]
    assert setting("palmd.service", "CPUSchedulingResetOnFork") == ["yes"]
    assert setting("palmd.service", "CacheDirectory") == ["palmd"]  # where model.compiled looks


@pytest.mark.parametrize("unit", UNITS)
def test_no_service_listens_on_the_network_or_gains_privileges(unit):
    assert setting(unit, "IPAddressDeny") == ["any"]
    assert setting(unit, "IPAddressAllow") == ["localhost"]
    assert setting(unit, "CapabilityBoundingSet") == [""]
    assert setting(unit, "NoNewPrivileges") == ["yes"]
    assert setting(unit, "User") == ["palmd"]
