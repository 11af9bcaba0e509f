"""Where clients look for a daemon."""

import grp
import os
import stat

import pytest

from palmd.bus import addresses
from palmd.bus.addresses import command_address, publish_address
from palmd.bus.link import COMMAND, PUBLISH
from palmd.console.errors import CliError
from palmd.daemon.bus import Bus, BusError

LOCAL = 'bus: {publish: "ipc:///run/x/p", command: "ipc:///run/x/c"}\n'


@pytest.fixture
def installed(tmp_path, monkeypatch):
    path = tmp_path / "palmd.yaml"
    monkeypatch.setattr(addresses, "INSTALLED", path)
    return path


def test_without_any_configuration_the_default_addresses_are_used(installed):
    assert not installed.exists()
    assert (publish_address(None), command_address(None)) == (PUBLISH, COMMAND)


@pytest.mark.parametrize("text", ["", "rig: {}\n", "bus: {command: 3}\n", "- 1\n", "a: [\n"])
def test_an_installed_configuration_without_addresses_gives_the_defaults(installed, text):
    installed.write_text(text)
    assert (publish_address(None), command_address(None)) == (PUBLISH, COMMAND)


def test_an_argument_precedes_the_file_and_the_file_precedes_the_installed_one(installed, tmp_path):
    installed.write_text(LOCAL)
    other = tmp_path / "other.yaml"
    other.write_text('bus: {publish: "tcp://0.0.0.0:1", command: "tcp://127.0.0.1:2"}\n')
    assert (publish_address(None), command_address(None)) == ("ipc:///run/x/p", "ipc:///run/x/c")
    assert publish_address(None, other) == "tcp://127.0.0.1:1"
    assert command_address("tcp://127.0.0.1:3", other) == "tcp://127.0.0.1:3"


def test_an_unreadable_file_is_reported(tmp_path):
    with pytest.raises(CliError, match=r"none\.yaml"):
        command_address(None, tmp_path / "none.yaml")


def test_local_sockets_are_open_to_the_user_alone_or_to_the_group(tmp_path):
    one, two = f"ipc://{tmp_path}/p", f"ipc://{tmp_path}/c"
    for group, mode in ((None, 0o600), (grp.getgrgid(os.getgid()).gr_name, 0o660)):
        bus = Bus(one, two, group=group)
        assert {stat.S_IMODE((tmp_path / each).stat().st_mode) for each in "pc"} == {mode}
        bus.close()
    with pytest.raises(BusError, match=r"bus\.group: there is no group nosuchgroup"):
        Bus(one, two, group="nosuchgroup")
