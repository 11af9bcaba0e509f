"""Files that release 0.2 has left on a machine still work: its configuration, keys and recordings.

`tests/data/0.2` is of commit 5995043c: `root` is what its `palmd install --root` wrote, with commands in `/opt/palmd`;
`run.mcap` what its `palmd demo --perfect --seconds 2.6 --seed 7` recorded at 10 ticks a second with the lively plan.
"""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
import zmq

import palmd
from palmd.cli import main
from palmd.console.shipped import shipped_service
from palmd.record.run import read_run
from palmd.yamlfile import load_config

OLD = Path(__file__).parents[1] / "data/0.2"
RUN = OLD / "run.mcap"


def files(root):
    return {path.relative_to(root): path.read_bytes() for path in root.rglob("*") if path.is_file()}


def test_an_upgrade_keeps_the_machines_own_files_and_replaces_the_rest(tmp_path, capsys):
    root = tmp_path / "root"
    shutil.copytree(OLD / "root", root)
    config = root / "etc/palmd/palmd.yaml"
    config.write_text(config.read_text().replace("palm1_length_mm: 120.0", "palm1_length_mm: 118.4"))
    names = root / "etc/udev/rules.d/71-palmd-names.rules"
    names.write_text(names.read_text() + "# of this machine\n")
    assert main(["keys", "new", "server", "-d", str(root / "etc/palmd/keys")]) == 0
    assert main(["keys", "new", "client", "desk", "--role", "operate", "-d", str(root / "etc/palmd/keys")]) == 0
    (root / "var/lib/palmd").mkdir(parents=True)
    shutil.copy(RUN, root / "var/lib/palmd/2026-11-23T06-00-00Z.mcap")
    before = files(root)
    assert main(["install", "--root", str(root)]) == 0
    after = files(root)
    own = {path for path in before if path.parts[0] in ("etc", "var")}
    assert len(own) > 9
    assert {path for path in own if before[path] != after[path]} == set()
    assert set(before) <= set(after)
    unit = Path("usr/local/lib/systemd/system/palmd.service")
    assert before[unit] != after[unit]
    assert "RuntimeDirectory=palmd" in after[unit].decode(), "needed by today's local sockets"
    capsys.readouterr()
    assert main(["check", str(config), *map(str, sorted((root / "etc/palmd/plans").iterdir()))]) == 0
    assert load_config(config).rig.palm_lengths_mm == (118.4, 120.0)
    assert main(["keys", "list", "-d", str(root / "etc/palmd/keys")]) == 0
    assert "desk" in capsys.readouterr().out
    assert main(["runs", str(root / "var/lib/palmd"), "--json"]) == 0
    assert "2026-11-23T06-00-00Z" in capsys.readouterr().out


def test_a_configuration_installed_by_0_2_keeps_its_meaning():
    """Every key in it has its value today."""
    path = OLD / "root/etc/palmd/palmd.yaml"
    written = yaml.safe_load(path.read_text())
    loaded = load_config(path).model_dump(mode="json")

    def agrees(said, now):
        if isinstance(said, dict):
            return all(agrees(value, now[key]) for key, value in said.items())
        return said == now or str(said) in str(now)  # paths are relative to the file

    assert agrees(written, loaded)


def test_services_still_have_their_names():
    for path in (OLD / "root/usr/local/lib/systemd/system").iterdir():
        assert shipped_service(path.name).exists(), "otherwise an old service would run beside today's"


def test_its_run_opens_as_tables():
    run = palmd.open(RUN)
    assert run.estimates["valid"].any()
    assert len(run.outline_xy()) >= 180
    assert len(run.contacts["s1_m"]) == len(run.estimates["psi_rad"]) > 40


@pytest.mark.parametrize(
    ("words", "status"),
    [
        (["report", "RUN", "-o", "OUT/report.html"], 0),
        (["why", "RUN"], 0),
        (["export", "RUN", "-o", "OUT/log.jsonl"], 0),
        (["export", "RUN", "-o", "OUT/outline.svg"], 0),
        (["export", "RUN", "-o", "OUT/csv", "--as", "csv"], 0),
        (["estimate", "RUN", "-o", "OUT/estimate.jsonl"], 0),
        (["reconstruct", "RUN", "-o", "OUT/result.json"], 0),
        (["runs", "recover", "RUN", "-o", "OUT/whole.mcap"], 0),
        (["replay", "RUN", "--check"], 1),  # its smoother's answers are of a model with fewer constants
    ],
)
def test_commands_read_its_run(words, status, tmp_path, capsys):
    run = str(shutil.copy(RUN, tmp_path / "run.mcap"))
    assert main([word.replace("OUT", str(tmp_path)).replace("RUN", run) for word in words]) == status
    said = capsys.readouterr().err
    if status:
        assert len(said.splitlines()) == 1
        assert "palmd estimate" in said
    if words[0] == "reconstruct":
        assert json.loads((tmp_path / "result.json").read_text())["verdict"] in ("accepted", "partial")


def test_its_run_replays_every_message_byte_for_byte(tmp_path):
    recorded = [(message.topic, message.payload) for message in read_run(RUN).messages()]
    with zmq.Context() as context, context.socket(zmq.SUB) as socket:
        socket.linger, socket.rcvhwm = 0, 0
        address = f"ipc://{tmp_path}/bus"
        socket.connect(address)
        socket.subscribe(b"")
        command = [sys.executable, "-m", "palmd", "replay", str(RUN), "--speed", "20", "--publish", address]
        heard = []
        with subprocess.Popen(command) as process:
            while process.poll() is None or socket.poll(200):
                if socket.poll(200):
                    topic, payload, *_ = socket.recv_multipart()
                    heard.append((topic.decode(), payload))
        assert process.returncode == 0
    assert [each for each in heard if each[0] != "replay/run"] == recorded
