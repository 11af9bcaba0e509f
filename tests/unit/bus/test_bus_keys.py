"""A bus with keys: a listed client may do what its role allows; any other client can neither read nor send."""

import contextlib
import logging
import re
import socket
import threading
import time
from pathlib import Path

import msgpack
import pytest
import zmq

from palmd import keys
from palmd.bus.command_client import CommandClient
from palmd.console.errors import CliError
from palmd.daemon import zap_auth
from palmd.daemon.bus import Bus
from palmd.daemon.commands import COMMANDS, Reply
from palmd.keys import Role
from palmd.messages import state_fields
from palmd.quantities import STATE
from palmd.view.daemon_link import Feed, PageCommands

GENEROUS_S = 10.0
ARGS = {"plan": {"path": "x"}, "note": {"text": "x"}, "recorder": {"bytes": 0, "messages": 0, "lost": 0}}


class Rig:
    """A guarded bus that answers each request that passes, and its clients."""

    def __init__(self, folder):
        self.folder, self.own = folder, folder / "keys"
        keys.make_pair(self.own, "server")
        for name, role in (("ann", Role.OPERATE), ("desk", Role.WATCH)):
            self.make(name)
            keys.allow(self.own, folder / f"{name}.key", role)
        self.make("stranger")
        (folder / "server.key").write_bytes((self.own / "server.key").read_bytes())
        self.bus = Bus("tcp://127.0.0.1:*", "tcp://127.0.0.1:*", keys.server_keys(self.own))
        self.publish, self.command = (socket.last_endpoint.decode() for socket in self.bus._sockets)
        self.context = zmq.Context()
        self.granted, self.whos, self.clients = [], [], []

    def make(self, name):
        keys.make_pair(self.folder, name)

    def credentials(self, name):
        return keys.client_credentials(self.folder / f"{name}.key_secret")

    def client(self, kind, credentials=None, address=None):
        made = self.context.socket(kind)
        made.linger = 0
        self.clients.append(made)
        if credentials is not None:
            credentials.encrypt(made)
        if kind == zmq.SUB:
            made.subscribe(b"")
        made.connect(address or (self.publish if kind == zmq.SUB else self.command))
        return made

    def turn(self):
        """One tick of the loop's work on the bus."""
        for request in self.bus.receive():
            self.granted.append(request.name)
            self.whos.append(request.who)
            self.bus.reply(Reply(request, None, {}))
        self.bus.publish(STATE, state_fields("idle", []), 0.0, 0.0)

    def until(self, holds):
        t_end = time.monotonic() + GENEROUS_S
        while not holds():
            assert time.monotonic() < t_end, "timed out"
            self.turn()
            time.sleep(1e-3)

    def ask(self, client, command, id=1):
        client.send(msgpack.packb({"id": id, "cmd": command, "args": ARGS.get(command, {})}))
        self.until(lambda: client.poll(0))
        return msgpack.unpackb(client.recv_multipart()[-1])

    def close(self):
        self.context.destroy(linger=0)
        self.bus.close()


@pytest.fixture
def rig(tmp_path):
    rig = Rig(tmp_path)
    yield rig
    rig.close()


def test_each_role_is_granted_exactly_the_commands_of_the_table(rig):
    watcher, operator = (rig.client(zmq.DEALER, rig.credentials(name)) for name in ("desk", "ann"))
    for command in COMMANDS:
        reply = rig.ask(watcher, command, id=command)
        if command == "status":
            assert reply == {"id": "status", "ok": True, "result": {}}
        else:
            assert reply == {"id": command, "ok": False, "error": f"{command} refused: your key may only watch"}
    assert rig.granted == ["status"]
    assert rig.bus.fields()["bus_forbidden"] == len(COMMANDS) - 1
    for command in COMMANDS:
        assert rig.ask(operator, command)["ok"]
    assert rig.granted[1:] == list(COMMANDS)


