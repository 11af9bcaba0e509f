"""A whole daemon with keys, open to the network: a client without a key receives nothing and moves nothing."""

import contextlib
import json
import time

import msgpack
import pytest
import zmq
from harness import Bench, Client, Process, free_ports, wait

from palmd import keys
from palmd.bus.command_client import CommandClient
from palmd.bus.subscriber import Subscriber
from palmd.keys import Role

pytestmark = pytest.mark.rig

MOVING = ("arm", "start", "jog", "plan", "reset", "hold", "stop")


@pytest.fixture
def guarded(tmp_path):
    """A daemon with keys on a rig, with a recorder; the bench's own client and subscriber have no key."""
    own = tmp_path / "keys"
    keys.make_pair(own, "server")
    for name in ("ann", "desk", "stranger"):
        keys.make_pair(tmp_path, name)
    keys.allow(own, tmp_path / "ann.key", Role.OPERATE)
    keys.allow(own, tmp_path / "desk.key", Role.WATCH)
    (tmp_path / "server.key").write_bytes((own / "server.key").read_bytes())
    publish, command = free_ports(2)
    bus = {"publish": f"tcp://0.0.0.0:{publish}", "command": f"tcp://0.0.0.0:{command}", "keys": str(own)}
    bench = Bench(tmp_path, record=True, bus=bus)
    bench.reach = [f"tcp://127.0.0.1:{port}" for port in (publish, command)]
    yield bench
    bench.close()


def test_only_clients_with_keys_receive_and_command(guarded, tmp_path):
    publish, command = guarded.reach

    def key(name):
        return keys.client_credentials(tmp_path / f"{name}.key_secret")

    def palmd(*arguments):
        """Exit status and output of a command."""
        process = Process(arguments, tmp_path)
        return process.wait(), process.all_said, process._out.read_text()

    with (
        CommandClient(command, 10.0, key("ann")) as operator,
        Subscriber(publish, topics=("palm/",), key=key("desk")) as watcher,
        CommandClient(command, 10.0, key("stranger")) as unknown,
        Subscriber(publish, topics=("palm/",), key=key("stranger")) as eavesdropper,
        Subscriber(publish, topics=("palm/",)) as passer_by,
        Client(command) as plain,
    ):
        status = lambda: operator.ask("status")["result"]  # noqa: E731
        wait(lambda: guarded.daemon.alive and operator.ask("status")["ok"], "an answer", pause_s=0.1)
        wait(lambda: status()["state"] == "ready", "ready", pause_s=0.1)
        for name in MOVING:
            for stranger in (plain.socket, unknown._socket):
                with contextlib.suppress(zmq.Again):  # a rejected client has nowhere to send to
                    stranger.send(msgpack.packb({"id": 1, "cmd": name}), zmq.NOBLOCK)
        assert palmd("ctl", "status", "--address", command)[0] == 3
        assert palmd("ctl", "arm", "--address", command, "--key", tmp_path / "stranger.key_secret")[0] == 3
        refused = palmd("ctl", "arm", "--address", command, "--key", tmp_path / "desk.key_secret")
        assert refused[:2] == (1, "arm refused: your key may only watch\n")
        loop = None
        for message in watcher.until(time.monotonic() + 20.0):
            loop = message.fields if message.topic == "palm/loop" else loop
            if loop is not None and loop["bus_turned_away"] >= 2 and loop["bus_forbidden"] == 1:
                break
        assert loop["bus_turned_away"] >= 2
        assert status()["state"] == "ready"
        assert guarded.rig_status()["largest_step_mm"] == 0.0
        wait(lambda: status().get("recorder"), "the recorder's own key", pause_s=0.1)

        desk = ("--key", tmp_path / "desk.key_secret")
        _, _, seen = palmd("ctl", "status", "--json", "--address", command, *desk)
        assert json.loads(seen)["result"]["state"] == "ready"
        assert palmd("ctl", "arm", "--address", command, "--key", tmp_path / "ann.key_secret")[0] == 0
        assert operator.ask("start", {"take": True})["ok"]
        wait(lambda: guarded.rig_status()["largest_step_mm"] > 0.0, "the arm moving")

        nothing = time.monotonic()
        assert list(eavesdropper.until(nothing)) == list(passer_by.until(nothing)) == []
        assert not any(stranger.poll(0) for stranger in (plain.socket, unknown._socket))
    assert not list(guarded.subscriber.frames(1))
    assert guarded.daemon.end() == 0
    recorded = wait(lambda: list(guarded.folder.glob("runs/*.mcap")), "a recording")
    assert recorded[0].stat().st_size > 10_000