def test_a_client_is_identified_by_its_key_not_by_the_name_it_sends(rig):
    operator = rig.client(zmq.DEALER, rig.credentials("ann"))
    operator.send(msgpack.packb({"id": 1, "cmd": "arm", "from": "bob"}))
    operator.send(msgpack.packb({"id": 2, "cmd": "arm"}))
    rig.until(lambda: len(rig.whos) == 2)
    assert rig.whos == ["ann, by bob", "ann"]


def test_both_roles_and_the_daemons_own_recorder_receive_published_messages(rig):
    listening = [
        rig.client(zmq.SUB, credentials)
        for credentials in (rig.credentials("ann"), rig.credentials("desk"), keys.own_credentials(rig.own))
    ]
    for client in listening:
        rig.until(lambda client=client: client.poll(0))
    assert rig.ask(rig.client(zmq.DEALER, keys.own_credentials(rig.own)), "recorder")["ok"]


def test_a_page_subscribes_to_a_daemon_with_keys_and_to_a_rig_without(rig):
    truth = rig.context.socket(zmq.PUB)
    rig.clients.append(truth)
    truth.bind("tcp://127.0.0.1:*")
    feed = Feed(rig.publish, truth.last_endpoint.decode(), rig.credentials("desk"))

    def both():
        truth.send_multipart((b"rig/truth", msgpack.packb({}), b"0"))
        feed.take()
        return {"palm/state", "rig/truth"} <= feed.latest.keys()

    with contextlib.closing(feed), contextlib.closing(PageCommands(rig.command, rig.credentials("ann"))) as desk:
        rig.until(both)
        rig.until(lambda: desk.open)
        desk.send("hold", {}, 0.0, "page 1")
        rig.until(lambda: rig.granted == ["hold"])


def test_the_subscriber_of_the_manual_works_with_keys(rig):
    page = (Path(__file__).parents[3] / "docs/operate/subscribing.md").read_text()
    (code,) = re.findall(r"```python\n(from zmq.auth.*?)```", page, flags=re.DOTALL)
    made = rig.context.socket(zmq.SUB)
    rig.clients.append(made)
    with contextlib.chdir(rig.folder):
        exec(code, {"socket": made})
    made.subscribe("palm/")
    made.connect(rig.publish)
    rig.until(lambda: made.poll(0))


def strangers(rig):
    """Credentials that must be rejected, by what is wrong with them."""
    right, other = rig.credentials("stranger"), rig.credentials("ann")
    fresh = keys.KeyPair(*zmq.curve_keypair())
    return {
        "no key": None,
        "a key that is not listed": right,
        "a listed public key without its secret": keys.Credentials(
            keys.KeyPair(other.pair.public, right.pair.secret), right.server
        ),
        "the server's public key without its secret": keys.Credentials(
            keys.KeyPair(right.server, fresh.secret), right.server
        ),
        "another server's key": keys.Credentials(other.pair, fresh.public),
    }


def test_a_client_with_wrong_credentials_neither_reads_nor_sends(rig):
    knocking = {}
    for what, credentials in strangers(rig).items():
        knocking[what] = [rig.client(kind, credentials) for kind in (zmq.SUB, zmq.DEALER, zmq.REQ)]
        for kind in knocking[what][1:]:
            kind.send(msgpack.packb({"id": 1, "cmd": "stop"}))
    witness, heard = rig.client(zmq.SUB, rig.credentials("desk")), []
    rig.until(lambda: rig.bus.fields()["bus_turned_away"] >= 3)
    rig.until(lambda: witness.poll(0) and (heard.append(witness.recv_multipart()) or len(heard) > 200))
    assert rig.ask(rig.client(zmq.DEALER, rig.credentials("ann")), "hold")["ok"]
    for what, clients in knocking.items():
        assert not any(client.poll(0) for client in clients), what
    assert rig.granted == ["hold"]
    assert rig.bus.counters.commands == 1


def test_a_rejected_client_gets_the_reason_with_each_request(rig):
    with CommandClient(rig.command, 0.3, rig.credentials("stranger")) as client:
        rig.until(lambda: rig.bus.fields()["bus_turned_away"])
        for _ in range(2):
            with pytest.raises(CliError, match="does it allow this key"):
                client.ask("status")


def test_a_client_of_an_old_protocol_is_disconnected(rig):
    old = {
        "ZMTP 1.0": b"\x01\x00",
        "ZMTP 2.0": b"\xff" + bytes(8) + b"\x7f\x01\x05\x00\x00",
        "ZMTP 3 with mechanism NULL": b"\xff" + bytes(8) + b"\x7f\x03\x00NULL" + bytes(16) + b"\x00" + bytes(31),
        "ZMTP 3 with mechanism PLAIN": b"\xff" + bytes(8) + b"\x7f\x03\x00PLAIN" + bytes(15) + b"\x00" + bytes(31),
        "junk": b"GET / HTTP/1.0\r\n\r\n",
    }
    subscribe_all = b"\x00\x01\x01"
    status = b"\x00" + bytes([14]) + msgpack.packb({"id": 1, "cmd": "stop"})
    for address, more in ((rig.publish, subscribe_all), (rig.command, status)):
        for what, greeting in old.items():
            with dialled(address) as line:
                said = spoken_to_the_end(rig, line, greeting + more)
            assert b"palm/" not in said, what
    assert rig.bus.counters.commands == 0


def test_recorded_traffic_of_an_operator_cannot_be_replayed(rig):
    with Wiretap(rig.command) as tap:
        assert rig.ask(rig.client(zmq.DEALER, rig.credentials("ann"), tap.address), "arm")["ok"]
    assert len(tap.sent) > 500
    assert b"arm" not in tap.sent.replace(b"READY", b"")
    granted, commands = len(rig.granted), rig.bus.counters.commands
    with dialled(rig.command) as line:
        spoken_to_the_end(rig, line, bytes(tap.sent))
    assert (len(rig.granted), rig.bus.counters.commands) == (granted, commands)


def test_commands_cannot_be_read_or_changed_in_transit(rig):
    with Wiretap(rig.command, garble=True) as tap:
        client = rig.client(zmq.DEALER, rig.credentials("ann"), tap.address)
        client.send(msgpack.packb({"id": 1, "cmd": "arm"}))
        rig.until(lambda: tap.garbled)
        assert rig.ask(rig.client(zmq.DEALER, rig.credentials("ann")), "hold")["ok"]
    assert rig.granted == ["hold"]


def test_a_revoked_key_is_rejected_after_a_restart(rig):
    keys.revoke(rig.own, "ann")
    rig.bus.close()
    rig.bus = Bus(rig.publish, rig.command, keys.server_keys(rig.own))
    revoked = rig.client(zmq.DEALER, rig.credentials("ann"))
    revoked.send(msgpack.packb({"id": 1, "cmd": "stop"}))
    rig.until(lambda: rig.bus.fields()["bus_turned_away"])
    assert rig.ask(rig.client(zmq.DEALER, rig.credentials("desk")), "status")["ok"]
    assert rig.granted == ["status"]


def test_rejected_clients_are_logged_at_a_limited_rate(rig, caplog):
    caplog.set_level(logging.WARNING)
    clients = [rig.client(zmq.DEALER, rig.credentials("stranger")) for _ in range(5)]
    rig.until(lambda: rig.bus.fields()["bus_turned_away"] >= len(clients))
    (line,) = [record.getMessage() for record in caplog.records if "bus: rejected" in record.getMessage()]
    assert "1 connection(s) with unknown keys, the last from 127.0.0.1" in line
    assert rig.credentials("stranger").pair.public.decode() in line


@pytest.mark.parametrize("what", ["no key", "another server's key"])
def test_a_client_that_proves_no_key_is_counted_and_logged(rig, caplog, what):
    caplog.set_level(logging.WARNING)
    right = rig.credentials("ann")
    wrong = {
        "no key": None,
        "another server's key": keys.Credentials(right.pair, rig.credentials("stranger").pair.public),
    }
    for kind in (zmq.SUB, zmq.DEALER):
        before = rig.bus.fields()["bus_unproven"]
        client = rig.client(kind, wrong[what])
        rig.until(lambda before=before: rig.bus.fields()["bus_unproven"] > before)
        client.close()
    assert rig.ask(rig.client(zmq.DEALER, right), "hold")["ok"]
    (line,) = [record.getMessage() for record in caplog.records if "wrong server.key" in record.getMessage()]
    assert rig.publish in line
    assert (rig.bus.fields()["bus_turned_away"], rig.granted) == (0, ["hold"])


def test_without_its_authenticator_the_bus_rejects_every_client(rig):
    rig.bus._authenticator.close()
    client = rig.client(zmq.SUB, rig.credentials("ann"))
    with client.get_monitor_socket(zmq.EVENT_DISCONNECTED | zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL) as monitor:
        rig.until(lambda: monitor.poll(0))
        assert not client.poll(0)
        client.disable_monitor()


def test_the_bus_closes_while_rejected_clients_are_connected(rig, monkeypatch):
    monkeypatch.setattr(zap_auth, "PAUSE_S", 0.05)
    for _ in range(20):
        rig.client(zmq.DEALER, rig.credentials("stranger"))
    rig.until(lambda: rig.bus.fields()["bus_turned_away"] >= 2)
    rig.bus.close()
    assert not any(thread.name == "door" for thread in threading.enumerate())


# ------------------------------------------------------------------------------------------------- on the wire


@contextlib.contextmanager
def dialled(address):
    host, port = address.removeprefix("tcp://").split(":")
    with socket.create_connection((host, int(port)), GENEROUS_S) as line:
        yield line


def spoken_to_the_end(rig, line, data):
    """All bytes that are sent in answer to `data` until the connection closes."""
    said, over = bytearray(), threading.Event()

    def listen():
        with contextlib.suppress(ConnectionError):
            while part := line.recv(4096):
                said.extend(part)
        over.set()

    with contextlib.suppress(ConnectionError):
        line.sendall(data)
    threading.Thread(target=listen, daemon=True).start()
    rig.until(over.is_set)
    return bytes(said)


class Wiretap:
    """A proxy that records what the client sends; with `garble` it flips one bit of each message."""

    def __init__(self, address, garble=False):
        self.sent, self.garbled = bytearray(), 0
        self._garble, self._ends = garble, []
        self._there = address
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"tcp://127.0.0.1:{self._listener.getsockname()[1]}"

    def __enter__(self):
        threading.Thread(target=self._accept, daemon=True).start()
        return self

    def __exit__(self, *_):
        self._listener.close()
        for end in self._ends:
            end.close()

    def _accept(self):
        with contextlib.suppress(OSError):
            while True:
                near, _ = self._listener.accept()
                host, port = self._there.removeprefix("tcp://").split(":")
                far = socket.create_connection((host, int(port)))
                self._ends += [near, far]
                for source, sink, tapped in ((near, far, True), (far, near, False)):
                    threading.Thread(target=self._pass_on, args=(source, sink, tapped), daemon=True).start()

    def _pass_on(self, source, sink, tapped):
        with contextlib.suppress(OSError):
            while part := source.recv(65536):
                if tapped:
                    self.sent += part
                    at = part.find(b"\x07MESSAGE")
                    if self._garble and at >= 0:
                        self.garbled += 1
                        part = part[: at + 30] + bytes([part[at + 30] ^ 1]) + part[at + 31 :]
                sink.sendall(part)
            sink.shutdown(socket.SHUT_RDWR)
